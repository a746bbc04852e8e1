//! The work directory: the arrays of a run, and a manifest that says what they are.
//!
//! Ownership rules. A stage owns the arrays it stamps; it writes them under temporary names,
//! renames them when whole, and stamps the manifest last. A stage whose *key* (a hash of its options
//! and of the keys it builds on) equals the stamped one is reused; any other key makes it
//! anew, and everything downstream with it, since their keys contain this one. The directory is
//! locked by an advisory lock that dies with its process, so a stale lock cannot exist.
//!
//! A temporary directory is removed when dropped; one that a killed run left behind is removed by
//! the next run that makes one beside it.

use super::MappedSlice;
use super::aligned_buffer::AlignedBuffer;
use super::budget::Budget;
use super::held::Held;
use super::manifest::MANIFEST;
pub use super::manifest::{FORMAT, FileRecord, Manifest, NOT_MADE, Stage, checksum, key_of};
use super::npy::{self, ArrayMut, ArrayWriter, Item};
use super::rows_file::{MOST_HELD, RowsFile};
use crate::base::{Error, Result};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard};

const LOCK: &str = "lock";
const TEMPORARY: &str = ".nystrom-stream-";

/// An open, locked work directory.
#[derive(Debug)]
pub struct WorkDir {
    path: PathBuf,
    manifest: Mutex<Manifest>,
    _lock: File,
    temporary: bool,
    /// Whether it lies in another, which it is removed with.
    inside: bool,
    /// Whether other processes may read it too; nothing is stamped then.
    pub(super) shared: bool,
    /// Arrays in memory instead of in files.
    held: Option<Arc<Held>>,
}

/// Locks the folder, alone or shared with other readers; `None` where another process is in the way.
fn lock(path: &Path, shared: bool) -> Result<Option<File>> {
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

impl WorkDir {
    /// Opens (or creates) the work directory at `path` and locks it.
    ///
    /// # Errors
    /// [`Error::WorkDir`] when it is in use, of another format, or not a work directory;
    /// [`Error::Io`].
    pub fn open(path: &Path) -> Result<Self> {
        Self::try_open(path, false)?
            .ok_or_else(|| Error::work_dir(path, "is in use by another process", "wait for it, or name another folder"))
    }

    /// The same, `None` where another process is in the way. `shared`: beside other processes that open it so too;
    /// nothing can be stamped then, and files may be added under names of one's own only.
    ///
    /// # Errors
    /// As [`WorkDir::open`], but for directories in use.
    pub fn try_open(path: &Path, shared: bool) -> Result<Option<Self>> {
        std::fs::create_dir_all(path).map_err(Error::io(path, "create"))?;
        let manifest_path = path.join(MANIFEST);
        // Looked into first: another process that begins here right now leaves its lock before anything else.
        let occupied = std::fs::read_dir(path).map_err(Error::io(path, "list"))?.next().is_some();
        if occupied && !manifest_path.exists() && !path.join(LOCK).exists() {
            return Err(Error::work_dir(
                path,
                "is not empty and not a work directory of this program",
                "name an empty or new folder",
            ));
        }
        let Some(lock) = lock(path, shared)? else { return Ok(None) };
        let manifest = match std::fs::read_to_string(&manifest_path) {
            Ok(text) => serde_json::from_str::<Manifest>(&text).map_err(|error| {
                Error::work_dir(&manifest_path, format!("cannot be read: {error}"), "delete the work directory")
            })?,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Manifest::new(),
            Err(error) => return Err(Error::io(&manifest_path, "read")(error)),
        };
        if manifest.format != FORMAT {
            return Err(Error::work_dir(
                path,
                format!("has format {}, this program writes {FORMAT}", manifest.format),
                "delete it or use the program that wrote it",
            ));
        }
        let manifest = Mutex::new(manifest);
        let work = Self {
            path: path.to_path_buf(),
            manifest,
            _lock: lock,
            temporary: false,
            inside: false,
            shared,
            held: None,
        };
        if !shared {
            work.sweep();
        }
        Ok(Some(work))
    }

    /// Opens an existing work directory for looking at it, beside any other reader.
    ///
    /// # Errors
    /// [`Error::WorkDir`] when there is none, or when it is in use; [`Error::Io`].
    pub fn open_existing(path: &Path) -> Result<Self> {
        if !path.join(MANIFEST).exists() {
            return Err(Error::work_dir(path, "is no work directory, or an empty one", "check the path"));
        }
        Self::try_open(path, true)?
            .ok_or_else(|| Error::work_dir(path, "is in use by another process", "wait for it to end"))
    }

    /// Removes temporary files that a killed run left.
    fn sweep(&self) {
        let Ok(entries) = std::fs::read_dir(&self.path) else { return };
        for entry in entries.flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            // Half-filled rows stay: their journal knows which of them are whole.
            let rows = name == "distances.npy.partial" || name.contains("-of-");
            if name.ends_with(".tmp") || (name.ends_with(".partial") && !rows) {
                self.remove(&name);
            }
        }
    }

    /// A temporary work directory inside `parent`, removed when dropped. Also removes those
    /// that killed runs left there.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn temporary(parent: &Path) -> Result<Self> {
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
                let manifest = Mutex::new(Manifest::new());
                return Ok(Self {
                    path,
                    manifest,
                    _lock: lock,
                    temporary: true,
                    inside: false,
                    shared: false,
                    held: None,
                });
            }
        }
        Err(Error::work_dir(parent, "temporary folders are taken away by another process", "name another --tmp"))
    }

    /// The same, but a temporary directory holds arrays in memory where they leave half of `budget` to others.
    #[must_use]
    pub fn holding(mut self, budget: &Budget) -> Self {
        self.held = self.temporary.then(|| Arc::new(Held::new(budget)));
        self
    }

    /// A work directory in the folder `name` of this one, which lasts as long. Its arrays are files, which others may find there.
    ///
    /// # Errors
    /// As [`WorkDir::open`].
    pub fn inner(&self, name: &str) -> Result<Self> {
        let mut inner = Self::open(&self.file(name))?;
        (inner.temporary, inner.inside) = (self.temporary, true);
        Ok(inner)
    }

    /// Its folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether it will be removed when dropped, or with the one it lies in.
    pub fn is_temporary(&self) -> bool {
        self.temporary
    }

    /// Whether files must reach the disk before they are stamped.
    pub fn durable(&self) -> bool {
        !self.temporary
    }

    /// The path of a file in it.
    pub fn file(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Starts an array of known shape. Where it lasts it is on its way to the disk when it is finished: stamping its stage
    /// waits for that.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn array<T: Item>(&self, name: &str, shape: &[usize]) -> Result<ArrayMut<T>> {
        let path = self.file(name);
        let bytes = shape.iter().product::<usize>() / T::WIDTH * size_of::<T>();
        Ok(match self.room(bytes) {
            Some((words, held)) => ArrayMut::held(&path, shape, words, held),
            None => ArrayMut::create(&path, shape)?.written_early(self.durable()),
        })
    }

    /// Memory for an array of `bytes`, where arrays are held and there is room.
    fn room(&self, bytes: usize) -> Option<(AlignedBuffer, Arc<Held>)> {
        let held = self.held.as_ref()?;
        (bytes > 0).then(|| held.take(bytes)).flatten().map(|words| (words, held.clone()))
    }

    /// Starts an array written front to back of at most `items` items.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn writer_of<T: Item>(&self, name: &str, row: usize, items: usize) -> Result<ArrayWriter<T>> {
        match self.room(items * size_of::<T>()) {
            Some((words, held)) => Ok(ArrayWriter::held(&self.file(name), row, words, held)),
            None => self.writer(name, row),
        }
    }

    /// Starts an array written front to back.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn writer<T: Item>(&self, name: &str, row: usize) -> Result<ArrayWriter<T>> {
        ArrayWriter::create(&self.file(name), row)
    }

    /// Starts a two-dimensional array whose rows are written one by one.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn rows<T: Item>(&self, name: &str, rows: usize, len: usize) -> Result<RowsFile<T>> {
        let (path, bytes) = (self.file(name), rows * len * size_of::<T>());
        let room = if bytes <= MOST_HELD { self.room(bytes) } else { None };
        match room {
            Some((words, held)) => Ok(RowsFile::held(&path, rows, len, words, held)),
            None => RowsFile::create(&path, rows, len),
        }
    }

    /// Writes a whole array: into memory, where arrays are held and there is room.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn write<T: Item>(&self, name: &str, items: &[T], row: usize) -> Result<MappedSlice<T>> {
        let mut writer = self.writer_of(name, row, items.len())?;
        writer.push(items)?;
        writer.finish(false)
    }

    /// Opens a finished array.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Malformed`].
    pub fn open_array<T: Item>(&self, name: &str) -> Result<MappedSlice<T>> {
        let path = self.file(name);
        match self.held.as_ref().and_then(|held| held.get(name)) {
            Some(bytes) => bytes.slice(&path, 0, bytes.len() / size_of::<T>()),
            None => npy::open(&path),
        }
    }

    /// Bytes of the array `name` where it is held in memory.
    pub(super) fn held_bytes(&self, name: &str) -> Option<u64> {
        Some(self.held.as_ref()?.get(name)?.len() as u64)
    }

    /// Removes a file that is no longer needed; whether it was there does not matter.
    pub fn remove(&self, name: &str) {
        if let Some(held) = &self.held {
            held.remove(name);
        }
        let _ = std::fs::remove_file(self.file(name));
    }

    pub(super) fn manifest_lock(&self) -> MutexGuard<'_, Manifest> {
        self.manifest.lock().unwrap_or_else(|poison| poison.into_inner())
    }

    /// A copy of the manifest.
    pub fn manifest(&self) -> Manifest {
        self.manifest_lock().clone()
    }

    /// Bytes of all files in it now.
    pub fn bytes(&self) -> u64 {
        let Ok(entries) = std::fs::read_dir(&self.path) else { return 0 };
        entries.flatten().filter_map(|entry| entry.metadata().ok()).map(|metadata| metadata.len()).sum()
    }
}

impl Drop for WorkDir {
    fn drop(&mut self) {
        if self.temporary && !self.inside {
            let _ = std::fs::remove_dir_all(&self.path);
        }
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_stage_is_reused_only_with_the_same_key_and_whole_files() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("w");
        let options = json!({"a": 1});
        let key = key_of(&options);
        {
            let work = WorkDir::open(&path).unwrap();
            assert!(WorkDir::open(&path).is_err(), "locked");
            npy::write(&work.file("x.npy"), &[1u32, 2], 1, true).unwrap();
            work.stamp("s", &key, &options, &["x.npy"], &7, 0.5).unwrap();
        }
        let work = WorkDir::open(&path).unwrap();
        assert_eq!(work.reuse::<i32>("s", &key), Ok(7));
        assert!(work.reuse::<i32>("t", &key).is_err());
        let whole = std::fs::read(work.file("x.npy")).unwrap();
        let mut flipped = whole.clone();
        *flipped.last_mut().unwrap() ^= 1;
        for (bytes, reason) in [(&whole[..1], "bytes"), (&flipped[..], "damaged")] {
            std::fs::write(work.file("x.npy"), bytes).unwrap();
            assert!(work.reuse::<i32>("s", &key).unwrap_err().contains(reason));
            // A stage that has to be made anew is forgotten at once.
            std::fs::write(work.file("x.npy"), &whole).unwrap();
            assert!(work.reuse::<i32>("s", &key).is_err());
            work.stamp("s", &key, &options, &["x.npy"], &7, 0.5).unwrap();
        }
        assert!(work.reuse::<i32>("s", "other").unwrap_err().contains("changed"));
    }

    #[test]
    fn temporary_directories_vanish_even_after_a_crash() {
        let dir = tempfile::tempdir().unwrap();
        let first = WorkDir::temporary(dir.path()).unwrap();
        let abandoned = dir.path().join(".nystrom-stream-dead");
        std::fs::create_dir(&abandoned).unwrap();
        std::fs::write(abandoned.join(LOCK), []).unwrap();
        let second = WorkDir::temporary(dir.path()).unwrap();
        assert!(!abandoned.exists());
        assert!(first.path().exists(), "a live one stays");
        drop((first, second));
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    }

    #[test]
    fn foreign_folders_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("thesis.doc"), []).unwrap();
        assert!(matches!(WorkDir::open(dir.path()), Err(Error::WorkDir { .. })));
    }
}
