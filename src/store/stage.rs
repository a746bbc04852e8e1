//! Stages: steps whose files are made once and reused while nothing that they depend on has changed.
//!
//! A stage is a value of a type that implements [`Stage`]: it knows its name, the version of its algorithm, what it
//! depends on, how to make its files and how to open them. [`Context::stage`] does the rest, in one place for all
//! stages:
//!
//! 1. The *key* is a hash of the stage's name, its version and its inputs, which contain the keys of the stages that it
//!    builds on. So a changed option, another mesh or a newer algorithm anywhere upstream gives another key.
//! 2. If the manifest has that key, and the files match the sizes and checksums recorded there, the stage is opened.
//! 3. Otherwise the stage is removed from the manifest, and the progress listener gets the reason; the stage is made,
//!    its files are synced, and the manifest is written last.
//!
//! A run that is killed at any moment thus leaves either a complete stage or none. In a temporary directory nothing is
//! synced and nothing is hashed.
//!
//! Cost: hashing at memory speed and one sync per file in a directory that is kept; none in a temporary one.

use super::folder::LOCK;
use super::json;
use super::manifest::{FileRecord, MANIFEST, Manifest, StageRecord, checksum, checksum_of};
use super::needs::{BudgetEstimate, Extent, Needs};
use super::run::Context;
use super::workdir::WorkDir;
use crate::base::parallel::map_chunks;
use crate::base::printable::counted;
use crate::base::sort::map_of;
use crate::base::{Error, Result};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::fmt;
use std::fs::File;
use std::io::ErrorKind;

/// A step of the work with files of its own in the work directory.
pub trait Stage: Sized {
    /// Its name in the manifest; unique among the stages of a work directory.
    const NAME: &'static str;
    /// The version of its algorithm. Raise it whenever the same inputs would give other bytes: files of an older
    /// program are then rebuilt.
    const VERSION: u32;
    /// What the manifest keeps besides the files: counts and sums.
    type Facts: Serialize + DeserializeOwned;
    /// What later stages receive.
    type Output;

    /// Everything that the files depend on: options, the seed where it is used, keys of other stages.
    fn inputs(&self, context: Context<'_>) -> Value;

    /// Makes the files. `key` identifies them in the inputs of later stages.
    ///
    /// # Errors
    /// Those of the work.
    fn make(self, key: &str, context: Context<'_>) -> Result<BuiltStage<Self>>;

    /// Opens the files of an earlier run.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Malformed`], [`Error::WorkDir`] for files that contradict each other.
    fn open(self, facts: Self::Facts, key: &str, context: Context<'_>) -> Result<Self::Output>;

    /// The unit and the number of units for progress; `None` if the stage reports its steps itself.
    fn progress(&self) -> Option<(&'static str, u64)> {
        None
    }

    /// Memory and disk that the stage needs for a mesh of size `extent`, reserved in `estimate` in the order of its
    /// code; see [`super::needs`].
    fn needs(extent: &Extent, estimate: &mut BudgetEstimate) -> Needs;
}

/// A stage just made: its output, and what the manifest records of it.
pub struct BuiltStage<S: Stage> {
    /// What later stages receive.
    pub output: S::Output,
    /// For the manifest.
    pub facts: S::Facts,
    /// Names of its files.
    pub files: Vec<&'static str>,
}

/// A finished stage as recorded in the manifest, found by its name alone.
#[derive(Clone, Debug)]
pub struct FinishedStage<F> {
    /// Its facts.
    pub facts: F,
    /// Its key.
    pub key: String,
    /// What it depended on.
    pub inputs: Value,
}

/// Why a stage has to be (re)built.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RebuildReason {
    /// It was never made, or its files were deleted.
    NotMade,
    /// Another version of the program made it.
    OtherVersion {
        /// The version of the algorithm that made it.
        found: u32,
        /// The version of this program.
        now: u32,
    },
    /// Its key differs.
    OtherInputs,
    /// A file or its record is damaged; the text gives details.
    Damaged(String),
}

impl fmt::Display for RebuildReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotMade => f.write_str("it was not made yet"),
            Self::OtherVersion { found, now } => {
                write!(f, "another version of the program made it (algorithm {found}, now {now})")
            }
            Self::OtherInputs => f.write_str("its options or inputs changed"),
            Self::Damaged(problem) => f.write_str(problem),
        }
    }
}

/// The key of a stage: a hash of its name, the version of its algorithm, and its inputs.
pub fn key_of(name: &str, version: u32, inputs: &Value) -> String {
    let text = serde_json::json!({"stage": name, "version": version, "inputs": inputs}).to_string();
    checksum_of(text.as_bytes())
}

/// Parses the facts recorded in the manifest.
fn facts<T: DeserializeOwned>(kept: Value) -> Result<T, RebuildReason> {
    serde_json::from_value(kept).map_err(|error| RebuildReason::Damaged(format!("its facts are unreadable: {error}")))
}

impl Context<'_> {
    /// The output of `stage`: opened if its files exist under the same key, else made.
    ///
    /// # Errors
    /// Those of [`Stage::make`] and [`Stage::open`]; [`Error::Io`] if the manifest cannot be written.
    pub fn stage<S: Stage>(self, stage: S) -> Result<S::Output> {
        let inputs = stage.inputs(self);
        let made_of = StageKey::of::<S>(inputs);
        let key = made_of.key.clone();
        match self.work.reuse::<S::Facts>(S::NAME, S::VERSION, &key) {
            Ok(facts) => {
                self.run.progress.note_of_work(&format!("{}: reused", S::NAME));
                return stage.open(facts, &key, self);
            }
            Err(RebuildReason::NotMade) => {}
            Err(reason) => self.run.progress.note_of_work(&format!("{}: rebuilt, {reason}", S::NAME)),
        }
        let (made, seconds) = match stage.progress() {
            Some((unit, total)) => self.run.stage(S::NAME, unit, total, || stage.make(&key, self))?,
            None => {
                let start = std::time::Instant::now();
                let made = stage.make(&key, self)?;
                (made, start.elapsed().as_secs_f64())
            }
        };
        self.work.record_stage(made_of, &made.files, &made.facts, seconds)?;
        Ok(made.output)
    }
}

/// What identifies a stage that is recorded in the manifest.
#[derive(Clone, Debug)]
pub struct StageKey {
    /// Its name.
    pub name: &'static str,
    /// The version of its algorithm.
    pub version: u32,
    /// The hash of both and of the inputs.
    pub key: String,
    /// What it depends on.
    pub inputs: Value,
}

impl StageKey {
    /// The key of version `version` of the stage `name` under `inputs`.
    pub fn new(name: &'static str, version: u32, inputs: Value) -> Self {
        Self { name, version, key: key_of(name, version, &inputs), inputs }
    }

    /// The key of the stage `S` under `inputs`.
    pub fn of<S: Stage>(inputs: Value) -> Self {
        Self::new(S::NAME, S::VERSION, inputs)
    }
}

impl WorkDir {
    /// The facts of a finished stage, if its key is `key` and its files match the recorded sizes and checksums.
    ///
    /// # Errors
    /// Why the stage has to be (re)built. The stage is then removed from the manifest, so that a run killed while
    /// rebuilding it leaves no record of files that no longer exist.
    pub fn reuse<T: DeserializeOwned>(&self, stage: &str, version: u32, key: &str) -> Result<T, RebuildReason> {
        let found = self.look_up(stage, version, key).and_then(facts);
        // What was not read to the end because of a stop is not damaged.
        found.map_err(|reason| if self.cancel.is_cancelled() { reason } else { self.forget(stage, reason) })
    }

    /// Removes `stage` from the manifest and returns `reason`, or the reason why that failed. If another version of the
    /// program made the stage, its files are removed too: files that have other names now would never be overwritten.
    fn forget(&self, stage: &str, reason: RebuildReason) -> RebuildReason {
        let mut manifest = self.manifest_lock();
        let record = if self.shared { None } else { manifest.stages.remove(stage) };
        let Some(record) = record else { return reason };
        if let Err(error) = self.save(&mut manifest) {
            return RebuildReason::Damaged(error.to_string());
        }
        if matches!(reason, RebuildReason::OtherVersion { .. }) {
            let is_listed = |file: &&String| manifest.stages.values().any(|other| other.files.contains_key(*file));
            record.files.keys().filter(|file| !is_listed(file)).for_each(|file| self.remove(file));
        }
        reason
    }

    /// Removes the stage `name` from the manifest, since its files are about to be rewritten; returns its record.
    /// [`Context::stage`] does this for all stages that a single process makes as a whole.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub(crate) fn remove_record(&self, name: &str) -> Result<Option<StageRecord>> {
        let mut manifest = self.manifest_lock();
        let record = manifest.stages.remove(name);
        if record.is_some() {
            self.save(&mut manifest)?;
        }
        Ok(record)
    }

    /// Whether the stage `name` is finished here with the key `key`, whatever its version.
    pub fn has_stage(&self, name: &str, key: &str) -> bool {
        let kept = self.manifest().stages.remove(name);
        kept.is_some_and(|kept| self.look_up(name, kept.version, key).is_ok())
    }

    /// The finished stage `S` of this directory, whatever its inputs, or an error that explains how to make it.
    ///
    /// # Errors
    /// [`Error::WorkDir`] if there is none, if its files are missing or damaged, or if an older program made it.
    pub fn finished_stage<S: Stage>(&self, remedy: &str) -> Result<FinishedStage<S::Facts>> {
        self.finished_stage_named(S::NAME, S::VERSION, remedy)
    }

    /// [`WorkDir::finished_stage`] for a stage given by name. The manifest stays unchanged: a file that cannot be read
    /// now may be there later, and a reader cannot rebuild it.
    ///
    /// # Errors
    /// As [`WorkDir::finished_stage`].
    pub fn finished_stage_named<T: DeserializeOwned>(
        &self,
        name: &str,
        version: u32,
        remedy: &str,
    ) -> Result<FinishedStage<T>> {
        let stage = self.manifest().stages.remove(name);
        let stage = stage.ok_or_else(|| Error::work_dir(self.path(), format!("holds no {name}"), remedy))?;
        let facts = self.look_up(name, version, &stage.key).and_then(facts).map_err(|problem| {
            if self.cancel.is_cancelled() {
                Error::Cancelled
            } else {
                Error::work_dir(self.path(), format!("{name}: {problem}"), remedy)
            }
        })?;
        Ok(FinishedStage { facts, key: stage.key, inputs: stage.inputs })
    }

    /// The recorded facts of the stage `S`, whether its files are intact or not.
    pub fn recorded_facts<S: Stage>(&self) -> Option<S::Facts> {
        let record = self.manifest().stages.remove(S::NAME).filter(|record| record.version == S::VERSION)?;
        serde_json::from_value(record.facts).ok()
    }

    /// The facts of a finished stage as stored in the manifest.
    fn look_up(&self, stage: &str, version: u32, key: &str) -> Result<Value, RebuildReason> {
        let manifest = self.manifest_lock();
        let record = manifest.stages.get(stage).ok_or(RebuildReason::NotMade)?;
        if record.version != version {
            return Err(RebuildReason::OtherVersion { found: record.version, now: version });
        }
        if record.key != key {
            return Err(RebuildReason::OtherInputs);
        }
        // In parallel: reading for the checksums is what takes longest when only the number of parts changes. None in a
        // temporary directory.
        let files: Vec<_> = record.files.iter().collect();
        let threads = if self.is_temporary() { 1 } else { files.len().min(self.threads) };
        let check = |k: usize, (): &mut ()| Ok(self.integrity_error(files[k].0, files[k].1));
        let checked = map_chunks(threads, &self.cancel, files.len(), || (), check);
        let checked = checked.map_err(|error| RebuildReason::Damaged(error.to_string()))?;
        if let Some((problem, (name, _))) =
            checked.into_iter().zip(files).find_map(|(problem, file)| Some((problem?, file)))
        {
            return Err(RebuildReason::Damaged(format!("{name} {problem}")));
        }
        Ok(record.facts.clone())
    }

    /// What is wrong with a file, if its bytes no longer match its checksum: one sequential read, far cheaper than a
    /// wrong label.
    pub(crate) fn integrity_error(&self, name: &str, file: &FileRecord) -> Option<String> {
        if self.bytes_in_memory(name) == Some(file.bytes) {
            return None;
        }
        let path = self.file(name);
        match std::fs::metadata(&path) {
            Ok(found) if found.len() != file.bytes => {
                Some(format!("has {} instead of {}", counted(found.len() as usize, "byte"), file.bytes))
            }
            Ok(_) if self.is_temporary() => None,
            Ok(_) => match checksum(&path, &self.cancel) {
                Ok(sum) if sum == file.xxh3 => None,
                Ok(_) => Some("has another checksum: it was changed or damaged".to_string()),
                Err(error) => Some(format!("cannot be read: {error}")),
            },
            Err(error) if error.kind() == ErrorKind::NotFound => Some("is missing".to_string()),
            Err(error) => Some(format!("cannot be accessed: {error}")),
        }
    }

    /// Records a stage as finished. [`Context::stage`] does this for all stages that a single process makes as a whole.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn record_stage(&self, stage: StageKey, files: &[&str], facts: &impl Serialize, seconds: f64) -> Result<()> {
        let facts = json::value(&format!("the facts of stage {}", stage.name), facts)?;
        self.record_stage_json(stage, files, facts, seconds)
    }

    /// [`WorkDir::record_stage`] with facts already in JSON.
    fn record_stage_json(&self, stage: StageKey, files: &[&str], facts: Value, seconds: f64) -> Result<()> {
        // In parallel, since each waits for the disk; a temporary directory does not wait.
        let threads = if self.is_temporary() { 1 } else { files.len().min(self.threads) };
        let record = |k: usize, (): &mut ()| Ok((files[k].to_string(), self.file_record(files[k])?));
        let files = map_of(map_chunks(threads, &self.cancel, files.len(), || (), record)?);
        let StageKey { name, version, key, inputs } = stage;
        let record = StageRecord { key, version, inputs, files, facts, seconds };
        let mut manifest = self.manifest_lock();
        manifest.stages.insert(name.to_string(), record);
        self.save(&mut manifest)
    }

    /// The record of the finished file `name`, synced before it enters the manifest.
    pub(crate) fn file_record(&self, name: &str) -> Result<FileRecord> {
        if let Some(bytes) = self.bytes_in_memory(name) {
            return Ok(FileRecord { bytes, xxh3: String::new() });
        }
        let path = self.file(name);
        let bytes = std::fs::metadata(&path).map_err(Error::io(&path, "access"))?.len();
        if self.is_temporary() {
            return Ok(FileRecord { bytes, xxh3: String::new() });
        }
        File::open(&path).and_then(|file| file.sync_all()).map_err(Error::io(&path, "sync"))?;
        Ok(FileRecord { bytes, xxh3: checksum(&path, &self.cancel)? })
    }

    /// Removes all stages with their files, here and in nested directories: they belong to another mesh, and nothing
    /// will read them.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::WorkDir`] if a nested directory is in use.
    pub fn clear(&self) -> Result<()> {
        for (name, inner) in self.inner_here()? {
            inner.clear()?;
            drop(inner);
            // If files of no stage are left, it stays a work directory: without a manifest, the program would refuse to
            // use the folder.
            let left = std::fs::read_dir(self.file(&name)).map_err(Error::io(self.file(&name), "list"))?.flatten();
            if left.map(|entry| entry.file_name()).all(|file| file == MANIFEST || file == LOCK) {
                [MANIFEST, LOCK].iter().for_each(|file| self.remove(&format!("{name}/{file}")));
                let _ = std::fs::remove_dir(self.file(&name));
            }
        }
        let mut manifest = self.manifest_lock();
        let stages = std::mem::take(&mut manifest.stages);
        self.save(&mut manifest)?;
        stages.values().flat_map(|stage| stage.files.keys()).for_each(|file| self.remove(file));
        self.remove_decoded();
        Ok(())
    }

    /// Deletes files of the finished stage `stage` that nothing will read again, in a temporary directory: this leaves
    /// more disk for a larger mesh, and more page cache for the rest. Should the stage be needed after all, it is
    /// rebuilt. Elsewhere the files are kept for the next run.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn release(&self, stage: &str, files: &[&str]) -> Result<()> {
        if !self.is_temporary() {
            return Ok(());
        }
        let mut manifest = self.manifest_lock();
        manifest.stages.remove(stage);
        self.save(&mut manifest)?;
        files.iter().for_each(|file| self.remove(file));
        Ok(())
    }

    /// Writes and syncs the manifest, unless the directory is temporary.
    fn save(&self, manifest: &mut Manifest) -> Result<()> {
        if self.is_temporary() {
            return Ok(());
        }
        manifest.program = super::manifest::PROGRAM.to_string();
        let path = self.file(MANIFEST);
        let text = serde_json::to_vec_pretty(manifest)
            .map_err(|error| Error::internal(&format!("the manifest cannot be represented as JSON: {error}")))?;
        json::publish(&path, &text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::npy;
    use serde_json::json;

    /// Regression: files that another version of the program had named otherwise stayed in the work directory.
    #[test]
    fn files_of_another_version_are_removed() {
        let dir = tempfile::tempdir().unwrap();
        let work = WorkDir::open(&dir.path().join("w")).unwrap();
        let record =
            |name, files: &[&str]| work.record_stage(StageKey::new(name, 1, json!({})), files, &7, 0.).unwrap();
        for name in ["old.npy", "shared.npy"] {
            npy::write(&work.file(name), &[1u32, 2], 1, true).unwrap();
        }
        record("s", &["old.npy", "shared.npy"]);
        record("t", &["shared.npy"]);
        let exists = || ["old.npy", "shared.npy"].map(|name| work.file(name).exists());
        // Other inputs keep the names, so the files are overwritten.
        let inputs = work.reuse::<u32>("s", 1, "another key").unwrap_err();
        assert!(matches!(inputs, RebuildReason::OtherInputs) && exists() == [true; 2]);
        record("s", &["old.npy", "shared.npy"]);
        let version = work.reuse::<u32>("s", 2, "another key").unwrap_err();
        assert!(matches!(version, RebuildReason::OtherVersion { found: 1, now: 2 }));
        assert_eq!(exists(), [false, true]);
    }
}
