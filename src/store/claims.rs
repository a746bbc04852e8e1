//! Which ranges of which files this process has mapped, so that no part of the program reads what another part writes.
//!
//! Two Rust slices over the same memory, one of them writable, are undefined behaviour, however they came about. Two
//! mappings of one file are such memory, whatever names the file is opened under. So every mapping is registered here
//! while it lives: a range mapped for writing is claimed exclusively, and a file with such a range cannot be mapped for
//! reading. Overlapping claims are refused, which makes mapping a safe function within one process; other processes are
//! kept out by the lock on the work directory.
//!
//! Cost: a lock and a look-up per mapping, less than the system call beside it.

use crate::base::parallel::lock;
use std::collections::BTreeMap;
use std::fs::Metadata;
use std::ops::Range;
use std::os::unix::fs::MetadataExt;
use std::sync::{Mutex, MutexGuard};

/// A file, by device and inode number: the same under every name.
type FileId = (u64, u64);

/// How a file is mapped now.
#[derive(Debug, Default)]
struct Mapped {
    readers: usize,
    written: Vec<Range<u64>>,
}

static MAPPED: Mutex<BTreeMap<FileId, Mapped>> = Mutex::new(BTreeMap::new());

fn mapped() -> MutexGuard<'static, BTreeMap<FileId, Mapped>> {
    lock(&MAPPED)
}

/// The right to map a file, given back when dropped.
#[derive(Debug)]
pub(super) struct Claim {
    file: FileId,
    /// The bytes that are written; `None`: the whole file is read.
    written: Option<Range<u64>>,
}

impl Claim {
    fn enter(file: &Metadata, written: Option<Range<u64>>) -> Option<Self> {
        let file = (file.dev(), file.ino());
        let mut all = mapped();
        let there = all.entry(file).or_default();
        let free = match &written {
            None => there.written.is_empty(),
            Some(range) => {
                let apart = |other: &Range<u64>| other.end <= range.start || range.end <= other.start;
                there.readers == 0 && there.written.iter().all(apart)
            }
        };
        // A refused claim leaves no empty entry behind: a new entry is always free.
        free.then(|| {
            match &written {
                None => there.readers += 1,
                Some(range) => there.written.push(range.clone()),
            }
            Self { file, written }
        })
    }

    /// A claim to read all of `file`; `None` while a part of it is mapped for writing.
    pub fn reading(file: &Metadata) -> Option<Self> {
        Self::enter(file, None)
    }

    /// A claim to write the bytes `range` of `file`; `None` while it is read, or any of them is written, elsewhere.
    pub fn writing(file: &Metadata, range: Range<u64>) -> Option<Self> {
        Self::enter(file, Some(range))
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        let mut all = mapped();
        let Some(there) = all.get_mut(&self.file) else { return };
        match &self.written {
            None => there.readers -= 1,
            Some(range) => {
                if let Some(k) = there.written.iter().position(|other| other == range) {
                    there.written.swap_remove(k);
                }
            }
        }
        if there.readers == 0 && there.written.is_empty() {
            all.remove(&self.file);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_range_has_one_writer_and_no_readers() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x");
        std::fs::write(&path, [0; 100]).unwrap();
        std::fs::hard_link(&path, dir.path().join("y")).unwrap();
        let (x, y) = (std::fs::metadata(&path).unwrap(), std::fs::metadata(dir.path().join("y")).unwrap());
        let first = Claim::writing(&x, 0..10).unwrap();
        let second = Claim::writing(&x, 10..20).unwrap();
        assert!(Claim::writing(&x, 9..11).is_none() && Claim::writing(&y, 0..1).is_none());
        assert!(Claim::reading(&x).is_none() && Claim::reading(&y).is_none());
        drop((first, second));
        let readers = (Claim::reading(&x).unwrap(), Claim::reading(&y).unwrap());
        assert!(Claim::writing(&x, 0..10).is_none());
        drop(readers);
        assert!(Claim::writing(&y, 0..10).is_some());
        assert!(!mapped().contains_key(&(x.dev(), x.ino())), "nothing is left");
    }
}
