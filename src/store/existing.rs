//! Opens work directories that must exist already, to continue them or to inspect them.

use super::WorkDir;
use super::folder::LOCK;
use super::manifest::MANIFEST;
use crate::base::{Error, Result};
use std::path::Path;

impl WorkDir {
    /// Opens an existing work directory read-only, beside any other reader.
    ///
    /// # Errors
    /// [`Error::WorkDir`] when there is none, or when it is in use; [`Error::Io`].
    pub fn open_existing(path: &Path) -> Result<Self> {
        if !path.join(MANIFEST).exists() {
            return Err(if is_of_two(path) {
                let problem = "is a work directory of `correspond`, which holds one for each of two meshes";
                Error::work_dir(path, problem, "choose one that `segment` or `graph` has made")
            } else if path.join(LOCK).is_file() {
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

    /// Opens an existing folder read-only.
    fn open_shared(path: &Path) -> Result<Self> {
        Self::try_open(path, true)?
            .ok_or_else(|| Error::work_dir(path, "is in use by another run", "wait for it to end"))
    }
}

/// Whether `correspond` wrote the folder `path`: it contains a work directory for each of two meshes.
fn is_of_two(path: &Path) -> bool {
    ["a", "b"].iter().all(|side| path.join(side).join(MANIFEST).is_file())
}
