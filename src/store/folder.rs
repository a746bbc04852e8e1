//! Folders that one process has for itself: locked while in use, and removed with the process where they are temporary.
//!
//! The lock is an advisory one of the operating system and dies with its process, so a stale lock cannot exist. Temporary
//! folders that a killed run left behind are known by their unlocked lock file, and the next run beside them removes them.

use crate::base::{Error, Result};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// The lock file.
pub(super) const LOCK: &str = "lock";
const TEMPORARY: &str = ".nystrom-stream-";

/// A folder and the lock on it.
#[derive(Debug)]
struct Folder {
    path: PathBuf,
    /// None where the folder could not be made: then every file in it fails as this one would.
    _lock: Option<File>,
}

/// The folder of a work directory, which may be made only when its first file needs it.
#[derive(Debug)]
pub(super) struct WorkFolder {
    parent: PathBuf,
    folder: OnceLock<Folder>,
}

impl WorkFolder {
    /// The folder `path`, whose lock is held.
    pub fn locked(path: &Path, lock: File) -> Self {
        let folder = Folder { path: path.to_path_buf(), _lock: Some(lock) };
        Self { parent: PathBuf::new(), folder: OnceLock::from(folder) }
    }

    /// A new folder in `parent`.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn temporary(parent: &Path) -> Result<Self> {
        Ok(Self { parent: parent.to_path_buf(), folder: OnceLock::from(temporary_folder(parent)?) })
    }

    /// A new folder in `parent`, made at the first call of [`WorkFolder::path`].
    pub fn put_off(parent: &Path) -> Self {
        Self { parent: parent.to_path_buf(), folder: OnceLock::new() }
    }

    /// Its path; made now where that was put off.
    pub fn path(&self) -> &Path {
        let make = || {
            let parent = || Folder { path: self.parent.clone(), _lock: None };
            temporary_folder(&self.parent).unwrap_or_else(|_| parent())
        };
        &self.folder.get_or_init(make).path
    }

    /// Its path where it is made, else that of the folder that it would be in.
    pub fn place(&self) -> &Path {
        self.made().unwrap_or(&self.parent)
    }

    /// Its path where it is made.
    pub fn made(&self) -> Option<&Path> {
        self.folder.get().map(|folder| folder.path.as_path())
    }

    /// Removes it with all that is in it.
    pub fn remove(&self) {
        if let Some(Folder { path, _lock: Some(_) }) = self.folder.get() {
            let _ = std::fs::remove_dir_all(path);
        }
    }
}

/// Locks the folder, alone or shared with other readers; `None` where another process is in the way.
pub(super) fn lock(path: &Path, shared: bool) -> Result<Option<File>> {
    let file = File::options()
        .create(true)
        .truncate(false)
        .read(true)
        .write(true)
        .open(path.join(LOCK))
        .map_err(Error::io(path.join(LOCK), "create"))?;
    let tried = if shared { fs4::FileExt::try_lock_shared(&file) } else { fs4::FileExt::try_lock(&file) };
    match tried {
        Ok(()) => Ok(Some(file)),
        Err(fs4::TryLockError::WouldBlock) => Ok(None),
        Err(fs4::TryLockError::Error(error)) => Err(Error::io(path.join(LOCK), "lock")(error)),
    }
}

/// A new, locked folder in `parent`; those that killed runs left there are removed.
fn temporary_folder(parent: &Path) -> Result<Folder> {
    remove_abandoned(parent);
    // Another process that clears up may take a folder in the moment before it is locked: then once more.
    for _ in 0..16 {
        let dir = tempfile::Builder::new()
            .prefix(TEMPORARY)
            .tempdir_in(parent)
            .map_err(Error::io(parent, "create a temporary folder in"))?;
        let path = dir.keep();
        let locked = lock(&path, false);
        if !path.join(LOCK).exists() {
            continue;
        }
        if let Some(lock) = locked? {
            return Ok(Folder { path, _lock: Some(lock) });
        }
    }
    Err(Error::work_dir(parent, "temporary folders are taken away by another process", "name another --tmp"))
}

/// Removes temporary work directories in `parent` whose process is gone.
fn remove_abandoned(parent: &Path) {
    let Ok(entries) = std::fs::read_dir(parent) else { return };
    for entry in entries.flatten() {
        let ours = entry.file_name().to_string_lossy().starts_with(TEMPORARY);
        if ours && entry.path().join(LOCK).exists() && matches!(lock(&entry.path(), false), Ok(Some(_))) {
            let _ = std::fs::remove_dir_all(entry.path());
        }
    }
}
