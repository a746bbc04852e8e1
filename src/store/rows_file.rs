//! A two-dimensional `.npy` whose rows are written one by one, each through a mapping of its own.
//!
//! So a finished row can be brought to the disk alone, whatever the others are doing, and a file that a killed run
//! left half-filled can be taken up again: which of its rows are whole is for a journal to say.

use super::mapped::{MappedSlice, MappedSliceMut};
use super::npy::{self, HEADER, Item};
use crate::base::{Error, Result};
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

/// A file of rows under its temporary name.
#[derive(Debug)]
pub struct RowsFile<T> {
    path: PathBuf,
    file: File,
    rows: usize,
    len: usize,
    item: std::marker::PhantomData<T>,
}

impl<T: Item> RowsFile<T> {
    fn bytes(rows: usize, len: usize) -> u64 {
        (HEADER + rows * len * size_of::<T>()) as u64
    }

    fn of(path: &Path, file: File, rows: usize, len: usize) -> Self {
        Self { path: path.to_path_buf(), file, rows, len, item: std::marker::PhantomData }
    }

    /// Creates `path.partial` for `rows` rows of `len` items, its blocks reserved.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn create(path: &Path, rows: usize, len: usize) -> Result<Self> {
        let partial = npy::partial_name(path);
        let mut file = npy::reserve_file(&partial, Self::bytes(rows, len))?;
        file.write_all(&npy::header(T::DESCR, &[rows, len])).map_err(Error::io(&partial, "write"))?;
        Ok(Self::of(path, file, rows, len))
    }

    /// Takes up `path.partial` as an earlier run left it; `None` where there is none of this shape.
    pub fn reopen(path: &Path, rows: usize, len: usize) -> Option<Self> {
        let mut file = File::options().read(true).write(true).open(npy::partial_name(path)).ok()?;
        let mut found = [0; HEADER];
        file.read_exact(&mut found).ok()?;
        let whole = file.metadata().ok()?.len() == Self::bytes(rows, len);
        (whole && found[..] == npy::header(T::DESCR, &[rows, len])).then(|| Self::of(path, file, rows, len))
    }

    /// Maps row `k` for writing (and reading back).
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn row(&self, k: usize) -> Result<MappedSliceMut<T>> {
        let offset = HEADER + k.min(self.rows) * self.len * size_of::<T>();
        MappedSliceMut::map(&self.file, &npy::partial_name(&self.path), offset, self.len)
    }

    /// Writes row `k` as a whole, without a mapping: a fault a page costs more than copying the row.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn write_row(&self, k: usize, row: &[T]) -> Result<()> {
        use std::os::unix::fs::FileExt;
        let offset = HEADER + k.min(self.rows) * self.len * size_of::<T>();
        let bytes = bytemuck::cast_slice(row);
        self.file.write_all_at(bytes, offset as u64).map_err(Error::io(npy::partial_name(&self.path), "write"))
    }

    /// Renames the file to its final name, after syncing it where `durable`, and maps it for reading.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn finish(self, durable: bool) -> Result<MappedSlice<T>> {
        let partial = npy::partial_name(&self.path);
        if durable {
            self.file.sync_all().map_err(Error::io(&partial, "sync"))?;
        }
        std::fs::rename(&partial, &self.path).map_err(Error::io(&partial, "rename"))?;
        npy::open(&self.path)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_survive_being_left() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("rows.npy");
        let file = RowsFile::<f32>::create(&path, 3, 1000).unwrap();
        file.row(2).unwrap().fill(7.);
        file.row(0).unwrap().fill(5.);
        drop(file);
        assert!(RowsFile::<f32>::reopen(&path, 3, 999).is_none());
        let file = RowsFile::<f32>::reopen(&path, 3, 1000).unwrap();
        let mut row = file.row(1).unwrap();
        row.fill(6.);
        row.sync().unwrap();
        drop(row);
        let all = file.finish(true).unwrap();
        assert_eq!((all.len(), all[999], all[1000], all[2999]), (3000, 5., 6., 7.));
        assert!(RowsFile::<f32>::reopen(&path, 3, 1000).is_none());
    }
}
