//! Vectors of integers of any type, as NumPy keeps them: labels, and maps of vertices.
//!
//! One pass over the mapped file; the vector made is all that is held.

use crate::base::{Error, Result};
use crate::store::{MappedBytes, npy_header};
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
    let header = npy_header::parse(&bytes).map_err(wrong)?;
    let &[len] = &header.shape[..] else { return Err(wrong(format!("has {} dimensions", header.shape.len()))) };
    let data = &bytes[header.data..];
    let (order, kind) = header.descr.split_at_checked(1).unwrap_or_default();
    let big = order == ">";
    let read: fn(&[u8], bool) -> i128 = match kind {
        "u1" | "u2" | "u4" | "u8" => unsigned,
        "i1" | "i2" | "i4" | "i8" => signed,
        _ => return Err(wrong(format!("has items {}", header.descr))),
    };
    let width = usize::from(kind.as_bytes()[1] - b'0');
    if data.len() / width < len as usize {
        return Err(wrong(format!("is cut short: {len} items are declared, {} are there", data.len() / width)));
    }
    let one = |(k, item)| convert(read(item, big)).ok_or_else(|| wrong(format!("item {k} {problem}")));
    data.chunks_exact(width).take(len as usize).enumerate().map(one).collect()
}

/// Bytes as a number, the first the lowest unless `big`.
fn unsigned(bytes: &[u8], big: bool) -> i128 {
    let add = |number: i128, &byte: &u8| number << 8 | i128::from(byte);
    if big { bytes.iter().fold(0, add) } else { bytes.iter().rev().fold(0, add) }
}

/// As [`unsigned`], in two's complement.
fn signed(bytes: &[u8], big: bool) -> i128 {
    let shift = 128 - 8 * bytes.len();
    unsigned(bytes, big) << shift >> shift
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integers_of_all_widths_and_both_orders_are_read() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.npy");
        let read = |descr: &str, data: &[u8]| {
            let text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': (2,), }}\n");
            let bytes = [b"\x93NUMPY\x01\x00", &(text.len() as u16).to_le_bytes()[..], text.as_bytes(), data].concat();
            std::fs::write(&path, bytes).unwrap();
            read_integers(&path, |item| (item != 77).then_some(item), "is 77", "give others").map_err(|e| e.to_string())
        };
        assert_eq!(read("|u1", &[255, 1]).unwrap(), [255, 1]);
        assert_eq!(read("|i1", &[255, 1]).unwrap(), [-1, 1]);
        assert_eq!(read("<u2", &[1, 2, 255, 255]).unwrap(), [513, 65535]);
        assert_eq!(read(">u2", &[1, 2, 255, 255]).unwrap(), [258, 65535]);
        assert_eq!(read("<i4", &[0, 0, 0, 128, 1, 0, 0, 0]).unwrap(), [-(1 << 31), 1]);
        assert_eq!(read(">i8", &[255; 16]).unwrap(), [-1, -1]);
        assert_eq!(read("<u8", &[255; 16]).unwrap(), [u64::MAX.into(); 2]);
        assert!(read("<u8", &[255; 15]).unwrap_err().contains("2 items are declared, 1 are there"));
        assert!(read("|u1", &[5, 77]).unwrap_err().contains("item 1 is 77"));
        assert!(read("<f4", &[0; 8]).unwrap_err().contains("has items <f4"));
        assert!(read("", &[0; 8]).unwrap_err().contains("has items"));
    }
}
