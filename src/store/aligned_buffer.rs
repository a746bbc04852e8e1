//! Memory for an array, as a budget grants it.

use super::budget::{Budget, Grant};
use super::mapped::huge_pages;
use bytemuck::Pod;

/// Zeroed memory of a budget, aligned for every item type.
#[derive(Debug)]
pub struct AlignedBuffer {
    words: Vec<u64>,
    _grant: Grant,
}

impl AlignedBuffer {
    /// Memory for at least `bytes` bytes on large pages, where `budget` can spare them: half of it stays for others. It is
    /// not touched here: pages come to be with the threads that fill them.
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
