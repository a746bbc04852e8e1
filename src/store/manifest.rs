//! The manifest of a work directory: which stages are finished, under which keys, with which files. It is read and
//! written as a whole: some hundred bytes per stage and file, and a kilobyte per part once there are labels. A checksum
//! takes one read of its file.

use super::folder::LOCK;
use super::mapped::{Access, MappedBytes};
use crate::base::{Cancel, Result};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use xxhash_rust::xxh3::{Xxh3, xxh3_64};

/// Version of the layout of a work directory. A newer one is refused; stages of an older one are rebuilt.
pub const FORMAT: u32 = 2;

/// Bytes hashed between two checks for cancellation.
const BYTES_BETWEEN_CHECKS: usize = 1 << 26;

/// Program and version recorded in manifests that are written now.
pub(super) const PROGRAM: &str = concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION"));
/// The file of the manifest.
pub const MANIFEST: &str = "manifest.json";

/// The content of the manifest.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Manifest {
    /// Layout version.
    pub format: u32,
    /// Program and version that wrote it last.
    pub program: String,
    /// Finished stages by name.
    pub stages: BTreeMap<String, StageRecord>,
}

/// A finished stage.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct StageRecord {
    /// Hash of name, version and inputs.
    pub key: String,
    /// Version of the algorithm that made it; 0 in manifests of format 1, which did not record it.
    #[serde(default)]
    pub version: u32,
    /// What the stage depends on: options, and keys of other stages.
    #[serde(alias = "options")]
    pub inputs: serde_json::Value,
    /// Its files by name.
    pub files: BTreeMap<String, FileRecord>,
    /// Numbers that later stages and reports need.
    pub facts: serde_json::Value,
    /// How many seconds it took.
    pub seconds: f64,
}

/// Size and checksum of a stage's file.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FileRecord {
    /// Bytes.
    pub bytes: u64,
    /// XXH3 of all bytes, in hexadecimal; empty in a temporary directory.
    pub xxh3: String,
}

impl Manifest {
    /// A manifest without stages.
    pub(super) fn new() -> Self {
        Self { format: FORMAT, program: PROGRAM.to_string(), stages: BTreeMap::new() }
    }

    /// A name that no file of a stage can have: one in another folder, or that of the manifest or the lock.
    pub(super) fn foreign_file(&self) -> Option<&str> {
        let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.');
        let is_own = |name: &str| {
            !name.is_empty() && name.chars().all(plain) && !name.starts_with('.') && name != MANIFEST && name != LOCK
        };
        let mut names = self.stages.values().flat_map(|stage| stage.files.keys());
        names.find(|name| !is_own(name)).map(String::as_str)
    }
}

/// Whether `correspond` wrote the folder `path`: it contains a work directory for each of two meshes.
pub(super) fn is_of_two(path: &Path) -> bool {
    ["a", "b"].iter().all(|side| path.join(side).join(MANIFEST).is_file())
}

/// XXH3 of a file's bytes, in hexadecimal. Hashed through the mapping: copying the bytes would cost as much as hashing.
///
/// # Errors
/// [`crate::base::Error::Io`]; [`crate::base::Error::Cancelled`].
pub fn checksum(path: &Path, cancel: &Cancel) -> Result<String> {
    let bytes = MappedBytes::open(path)?;
    bytes.advise(Access::Sequential);
    checksum_within(&bytes, cancel)
}

/// The same for bytes in memory, or mapped, that may be many.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub(crate) fn checksum_within(bytes: &[u8], cancel: &Cancel) -> Result<String> {
    let mut hash = Xxh3::new();
    for some in bytes.chunks(BYTES_BETWEEN_CHECKS) {
        cancel.check()?;
        hash.update(some);
    }
    Ok(format!("{:016x}", hash.digest()))
}

/// The same for a few bytes in memory.
pub fn checksum_of(bytes: &[u8]) -> String {
    format!("{:016x}", xxh3_64(bytes))
}
