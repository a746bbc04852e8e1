//! Stages of a work directory: reused where their keys say so, stamped when they are finished.

use super::manifest::{FileRecord, MANIFEST, Manifest, NOT_MADE, Stage, checksum};
use super::npy;
use super::workdir::WorkDir;
use crate::base::{Error, Result};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Write;

impl WorkDir {
    /// The facts of a finished stage, where its key is `key` and its files have the stamped sizes and checksums.
    /// Otherwise `Err` with the reason, in words, why it has to be made (anew); the manifest forgets the stage then, so
    /// that a run killed while making it anew leaves no record of files that are no longer those.
    pub fn reuse<T: DeserializeOwned>(&self, stage: &str, key: &str) -> Result<T, String> {
        let found = self.look_up(stage, key);
        if found.is_err() && !self.shared {
            let mut manifest = self.manifest_lock();
            if manifest.stages.remove(stage).is_some()
                && let Err(error) = self.save(&manifest)
            {
                return Err(error.to_string());
            }
        }
        found
    }

    fn look_up<T: DeserializeOwned>(&self, stage: &str, key: &str) -> Result<T, String> {
        let manifest = self.manifest_lock();
        let record = manifest.stages.get(stage).ok_or_else(|| NOT_MADE.to_string())?;
        if record.key != key {
            return Err("its options or inputs changed".to_string());
        }
        if self.is_temporary() {
            record.files.iter().try_for_each(|(name, file)| self.unharmed(name, file))?;
        } else {
            // Side by side: reading is what another number of parts waits for most.
            std::thread::scope(|scope| {
                let mut checks = Vec::new();
                for (name, file) in &record.files {
                    checks.push(scope.spawn(|| self.unharmed(name, file)));
                }
                checks
                    .into_iter()
                    .try_for_each(|check| check.join().unwrap_or_else(|_| Err("it cannot be read".into())))
            })?;
        }
        serde_json::from_value(record.facts.clone()).map_err(|error| format!("its facts are unreadable: {error}"))
    }

    /// Whether a file still has the bytes that were stamped: one sequential read, far cheaper than a wrong label.
    fn unharmed(&self, name: &str, file: &FileRecord) -> Result<(), String> {
        if self.held_bytes(name) == Some(file.bytes) {
            return Ok(());
        }
        match std::fs::metadata(self.file(name)) {
            Ok(metadata) if metadata.len() == file.bytes => {}
            Ok(metadata) => return Err(format!("{name} has {} bytes instead of {}", metadata.len(), file.bytes)),
            Err(_) => return Err(format!("{name} is missing")),
        }
        if file.xxh3.is_empty() {
            return Ok(());
        }
        match checksum(&self.file(name)) {
            Ok(sum) if sum == file.xxh3 => Ok(()),
            Ok(_) => Err(format!("{name} was changed or damaged")),
            Err(error) => Err(error.to_string()),
        }
    }

    /// Stamps a stage as finished.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn stamp(
        &self,
        stage: &str,
        key: &str,
        options: &serde_json::Value,
        files: &[&str],
        facts: &impl Serialize,
        seconds: f64,
    ) -> Result<()> {
        let records = if self.is_temporary() {
            // Nothing to wait for.
            files.iter().map(|&name| Ok((name.to_string(), self.sealed(name)?))).collect::<Result<BTreeMap<_, _>>>()?
        } else {
            self.sealed_all(files)?
        };
        let facts = serde_json::to_value(facts)
            .map_err(|error| Error::work_dir(self.path(), format!("facts of {stage}: {error}"), "report this"))?;
        let record = Stage { key: key.to_string(), options: options.clone(), files: records, facts, seconds };
        let mut manifest = self.manifest_lock();
        manifest.stages.insert(stage.to_string(), record);
        self.save(&manifest)
    }

    /// The records of finished files, side by side: each waits for the disk.
    fn sealed_all(&self, files: &[&str]) -> Result<BTreeMap<String, FileRecord>> {
        std::thread::scope(|scope| {
            let started: Vec<_> = files.iter().map(|&name| (name, scope.spawn(move || self.sealed(name)))).collect();
            let ended = started.into_iter().map(|(name, sealing)| {
                let lost = || Error::io(self.file(name), "sync")(std::io::Error::other("a thread failed"));
                Ok((name.to_string(), sealing.join().map_err(|_| lost())??))
            });
            ended.collect::<Result<BTreeMap<_, _>>>()
        })
    }

    /// The record of the finished file `name`, which is on the disk before the manifest says so.
    fn sealed(&self, name: &str) -> Result<FileRecord> {
        if let Some(bytes) = self.held_bytes(name) {
            return Ok(FileRecord { bytes, xxh3: String::new() });
        }
        let path = self.file(name);
        let bytes = std::fs::metadata(&path).map_err(Error::io(&path, "look at"))?.len();
        if self.is_temporary() {
            return Ok(FileRecord { bytes, xxh3: String::new() });
        }
        File::open(&path).and_then(|file| file.sync_all()).map_err(Error::io(&path, "sync"))?;
        Ok(FileRecord { bytes, xxh3: checksum(&path)? })
    }

    /// Gives up files of a finished stage that nothing will read again, in a temporary directory: its disk can hold a
    /// larger mesh then, and the page cache more of the rest. Should the stage be asked for after all, it is made anew.
    /// Elsewhere they stay, for the next run.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn release(&self, stage: &str, files: &[&str]) -> Result<()> {
        if !self.is_temporary() {
            return Ok(());
        }
        let mut manifest = self.manifest_lock();
        manifest.stages.remove(stage);
        self.save(&manifest)?;
        files.iter().for_each(|file| self.remove(file));
        Ok(())
    }

    /// Brings the manifest to the disk, where it will outlast this process.
    fn save(&self, manifest: &Manifest) -> Result<()> {
        if self.is_temporary() {
            return Ok(());
        }
        let path = self.file(MANIFEST);
        let partial = npy::partial_name(&path);
        let text = serde_json::to_string_pretty(manifest)
            .map_err(|error| Error::work_dir(&path, error.to_string(), "report this"))?;
        let mut file = File::create(&partial).map_err(Error::io(&partial, "create"))?;
        file.write_all(text.as_bytes()).map_err(Error::io(&partial, "write"))?;
        file.sync_all().map_err(Error::io(&partial, "sync"))?;
        std::fs::rename(&partial, &path).map_err(Error::io(&partial, "rename"))
    }
}
