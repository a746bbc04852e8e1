//! A two-dimensional `.npy` whose rows are written one by one, each through a mapping of its own.
//!
//! So a finished row can be synced alone, whatever the others are doing, and a half-filled file of a killed run can be
//! resumed: a journal records which of its rows are complete. In a temporary directory rows are kept in memory instead
//! where the budget has room ([`super::in_memory`], [`are_held`]).

use super::in_memory::InMemoryArrays;
use super::mapped::AlignedBuffer;
use super::mapped::{MappedSlice, MappedSliceMut};
use super::new_file::{partial_name, reserve_file};
use super::npy::{self, HEADER, Item};
use crate::base::parallel::lock;
use crate::base::{Error, Result};
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard};

/// Rows up to this total size, in bytes, are kept in memory whatever the budget.
const FEW: u64 = 32 << 20;
/// Rows in memory may take one part in this many of the budget. Through a file each is copied twice and read back a
/// page at a time, which takes a tenth of a whole K-means run at a million faces; but the kernel can reclaim pages of a
/// file.
const SHARE: u64 = 8;

/// Whether rows of `bytes` bytes in total are kept in memory, of a budget of `total` bytes that has room for them.
pub fn are_held(bytes: u64, total: u64) -> bool {
    bytes <= FEW.max(total / SHARE)
}

/// Where the rows are.
#[derive(Debug)]
enum Place<T> {
    /// In a file under its temporary name.
    File(Arc<File>),
    /// In memory, registered when all are complete.
    Memory(Mutex<MappedSliceMut<T>>, Arc<InMemoryArrays>),
}

/// A file of rows in progress.
#[derive(Debug)]
pub struct RowsFile<T> {
    path: PathBuf,
    place: Place<T>,
    rows: usize,
    len: usize,
}

impl<T: Item> RowsFile<T> {
    fn bytes(rows: usize, len: usize) -> u64 {
        (HEADER + rows * len * size_of::<T>()) as u64
    }

    fn of(path: &Path, file: File, rows: usize, len: usize) -> Self {
        Self { path: path.to_path_buf(), place: Place::File(Arc::new(file)), rows, len }
    }

    /// Rows in `buffer`, to be registered in `arrays` under the name of `path`.
    pub(super) fn in_memory(
        path: &Path,
        rows: usize,
        len: usize,
        buffer: AlignedBuffer,
        arrays: Arc<InMemoryArrays>,
    ) -> Self {
        let data = MappedSliceMut::held(buffer, rows * len);
        Self { path: path.to_path_buf(), place: Place::Memory(Mutex::new(data), arrays), rows, len }
    }

    /// All rows, one after another, where they are in memory; they cannot be mapped one by one then.
    pub fn held(&self) -> Option<MutexGuard<'_, MappedSliceMut<T>>> {
        let Place::Memory(data, _) = &self.place else { return None };
        Some(lock(data))
    }

    /// Creates `path.partial` for `rows` rows of `len` items, its blocks reserved.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn create(path: &Path, rows: usize, len: usize) -> Result<Self> {
        let mut file = reserve_file(path, Self::bytes(rows, len))?;
        file.write_all(&npy::header(T::DESCR, &[rows, len])).map_err(Error::io(path, "write"))?;
        Ok(Self::of(path, file, rows, len))
    }

    /// Resumes `path.partial` of an earlier run; `None` if there is none of this shape.
    pub fn reopen(path: &Path, rows: usize, len: usize) -> Option<Self> {
        let mut file = File::options().read(true).write(true).open(partial_name(path)).ok()?;
        let mut found = [0; HEADER];
        file.read_exact(&mut found).ok()?;
        let whole = file.metadata().ok()?.len() == Self::bytes(rows, len);
        (whole && found[..] == npy::header(T::DESCR, &[rows, len])).then(|| Self::of(path, file, rows, len))
    }

    /// Maps row `k` for writing (and reading back).
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Internal`] for a row that does not exist, or is mapped already.
    pub fn row(&self, k: usize) -> Result<MappedSliceMut<T>> {
        let Place::File(file) = &self.place else {
            return Err(Error::internal("rows held in memory have no mappings"));
        };
        if k >= self.rows {
            return Err(Error::internal(&format!("row {k}, where there are {}", self.rows)));
        }
        let offset = HEADER + k * self.len * size_of::<T>();
        MappedSliceMut::map(file, &partial_name(&self.path), offset, self.len)
    }

    /// Renames the file to its final name, after syncing it where `durable`, and maps it for reading.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn finish(self, durable: bool) -> Result<MappedSlice<T>> {
        let file = match self.place {
            Place::File(file) => file,
            Place::Memory(data, arrays) => {
                let data = data.into_inner().unwrap_or_else(|poison| poison.into_inner());
                return npy::register(&self.path, &arrays, data.freeze(), self.rows * self.len);
            }
        };
        if durable {
            file.sync_all().map_err(Error::io(&self.path, "sync"))?;
        }
        std::fs::rename(partial_name(&self.path), &self.path).map_err(Error::io(&self.path, "rename"))?;
        npy::open(&self.path)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_rows_of_a_temporary_directory_are_held() {
        let dir = tempfile::tempdir().unwrap();
        let budget = crate::store::Budget::new(1 << 30);
        let work = crate::store::WorkDir::temporary(dir.path()).unwrap().holding(&budget);
        let file = work.rows::<f32>("rows.npy", 3, 1000).unwrap();
        assert!(file.row(0).is_err());
        for k in [2, 0, 1] {
            file.held().unwrap()[1000 * k..][..1000].fill(k as f32);
        }
        let all = file.finish(false).unwrap();
        assert_eq!((all.len(), all[999], all[1000], all[2999]), (3000, 0., 1., 2.));
        assert_eq!(*work.open_array::<f32>("rows.npy").unwrap(), *all);
        assert!(work.rows::<f32>("larger.npy", 2, 1 << 24).unwrap().held().is_some());
        assert!(work.rows::<f32>("too-large.npy", 2, (1 << 24) + 1).unwrap().held().is_none());
    }

    #[test]
    fn rows_survive_being_left() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("rows.npy");
        let file = RowsFile::<f32>::create(&path, 3, 1000).unwrap();
        file.row(2).unwrap().fill(7.);
        let row = file.row(0).unwrap();
        assert!(file.row(0).is_err(), "one row was handed out twice");
        assert!(file.row(3).is_err());
        drop(row);
        file.row(0).unwrap().overwrite(&[5.; 1000]).unwrap();
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
