//! Records what made an output of a batch, so that `--resume` skips only results of the same mesh and options.
//!
//! Beside the outputs of a batch is a folder `.nystrom-stream` with one small file per output: a key of the program's
//! version, the mesh and the options, the modification time of the mesh and a hash of all of it, and the size and time
//! of the output as written. One file per output, written by rename, so several processes may write to one folder of
//! outputs. An output without such a record, or changed since, counts as made by something else. While an output is
//! being written, an empty record marks it, so that the next run does not take what a killed one leaves for a mesh. A
//! locked file beside the record tells other batches that the run is alive; the lock ends with its process.
//!
//! Cost: a mesh is read once more for its hash, after it was cut, and again only if its times differ.

use super::output::Output;
use nystrom_stream::apps::export::Form;
use nystrom_stream::base::{Error, Result};
use nystrom_stream::pipeline::input;
use nystrom_stream::pipeline::labels::LABELS_VERSION;
use nystrom_stream::store::manifest::checksum_of;
use nystrom_stream::store::{create_locked, folder_of, json};
use serde_json::{Value, json};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::UNIX_EPOCH;

/// The folder of records.
pub const FOLDER: &str = ".nystrom-stream";

/// What an output depends on: version, mesh and all options.
pub struct Provenance {
    key: String,
    mesh: PathBuf,
    /// Identity of the mesh before it was read.
    identity: Value,
    /// A hash of all of it; `None` if it cannot be read.
    whole: OnceLock<Option<Value>>,
}

impl Provenance {
    /// For the mesh at `path` in its present state, with `options`; `None` if it cannot be read. Time and location of
    /// the mesh do not count.
    pub fn new(path: &Path, options: &Value) -> Option<Self> {
        let identity = input::identity(path).ok()?;
        let all = json!([env!("CARGO_PKG_VERSION"), LABELS_VERSION, identity["bytes"], identity["ends"], options]);
        let key = checksum_of(all.to_string().as_bytes());
        Some(Self { key, mesh: path.to_path_buf(), identity, whole: OnceLock::new() })
    }

    /// A hash of all of the mesh.
    fn whole(&self) -> Option<&Value> {
        let content = || Some(input::content(&self.mesh).ok()?["whole"].clone());
        self.whole.get_or_init(content).as_ref()
    }

    /// Whether the mesh is the one in `record`: the key covers only its ends, so the full hash is compared.
    fn is_of(&self, record: &Value) -> bool {
        record["mesh"] == self.identity["changed"] || self.whole().is_some_and(|whole| record["whole"] == *whole)
    }

    /// The record of `output` in its present state; `None` if it is not a file, or incomplete.
    fn record(&self, output: &Output) -> Option<Value> {
        let last = output.last_file()?;
        let (mut bytes, mut changed) = state(&last)?;
        if output.form() == Form::Folder {
            // The list is written last, but any of its files may be missing by now.
            let list: Value = serde_json::from_slice(&std::fs::read(&last).ok()?).ok()?;
            for part in list["parts"].as_array()? {
                let (more, time) = state(&output.target().join(part["file"].as_str()?))?;
                let all = format!("{changed} {more} {time}");
                (bytes, changed) = (bytes + more, checksum_of(all.as_bytes()));
            }
        }
        Some(json!({"key": self.key, "bytes": bytes, "changed": changed}))
    }

    /// Whether this made `output`, and it is unchanged.
    pub fn is_current(&self, output: &Output) -> bool {
        let kept = output.path().and_then(place).and_then(|path| std::fs::read(path).ok());
        let kept = kept.and_then(|text| serde_json::from_slice::<Value>(&text).ok());
        let same =
            |(kept, now): (&Value, Value)| ["key", "bytes", "changed"].iter().all(|name| kept[name] == now[name]);
        kept.as_ref().zip(self.record(output)).is_some_and(same) && kept.as_ref().is_some_and(|kept| self.is_of(kept))
    }

    /// Replaces the record of `output` by an empty one, before it is rewritten.
    pub fn mark<'a>(&'a self, output: &'a Output) -> Mark<'a> {
        let was_ours = output.path().is_some_and(is_output);
        let mark = Mark { provenance: self, output, was_ours, before: last_state(output) };
        if let Some(path) = output.path().and_then(place) {
            let _ = path.parent().map(std::fs::create_dir);
            // Never through a link that somebody put there.
            let _ = std::fs::remove_file(&path);
            let _ = File::create_new(path);
        }
        mark
    }

    /// Records that this made `output`. If the folder is not writable, or the mesh has changed meanwhile, the next run
    /// makes the output again.
    fn write_record(&self, output: &Output) {
        let Some(whole) = self.whole() else { return };
        let unchanged = input::identity(&self.mesh).is_ok_and(|identity| identity == self.identity);
        if let (Some(path), Some(mut record)) = (output.path().and_then(place), self.record(output))
            && unchanged
            && std::fs::create_dir_all(folder_of(&path)).is_ok()
        {
            (record["mesh"], record["whole"]) = (self.identity["changed"].clone(), whole.clone());
            // The folder may belong to somebody else, or not support such long names.
            let _ = json::publish(&path, record.to_string().as_bytes());
        }
    }
}

/// The empty record of an output that is being written.
pub struct Mark<'a> {
    provenance: &'a Provenance,
    output: &'a Output,
    /// Whether a batch had made what was there before.
    was_ours: bool,
    /// The state of what was there before.
    before: Option<(u64, String)>,
}

impl Mark<'_> {
    /// Records that the output is made.
    pub fn complete(self) {
        self.provenance.write_record(self.output);
    }

    /// Removes the mark of an output that was not made, unless what is there now is of a batch.
    pub fn undo(self) {
        let now = last_state(self.output);
        let is_ours = now.is_some() && (self.was_ours || now != self.before);
        if let (Some(path), false) = (self.output.path().and_then(place), is_ours) {
            let _ = std::fs::remove_file(&path);
            // It stays if it holds other records.
            let _ = path.parent().map(std::fs::remove_dir);
        }
    }
}

/// The claim of a run that is making an output, until it is dropped.
pub struct Claim {
    path: PathBuf,
    _locked: File,
}

impl Claim {
    /// Claims `output`; `None` for standard output, and if nothing can be written beside it.
    ///
    /// # Errors
    /// [`Error::Unusable`] if another run has claimed it.
    pub fn of(output: &Output) -> Result<Option<Self>> {
        let Some(path) = output.path().and_then(place).map(|record| record.with_extension("claim")) else {
            return Ok(None);
        };
        let _ = path.parent().map(std::fs::create_dir);
        match create_locked(&path) {
            Ok(locked) => Ok(Some(Self { path, _locked: locked })),
            Err(error @ Error::Unusable { .. }) => Err(error),
            Err(_) => Ok(None),
        }
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
        // It stays if it holds records.
        let _ = self.path.parent().map(std::fs::remove_dir);
    }
}

/// Whether a batch made the file `path`.
pub fn is_output(path: &Path) -> bool {
    place(path).is_some_and(|record| record.is_file())
}

/// The path of the record for the output `path`.
fn place(path: &Path) -> Option<PathBuf> {
    let name = path.file_name()?.to_string_lossy().into_owned() + ".json";
    Some(folder_of(path).join(FOLDER).join(name))
}

/// The state of the file of `output` that is written last.
fn last_state(output: &Output) -> Option<(u64, String)> {
    state(&output.last_file()?)
}

/// Size and modification time of the file `path`.
fn state(path: &Path) -> Option<(u64, String)> {
    let known = std::fs::metadata(path).ok()?;
    let changed = known.modified().ok()?.duration_since(UNIX_EPOCH).ok()?.as_nanos().to_string();
    Some((known.len(), changed))
}
