//! Arrays of a temporary work directory that are held in memory, where the budget allows it.
//!
//! A file that nobody will ever open again costs a fault a page of 4 KiB when it is first written, another when it is
//! read, and its way to the disk if it lives long enough: on a mesh of a million faces a fifth of the whole run, on one of
//! a hundred millions more than the disk can take. Memory on large pages costs none of that. So a temporary directory may
//! be given a budget, and what fits into it is allocated instead: counted, and the budget's like every other allocation.
//! What does not fit becomes a file, with the same values: where an array lies changes no byte of a result.

use super::aligned_buffer::AlignedBuffer;
use super::budget::Budget;
use super::mapped::MappedBytes;
use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard};

/// The arrays of a work directory that are held in memory.
#[derive(Debug)]
pub struct Held {
    budget: Budget,
    arrays: Mutex<BTreeMap<String, MappedBytes>>,
}

impl Held {
    /// None yet; they will be taken from `budget`.
    pub fn new(budget: &Budget) -> Self {
        Self { budget: budget.clone(), arrays: Mutex::default() }
    }

    /// Zeroed memory for at least `bytes` bytes, where the budget can spare them.
    pub fn take(&self, bytes: usize) -> Option<AlignedBuffer> {
        AlignedBuffer::spare(&self.budget, bytes)
    }

    fn arrays(&self) -> MutexGuard<'_, BTreeMap<String, MappedBytes>> {
        self.arrays.lock().unwrap_or_else(|poison| poison.into_inner())
    }

    /// Keeps a finished array under the name that its file would have.
    pub fn keep(&self, name: &str, bytes: MappedBytes) {
        self.arrays().insert(name.to_string(), bytes);
    }

    /// The bytes of the array `name`.
    pub fn get(&self, name: &str) -> Option<MappedBytes> {
        self.arrays().get(name).cloned()
    }

    /// Gives up the array `name`, if there is one. Its memory is free when its last reader is gone.
    pub fn remove(&self, name: &str) {
        self.arrays().remove(name);
    }
}
