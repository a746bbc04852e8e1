//! Arrays of a temporary work directory that are held in memory, where the budget allows it.
//!
//! A file that nobody will ever open again costs a page fault for every 4 KiB when it is first written, another when it
//! is read, and its way to the disk if it lives long enough: on a mesh of a million faces a fifth of the whole run, on
//! one of a hundred million more than the disk can take. Memory on large pages costs none of that. So a temporary
//! directory may be given a budget, and what fits into it is allocated instead: counted, and taken from the budget like
//! every other allocation. What does not fit becomes a file with the same values: where an array lies changes no byte of
//! a result.

use super::budget::{Budget, Grant};
use super::mapped::{MappedBytes, huge_pages};
use bytemuck::Pod;
use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard};

/// Zeroed memory of a budget, aligned for every item type.
#[derive(Debug)]
pub struct AlignedBuffer {
    words: Vec<u64>,
    _grant: Grant,
}

impl AlignedBuffer {
    /// Memory for at least `bytes` bytes on large pages, where `budget` can spare them: half of it stays for others. The
    /// pages are not touched here but by the threads that fill them.
    pub fn spare(budget: &Budget, bytes: usize) -> Option<Self> {
        let words = bytes.div_ceil(size_of::<u64>());
        let bytes = (words * size_of::<u64>()) as u64;
        if budget.left() < bytes.saturating_add(budget.total() / 2) {
            return None;
        }
        let grant = budget.take("work arrays", bytes, bytes).ok()?;
        let words = vec![0; words];
        huge_pages(&words);
        Some(Self { words, _grant: grant })
    }

    /// A copy of `items`, where `budget` can spare the memory.
    pub fn copy_of<T: Pod>(budget: &Budget, items: &[T]) -> Option<Self> {
        let mut words = Self::spare(budget, size_of_val(items))?;
        words.items_mut(items.len()).copy_from_slice(items);
        Some(words)
    }

    /// Its bytes.
    #[inline]
    pub fn bytes(&self) -> &[u8] {
        bytemuck::cast_slice(&self.words)
    }

    /// Its bytes, to be written.
    #[inline]
    pub fn bytes_mut(&mut self) -> &mut [u8] {
        bytemuck::cast_slice_mut(&mut self.words)
    }

    /// Its first `len` items.
    ///
    /// # Panics
    /// Where it is shorter.
    pub fn items<T: Pod>(&self, len: usize) -> &[T] {
        bytemuck::cast_slice(&self.bytes()[..len * size_of::<T>()])
    }

    /// Its first `len` items, to be written.
    ///
    /// # Panics
    /// Where it is shorter.
    pub fn items_mut<T: Pod>(&mut self, len: usize) -> &mut [T] {
        bytemuck::cast_slice_mut(&mut self.bytes_mut()[..len * size_of::<T>()])
    }
}

/// The arrays of a work directory that are held in memory.
#[derive(Debug)]
pub struct InMemoryArrays {
    budget: Budget,
    /// By the name that the file would have: the bytes, and how many of them are the array's.
    arrays: Mutex<BTreeMap<String, (MappedBytes, usize)>>,
}

impl InMemoryArrays {
    /// No arrays yet; their memory will be taken from `budget`.
    pub fn new(budget: &Budget) -> Self {
        Self { budget: budget.clone(), arrays: Mutex::default() }
    }

    /// Zeroed memory for at least `bytes` bytes, where the budget can spare them.
    pub fn take(&self, bytes: usize) -> Option<AlignedBuffer> {
        AlignedBuffer::spare(&self.budget, bytes)
    }

    fn arrays(&self) -> MutexGuard<'_, BTreeMap<String, (MappedBytes, usize)>> {
        self.arrays.lock().unwrap_or_else(|poison| poison.into_inner())
    }

    /// Keeps a finished array, the first `len` of `bytes`, under the name that its file would have.
    pub fn keep(&self, name: &str, bytes: MappedBytes, len: usize) {
        self.arrays().insert(name.to_string(), (bytes, len));
    }

    /// The bytes of the array `name`, of which it is the first so many.
    pub fn get(&self, name: &str) -> Option<(MappedBytes, usize)> {
        self.arrays().get(name).cloned()
    }

    /// Gives up the array `name`, if there is one. Its memory is free when its last reader is gone.
    pub fn remove(&self, name: &str) {
        self.arrays().remove(name);
    }
}
