//! Opens work directories that must exist already, to continue them or to inspect them, and those nested in them.

use super::WorkDir;
use super::folder::is_begun;
use super::manifest::{MANIFEST, is_of_two};
use crate::base::sort::map_of;
use crate::base::{Error, Result};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

impl WorkDir {
    /// Opens an existing work directory read-only, beside any other reader.
    ///
    /// # Errors
    /// [`Error::WorkDir`] when there is none, or when it is in use; [`Error::Io`].
    pub fn open_existing(path: &Path) -> Result<Self> {
        let found = path.join(MANIFEST).try_exists();
        if let Err(error) = found.as_ref().map_err(|error| error.kind())
            && error == std::io::ErrorKind::PermissionDenied
        {
            return Err(Error::io(path, "open")(error.into()));
        }
        if !found.unwrap_or(false) {
            return Err(if is_of_two(path) {
                let problem = "is a work directory of `correspond`, which holds one for each of two meshes";
                Error::work_dir(path, problem, "choose one that `segment` or `graph` has made")
            } else if is_begun(path) {
                let remedy = "wait for the run that uses it, or start the interrupted one again";
                Error::work_dir(path, "has no finished stage yet", remedy)
            } else {
                let remedy = "check the path, or create it first: stage `record`";
                Error::work_dir(path, "is not a work directory, or an empty one", remedy)
            });
        }
        Self::open_shared(path)
    }

    /// The same, but also accepts the work directory of two meshes that `correspond` writes, which has no stages of its
    /// own.
    ///
    /// # Errors
    /// As [`WorkDir::open_existing`].
    pub fn open_any(path: &Path) -> Result<Self> {
        if is_of_two(path) { Self::open_shared(path) } else { Self::open_existing(path) }
    }

    /// Whether this was written by `correspond`: it contains a work directory for each of two meshes.
    pub fn is_of_two(&self) -> bool {
        is_of_two(self.path())
    }

    /// The nested work directories, at any depth, that have a manifest, by path: `proxy`, `proxy/contracted`.
    ///
    /// # Errors
    /// As [`WorkDir::inner`].
    pub fn all_inner(&self) -> Result<BTreeMap<String, Arc<Self>>> {
        let mut all = BTreeMap::new();
        for (name, inner) in self.inner_here()? {
            all.extend(inner.all_inner()?.into_iter().map(|(path, inner)| (format!("{name}/{path}"), inner)));
            all.insert(name, inner);
        }
        Ok(all)
    }

    /// The same, without those nested in these.
    pub(super) fn inner_here(&self) -> Result<BTreeMap<String, Arc<Self>>> {
        let entries = std::fs::read_dir(self.path()).map_err(Error::io(self.path(), "read"))?.flatten();
        let folders = entries.filter(|entry| entry.path().join(MANIFEST).is_file());
        let names = folders.filter_map(|entry| entry.file_name().into_string().ok());
        let inner = names.map(|name| Ok((name.clone(), self.inner(&name)?))).collect::<Result<Vec<_>>>()?;
        Ok(map_of(inner))
    }

    /// Opens an existing folder read-only.
    fn open_shared(path: &Path) -> Result<Self> {
        Self::try_open(path, true)?
            .ok_or_else(|| Error::work_dir(path, "is in use by another run", "wait for it to end"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::folder::{LOCK, MARK};
    use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

    /// Regression: any folder with a file `lock` was taken for a work directory whose first stage had been interrupted,
    /// and files in it were removed.
    #[test]
    fn the_lock_of_another_program_makes_no_work_directory() {
        let dir = tempfile::tempdir().unwrap();
        let refused = || matches!(WorkDir::open(dir.path()), Err(Error::WorkDir { .. }));
        let thesis = dir.path().join("thesis.partial");
        std::fs::write(&thesis, []).unwrap();
        for content in ["", "4711\n"] {
            std::fs::write(dir.path().join(LOCK), content).unwrap();
            assert!(refused() && thesis.exists(), "{content:?}");
            let told = WorkDir::open_existing(dir.path()).unwrap_err().to_string();
            assert!(told.contains("is not a work directory"), "{told}");
        }
        std::fs::remove_file(&thesis).unwrap();
        assert!(refused(), "it says something else than ours");
    }

    /// Regression: a run that failed at once left a folder with a lock file behind.
    #[test]
    fn a_directory_that_was_not_used_goes_and_one_in_use_or_of_others_stays() {
        let dir = tempfile::tempdir().unwrap();
        let (mine, new) = (dir.path().join("mine"), dir.path().join("new/work"));
        std::fs::create_dir(&mine).unwrap();
        drop((WorkDir::open(&mine).unwrap(), WorkDir::open(&new).unwrap()));
        assert!(std::fs::read_dir(&mine).unwrap().next().is_none() && !dir.path().join("new").exists());
        let work = WorkDir::open(&new).unwrap();
        std::fs::write(work.file("x.npy"), []).unwrap();
        drop(work);
        assert!(new.join("x.npy").exists() && WorkDir::open(&new).is_ok());
    }

    #[test]
    fn a_directory_that_comes_and_goes_has_one_owner_at_a_time() {
        let dir = tempfile::tempdir().unwrap();
        let (path, owned, found) = (dir.path().join("work"), AtomicBool::new(false), AtomicUsize::new(0));
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    for _ in 0..200 {
                        if let Some(work) = WorkDir::try_open(&path, false).unwrap() {
                            assert!(!owned.swap(true, Ordering::SeqCst) && path.join(LOCK).exists());
                            found.fetch_add(1, Ordering::SeqCst);
                            owned.store(false, Ordering::SeqCst);
                            drop(work);
                        }
                    }
                });
            }
        });
        let left = std::fs::read_dir(&path).map_or(0, Iterator::count);
        assert!(found.into_inner() > 0 && left == 0);
    }

    #[test]
    fn a_directory_without_a_finished_stage_is_used_again() {
        let dir = tempfile::tempdir().unwrap();
        // What a run leaves that is killed before it could write into its lock.
        std::fs::write(dir.path().join(LOCK), []).unwrap();
        drop(WorkDir::open(dir.path()).unwrap());
        // And later.
        std::fs::write(dir.path().join(LOCK), MARK).unwrap();
        let left = dir.path().join("x.npy.partial");
        std::fs::write(&left, []).unwrap();
        let told = WorkDir::open_existing(dir.path()).unwrap_err().to_string();
        assert!(told.contains("has no finished stage yet"), "{told}");
        drop(WorkDir::open(dir.path()).unwrap());
        assert!(!left.exists());
    }
}
