//! Arrays that last as long as the work that needs them: in memory where the budget can spare it, else in a file.
//!
//! The arrays of a stage are files of a lasting work directory whatever the budget, since the next run reads them.
//! Nobody reads these again, so they go to the disk only where memory is short. Cost: that of the items; a file is
//! reserved on the disk and mapped, and removed when it is dropped.

use super::mapped::AlignedBuffer;
use super::npy::ArrayMut;
use super::{Context, MappedSliceMut};
use crate::base::Result;
use bytemuck::Pod;
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};

/// Zeroed items of any type made of 32-bit numbers; derefs to a slice.
#[derive(Debug)]
pub struct ScratchArray<T> {
    words: Words,
    item: PhantomData<T>,
}

#[derive(Debug)]
enum Words {
    Memory(MappedSliceMut<u32>),
    File(ArrayMut<u32>),
}

impl<T: Pod> ScratchArray<T> {
    /// `len` items, in the file `name` of the work directory where memory is short.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`].
    pub fn new(name: &str, len: usize, context: Context<'_>) -> Result<Self> {
        const { assert!(size_of::<T>().is_multiple_of(size_of::<u32>()) && align_of::<T>() <= align_of::<u32>()) };
        let words = len * (size_of::<T>() / size_of::<u32>());
        let words = match AlignedBuffer::try_new(&context.run.budget, words * size_of::<u32>()) {
            Some(buffer) => Words::Memory(MappedSliceMut::held(buffer, words)),
            None => Words::File(ArrayMut::create(&context.work.new_file(name)?, &[words])?),
        };
        Ok(Self { words, item: PhantomData })
    }
}

impl<T: Pod> Deref for ScratchArray<T> {
    type Target = [T];
    #[inline]
    fn deref(&self) -> &[T] {
        match &self.words {
            Words::Memory(words) => bytemuck::cast_slice(words),
            Words::File(array) => bytemuck::cast_slice(array.items()),
        }
    }
}

impl<T: Pod> DerefMut for ScratchArray<T> {
    #[inline]
    fn deref_mut(&mut self) -> &mut [T] {
        match &mut self.words {
            Words::Memory(words) => bytemuck::cast_slice_mut(words),
            Words::File(array) => bytemuck::cast_slice_mut(array.data()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::{Budget, Run, WorkDir};

    #[test]
    fn arrays_are_zeroed_and_leave_nothing_in_memory_or_not() {
        let folder = tempfile::tempdir().unwrap();
        let work = WorkDir::open(folder.path()).unwrap();
        let before = std::fs::read_dir(folder.path()).unwrap().count();
        for (budget, files) in [(1 << 20, 0), (100, 1)] {
            let budget = Budget::new(budget);
            let run = Run { budget: budget.clone(), ..Run::new(&()) };
            let mut array = ScratchArray::<[f32; 2]>::new("some.tmp", 1000, Context::new(&work, &run)).unwrap();
            assert!(array.len() == 1000 && array.iter().all(|item| *item == [0.; 2]));
            array[999] = [1., 2.];
            assert_eq!(array[999], [1., 2.]);
            assert_eq!(budget.left() == budget.total(), files == 1);
            assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), before + files);
            drop(array);
            assert_eq!(budget.left(), budget.total());
            assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), before);
            let none = ScratchArray::<u32>::new("none.tmp", 0, Context::new(&work, &run)).unwrap();
            assert!(none.is_empty());
        }
    }
}
