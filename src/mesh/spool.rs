//! Compressed and streamed input becomes a plain file that can be mapped.
//!
//! The stream passes through one buffer of [`BUFFER`] bytes; the disk holds the plain file for as
//! long as the scratch folder lives.

use super::header::CUT_SHORT;
use super::output::by_rename;
use crate::base::{Error, Result};
use crate::store::{MappedBytes, Run};
use flate2::bufread::MultiGzDecoder;
use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::path::Path;

/// Bytes copied at a time.
const BUFFER: usize = 1 << 20;

/// Whether `bytes` begin as gzip does.
pub(super) fn is_compressed(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0x1f, 0x8b])
}

/// Writes all of `source` to the file `to`, by rename (an earlier one may still be mapped), and maps it. `path` names the source in errors.
///
/// # Errors
/// [`Error::Io`], [`Error::Cancelled`]; [`Error::Malformed`] when compressed data are damaged.
pub(super) fn spool(path: &Path, source: &mut impl Read, to: &Path, run: &Run) -> Result<MappedBytes> {
    by_rename(to, 0, false, |file| copy(path, source, to, file, run))?;
    MappedBytes::open(to)
}

fn copy(path: &Path, source: &mut impl Read, to: &Path, file: &mut File, run: &Run) -> Result<()> {
    let mut buffer = vec![0; BUFFER];
    let mut total = 0u64;
    loop {
        run.cancel.check()?;
        let count = match source.read(&mut buffer) {
            Ok(0) => return Ok(()),
            Ok(count) => count,
            Err(error) if error.kind() == ErrorKind::Interrupted => continue,
            // What flate2 answers to data that are no gzip, damaged or cut short.
            Err(error)
                if matches!(
                    error.kind(),
                    ErrorKind::InvalidInput | ErrorKind::InvalidData | ErrorKind::UnexpectedEof
                ) =>
            {
                let place = format!("byte {total} of the uncompressed data");
                return Err(Error::malformed(path, place, format!("cannot be decompressed ({error})"), CUT_SHORT));
            }
            Err(error) => return Err(Error::io(path, "read")(error)),
        };
        file.write_all(&buffer[..count]).map_err(Error::io(to, "write"))?;
        total += count as u64;
    }
}

/// Decompresses `bytes`, the content of `path`, into `scratch` and maps the result.
///
/// # Errors
/// As [`spool`].
pub(super) fn decompress(path: &Path, bytes: &[u8], scratch: &Path, run: &Run) -> Result<MappedBytes> {
    spool(path, &mut MultiGzDecoder::new(bytes), &scratch.join("input.ply"), run)
}
