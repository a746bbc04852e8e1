//! Which input a work directory belongs to.

use crate::base::{Error, Result};
use serde_json::json;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;
use xxhash_rust::xxh3::Xxh3;

/// Bytes hashed at either end of the file.
const END: u64 = 1 << 20;

/// What identifies an input without reading all of it: size, time of change, and a hash of its first and last
/// mebibyte. A file edited in place in its middle within the clock's resolution goes unnoticed; nothing else does.
///
/// # Errors
/// [`Error::Io`].
pub fn identity(path: &Path) -> Result<serde_json::Value> {
    let mut file = File::open(path).map_err(Error::io(path, "open"))?;
    let metadata = file.metadata().map_err(Error::io(path, "look at"))?;
    let changed = metadata
        .modified()
        .ok()
        .and_then(|time| time.duration_since(std::time::UNIX_EPOCH).ok())
        .map_or(0, |age| age.as_nanos() as u64);
    let mut hash = Xxh3::new();
    let mut buffer = Vec::new();
    (&mut file).take(END).read_to_end(&mut buffer).map_err(Error::io(path, "read"))?;
    hash.update(&buffer);
    if metadata.len() > END {
        buffer.clear();
        file.seek(SeekFrom::Start(metadata.len().saturating_sub(END).max(END))).map_err(Error::io(path, "read"))?;
        file.take(END).read_to_end(&mut buffer).map_err(Error::io(path, "read"))?;
        hash.update(&buffer);
    }
    Ok(json!({
        "file": path.file_name().unwrap_or_default().to_string_lossy(),
        "bytes": metadata.len(),
        "changed": changed,
        "ends": format!("{:016x}", hash.digest()),
    }))
}

/// Whether two identities are of the same content, wherever it lies and whenever it was copied there.
pub fn same(a: &serde_json::Value, b: &serde_json::Value) -> bool {
    a["bytes"] == b["bytes"] && a["ends"] == b["ends"]
}
