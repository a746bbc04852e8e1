//! JSON files that appear by rename when they are whole.
//!
//! What cannot be told as JSON is an error, never an empty file.

use super::npy::partial_name;
use crate::base::{Error, Result};
use serde::Serialize;
use std::path::Path;

/// `value` as JSON, for the file `path`.
///
/// # Errors
/// [`Error::Unusable`] naming `path` for a value that JSON cannot tell.
pub fn text(path: &Path, value: &impl Serialize) -> Result<Vec<u8>> {
    serde_json::to_vec(value).map_err(|error| {
        Error::unusable(path, format!("would hold what JSON cannot tell: {error}"), "report this as a fault")
    })
}

/// Writes the file `path` with `text`, under another name until it is whole.
///
/// # Errors
/// [`Error::Io`].
pub fn publish(path: &Path, text: &[u8]) -> Result<()> {
    let partial = partial_name(path);
    let written = std::fs::write(&partial, text).map_err(Error::io(path, "write"));
    let renamed = written.and_then(|()| std::fs::rename(&partial, path).map_err(Error::io(path, "rename")));
    renamed.inspect_err(|_| {
        let _ = std::fs::remove_file(&partial);
    })
}

/// Writes `value` as the JSON file `path`, by rename.
///
/// # Errors
/// As [`text`] and [`publish`].
pub fn write(path: &Path, value: &impl Serialize) -> Result<()> {
    publish(path, &text(path, value)?)
}
