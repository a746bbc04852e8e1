//! Vectors of integers of any type, as NumPy keeps them: labels, and maps of vertices.
//!
//! One pass over the mapped file; the vector made is all that is held.

use crate::base::{Error, Result};
use crate::store::MappedBytes;
use npyz::{Deserialize, NpyFile};
use std::path::Path;

/// Reads the vector in `path`, each item as `convert` has it; where that gives `None`, the error says that the item
/// `problem`, and what to do about it is `remedy`.
///
/// # Errors
/// [`Error::Malformed`] for an array that is no vector of integers, or an item that does not convert; [`Error::Io`].
pub(super) fn read_integers<R>(
    path: &Path,
    convert: impl Fn(i128) -> Option<R>,
    problem: &str,
    remedy: &str,
) -> Result<Vec<R>> {
    let bytes = MappedBytes::open(path)?;
    let wrong = |problem: String| Error::malformed(path, "array", problem, remedy);
    let header = npyz::NpyHeader::from_reader(&bytes[..]).map_err(|error| wrong(error.to_string()))?;
    if header.shape().len() != 1 {
        return Err(wrong(format!("has {} dimensions", header.shape().len())));
    }
    let descr = header.dtype().descr();
    match descr.trim_matches('\'').get(1..) {
        Some("u1") => items::<u8, R>(&bytes, convert, problem),
        Some("u2") => items::<u16, R>(&bytes, convert, problem),
        Some("u4") => items::<u32, R>(&bytes, convert, problem),
        Some("u8") => items::<u64, R>(&bytes, convert, problem),
        Some("i1") => items::<i8, R>(&bytes, convert, problem),
        Some("i2") => items::<i16, R>(&bytes, convert, problem),
        Some("i4") => items::<i32, R>(&bytes, convert, problem),
        Some("i8") => items::<i64, R>(&bytes, convert, problem),
        _ => Err(format!("has items {descr}")),
    }
    .map_err(wrong)
}

fn items<T: Deserialize + Into<i128>, R>(
    bytes: &[u8],
    convert: impl Fn(i128) -> Option<R>,
    problem: &str,
) -> std::result::Result<Vec<R>, String> {
    let file = NpyFile::new(bytes).map_err(|error| error.to_string())?;
    let items = file.data::<T>().map_err(|error| error.to_string())?;
    let one = |(k, item): (usize, std::io::Result<T>)| {
        let item = item.map_err(|error| error.to_string())?;
        convert(item.into()).ok_or_else(|| format!("item {k} {problem}"))
    };
    items.enumerate().map(one).collect()
}
