//! Vectors of integers of any type, as stored by NumPy: labels, and maps of vertices.
//!
//! One pass over the mapped file; only the resulting vector is in memory. Labels can go to a file instead.

use crate::base::{Error, Result};
use crate::mesh::seg::each_label_or_none;
use crate::store::npy::{self, ArrayWriter};
use crate::store::{MappedBytes, MappedSlice, WorkDir, npy_header};
use std::ffi::OsStr;
use std::path::Path;

/// Reads the vector in `path`, each item converted by `convert`; if that returns `None`, the error names the item, the
/// `problem` and the `remedy`.
///
/// # Errors
/// [`Error::Malformed`] for an array that is not a vector of integers, or an item that cannot be converted;
/// [`Error::Io`].
#[cfg(any(feature = "correspondence", test))]
pub(super) fn read_integers<R>(
    path: &Path,
    convert: impl Fn(i128) -> Option<R>,
    problem: &str,
    remedy: &str,
) -> Result<Vec<R>> {
    let mut all = Vec::new();
    let push = |item| {
        all.push(item);
        Ok(())
    };
    each_integer(path, convert, problem, remedy, push)?;
    Ok(all)
}

/// Calls `visit` with the same items, one after the other.
fn each_integer<R>(
    path: &Path,
    convert: impl Fn(i128) -> Option<R>,
    problem: &str,
    remedy: &str,
    mut visit: impl FnMut(R) -> Result<()>,
) -> Result<()> {
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
    if ((data.len() / width) as u64) < len {
        return Err(wrong(format!(
            "is cut short: {len} items are declared, but only {} are present",
            data.len() / width
        )));
    }
    for (k, item) in data.chunks_exact(width).take(len as usize).enumerate() {
        let item = read(item, big);
        visit(convert(item).ok_or_else(|| wrong(format!("item {k} is {item}, {problem}")))?)?;
    }
    Ok(())
}

/// Labels (n) from a `.seg` file or a `.npy` file, a vector of integers of any type; in both, a negative number means
/// that a face has no label, and becomes `u32::MAX`, which means the same. A vector of `u32` is used in place; others
/// are converted item by item to an array in `work`.
///
/// # Errors
/// [`Error::Unusable`] for another extension or a file without labels; [`Error::Malformed`] naming the line or the item
/// that is not a label; [`Error::Io`].
pub fn open_labels(path: &Path, work: &WorkDir) -> Result<MappedSlice<u32>> {
    const FILE: &str = "given_labels.npy";
    match path.extension().and_then(OsStr::to_str).map(str::to_ascii_lowercase).as_deref() {
        Some("seg") => {
            let mut writer = ArrayWriter::create(&work.file(FILE), 1)?;
            each_label_or_none(path, |label| writer.push(&[label]))?;
            writer.finish(false)
        }
        Some("npy") => {
            if let Ok((labels, shape)) = npy::open_shaped(path)
                && shape.len() == 1
            {
                return Ok(labels);
            }
            let label_or_none = |item: i128| if item < 0 { Some(u32::MAX) } else { u32::try_from(item).ok() };
            let mut writer = ArrayWriter::create(&work.file(FILE), 1)?;
            let remedy = "give a vector of integers up to 4294967294; negative ones for faces without a label";
            each_integer(path, label_or_none, "beyond 32 bits", remedy, |label| writer.push(&[label]))?;
            writer.finish(false)
        }
        _ => Err(Error::unusable(path, "unknown extension for labels", "give a .seg or .npy file")),
    }
}

/// Bytes as an unsigned number, little-endian unless `big`.
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

    /// Writes an array of two items of the type `descr`.
    fn write(path: &Path, descr: &str, data: &[u8]) {
        let text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': (2,), }}\n");
        let bytes = [b"\x93NUMPY\x01\x00", &(text.len() as u16).to_le_bytes()[..], text.as_bytes(), data].concat();
        std::fs::write(path, bytes).unwrap();
    }

    /// Regression: a negative number was accepted in a mesh's own labels, but an error in an array.
    #[test]
    fn a_negative_integer_is_no_label() {
        let dir = tempfile::tempdir().unwrap();
        let work = WorkDir::temporary(dir.path()).unwrap();
        let path = dir.path().join("x.npy");
        let write = |labels: [i64; 2]| write(&path, "<i8", bytemuck::bytes_of(&labels.map(i64::to_le)));
        write([3, 1 << 40]);
        assert!(open_labels(&path, &work).unwrap_err().to_string().contains("item 1 is 1099511627776, beyond 32 bits"));
        write([3, -7]);
        assert_eq!(open_labels(&path, &work).unwrap()[..], [3, u32::MAX]);
        // Regression: it was an error in a .seg file, although the documentation describes both formats alike.
        let path = dir.path().join("x.seg");
        std::fs::write(&path, "3\n-7\n").unwrap();
        assert_eq!(open_labels(&path, &work).unwrap()[..], [3, u32::MAX]);
        std::fs::write(&path, "3\n4294967296\n").unwrap();
        assert!(open_labels(&path, &work).unwrap_err().to_string().contains("line 2: \"4294967296\" is not a label"));
    }

    #[test]
    fn integers_of_all_widths_and_both_orders_are_read() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.npy");
        let read = |descr: &str, data: &[u8]| {
            write(&path, descr, data);
            read_integers(&path, |item| (item != 77).then_some(item), "odd", "give others").map_err(|e| e.to_string())
        };
        assert_eq!(read("|u1", &[255, 1]).unwrap(), [255, 1]);
        assert_eq!(read("|i1", &[255, 1]).unwrap(), [-1, 1]);
        assert_eq!(read("<u2", &[1, 2, 255, 255]).unwrap(), [513, 65535]);
        assert_eq!(read(">u2", &[1, 2, 255, 255]).unwrap(), [258, 65535]);
        assert_eq!(read("<i4", &[0, 0, 0, 128, 1, 0, 0, 0]).unwrap(), [-(1 << 31), 1]);
        assert_eq!(read(">i8", &[255; 16]).unwrap(), [-1, -1]);
        assert_eq!(read("<u8", &[255; 16]).unwrap(), [u64::MAX.into(); 2]);
        assert!(read("<u8", &[255; 15]).unwrap_err().contains("2 items are declared, but only 1 are present"));
        assert!(read("|u1", &[5, 77]).unwrap_err().contains("item 1 is 77, odd"));
        assert!(read("<f4", &[0; 8]).unwrap_err().contains("has items <f4"));
        assert!(read("", &[0; 8]).unwrap_err().contains("has items"));
    }
}
