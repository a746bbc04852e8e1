//! The manifest of a work directory: which stages are finished, under which keys, with which files.

use super::mapped::{Access, MappedBytes};
use crate::base::Result;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use xxhash_rust::xxh3::xxh3_64;

/// Version of the layout of a work directory; another one is refused.
pub const FORMAT: u32 = 1;

/// The reason for making a stage for the first time.
pub const NOT_MADE: &str = "it was not made yet";
/// Its file.
pub(super) const MANIFEST: &str = "manifest.json";

/// What the manifest says.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Manifest {
    /// Layout version.
    pub format: u32,
    /// Program and version that wrote it last.
    pub program: String,
    /// Finished stages by name.
    pub stages: BTreeMap<String, Stage>,
}

/// A finished stage.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Stage {
    /// Hash of options and inputs.
    pub key: String,
    /// The options behind the key, for the reader.
    pub options: serde_json::Value,
    /// Its files by name.
    pub files: BTreeMap<String, FileRecord>,
    /// Numbers that later stages and reports need.
    pub facts: serde_json::Value,
    /// How long it took.
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

/// The key of a stage: a hash of its options (with the keys of what it builds on among them).
pub fn key_of(options: &serde_json::Value) -> String {
    format!("{:016x}", xxh3_64(options.to_string().as_bytes()))
}

impl Manifest {
    /// A manifest without stages.
    pub(super) fn new() -> Self {
        let program = concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION")).to_string();
        Self { format: FORMAT, program, stages: BTreeMap::new() }
    }
}

/// XXH3 of a file's bytes, in hexadecimal. Read where they are mapped: copying them would cost as much as hashing.
///
/// # Errors
/// [`crate::base::Error::Io`].
pub fn checksum(path: &Path) -> Result<String> {
    let bytes = MappedBytes::open(path)?;
    bytes.advise(Access::Sequential);
    Ok(format!("{:016x}", xxh3_64(&bytes)))
}
