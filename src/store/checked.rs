//! Arrays of an earlier run, validated when opened: lengths against each other, and indices against the number of
//! nodes, cells or rows.
//!
//! A stage's files are opened only if their checksums match the manifest. But whoever alters an array can alter the
//! manifest too. After these checks no index read from a work directory is out of bounds; a violation is an error that
//! names the file. Cost: one pass over the index arrays, 4 bytes per item, at memory speed, right after the pass for
//! the checksum.

use super::MappedSlice;
use super::npy::Item;
use super::workdir::WorkDir;
use crate::base::printable::counted;
use crate::base::{Error, Result};

/// Items checked together; each block is checked without branches.
const BLOCK: usize = 1 << 12;

/// Whether all of `values` are below `end`.
pub fn all_below(values: impl ExactSizeIterator<Item = u32> + Clone, end: usize) -> bool {
    let Ok(end) = u32::try_from(end) else { return true };
    let mut rest = values;
    while rest.len() > 0 {
        // Block by block: the inner loop vectorises, and the search still ends early.
        if rest.by_ref().take(BLOCK).fold(false, |wrong, value| wrong | (value >= end)) {
            return false;
        }
    }
    true
}

impl WorkDir {
    /// The error for a file of this directory that is inconsistent with others, or with itself.
    pub fn damaged(&self, name: &str, problem: impl Into<String>) -> Error {
        Error::work_dir(
            self.place(name),
            problem,
            "it was altered or damaged: delete the work directory and start again",
        )
    }

    /// Opens the finished array `name`, which has `len` items.
    ///
    /// # Errors
    /// [`Error::WorkDir`] where the length differs; as [`WorkDir::open_array`].
    pub fn array_of<T: Item>(&self, name: &str, len: usize) -> Result<MappedSlice<T>> {
        let array = self.open_array::<T>(name)?;
        if array.len() == len {
            return Ok(array);
        }
        Err(self.damaged(name, format!("has {} instead of {len}", counted(array.len(), "item"))))
    }

    /// Opens the finished array `name` of `len` indices below `end`.
    ///
    /// # Errors
    /// [`Error::WorkDir`] where one of them is `end` or more; as [`WorkDir::array_of`].
    pub fn indices<T: Item + Into<u32>>(&self, name: &str, len: usize, end: usize) -> Result<MappedSlice<T>> {
        let array = self.array_of::<T>(name, len)?;
        if all_below(array.iter().map(|&index| index.into()), end) {
            return Ok(array);
        }
        Err(self.damaged(name, format!("has indices that are not below {end}")))
    }

    /// Opens the finished array `name` of the starts of `rows` rows, followed by the end: `items` items in all.
    ///
    /// # Errors
    /// [`Error::WorkDir`] where they do not ascend from 0 to `items`; as [`WorkDir::array_of`].
    pub fn starts(&self, name: &str, rows: usize, items: usize) -> Result<MappedSlice<u64>> {
        let array = self.array_of::<u64>(name, rows.saturating_add(1))?;
        if array.first() == Some(&0) && array.last() == Some(&(items as u64)) && array.is_sorted() {
            return Ok(array);
        }
        Err(self.damaged(name, format!("does not ascend from 0 to {items}")))
    }

    /// Opens the finished array `name` of `len` positive numbers.
    ///
    /// # Errors
    /// [`Error::WorkDir`] where one of them is 0, negative or NaN; as [`WorkDir::array_of`].
    pub fn positive(&self, name: &str, len: usize) -> Result<MappedSlice<f32>> {
        let array = self.array_of::<f32>(name, len)?;
        if array.chunks(BLOCK).all(|block| block.iter().fold(true, |fine, &value| fine & (value > 0.))) {
            return Ok(array);
        }
        Err(self.damaged(name, "has a value that is not positive (0, negative or NaN)"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_lead_beyond_an_array_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let work = WorkDir::temporary(dir.path()).unwrap();
        let mut values = vec![2u32; 3 * BLOCK];
        for (k, end, sound) in [(0, 3, true), (0, 2, false), (3 * BLOCK - 1, 7, false), (BLOCK, 8, true)] {
            values[k] = if end > 3 { 7 } else { 2 };
            work.write("x.npy", &values, 1).unwrap();
            assert_eq!(work.indices::<u32>("x.npy", values.len(), end).is_ok(), sound, "{k} {end}");
            values[k] = 2;
        }
        let error = work.indices::<u32>("x.npy", 5, 9).unwrap_err().to_string();
        assert!(error.contains("x.npy: has 12288 items instead of 5"), "{error}");
        for (starts, sound) in
            [([0u64, 2, 2, 5], true), ([0, 3, 2, 5], false), ([1, 2, 3, 5], false), ([0, 1, 2, 6], false)]
        {
            work.write("s.npy", &starts, 1).unwrap();
            assert_eq!(work.starts("s.npy", 3, 5).is_ok(), sound, "{starts:?}");
        }
        for (value, sound) in [(1f32, true), (f32::INFINITY, true), (0., false), (-1., false), (f32::NAN, false)] {
            work.write("w.npy", &[1., value], 1).unwrap();
            assert_eq!(work.positive("w.npy", 2).is_ok(), sound, "{value}");
        }
    }
}
