//! JSON files, written atomically by rename.
//!
//! A value that cannot be represented in JSON is an error. Files written by hand, JSON or not, are read as a whole, up
//! to a size limit.

use super::new_file::by_rename;
use crate::base::{Error, Result};
use serde::Serialize;
use serde_json::Value;
use std::fs::File;
use std::io::{Read, Write};
use std::path::Path;

/// `value` as a JSON value; `what` names it in the error.
///
/// # Errors
/// [`Error::Internal`] for a value that JSON cannot represent.
pub fn value(what: &str, value: &impl Serialize) -> Result<Value> {
    serde_json::to_value(value).map_err(|error| not_json(what, &error))
}

/// The largest file that is read as a whole: files written by hand, and hierarchies of some two thousand cells.
const SMALL: u64 = 64 << 20;

/// The content of the small file `path`.
///
/// # Errors
/// [`Error::Io`]; [`Error::Unusable`] above 64 MiB, more than any file of this kind has.
pub fn read_small(path: &Path) -> Result<Vec<u8>> {
    let mut text = Vec::new();
    File::open(path).and_then(|file| file.take(SMALL + 1).read_to_end(&mut text)).map_err(Error::io(path, "read"))?;
    if text.len() as u64 > SMALL {
        return Err(Error::unusable(
            path,
            "is larger than 64 MiB, too large for a file of this kind",
            "give the right file",
        ));
    }
    Ok(text)
}

/// `value` as JSON, for the file `path`.
///
/// # Errors
/// [`Error::Internal`] naming `path` for a value that JSON cannot represent.
pub fn text(path: &Path, value: &impl Serialize) -> Result<Vec<u8>> {
    serde_json::to_vec(value).map_err(|error| not_json(&path.display().to_string(), &error))
}

/// `value` as indented JSON; `what` names it in the error.
///
/// # Errors
/// As [`value`].
pub fn pretty(what: &str, value: &impl Serialize) -> Result<String> {
    serde_json::to_string_pretty(value).map_err(|error| not_json(what, &error))
}

fn not_json(what: &str, error: &serde_json::Error) -> Error {
    Error::internal(&format!("{what} cannot be represented as JSON: {error}"))
}

/// Writes `text` to the file `path`, under another name until it is complete and synced.
///
/// # Errors
/// [`Error::Io`].
pub fn publish(path: &Path, text: &[u8]) -> Result<()> {
    replace(path, text, true)
}

/// The same, but synced before the rename only where `durable`.
///
/// # Errors
/// [`Error::Io`].
pub(super) fn replace(path: &Path, text: &[u8], durable: bool) -> Result<()> {
    by_rename(path, 0, durable, |file| file.write_all(text).map_err(Error::io(path, "write")))
}

/// Writes `value` as the JSON file `path`, by rename.
///
/// # Errors
/// As [`text`] and [`publish`].
pub fn write(path: &Path, value: &impl Serialize) -> Result<()> {
    publish(path, &text(path, value)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    /// Regression: a value that JSON cannot represent became an empty file, or an empty value in a report.
    #[test]
    fn what_json_cannot_tell_is_an_error_and_leaves_no_file() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.json");
        let bad = BTreeMap::from([(vec![1, 2], 3)]);
        assert!(write(&path, &bad).is_err());
        assert!(value("a map of lists", &bad).unwrap_err().to_string().contains("a map of lists"));
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
        write(&path, &[1, 2]).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "[1,2]");
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    }
}
