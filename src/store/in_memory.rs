//! Arrays of a temporary work directory that are kept in memory where the budget allows.
//!
//! A file that nobody will open again costs a page fault per 4 KiB when it is first written, another when it is read,
//! and disk writes if it lives long enough: a fifth of the whole run on a mesh of a million faces, and more than the
//! disk can take on one of a hundred million. Memory on large pages costs none of that. So a temporary directory may be
//! given a budget; arrays that fit are allocated from it like everything else. An array that does not fit becomes a
//! file with the same values, so results do not depend on where an array is.

use super::budget::Budget;
use super::folder::WorkFolder;
use super::mapped::{AlignedBuffer, MappedBytes};
use crate::base::parallel::lock;
use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard};

/// The arrays of a work directory that are kept in memory.
#[derive(Debug)]
pub struct InMemoryArrays {
    budget: Budget,
    /// Where arrays go that do not fit in memory.
    folder: Arc<WorkFolder>,
    /// Buffer and length in bytes of each array, by the name that its file would have.
    arrays: Mutex<BTreeMap<String, (MappedBytes, usize)>>,
}

impl InMemoryArrays {
    /// No arrays yet; their memory will be taken from `budget`.
    pub(super) fn new(budget: &Budget, folder: Arc<WorkFolder>) -> Self {
        Self { budget: budget.clone(), folder, arrays: Mutex::default() }
    }

    /// No arrays yet, from the same budget; for a nested folder.
    pub(super) fn within(&self, folder: Arc<WorkFolder>) -> Self {
        Self::new(&self.budget, folder)
    }

    /// The size of the whole budget in bytes.
    pub fn budget(&self) -> u64 {
        self.budget.total()
    }

    /// The path of the file `name`, for an array that is not in memory.
    pub fn file(&self, name: &OsStr) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Zeroed memory for at least `bytes` bytes, where the budget can spare them.
    pub fn take(&self, bytes: usize) -> Option<AlignedBuffer> {
        AlignedBuffer::try_new(&self.budget, bytes)
    }

    fn arrays(&self) -> MutexGuard<'_, BTreeMap<String, (MappedBytes, usize)>> {
        lock(&self.arrays)
    }

    /// Keeps a finished array, the first `len` of `bytes`, under the name that its file would have.
    pub fn keep(&self, name: &str, bytes: MappedBytes, len: usize) {
        self.arrays().insert(name.to_string(), (bytes, len));
    }

    /// The buffer of the array `name`, and how many of its first bytes the array takes.
    pub fn get(&self, name: &str) -> Option<(MappedBytes, usize)> {
        self.arrays().get(name).cloned()
    }

    /// Removes the array `name`, if there is one. Its memory is freed with its last reader.
    pub fn remove(&self, name: &str) {
        self.arrays().remove(name);
    }
}
