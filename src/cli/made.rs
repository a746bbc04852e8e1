//! What made an output of a batch, so that `--resume` skips results of the same mesh and options only.
//!
//! Beside the outputs of a batch lies a folder `.nystrom-stream` with one small file per output: a key of the program's
//! version, the mesh and the options, and the size and time of the output as it was written. One file each, by rename,
//! so several processes may write to one folder of outputs. An output without such a record, or that changed since,
//! counts as made by something else.

use super::output::Output;
use super::sink::folder_of;
use nystrom_stream::apps::export::Form;
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

    /// The record of `output` as it lies there now; nothing for one that is no file, or not whole.
    fn record(&self, output: &Output) -> Option<Value> {
        let last = output.last_file()?;
        let (mut bytes, mut changed) = state(&last)?;
        if output.form() == Form::Folder {
            // The list is written last, but any of its files may be gone since.
            let list: Value = serde_json::from_slice(&std::fs::read(&last).ok()?).ok()?;
            for part in list["parts"].as_array()? {
                let (more, time) = state(&output.target().join(part["file"].as_str()?))?;
                let all = format!("{changed} {more} {time}");
                (bytes, changed) = (bytes + more, format!("{:016x}", xxh3_64(all.as_bytes())));
            }
        }
        Some(json!({"key": self.0, "bytes": bytes, "changed": changed}))
    }

    /// Whether this made `output`, and nothing has changed it since.
    pub fn made(&self, output: &Output) -> bool {
        let kept = output.path().and_then(place).and_then(|path| std::fs::read(path).ok());
        let kept = kept.and_then(|text| serde_json::from_slice::<Value>(&text).ok());
        kept.is_some() && kept == self.record(output)
    }

    /// Forgets what made `output`, before it is written anew.
    pub fn forget(&self, output: &Output) {
        if let Some(path) = output.path().and_then(place) {
            let _ = std::fs::remove_file(path);
        }
    }

    /// Records that this made `output`. Where the folder cannot be written to, the next run makes it anew.
    pub fn stamp(&self, output: &Output) {
        if let (Some(path), Some(record)) = (output.path().and_then(place), self.record(output))
            && std::fs::create_dir_all(path.parent().unwrap_or(Path::new("."))).is_ok()
        {
            // It may be somebody else's, or take no names as long.
            let _ = json::publish(&path, record.to_string().as_bytes());
        }
    }
}

/// Whether a batch has made the file `path`.
pub fn is_output(path: &Path) -> bool {
    place(path).is_some_and(|record| record.is_file())
}

/// Where the record of the output `path` lies.
fn place(path: &Path) -> Option<PathBuf> {
    let name = path.file_name()?.to_string_lossy().into_owned() + ".json";
    Some(folder_of(path).join(FOLDER).join(name))
}

/// Size and time of the file `path`.
fn state(path: &Path) -> Option<(u64, String)> {
    let known = std::fs::metadata(path).ok()?;
    let changed = known.modified().ok()?.duration_since(UNIX_EPOCH).ok()?.as_nanos().to_string();
    Some((known.len(), changed))
}
