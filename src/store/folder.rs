//! Folders owned by one process: locked while in use, and removed with the process where they are temporary.
//!
//! The lock is an advisory lock of the operating system and ends with its process, so a stale lock cannot exist.
//! Other programs have files called `lock`, too. The content of ours tells them apart: it marks a work directory that
//! has no manifest yet, and names the machine of a temporary folder.
//! Temporary folders of a killed run are recognised by their unlocked lock file, or by being empty, and the next run in
//! the same parent removes them.
//!
//! Others may use the same parent, above all `/tmp`. So a temporary folder is accessible to its owner alone, and only
//! real folders of the same owner are treated as abandoned.
//!
//! Network file systems weaken this in two ways. Some refuse locks (Lustre without `flock`, NFS without its lock
//! service): work directories are then used without one, and temporary folders are never removed by others. Some
//! keep locks within one machine (NFS with `nolock`): a lock file therefore names its machine, and only a run on
//! that one removes the folder.
//!
//! Memory: a path and an open file. Time: a few system calls, and one look at each entry of the
//! parent of a temporary folder.

use crate::base::{Error, Result};
use std::fs::{File, Permissions};
use std::io::{self, ErrorKind, Read, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

/// The lock file.
pub(super) const LOCK: &str = "lock";
const TEMPORARY: &str = ".nystrom-stream-";
/// The content of the lock file of a work directory that is kept.
pub(super) const MARK: &[u8] = b"nystrom-stream work directory\n";

/// The result of trying to lock a folder.
#[derive(Debug)]
pub(super) enum Lock {
    /// It is held until this is dropped.
    Held(HeldLock),
    /// Another process holds it.
    Busy,
    /// The file system does not support locks, or a reader may not create one.
    Unsupported,
}

/// The lock on a folder, held until this is dropped.
#[derive(Debug)]
pub(super) struct HeldLock {
    file: File,
    /// The process that took the lock; a forked child has a copy of this value but does not own the lock.
    process: u32,
    /// Whether nothing was written to the lock file before: the folder was not in use yet.
    is_new: bool,
}

impl Drop for HeldLock {
    fn drop(&mut self) {
        // Closing the file is not enough. A child that another thread is just spawning has a copy of the descriptor
        // until it execs, and whoever opens the folder next would find it in use.
        if self.process == std::process::id() {
            let _ = fs4::FileExt::unlock(&self.file);
        }
    }
}

/// A folder and the lock on it.
#[derive(Debug)]
struct Folder {
    path: PathBuf,
    /// Why it could not be created; every file in it then fails with the same error.
    failure: Option<Error>,
    /// None without a lock.
    lock: Option<HeldLock>,
    /// The process that opened it; a forked child has a copy of this value but leaves the folder to its parent.
    process: u32,
    /// How many folders were created for it: the last ones of its path.
    created: usize,
}

impl Folder {
    fn new(path: PathBuf, failure: Option<Error>, lock: Option<HeldLock>) -> Self {
        Self { path, failure, lock, process: std::process::id(), created: 0 }
    }

    /// Removes it with all that is in it.
    fn remove(&self) {
        if self.failure.is_none() && self.process == std::process::id() {
            remove_folder(&self.path);
        }
    }

    /// Removes what was created for it if nothing but the lock file is in it. Without a lock, another process may be
    /// about to write there.
    fn remove_unused(&self) {
        let is_new = self.lock.as_ref().is_some_and(|lock| lock.is_new);
        if !is_new || self.process != std::process::id() || !holds_lock_alone(&self.path) {
            return;
        }
        let _ = std::fs::remove_file(self.path.join(LOCK));
        // Folders that hold something else by now stay.
        let folders = self.path.ancestors().take(self.created);
        let _ = folders.map(std::fs::remove_dir).take_while(std::result::Result::is_ok).count();
    }
}

/// Creates the folder `path`, and those that it lies in, as far as they are missing; returns how many.
///
/// # Errors
/// [`Error::Io`].
pub(super) fn create_missing(path: &Path) -> Result<usize> {
    let missing = |folder: &&Path| !folder.as_os_str().is_empty() && !folder.exists();
    let folders = path.ancestors().take_while(missing).count();
    let mut made = std::fs::create_dir_all(path);
    // Another process may be removing it right now, unused.
    let gone = |error: &io::Error| matches!(error.kind(), ErrorKind::AlreadyExists | ErrorKind::NotFound);
    for _ in 0..16 {
        if made.as_ref().is_err_and(gone) && !path.exists() {
            made = std::fs::create_dir_all(path);
        }
    }
    made.map_err(Error::io(path, "create"))?;
    Ok(folders)
}

/// The folder of a work directory, which may be created lazily with its first file.
#[derive(Debug)]
pub(super) struct WorkFolder {
    parent: PathBuf,
    folder: OnceLock<Folder>,
}

impl WorkFolder {
    /// The folder `path`, for which `created` folders were created; locked until `lock` is dropped, which is `None`
    /// where the file system has no locks.
    pub fn of(path: &Path, lock: Option<HeldLock>, created: usize) -> Self {
        let folder = Folder { created, ..Folder::new(path.to_path_buf(), None, lock) };
        Self { folder: OnceLock::from(folder), ..Self::deferred(Path::new("")) }
    }

    /// A new folder in `parent`.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn temporary(parent: &Path) -> Result<Self> {
        Ok(Self { folder: OnceLock::from(temporary_folder(parent)?), ..Self::deferred(parent) })
    }

    /// A new folder in `parent`, created at the first call of [`WorkFolder::path`].
    pub fn deferred(parent: &Path) -> Self {
        Self { parent: parent.to_path_buf(), folder: OnceLock::new() }
    }

    /// Its path; the folder is created now if that was deferred. If it cannot be created, the path does not exist and
    /// nothing can be created in it. Never falls back to the parent, whose files belong to others.
    pub fn path(&self) -> &Path {
        self.path_made_by(temporary_folder)
    }

    fn path_made_by(&self, make: impl FnOnce(&Path) -> Result<Folder>) -> &Path {
        let none = |error: Error| Folder::new(self.parent.join(format!("{TEMPORARY}none")), Some(error), None);
        &self.folder.get_or_init(|| make(&self.parent).unwrap_or_else(none)).path
    }

    /// Its path, for something new in it.
    ///
    /// # Errors
    /// [`Error::Io`] where it could not be made.
    pub fn for_new(&self) -> Result<&Path> {
        let path = self.path();
        match self.folder.get().and_then(|folder| folder.failure.as_ref()) {
            None => Ok(path),
            Some(error) => Err(again(error)),
        }
    }

    /// The file `name` in it.
    pub fn file(self: &Arc<Self>, name: &'static str) -> DeferredFile {
        DeferredFile { folder: self.clone(), name }
    }

    /// Its path if it exists, else that of the parent.
    pub fn place(&self) -> &Path {
        self.existing().unwrap_or(&self.parent)
    }

    /// Its path if it exists.
    pub fn existing(&self) -> Option<&Path> {
        self.folder.get().map(|folder| folder.path.as_path())
    }

    /// Whether a lock keeps other processes out.
    pub fn is_locked(&self) -> bool {
        self.folder.get().is_some_and(|folder| folder.lock.is_some())
    }

    /// Whether a lock of this very process, and not of its parent, keeps other processes out.
    pub fn is_owned(&self) -> bool {
        self.is_locked() && self.folder.get().is_some_and(|folder| folder.process == std::process::id())
    }

    /// Removes it with all that is in it.
    pub fn remove(&self) {
        self.folder.get().into_iter().for_each(Folder::remove);
    }

    /// Removes what was created when it was opened if nothing has been written to it.
    pub fn remove_unused(&self) {
        self.folder.get().into_iter().for_each(Folder::remove_unused);
    }
}

/// A file in a work directory, whose folder need not exist before the file.
#[derive(Debug)]
pub struct DeferredFile {
    folder: Arc<WorkFolder>,
    name: &'static str,
}

impl DeferredFile {
    /// Its path; the folder is created now if that was deferred.
    ///
    /// # Errors
    /// [`Error::Io`] where the folder could not be made.
    pub fn path(&self) -> Result<PathBuf> {
        Ok(self.folder.for_new()?.join(self.name))
    }
}

/// Whether the folder `path` exists and is not empty.
///
/// # Errors
/// [`Error::Io`].
pub(super) fn is_occupied(path: &Path) -> Result<bool> {
    match std::fs::read_dir(path) {
        // An empty path would stand for the current folder.
        Err(error) if error.kind() == ErrorKind::NotFound && !path.as_os_str().is_empty() => Ok(false),
        entries => Ok(entries.map_err(Error::io(path, "list"))?.next().is_some()),
    }
}

/// The size in bytes of all files in `folder` and in folders inside; what cannot be read counts as nothing.
pub(super) fn bytes_in(folder: &Path) -> u64 {
    let Ok(entries) = std::fs::read_dir(folder) else { return 0 };
    let bytes = |entry: std::fs::DirEntry| match entry.metadata() {
        Ok(metadata) if metadata.is_dir() => bytes_in(&entry.path()),
        Ok(metadata) => metadata.len(),
        Err(_) => 0,
    };
    entries.flatten().map(bytes).sum()
}

/// Locks the folder, exclusively or shared with other readers. A reader may lack write permission: a lock file that is
/// missing or cannot be read keeps nobody out. An empty lock file gets the `content`, unless another process has it.
///
/// # Errors
/// [`Error::Io`].
pub(super) fn lock(path: &Path, shared: bool, content: &[u8]) -> Result<Lock> {
    let mut options = File::options();
    // A symbolic link in place of the lock file is an error.
    options.read(true).write(!shared).create(!shared).custom_flags(libc::O_NOFOLLOW);
    let mut file = match options.open(path.join(LOCK)) {
        Err(error) if shared && matches!(error.kind(), ErrorKind::NotFound | ErrorKind::PermissionDenied) => {
            return Ok(Lock::Unsupported);
        }
        // Whoever created the folder has just removed it, unused.
        Err(error) if !shared && error.kind() == ErrorKind::NotFound => return Ok(Lock::Busy),
        file => file.map_err(Error::io(path.join(LOCK), "open"))?,
    };
    let tried = if shared { fs4::FileExt::try_lock_shared(&file) } else { fs4::FileExt::try_lock(&file) };
    let held = match tried {
        Ok(()) => true,
        Err(fs4::TryLockError::WouldBlock) => return Ok(Lock::Busy),
        Err(fs4::TryLockError::Error(error)) if without_locks(&error) => false,
        Err(fs4::TryLockError::Error(error)) => return Err(Error::io(path.join(LOCK), "lock")(error)),
    };
    // The same, between opening the file and locking it: another process may hold the lock on a new one.
    let found = (file.metadata(), std::fs::symlink_metadata(path.join(LOCK)));
    let is_there = matches!(&found, (Ok(own), Ok(there)) if (own.dev(), own.ino()) == (there.dev(), there.ino()));
    if held && !shared && !is_there {
        return Ok(Lock::Busy);
    }
    let is_empty = found.0.is_ok_and(|metadata| metadata.len() == 0);
    if !shared && is_empty && !content.is_empty() {
        file.write_all(content).map_err(Error::io(path.join(LOCK), "write"))?;
    }
    let held_lock = || HeldLock { file, process: std::process::id(), is_new: !shared && is_empty };
    Ok(if held { Lock::Held(held_lock()) } else { Lock::Unsupported })
}

/// Whether the lock file in the folder `path`, which has no manifest, is ours: its run is in its first stage, or was
/// killed there.
pub(super) fn is_begun(path: &Path) -> bool {
    let lock = path.join(LOCK);
    let Ok(found) = std::fs::symlink_metadata(&lock) else { return false };
    // A run that was killed, or is just starting, may not have written into it; then nothing else is there. Whoever
    // lists another file here finds the mark.
    let alone = holds_lock_alone(path);
    let mut begin = Vec::new();
    let mut read = || File::open(&lock)?.take(MARK.len() as u64 + 1).read_to_end(&mut begin);
    found.is_file() && (alone && found.len() == 0 || read().is_ok() && begin == MARK)
}

/// Whether the folder `path` holds nothing but a lock file, if that.
fn holds_lock_alone(path: &Path) -> bool {
    std::fs::read_dir(path).is_ok_and(|mut all| all.all(|file| file.is_ok_and(|file| file.file_name() == LOCK)))
}

/// Whether `error` means that the file system has no locks.
fn without_locks(error: &io::Error) -> bool {
    error.kind() == ErrorKind::Unsupported || error.raw_os_error() == Some(libc::ENOLCK)
}

/// A folder for scratch files, removed when dropped. If the process is killed instead, the next run that creates one in
/// the same parent removes it.
#[derive(Debug)]
pub struct PrivateFolder(Folder);

impl PrivateFolder {
    /// Its path.
    pub fn path(&self) -> &Path {
        &self.0.path
    }
}

impl Drop for PrivateFolder {
    fn drop(&mut self) {
        self.0.remove();
    }
}

/// A new folder in `parent` that only its owner can access.
///
/// # Errors
/// [`Error::Io`].
pub fn private(parent: &Path) -> Result<PrivateFolder> {
    temporary_folder(parent).map(PrivateFolder)
}

/// An error of `tempfile` without the path that its text repeats. Its operating-system error code is found only in the
/// text.
fn plain(error: io::Error) -> io::Error {
    let text = error.to_string();
    let text = text.split(" at path ").next().unwrap_or(&text);
    let number = text.rsplit_once("(os error ").and_then(|(_, rest)| rest.trim_end_matches(')').parse().ok());
    number.map_or_else(|| io::Error::new(error.kind(), text), io::Error::from_raw_os_error)
}

/// A copy of the `error` of creating a folder, with its source, for the next file that needs the folder.
fn again(error: &Error) -> Error {
    match error {
        Error::Io { path, action, source } => {
            let same = || io::Error::new(source.kind(), source.to_string());
            let source = source.raw_os_error().map_or_else(same, io::Error::from_raw_os_error);
            Error::Io { path: path.clone(), action, source }
        }
        Error::WorkDir { path, problem, remedy } => Error::work_dir(path, problem, remedy),
        other => Error::internal(&other.to_string()),
    }
}

/// A new, locked folder in `parent`; abandoned ones of killed runs are removed.
fn temporary_folder(parent: &Path) -> Result<Folder> {
    // Another process that cleans up may remove a folder just before it is locked; then try again.
    for _ in 0..16 {
        let folder =
            tempfile::Builder::new().prefix(TEMPORARY).permissions(Permissions::from_mode(0o700)).tempdir_in(parent);
        // Until it is locked, it is removed when this variable is dropped.
        let folder = folder.map_err(|error| Error::io(parent, "create a temporary folder here")(plain(error)))?;
        let path = folder.path().to_path_buf();
        let locked = lock(&path, false, &machine());
        let taken = !path.join(LOCK).exists() && (locked.is_ok() || !path.exists());
        if taken {
            continue;
        }
        let lock = match locked? {
            Lock::Busy => continue,
            Lock::Unsupported => None,
            Lock::Held(held) => Some(held),
        };
        remove_abandoned(parent, &path);
        let path = folder.keep();
        return Ok(Folder::new(path, None, lock));
    }
    Err(Error::work_dir(
        parent,
        "temporary folders are being removed by another process",
        "choose another `temporary_folder`",
    ))
}

/// The name of this machine.
fn machine() -> Vec<u8> {
    rustix::system::uname().nodename().to_bytes().to_vec()
}

/// Removes temporary work directories in `parent` whose process ran on this machine and is gone. Only real folders with
/// a real lock file and the same owner as `own`, a newly created one, are removed.
fn remove_abandoned(parent: &Path, own: &Path) {
    let (Ok(entries), Ok(own)) = (std::fs::read_dir(parent), std::fs::metadata(own)) else { return };
    for entry in entries.flatten() {
        let path = entry.path();
        let named = entry.file_name().to_string_lossy().starts_with(TEMPORARY);
        // Links are not followed.
        let real = |path: &Path| std::fs::symlink_metadata(path).ok().filter(|found| found.uid() == own.uid());
        // Covers runs killed between creating and locking their folder, or just before removing it. A run that is about
        // to lock its folder simply creates another. Links and folders with files are kept.
        let real_folder = named && real(&path).is_some_and(|found| found.is_dir());
        if real_folder && std::fs::remove_dir(&path).is_ok() {
            continue;
        }
        // An empty lock file belongs to a run that ended before it could write, or to an older version.
        let ours = |file: PathBuf| std::fs::read(file).is_ok_and(|name| name.is_empty() || name == machine());
        let abandoned =
            real_folder && real(&path.join(LOCK)).is_some_and(|found| found.is_file()) && ours(path.join(LOCK));
        if !abandoned {
            continue;
        }
        // Held until all is removed: a run that created its lock file and is about to lock it finds it busy or gone.
        if let Ok(Lock::Held(_held)) = lock(&path, false, &[]) {
            remove_folder(&path);
        }
    }
}

/// Removes a folder with all that is in it, its lock file last: if this run is killed meanwhile, the lock file lets the
/// next run recognise what is left. Files that cannot be removed stay.
fn remove_folder(path: &Path) {
    for entry in std::fs::read_dir(path).into_iter().flatten().flatten() {
        if entry.file_name() == LOCK {
            continue;
        }
        let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
        let _ = if is_folder { std::fs::remove_dir_all(entry.path()) } else { std::fs::remove_file(entry.path()) };
    }
    let _ = std::fs::remove_dir_all(path);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Regression: the size of a work directory left out the folder of the contraction.
    #[test]
    fn the_size_includes_folders_inside() {
        let dir = tempfile::tempdir().unwrap();
        let inner = dir.path().join("contracted");
        std::fs::create_dir(&inner).unwrap();
        std::fs::write(dir.path().join("x"), [1; 100]).unwrap();
        std::fs::write(inner.join("y"), [1; 20]).unwrap();
        std::os::unix::fs::symlink(dir.path(), inner.join("circle")).unwrap();
        let link = std::fs::symlink_metadata(inner.join("circle")).unwrap().len();
        assert_eq!(bytes_in(dir.path()), 120 + link);
        assert_eq!(bytes_in(&dir.path().join("absent")), 0);
    }

    /// Regression: other users could read temporary folders, and a planted symbolic link had its target changed.
    #[test]
    fn temporary_folders_are_private_and_planted_links_stay() {
        let dir = tempfile::tempdir().unwrap();
        let precious = dir.path().join("precious");
        std::fs::create_dir(&precious).unwrap();
        std::fs::write(precious.join(LOCK), "kept").unwrap();
        std::os::unix::fs::symlink(&precious, dir.path().join(".nystrom-stream-link")).unwrap();
        let planted = dir.path().join(".nystrom-stream-planted");
        std::fs::create_dir(&planted).unwrap();
        std::os::unix::fs::symlink(dir.path().join("absent"), planted.join(LOCK)).unwrap();
        let folder = WorkFolder::temporary(dir.path()).unwrap();
        let mode = std::fs::metadata(folder.path()).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o700);
        assert!(planted.exists() && !dir.path().join("absent").exists());
        assert_eq!(std::fs::read_to_string(precious.join(LOCK)).unwrap(), "kept");
        folder.remove();
    }

    /// Regression: if the folder could not be created, files were written to its parent and replaced files of the same
    /// name.
    #[test]
    fn where_no_folder_can_be_made_the_parent_is_left_alone() {
        let dir = tempfile::tempdir().unwrap();
        let folder = WorkFolder::deferred(dir.path());
        let full =
            |_: &Path| Err(Error::io(dir.path(), "create a temporary folder here")(ErrorKind::StorageFull.into()));
        let path = folder.path_made_by(full);
        assert!(path.parent() == Some(dir.path()) && !path.exists());
        // Regression: the reason was text in an error of another kind, and the error number of the system was lost.
        for _ in 0..2 {
            let error = folder.for_new().unwrap_err();
            assert!(error.to_string().contains("create a temporary folder"), "{error}");
            let source = std::error::Error::source(&error).and_then(|source| source.downcast_ref::<io::Error>());
            assert_eq!(source.map(io::Error::kind), Some(ErrorKind::StorageFull));
        }
        let Err(Error::Io { source, .. }) = temporary_folder(&dir.path().join("absent")) else { panic!("it was made") };
        assert_eq!(source.raw_os_error(), Some(libc::ENOENT));
        folder.remove();
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    }

    #[test]
    fn scratch_folders_are_locked_and_go() {
        let dir = tempfile::tempdir().unwrap();
        let folder = private(dir.path()).unwrap();
        std::fs::write(folder.path().join("input"), "x").unwrap();
        let path = folder.path().to_path_buf();
        // Another folder created here leaves this one alone until its process has ended.
        let other = private(dir.path()).unwrap();
        assert!(path.join("input").exists());
        let PrivateFolder(Folder { lock, .. }) = &folder;
        fs4::FileExt::unlock(&lock.as_ref().unwrap().file).unwrap();
        drop(private(dir.path()).unwrap());
        assert!(!path.exists() && other.path().exists());
        drop((folder, other));
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    }

    /// Regression: a process that was just being started by another thread kept the lock for a moment after the folder
    /// was closed.
    #[test]
    fn a_copy_of_the_lock_file_does_not_keep_the_lock() {
        let dir = tempfile::tempdir().unwrap();
        let Ok(Lock::Held(held)) = lock(dir.path(), false, MARK) else { panic!("it is not locked") };
        let copy = held.file.try_clone().unwrap();
        assert!(matches!(lock(dir.path(), false, MARK), Ok(Lock::Busy)));
        drop(held);
        assert!(matches!(lock(dir.path(), false, MARK), Ok(Lock::Held(_))));
        drop(copy);
    }

    /// Regression: a run killed between creating and locking its folder, or between emptying and removing it, left an
    /// empty folder for ever.
    #[test]
    fn an_empty_folder_goes_and_one_with_unknown_files_stays() {
        let dir = tempfile::tempdir().unwrap();
        let [empty, full] = ["empty", "full"].map(|name| dir.path().join(format!("{TEMPORARY}{name}")));
        std::fs::create_dir(&empty).unwrap();
        std::fs::create_dir(&full).unwrap();
        std::fs::write(full.join("file"), "kept").unwrap();
        let other = dir.path().join("empty");
        std::fs::create_dir(&other).unwrap();
        drop(private(dir.path()).unwrap());
        assert!(!empty.exists() && full.join("file").exists() && other.exists());
    }

    /// Threads that create folders at the same time may remove each other's before these are locked; then another is
    /// created.
    #[test]
    fn folders_made_side_by_side_are_all_there() {
        let dir = tempfile::tempdir().unwrap();
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    for _ in 0..100 {
                        let folder = private(dir.path()).unwrap();
                        std::fs::write(folder.path().join("file"), "x").unwrap();
                    }
                });
            }
        });
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    }

    #[test]
    fn a_link_in_the_place_of_the_lock_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let target = dir.path().join("target");
        std::os::unix::fs::symlink(&target, dir.path().join(LOCK)).unwrap();
        assert!(lock(dir.path(), false, MARK).is_err() && !target.exists());
    }

    #[test]
    fn a_folder_of_another_machine_stays() {
        let dir = tempfile::tempdir().unwrap();
        let folder = |name: &str, machine: &[u8]| {
            let path = dir.path().join(format!("{TEMPORARY}{name}"));
            std::fs::create_dir(&path).unwrap();
            std::fs::write(path.join(LOCK), machine).unwrap();
            path
        };
        let [ours, old, foreign] = [folder("ours", &machine()), folder("old", b""), folder("foreign", b"n7.cluster")];
        remove_abandoned(dir.path(), dir.path());
        assert!(!ours.exists() && !old.exists() && foreign.exists());
    }

    #[test]
    fn what_a_file_system_without_locks_answers() {
        let of = io::Error::from_raw_os_error;
        assert!([libc::ENOLCK, libc::ENOSYS, libc::EOPNOTSUPP].into_iter().all(|code| without_locks(&of(code))));
        assert!(![libc::EIO, libc::EINTR, libc::ESTALE].into_iter().any(|code| without_locks(&of(code))));
    }
}
