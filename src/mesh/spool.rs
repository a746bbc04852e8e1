//! Compressed and streamed input becomes a plain file that can be mapped.
//!
//! The stream passes through one buffer of [`BUFFER`] bytes; the disk holds the plain file for as
//! long as the scratch folder lives.

use crate::base::{Error, Result};
use crate::store::{MappedBytes, Run};
use flate2::bufread::MultiGzDecoder;
use std::fs::File;
use std::io::{Read, Write};
use std::path::Path;

/// Bytes copied at a time.
const BUFFER: usize = 1 << 20;

/// Whether `bytes` begin as gzip does.
pub(super) fn is_compressed(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0x1f, 0x8b])
}

/// Writes all of `source` to the file `to` and maps it. `path` names the source in errors.
///
/// # Errors
/// [`Error::Io`], [`Error::Cancelled`]; [`Error::Malformed`] when compressed data are damaged.
pub(super) fn spool(path: &Path, source: &mut impl Read, to: &Path, run: &Run) -> Result<MappedBytes> {
    let mut file = File::create(to).map_err(Error::io(to, "create"))?;
    let mut buffer = vec![0; BUFFER];
    let mut total = 0u64;
    loop {
        run.cancel.check()?;
        let count = match source.read(&mut buffer) {
            Ok(0) => break,
            Ok(count) => count,
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => continue,
            Err(error)
                if matches!(
                    error.kind(),
                    std::io::ErrorKind::InvalidInput
                        | std::io::ErrorKind::InvalidData
                        | std::io::ErrorKind::UnexpectedEof
                ) =>
            {
                let place = format!("byte {total} of the uncompressed data");
                return Err(Error::malformed(
                    path,
                    place,
                    format!("cannot be decompressed ({error})"),
                    "the file is cut short or damaged; get it again",
                ));
            }
            Err(error) => return Err(Error::io(path, "read")(error)),
        };
        file.write_all(&buffer[..count]).map_err(Error::io(to, "write"))?;
        total += count as u64;
    }
    drop(file);
    MappedBytes::open(to)
}

/// Decompresses `bytes`, the content of `path`, into `scratch` and maps the result.
///
/// # Errors
/// As [`spool`].
pub(super) fn decompress(path: &Path, bytes: &[u8], scratch: &Path, run: &Run) -> Result<MappedBytes> {
    spool(path, &mut MultiGzDecoder::new(bytes), &scratch.join("input.ply"), run)
}
