//! `.seg` files: one label per line, one line per face, as in the Princeton segmentation benchmark.
//!
//! Written through one buffer, about 5 ns per label; reading takes 4 bytes of memory per label.

use super::output::{Gather, publish};
use crate::base::{Error, Result};
use crate::store::{MappedBytes, Run};
use std::io::Write;
use std::path::Path;

/// Labels between two checks of the stop flag.
const CHUNK: usize = 1 << 16;

/// Writes `labels`, one per face, to `path`, by rename.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use nystrom_stream::mesh::{read_seg, write_seg};
/// # let dir = tempfile::tempdir()?;
/// # let path = dir.path().join("mesh.seg");
/// write_seg(&path, &[0, 0, 1], &nystrom_stream::store::Run::new(&()))?;
/// assert_eq!(std::fs::read_to_string(&path)?, "0\n0\n1\n");
/// assert_eq!(read_seg(&path)?, [0, 0, 1]);
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// [`Error::Io`], [`Error::Cancelled`].
pub fn write_seg(path: &Path, labels: &[u32], run: &Run) -> Result<()> {
    publish(path, 0, |file| write_seg_to(path, file, labels, run))
}

/// Writes `labels` to a stream; `path` names it in errors.
///
/// # Errors
/// As [`write_seg`].
pub fn write_seg_to(path: &Path, writer: &mut dyn Write, labels: &[u32], run: &Run) -> Result<()> {
    let mut out = Gather::new(path, writer);
    for chunk in labels.chunks(CHUNK) {
        run.cancel.check()?;
        for &label in chunk {
            out.decimal(label);
            out.buffer.push(b'\n');
        }
        out.flush_if_full()?;
    }
    out.finish()
}

/// Reads a `.seg` file. Blank lines, blanks around a label, CRLF, a byte order mark and lines that begin with `#` are
/// accepted.
///
/// # Errors
/// [`Error::Io`]; [`Error::Malformed`] naming the line that is not a label; [`Error::Unusable`] for a file without
/// labels.
pub fn read_seg(path: &Path) -> Result<Vec<u32>> {
    let mut labels = Vec::new();
    each_label(
        path,
        |text| text.parse().ok(),
        "a .seg file has one whole number of 0 or more per line, one line per face",
        |label| {
            labels.push(label);
            Ok(())
        },
    )?;
    Ok(labels)
}

/// Calls `visit` for each label, but a negative number means that a face has no label, and becomes `u32::MAX`.
///
/// # Errors
/// As [`read_seg`]; those of `visit`.
pub(crate) fn each_label_or_none(path: &Path, visit: impl FnMut(u32) -> Result<()>) -> Result<()> {
    let parse = |text: &str| {
        let number: i64 = text.parse().ok()?;
        if number < 0 { Some(u32::MAX) } else { u32::try_from(number).ok() }
    };
    let remedy =
        "a .seg file has one whole number per line, one line per face; negative ones for faces without a label";
    each_label(path, parse, remedy, visit)
}

/// Calls `visit` for the labels in `path`, each as parsed by `parse`; `remedy` tells what it takes.
fn each_label(
    path: &Path,
    parse: impl Fn(&str) -> Option<u32>,
    remedy: &str,
    mut visit: impl FnMut(u32) -> Result<()>,
) -> Result<()> {
    let bytes = MappedBytes::open(path)?;
    // Editors of some systems put a byte order mark at the start.
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes);
    let mut any = false;
    for (number, line) in text.split(|&byte| byte == b'\n').enumerate() {
        let line = line.trim_ascii();
        if line.is_empty() || line.starts_with(b"#") {
            continue;
        }
        let label = std::str::from_utf8(line).ok().and_then(&parse);
        any = true;
        visit(label.ok_or_else(|| {
            Error::malformed(
                path,
                format!("line {}", number + 1),
                format!("{} is not a label", super::ply::header::shown(line)),
                remedy,
            )
        })?)?;
    }
    if any { Ok(()) } else { Err(Error::unusable(path, "has no labels", "give a file with one label per line")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_come_back() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.seg");
        write_seg(&path, &[0, 7, u32::MAX, 12], &Run::new(&())).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "0\n7\n4294967295\n12\n");
        assert_eq!(read_seg(&path).unwrap(), [0, 7, u32::MAX, 12]);
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    }

    #[test]
    fn odd_lines_are_accepted_or_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.seg");
        std::fs::write(&path, "# truth\r\n 1\r\n\r\n2").unwrap();
        assert_eq!(read_seg(&path).unwrap(), [1, 2]);
        std::fs::write(&path, "\u{feff}3\n4\n").unwrap();
        assert_eq!(read_seg(&path).unwrap(), [3, 4]);
        std::fs::write(&path, "1\n\n-1\n").unwrap();
        assert!(read_seg(&path).unwrap_err().to_string().contains("x.seg: line 3: \"-1\" is not a label; "));
        std::fs::write(&path, "\n").unwrap();
        assert!(read_seg(&path).is_err());
    }
}
