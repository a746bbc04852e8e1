//! Labels from whatever form they were kept in.
//!
//! The ending says which: `.seg` (a label a line), `.npy` (a vector of any integer type), `.ply` (the faces' property
//! `label`). One pass, 4 bytes a face.

use crate::base::{Error, Result};
use crate::mesh::{self, read_seg};
use crate::store::{MappedBytes, Run};
use npyz::{Deserialize, NpyFile};
use std::ffi::OsStr;
use std::path::Path;

/// Endings of the forms that [`read_labels`] knows, in the order in which a folder is searched for them.
pub const ENDINGS: [&str; 3] = ["seg", "npy", "ply"];

/// Reads labels, one a face. `scratch` takes what has to be unpacked.
///
/// # Errors
/// [`Error::Unusable`] for an unknown ending or a file without labels, and those of the readers.
pub fn read_labels(path: &Path, scratch: &Path, run: &Run) -> Result<Vec<u32>> {
    match path.extension().and_then(OsStr::to_str).map(str::to_ascii_lowercase).as_deref() {
        Some("seg") => read_seg(path),
        Some("npy") => read_npy(path),
        Some("ply") => mesh::open(path, scratch, run)?.document.face_property("label", run),
        _ => Err(Error::unusable(path, "its ending says no known form of labels", "give a .seg, .npy or .ply file")),
    }
}

/// A vector of non-negative integers of any type, as NumPy keeps it.
fn read_npy(path: &Path) -> Result<Vec<u32>> {
    let bytes = MappedBytes::open(path)?;
    let wrong = |problem: String| Error::malformed(path, "array", problem, "give a vector of integers from 0 on");
    let header = npyz::NpyHeader::from_reader(&bytes[..]).map_err(|error| wrong(error.to_string()))?;
    if header.shape().len() != 1 {
        return Err(wrong(format!("has {} dimensions", header.shape().len())));
    }
    let descr = header.dtype().descr();
    let labels = match descr.trim_matches('\'').get(1..) {
        Some("u1") => integers::<u8>(&bytes),
        Some("u2") => integers::<u16>(&bytes),
        Some("u4") => integers::<u32>(&bytes),
        Some("u8") => integers::<u64>(&bytes),
        Some("i1") => integers::<i8>(&bytes),
        Some("i2") => integers::<i16>(&bytes),
        Some("i4") => integers::<i32>(&bytes),
        Some("i8") => integers::<i64>(&bytes),
        _ => Err(format!("has items {descr}")),
    };
    labels.map_err(wrong)
}

fn integers<T: Deserialize + TryInto<u32>>(bytes: &[u8]) -> std::result::Result<Vec<u32>, String> {
    let file = NpyFile::new(bytes).map_err(|error| error.to_string())?;
    let items = file.data::<T>().map_err(|error| error.to_string())?;
    let label = |(k, item): (usize, std::io::Result<T>)| {
        let item = item.map_err(|error| error.to_string())?;
        item.try_into().map_err(|_| format!("item {k} is negative or beyond 32 bits"))
    };
    items.enumerate().map(label).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::npy;

    #[test]
    fn arrays_of_several_types_are_read_and_others_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.npy");
        let read = || read_labels(&path, dir.path(), &Run::new(&()));
        npy::write::<u32>(&path, &[5, 0, u32::MAX], 1, false).unwrap();
        assert_eq!(read().unwrap(), [5, 0, u32::MAX]);
        npy::write::<u64>(&path, &[5, 1 << 40], 1, false).unwrap();
        assert!(read().unwrap_err().to_string().contains("item 1 is negative or beyond"));
        // NumPy's own type for integers: signed, 64 bits.
        let mut bytes = std::fs::read(&path).unwrap();
        let at = bytes.windows(3).position(|w| w == b"<u8").unwrap();
        bytes[at + 1] = b'i';
        std::fs::write(&path, &bytes).unwrap();
        assert!(read().is_err());
        npy::write::<u64>(&path, &[7, 3], 1, false).unwrap();
        let mut bytes = std::fs::read(&path).unwrap();
        bytes[at + 1] = b'i';
        std::fs::write(&path, &bytes).unwrap();
        assert_eq!(read().unwrap(), [7, 3]);
        npy::write::<f32>(&path, &[1.], 1, false).unwrap();
        assert!(read().unwrap_err().to_string().contains("has items"));
        npy::write::<u32>(&path, &[1, 2], 2, false).unwrap();
        assert!(read().unwrap_err().to_string().contains("dimensions"));
        assert!(read_labels(Path::new("x.txt"), dir.path(), &Run::new(&())).is_err());
    }
}
