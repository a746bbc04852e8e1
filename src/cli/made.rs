//! What made an output of a batch, so that `--resume` skips results of the same mesh and options only.
//!
//! Beside the outputs of a batch lies a folder `.nystrom-stream` with one small file per output: a key of the program's
//! version, the mesh and the options, and the size and time of the output as it was written. One file each, by rename,
//! so several processes may write to one folder of outputs. An output without such a record, or that changed since,
//! counts as made by something else.

use super::output::{Output, folder_of};
use nystrom_stream::base::Result;
use nystrom_stream::store::json;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;
use xxhash_rust::xxh3::xxh3_64;

/// The folder of records.
pub const FOLDER: &str = ".nystrom-stream";

/// What an output depends on: version, mesh and everything that was asked for.
pub struct Maker(String);

impl Maker {
    /// Of the mesh that `identity` tells, under `options`. When and where the mesh lies does not count.
    pub fn new(identity: &Value, options: &Value) -> Self {
        let all = json!([env!("CARGO_PKG_VERSION"), identity["bytes"], identity["ends"], options]);
        Self(format!("{:016x}", xxh3_64(all.to_string().as_bytes())))
    }

    /// The record of `output` as it lies there now; nothing for one that is no file.
    fn record(&self, output: &Output) -> Option<(PathBuf, Value)> {
        let path = output.path()?;
        let known = std::fs::metadata(output.last_file()?).ok()?;
        let changed = known.modified().ok()?.duration_since(UNIX_EPOCH).ok()?.as_nanos().to_string();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned() + ".json";
        let record = json!({"key": self.0, "bytes": known.len(), "changed": changed});
        Some((folder_of(path).join(FOLDER).join(name), record))
    }

    /// Whether this made `output`, and nothing has changed it since.
    pub fn made(&self, output: &Output) -> bool {
        let Some((path, record)) = self.record(output) else { return false };
        let kept = std::fs::read(path).ok().and_then(|text| serde_json::from_slice::<Value>(&text).ok());
        kept == Some(record)
    }

    /// Forgets what made `output`, before it is written anew.
    pub fn forget(&self, output: &Output) {
        if let Some((path, _)) = self.record(output) {
            let _ = std::fs::remove_file(path);
        }
    }

    /// Records that this made `output`. Where the folder cannot be written to, the next run makes it anew.
    pub fn stamp(&self, output: &Output) -> Result<()> {
        let Some((path, record)) = self.record(output) else { return Ok(()) };
        if std::fs::create_dir_all(path.parent().unwrap_or(Path::new("."))).is_err() {
            return Ok(());
        }
        json::publish(&path, record.to_string().as_bytes())
    }
}
