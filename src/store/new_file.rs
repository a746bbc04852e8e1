//! Files that are begun: new ones, no links that somebody planted, and nobody else's.
//!
//! The names of temporary files can be foreseen, and their folders may be open to others. So a file is never truncated where it
//! is found: whatever has its name is removed, and the file is made by a call that fails if the name exists, which follows
//! no link. A file that another process is writing is left alone; an advisory lock that dies with its process tells.
//!
//! Cost: three system calls a file.

use crate::base::{Error, Result};
use std::fs::{File, TryLockError};
use std::io::ErrorKind;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// Creates `path` for writing and reading; what a killed run left under this name is removed.
///
/// # Errors
/// [`Error::Io`]; [`Error::Unusable`] while another process writes it.
pub(crate) fn create(path: &Path) -> Result<File> {
    let wrong = || Error::io(path, "create");
    // Another process may be in the same place: whoever finds its file replaced begins once more.
    for _ in 0..8 {
        match File::options().read(true).write(true).create_new(true).open(path) {
            Ok(file) => {
                if is_locked_elsewhere(&file) {
                    break;
                }
                let made = file.metadata().map_err(wrong())?;
                match std::fs::symlink_metadata(path) {
                    Ok(found) if (found.dev(), found.ino()) == (made.dev(), made.ino()) => return Ok(file),
                    _ => continue,
                }
            }
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {
                let plain = std::fs::symlink_metadata(path).is_ok_and(|found| found.is_file());
                if plain && File::open(path).is_ok_and(|file| is_locked_elsewhere(&file)) {
                    break;
                }
                match std::fs::remove_file(path) {
                    Err(error) if error.kind() != ErrorKind::NotFound => return Err(wrong()(error)),
                    _ => continue,
                }
            }
            Err(error) => return Err(wrong()(error)),
        }
    }
    Err(Error::unusable(path, "is being written by another process", "wait for it, or name another file"))
}

/// Whether somebody has locked `file`; if not, it is locked from here on, where the file system can.
fn is_locked_elsewhere(file: &File) -> bool {
    matches!(file.try_lock(), Err(TryLockError::WouldBlock))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    /// A link under the name of a temporary file had its target overwritten.
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
