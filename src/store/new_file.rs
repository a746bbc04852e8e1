//! Creating files: always new ones, never through a planted link, never over the file of another process.
//!
//! The names of temporary files are predictable, and their folders may be open to others. So an existing file is never
//! truncated: whatever has the name is removed, and the file is created by a call that fails if the name exists and
//! follows no link. A file that another process is writing is left alone; it is recognised by an advisory lock, which
//! ends with its process.
//!
//! Cost: three system calls per file.

use crate::base::{Error, Result};
use std::fs::{File, TryLockError};
use std::io::ErrorKind;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// Creates `path` for writing and reading, and locks it until it is closed; a leftover of a killed run under this name
/// is removed.
///
/// # Errors
/// [`Error::Io`]; [`Error::Unusable`] while another process has it.
pub fn create(path: &Path) -> Result<File> {
    create_for(path, path)
}

/// The same for the temporary file of `name`: errors name the file that the user requested.
///
/// # Errors
/// As [`create`].
pub(crate) fn create_for(name: &Path, path: &Path) -> Result<File> {
    let wrong = || Error::io(name, "create");
    // Another process may be creating the same file: whoever finds its own replaced starts again.
    for _ in 0..8 {
        match File::options().read(true).write(true).create_new(true).open(path) {
            Ok(file) => {
                if is_locked_elsewhere(&file) {
                    break;
                }
                if is_at(&file, path).map_err(wrong())? {
                    return Ok(file);
                }
            }
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {
                // Locked until it is removed: a run that created it a moment ago and has not locked it yet cannot
                // continue with a file that loses its name.
                let held = match std::fs::symlink_metadata(path) {
                    Ok(left) if left.is_file() => File::open(path).map(Some),
                    // A link, or a folder.
                    Ok(_) => Ok(None),
                    Err(error) => Err(error),
                };
                match &held {
                    Ok(Some(held)) if is_locked_elsewhere(held) => break,
                    Ok(Some(held)) if !is_at(held, path).map_err(wrong())? => continue,
                    // It is gone: whatever has the name from here on is somebody else's new file.
                    Err(error) if error.kind() == ErrorKind::NotFound => continue,
                    _ => {}
                }
                match std::fs::remove_file(path) {
                    Err(error) if error.kind() != ErrorKind::NotFound => return Err(wrong()(error)),
                    _ => continue,
                }
            }
            Err(error) => return Err(wrong()(error)),
        }
    }
    Err(Error::unusable(name, "is being written by another process", "wait for it, or choose another file"))
}

/// The name that a file has until it is complete.
pub fn partial_name(path: &Path) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(".partial");
    path.with_file_name(name)
}

/// The folder that holds `path`: `.` for a name alone.
pub fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Creates the temporary file of `path` ([`partial_name`]), with `bytes` reserved on the disk.
///
/// # Errors
/// [`Error::Io`] naming `path`, with the operating system's "no space" when the disk cannot hold it; no file is left
/// then.
pub(crate) fn reserve_file(path: &Path, bytes: u64) -> Result<File> {
    let partial = partial_name(path);
    let file = create_for(path, &partial)?;
    if bytes > 0 {
        let reserve = || {
            match fs4::FileExt::allocate(&file, bytes) {
                Err(error) if matches!(error.kind(), ErrorKind::Unsupported) => {}
                done => done.map_err(Error::io(path, "reserve space"))?,
            }
            file.set_len(bytes).map_err(Error::io(path, "enlarge"))
        };
        reserve().inspect_err(|_| {
            let _ = std::fs::remove_file(&partial);
        })?;
    }
    Ok(file)
}

/// Calls `write` on a new file, with `bytes` reserved, and renames it to `path`, after syncing it where `durable`.
/// Leaves nothing behind on failure.
///
/// # Errors
/// Those of `write`; [`Error::Io`].
pub(crate) fn by_rename(
    path: &Path,
    bytes: u64,
    durable: bool,
    write: impl FnOnce(&mut File) -> Result<()>,
) -> Result<()> {
    let mut write = Some(write);
    filled(path, bytes, durable, &mut |file| write.take().map_or(Ok(()), |write| write(file)))
}

/// [`by_rename`], compiled once for all of its callers.
fn filled(path: &Path, bytes: u64, durable: bool, write: &mut dyn FnMut(&mut File) -> Result<()>) -> Result<()> {
    let mut file = reserve_file(path, bytes)?;
    let partial = partial_name(path);
    let mut fill = || {
        write(&mut file)?;
        if durable {
            file.sync_all().map_err(Error::io(path, "sync"))?;
        }
        std::fs::rename(&partial, path).map_err(Error::io(path, "rename"))
    };
    fill().inspect_err(|_| {
        let _ = std::fs::remove_file(&partial);
    })
}

/// Brings all files of the file system that holds `folder` to the disk: for many small ones far faster than one by one.
///
/// # Errors
/// [`Error::Io`].
pub(crate) fn sync_file_system(folder: &Path) -> Result<()> {
    #[cfg(target_os = "linux")]
    return File::open(folder).and_then(|open| Ok(rustix::fs::syncfs(open)?)).map_err(Error::io(folder, "sync"));
    #[cfg(not(target_os = "linux"))]
    {
        rustix::fs::sync();
        Ok(())
    }
}

/// Whether `path` still names `file`, and not another one that replaced it.
fn is_at(file: &File, path: &Path) -> std::io::Result<bool> {
    let own = file.metadata()?;
    Ok(std::fs::symlink_metadata(path).is_ok_and(|found| (found.dev(), found.ino()) == (own.dev(), own.ino())))
}

/// Whether another process has locked `file`; if not, locks it from here on, if the file system can.
fn is_locked_elsewhere(file: &File) -> bool {
    matches!(file.try_lock(), Err(TryLockError::WouldBlock))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    /// Regression: the target of a link with the name of a temporary file was overwritten.
    #[test]
    fn planted_links_are_replaced_and_their_targets_left_alone() {
        let dir = tempfile::tempdir().unwrap();
        let (target, path) = (dir.path().join("precious"), dir.path().join("x.partial"));
        std::fs::write(&target, "kept").unwrap();
        let link = |how: fn(&Path, &Path) -> std::io::Result<()>| {
            let _ = std::fs::remove_file(&path);
            how(&target, &path).unwrap();
            create(&path).unwrap().write_all(b"new").unwrap();
            assert_eq!(std::fs::read_to_string(&target).unwrap(), "kept");
            assert_eq!(std::fs::read_to_string(&path).unwrap(), "new");
        };
        link(|target, path| std::os::unix::fs::symlink(target, path));
        link(|target, path| std::fs::hard_link(target, path));
        std::fs::remove_file(&path).unwrap();
        std::fs::create_dir(&path).unwrap();
        assert!(create(&path).is_err(), "a folder is not removed");
    }

    #[test]
    fn a_file_has_its_name_only_when_it_is_whole() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x");
        std::fs::write(&path, "old").unwrap();
        for (reserved, durable) in [(0, false), (100, true)] {
            let failing = by_rename(&path, reserved, durable, |file| {
                file.write_all(b"half").unwrap();
                Err(Error::Cancelled)
            });
            assert!(failing.is_err() && std::fs::read(&path).unwrap() == b"old");
            assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
        }
        by_rename(&path, 0, true, |file| file.write_all(b"new").map_err(Error::io(&path, "write"))).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
    }

    /// Regression: two runs that started at the same time removed each other's file between its creation and its lock.
    #[test]
    fn of_many_that_begin_at_once_nobody_loses_a_file_that_was_granted() {
        let dir = tempfile::tempdir().unwrap();
        for round in 0..300 {
            let path = dir.path().join(format!("{round}.partial"));
            let start = std::sync::Barrier::new(4);
            let begin = || {
                start.wait();
                let made = create(&path).ok();
                start.wait();
                // All files that were granted are open, so only one of them can have the name.
                let named = made.as_ref().map(|file| is_at(file, &path).unwrap());
                start.wait();
                named
            };
            let granted: Vec<bool> = std::thread::scope(|scope| {
                let threads: Vec<_> = (0..4).map(|_| scope.spawn(begin)).collect();
                threads.into_iter().filter_map(|thread| thread.join().unwrap()).collect()
            });
            assert!(granted.iter().all(|&named| named), "{round}: {granted:?}");
            assert_eq!(granted.len(), 1, "{round}");
        }
    }

    #[test]
    fn a_file_has_one_writer_and_an_abandoned_one_is_begun_again() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.partial");
        let mut first = create(&path).unwrap();
        first.write_all(b"of a run that goes on").unwrap();
        assert!(create(&path).unwrap_err().to_string().contains("written by another process"));
        drop(first);
        create(&path).unwrap();
        assert!(std::fs::read(&path).unwrap().is_empty());
    }
}
