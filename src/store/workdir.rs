//! The work directory: the arrays of a run, and a manifest that describes them.
//!
//! A stage owns the arrays that it records; it writes them under temporary names, renames them when complete, and
//! records them in the manifest last. A stage whose *key* (a hash of its options and of the keys it builds on) equals
//! the recorded one is reused. With another key it is rebuilt, as is everything downstream, since those keys contain
//! this one. The directory is locked by an advisory lock that ends with its process, so a stale lock cannot exist.
//! Where the file system has no locks ([`WorkDir::is_locked`]), whoever starts the processes must keep them apart.
//!
//! A temporary directory is removed when dropped; that of a killed run is removed by the next run that creates one in
//! the same parent. A lasting one that was created is removed too if nothing was written to it but a decoded mesh.
//!
//! Memory: the manifest, some hundred bytes per file, and the arrays kept in memory, which count against the budget
//! ([`super::in_memory`]). Opening reads the manifest and lists the folder; a stage's files are read when they are
//! reused.

use super::budget::Budget;
use super::folder::{Lock, MARK, WorkFolder, bytes_in, create_missing, is_begun, is_occupied, lock};
use super::in_memory::InMemoryArrays;
use super::json;
use super::manifest::{FORMAT, MANIFEST, is_of_two};
pub use super::manifest::{Manifest, checksum};
use super::mapped::AlignedBuffer;
use super::npy::{self, ArrayMut, ArrayWriter, Item};
use super::rows_file::{self, RowsFile};
use super::{MappedBytes, MappedSlice, MappedSliceMut};
use crate::base::{Cancel, Error, Result, parallel};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard};

/// An open, locked work directory.
#[derive(Debug)]
pub struct WorkDir {
    folder: Arc<WorkFolder>,
    manifest: Mutex<Manifest>,
    temporary: bool,
    /// Whether it is nested in another one and removed with it.
    inside: bool,
    /// Whether other processes may read it too; no stage is recorded then.
    pub(super) shared: bool,
    /// Arrays in memory instead of in files.
    arrays: Option<Arc<InMemoryArrays>>,
    /// The directories nested in a temporary one, by name: their arrays in memory live as long as this one.
    inside_of_it: Mutex<BTreeMap<String, Arc<WorkDir>>>,
    /// Whether arrays that are only read sequentially are kept in memory too, although files serve as well for them.
    everything: bool,
    /// Whoever asks for a stop while files are read for their checksums.
    pub cancel: Cancel,
    /// On how many threads that is done at most.
    pub(super) threads: usize,
    /// The input's identity, taken before it was read; null if there is none.
    pub(crate) input: Mutex<Value>,
}

/// Removes files of a work directory when dropped: arrays that are needed only during one computation.
#[derive(Debug)]
#[must_use]
pub struct Scratch<'a> {
    work: &'a WorkDir,
    names: &'a [&'a str],
}

impl Drop for Scratch<'_> {
    fn drop(&mut self) {
        self.names.iter().for_each(|name| self.work.remove(name));
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
            .ok_or_else(|| Error::work_dir(path, "is in use by another run", "wait for it, or choose another folder"))
    }

    /// The same, but `None` if another process has locked it. `shared`: beside other processes that open it shared;
    /// nothing is created or recorded then, except files under unique names, and a missing folder also gives `None`.
    ///
    /// # Errors
    /// As [`WorkDir::open`], except for directories in use.
    pub fn try_open(path: &Path, shared: bool) -> Result<Option<Self>> {
        if shared && !path.is_dir() {
            return Ok(None);
        }
        let created = if shared { 0 } else { create_missing(path)? };
        let manifest_path = path.join(MANIFEST);
        // Listed before checking for a lock: another process that starts here right now creates its lock, and marks it,
        // before anything else.
        let foreign = || -> Result<bool> {
            Ok(is_occupied(path)? && !manifest_path.exists() && !is_begun(path) && !is_of_two(path))
        };
        // More than once: a process that ends here unused may be removing its lock.
        if foreign()? && foreign()? && foreign()? {
            return Err(Error::work_dir(
                path,
                "is not empty and not a work directory of this program",
                "choose an empty or new folder",
            ));
        }
        let lock = match lock(path, shared, MARK)? {
            Lock::Busy => return Ok(None),
            Lock::Held(held) => Some(held),
            Lock::Unsupported => None,
        };
        let manifest = match std::fs::read(&manifest_path) {
            Ok(text) => serde_json::from_slice::<Manifest>(&text).map_err(|error| {
                Error::work_dir(&manifest_path, format!("cannot be read: {error}"), "delete the work directory")
            })?,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Manifest::new(),
            Err(error) => return Err(Error::io(&manifest_path, "read")(error)),
        };
        if manifest.format > FORMAT {
            return Err(Error::work_dir(
                path,
                format!("has format {}, this program writes {FORMAT}", manifest.format),
                "delete it or use the program that wrote it",
            ));
        }
        if let Some(name) = manifest.foreign_file() {
            let problem = format!("lists {name:?}, which is not a file of a work directory");
            return Err(Error::work_dir(&manifest_path, problem, "delete the work directory"));
        }
        let manifest = Manifest { format: FORMAT, ..manifest };
        let mut work = Self::of(WorkFolder::of(path, lock, created), manifest);
        work.shared = shared;
        if !shared {
            work.sweep();
        }
        Ok(Some(work))
    }

    fn of(folder: WorkFolder, manifest: Manifest) -> Self {
        Self {
            folder: Arc::new(folder),
            manifest: Mutex::new(manifest),
            temporary: false,
            inside: false,
            shared: false,
            arrays: None,
            inside_of_it: Mutex::default(),
            everything: false,
            cancel: Cancel::default(),
            threads: usize::MAX,
            input: Mutex::default(),
        }
    }

    /// A temporary work directory inside `parent`, removed when dropped. Also removes those of killed runs there.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn temporary(parent: &Path) -> Result<Self> {
        let mut work = Self::of(WorkFolder::temporary(parent)?, Manifest::new());
        work.temporary = true;
        Ok(work)
    }

    /// A temporary work directory that keeps all arrays in memory as long as `budget` has room; its folder,
    /// in `parent`, is created with the first file that does not fit, and removed when dropped.
    pub fn in_memory(parent: &Path, budget: &Budget) -> Self {
        let mut work = Self::of(WorkFolder::deferred(parent), Manifest::new());
        (work.temporary, work.everything) = (true, true);
        work.holding(budget)
    }

    /// The same directory; if temporary, it keeps arrays in memory as long as [`Budget::left_to_stages`] stays free.
    #[must_use]
    pub fn holding(mut self, budget: &Budget) -> Self {
        self.arrays = self.temporary.then(|| Arc::new(InMemoryArrays::new(budget, self.folder.clone())));
        self
    }

    /// The same directory; files are read for their checksums on `threads` threads, and `cancel` stops that too.
    #[must_use]
    pub fn heeding(mut self, cancel: &Cancel, threads: usize) -> Self {
        (self.cancel, self.threads) = (cancel.clone(), threads);
        self
    }

    /// A work directory in the folder `name` of this one, with the same lifetime. It keeps arrays in memory if this one
    /// does.
    ///
    /// # Errors
    /// As [`WorkDir::open`].
    pub fn inner(&self, name: &str) -> Result<Arc<Self>> {
        let mut all = parallel::lock(&self.inside_of_it);
        if let Some(inner) = all.get(name) {
            return Ok(inner.clone());
        }
        let path = self.new_file(name)?;
        let mut inner = if self.shared { Self::open_existing(&path)? } else { Self::open(&path)? };
        (inner.temporary, inner.inside, inner.everything) = (self.temporary, true, self.everything);
        let mut inner = inner.heeding(&self.cancel, self.threads);
        inner.arrays = self.arrays.as_ref().map(|arrays| Arc::new(arrays.within(inner.folder.clone())));
        let inner = Arc::new(inner);
        if self.temporary {
            all.insert(name.to_string(), inner.clone());
        }
        Ok(inner)
    }

    /// Its folder; created now if that was deferred.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Whether it will be removed when dropped, or with its parent directory.
    pub fn is_temporary(&self) -> bool {
        self.temporary
    }

    /// Whether a lock keeps other processes out. False where the file system has no locks.
    pub fn is_locked(&self) -> bool {
        self.folder.is_locked()
    }

    /// Whether files must be synced before they are recorded.
    pub fn durable(&self) -> bool {
        !self.temporary
    }

    /// The path of a file in it.
    pub fn file(&self, name: &str) -> PathBuf {
        self.path().join(name)
    }

    /// The path of a new file in it.
    ///
    /// # Errors
    /// [`Error::Io`] if its folder could not be created.
    pub(super) fn new_file(&self, name: &str) -> Result<PathBuf> {
        // An array of that name in memory would shadow the file.
        if let Some(arrays) = &self.arrays {
            arrays.remove(name);
        }
        Ok(self.folder.for_new()?.join(name))
    }

    /// The file `name`, for records that exceed memory.
    pub fn spill(&self, name: &'static str) -> super::folder::DeferredFile {
        self.folder.file(name)
    }

    /// The path that a file has, or would have if the folder does not exist yet.
    pub(crate) fn place(&self, name: &str) -> PathBuf {
        self.folder.place().join(name)
    }

    /// Returns a guard that removes the files `names` when it is dropped.
    pub fn scratch<'a>(&'a self, names: &'a [&'a str]) -> Scratch<'a> {
        Scratch { work: self, names }
    }

    /// Starts an array of known shape. In a directory that is kept, finishing starts to write it to the disk; recording
    /// its stage waits for that.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn array<T: Item>(&self, name: &str, shape: &[usize]) -> Result<ArrayMut<T>> {
        match self.array_in_memory(name, shape) {
            Some(array) => Ok(array),
            None => Ok(ArrayMut::create(&self.new_file(name)?, shape)?.written_early(self.durable())),
        }
    }

    /// The same if it fits in memory; `None` if it would be a file.
    pub fn array_in_memory<T: Item>(&self, name: &str, shape: &[usize]) -> Option<ArrayMut<T>> {
        let bytes = shape.iter().product::<usize>() / T::WIDTH * size_of::<T>();
        let (buffer, arrays) = self.room(bytes)?;
        Some(ArrayMut::in_memory(&self.place(name), shape, buffer, arrays))
    }

    /// Memory for an array of `bytes`, if arrays are kept in memory and there is room.
    fn room(&self, bytes: usize) -> Option<(AlignedBuffer, Arc<InMemoryArrays>)> {
        let arrays = self.arrays.as_ref()?;
        (bytes > 0).then(|| arrays.take(bytes)).flatten().map(|buffer| (buffer, arrays.clone()))
    }

    /// Starts an array of some `items` items, written front to back. It may become longer.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn writer_of<T: Item>(&self, name: &str, row: usize, items: usize) -> Result<ArrayWriter<T>> {
        match self.room(items * size_of::<T>()) {
            Some((buffer, arrays)) => Ok(ArrayWriter::in_memory(&self.place(name), row, Some(buffer), arrays)),
            None => self.writer(name, row),
        }
    }

    /// Starts an array written front to back.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn writer<T: Item>(&self, name: &str, row: usize) -> Result<ArrayWriter<T>> {
        match &self.arrays {
            Some(arrays) if self.everything => Ok(ArrayWriter::in_memory(&self.place(name), row, None, arrays.clone())),
            _ => ArrayWriter::create(&self.new_file(name)?, row),
        }
    }

    /// Starts a two-dimensional array whose rows are written one by one.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn rows<T: Item>(&self, name: &str, rows: usize, len: usize) -> Result<RowsFile<T>> {
        let bytes = rows * len * size_of::<T>();
        let held = |arrays: &Arc<InMemoryArrays>| self.everything || rows_file::are_held(bytes as u64, arrays.budget());
        let room = if self.arrays.as_ref().is_some_and(held) { self.room(bytes) } else { None };
        match room {
            Some((buffer, arrays)) => Ok(RowsFile::in_memory(&self.place(name), rows, len, buffer, arrays)),
            None => RowsFile::create(&self.new_file(name)?, rows, len),
        }
    }

    /// Writes a whole array: to memory, if arrays are kept there and there is room.
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
        let path = self.place(name);
        match self.arrays.as_ref().and_then(|arrays| arrays.get(name)) {
            Some((bytes, len)) => bytes.slice(&path, 0, len / size_of::<T>()),
            None => npy::open(&path),
        }
    }

    /// The bytes of a finished array and the offset of its data: for records that are not an [`Item`].
    ///
    /// # Errors
    /// [`Error::Io`].
    pub(crate) fn array_bytes(&self, name: &str) -> Result<(MappedBytes, usize)> {
        match self.arrays.as_ref().and_then(|arrays| arrays.get(name)) {
            Some((bytes, _)) => Ok((bytes, 0)),
            None => Ok((MappedBytes::open(&self.place(name))?, npy::HEADER)),
        }
    }

    /// Writes `value` as JSON: to memory, if arrays are kept there and there is room, else to a file, by rename.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Unusable`] for a value that JSON cannot represent.
    pub fn write_json(&self, name: &str, value: &impl Serialize) -> Result<()> {
        let text = json::text(&self.place(name), value)?;
        if let Some((mut buffer, arrays)) = self.room(text.len()) {
            buffer.bytes_mut()[..text.len()].copy_from_slice(&text);
            if let Some(bytes) = MappedSliceMut::<u8>::held(buffer, text.len()).freeze() {
                arrays.keep(name, bytes, text.len());
            }
            return Ok(());
        }
        json::replace(&self.new_file(name)?, &text, self.durable())
    }

    /// Whether there is a file or an array in memory named `name`.
    pub fn holds(&self, name: &str) -> bool {
        self.bytes_in_memory(name).is_some() || self.place(name).exists()
    }

    /// The text of the JSON file `name`.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn json_text(&self, name: &str) -> Result<Vec<u8>> {
        if let Some((bytes, len)) = self.arrays.as_ref().and_then(|arrays| arrays.get(name)) {
            return Ok(bytes[..len].to_vec());
        }
        let path = self.place(name);
        std::fs::read(&path).map_err(Error::io(&path, "read"))
    }

    /// Reads what [`WorkDir::write_json`] wrote.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::WorkDir`].
    pub fn read_json<T: DeserializeOwned>(&self, name: &str) -> Result<T> {
        serde_json::from_slice(&self.json_text(name)?)
            .map_err(|error| Error::work_dir(self.place(name), error.to_string(), "delete the work directory"))
    }

    /// Size in bytes of the array `name` if it is in memory.
    pub(super) fn bytes_in_memory(&self, name: &str) -> Option<u64> {
        Some(self.arrays.as_ref()?.get(name)?.1 as u64)
    }

    /// Removes a file that is no longer needed; a missing file is fine.
    pub fn remove(&self, name: &str) {
        if let Some(arrays) = &self.arrays {
            arrays.remove(name);
        }
        if let Some(folder) = self.folder.existing() {
            let _ = std::fs::remove_file(folder.join(name));
        }
    }

    pub(super) fn manifest_lock(&self) -> MutexGuard<'_, Manifest> {
        parallel::lock(&self.manifest)
    }

    /// A copy of the manifest.
    pub fn manifest(&self) -> Manifest {
        self.manifest_lock().clone()
    }

    /// Total size in bytes of all files in it now, those of folders inside included.
    pub fn bytes(&self) -> u64 {
        self.folder.existing().map_or(0, bytes_in)
    }
}

impl Drop for WorkDir {
    fn drop(&mut self) {
        if self.temporary && !self.inside {
            self.folder.remove();
        } else {
            if self.folder.is_owned() && !self.shared {
                self.remove_mesh_without_stage();
            }
            self.folder.remove_unused();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::folder::LOCK;
    use crate::store::stage::{RebuildReason, StageKey, key_of};
    use serde_json::json;

    #[test]
    fn a_stage_is_reused_only_with_the_same_key_and_whole_files() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("w");
        let options = json!({"a": 1});
        let key = key_of("s", 1, &options);
        let stage = |version| StageKey { name: "s", version, key: key.clone(), inputs: options.clone() };
        {
            let work = WorkDir::open(&path).unwrap();
            assert!(WorkDir::open(&path).is_err(), "locked");
            npy::write(&work.file("x.npy"), &[1u32, 2], 1, true).unwrap();
            work.record_stage(stage(1), &["x.npy"], &7, 0.5).unwrap();
        }
        // A reader creates nothing: a copy of a directory need not have a lock, or may be read-only.
        std::fs::remove_file(path.join(LOCK)).unwrap();
        {
            let looks = [WorkDir::open_existing(&path).unwrap(), WorkDir::open_existing(&path).unwrap()];
            assert!(looks.iter().all(|work| !work.is_locked()) && !path.join(LOCK).exists());
            assert!(WorkDir::try_open(&dir.path().join("absent"), true).unwrap().is_none());
            assert!(!dir.path().join("absent").exists());
        }
        let work = WorkDir::open(&path).unwrap();
        assert_eq!(work.reuse::<i32>("s", 1, &key), Ok(7));
        assert_eq!(work.reuse::<i32>("t", 1, &key), Err(RebuildReason::NotMade));
        let whole = std::fs::read(work.file("x.npy")).unwrap();
        let mut flipped = whole.clone();
        *flipped.last_mut().unwrap() ^= 1;
        for (bytes, reason) in [(&whole[..1], "1 byte instead"), (&flipped[..], "damaged")] {
            std::fs::write(work.file("x.npy"), bytes).unwrap();
            let Err(RebuildReason::Damaged(problem)) = work.reuse::<i32>("s", 1, &key) else { panic!("{reason}") };
            assert!(problem.contains(reason), "{problem}");
            // A stage that has to be rebuilt is removed from the manifest at once.
            std::fs::write(work.file("x.npy"), &whole).unwrap();
            assert_eq!(work.reuse::<i32>("s", 1, &key), Err(RebuildReason::NotMade));
            work.record_stage(stage(1), &["x.npy"], &7, 0.5).unwrap();
        }
        assert_eq!(work.reuse::<i32>("s", 1, "other"), Err(RebuildReason::OtherInputs));
        work.record_stage(stage(1), &["x.npy"], &7, 0.5).unwrap();
        let other = work.reuse::<i32>("s", 2, &key).unwrap_err();
        assert_eq!(other.to_string(), "another version of the program made it (algorithm 1, now 2)");
    }

    #[test]
    fn a_file_takes_the_place_of_a_held_array_of_its_name() {
        let dir = tempfile::tempdir().unwrap();
        let work = WorkDir::temporary(dir.path()).unwrap().holding(&Budget::new(1 << 30));
        let held = work.array_in_memory::<u32>("lengths.npy", &[7]).unwrap().finish(false).unwrap();
        // Regression: an array held in memory was found instead of a later file of its name, such as edges with
        // bridges.
        let mut longer = work.writer::<u32>("lengths.npy", 1).unwrap();
        longer.push(&[3; 9]).unwrap();
        longer.finish(false).unwrap();
        assert_eq!((*held).len(), 7);
        assert_eq!(*work.open_array::<u32>("lengths.npy").unwrap(), [3; 9]);
    }

    #[test]
    fn what_a_killed_run_left_goes_and_half_filled_rows_stay() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("w");
        drop(WorkDir::open(&path).unwrap());
        let work = WorkDir::open(&path).unwrap();
        npy::write(&work.file("x.npy"), &[1u32], 1, true).unwrap();
        work.record_stage(StageKey::new("s", 1, json!({})), &["x.npy"], &7, 0.5).unwrap();
        drop(work);
        let names = ["cells.tmp", "x.npy.partial", "distances.npy.partial", "rows-1-of-2.npy.partial", "x.npy"];
        let there = || names.map(|name| path.join(name).exists());
        names[..4].iter().for_each(|name| std::fs::write(path.join(name), []).unwrap());
        // A reader removes nothing.
        drop(WorkDir::open_existing(&path).unwrap());
        assert_eq!(there(), [true; 5]);
        drop(WorkDir::open(&path).unwrap());
        assert_eq!(there(), [false, false, true, true, true]);
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
    fn a_directory_of_format_1_is_read_and_its_stages_are_made_anew() {
        let dir = tempfile::tempdir().unwrap();
        let stage = json!({"key": "k", "options": {}, "files": {}, "facts": 7, "seconds": 1.});
        let manifest = json!({"format": 1, "program": "nystrom-stream 0.1.0", "stages": {"s": stage}});
        std::fs::write(dir.path().join(MANIFEST), manifest.to_string()).unwrap();
        let work = WorkDir::open(dir.path()).unwrap();
        assert!(matches!(work.reuse::<i32>("s", 1, "k"), Err(RebuildReason::OtherVersion { .. })));
        // Regression: the manifest named the program that created the directory, not the one that last wrote to it.
        work.record_stage(StageKey::new("s", 2, json!({})), &[], &7, 0.5).unwrap();
        let manifest: Value = serde_json::from_slice(&std::fs::read(dir.path().join(MANIFEST)).unwrap()).unwrap();
        assert_eq!((&manifest["format"], &manifest["program"]), (&json!(2), &json!(crate::store::manifest::PROGRAM)));
    }

    #[test]
    fn arrays_in_memory_touch_no_disk_until_the_budget_ends() {
        let dir = tempfile::tempdir().unwrap();
        let files = || std::fs::read_dir(dir.path()).unwrap().count();
        let work = WorkDir::in_memory(dir.path(), &Budget::new(1 << 20));
        let mut array = work.array::<u32>("a.npy", &[1001]).unwrap();
        array.data().fill(3);
        array.finish(false).unwrap();
        assert_eq!(work.open_array::<u32>("a.npy").unwrap().len(), 1001, "the buffer is a word longer");
        work.write_json("facts.json", &vec![1, 2]).unwrap();
        assert_eq!(work.read_json::<Vec<u32>>("facts.json").unwrap(), [1, 2]);
        let mut writer = work.writer::<u32>("b.npy", 1).unwrap();
        writer.push(&[1; 20_000]).unwrap();
        assert_eq!(files(), 0);
        // Half of the budget stays free: what exceeds the rest becomes a file, with all that the array already had.
        for _ in 0..20 {
            writer.push(&[2; 20_000]).unwrap();
        }
        let long = writer.finish(false).unwrap();
        assert_eq!((long.len(), long[19_999], long[20_000], files()), (420_000, 1, 2, 1));
        assert_eq!(*work.open_array::<u32>("b.npy").unwrap(), *long);
        {
            let _scratch = work.scratch(&["a.npy", "b.npy"]);
        }
        assert!(work.open_array::<u32>("a.npy").is_err() && work.open_array::<u32>("b.npy").is_err());
        drop((work, long));
        assert_eq!(files(), 0);
    }

    #[test]
    fn foreign_folders_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("thesis.doc"), []).unwrap();
        assert!(matches!(WorkDir::open(dir.path()), Err(Error::WorkDir { .. })));
    }
}
