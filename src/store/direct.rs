//! Arrays of 4-byte items that are read piece by piece, bypassing the page cache.
//!
//! For every few pages, a mapping costs the kernel a fault, a page-table entry and, when memory is short, a TLB flush
//! on all processors. Code that knows which pieces come next avoids that: each piece is one read into the caller's own
//! memory, which the disk fills directly. Where a file system does not support direct reads (`tmpfs`), pieces are read
//! as usual. Memory: the caller's, up to two pages more than the piece.

use super::mapped::MappedSlice;
use crate::base::{Error, Result};
use bytemuck::Pod;
use std::fs::{File, OpenOptions};
use std::io::ErrorKind;
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

/// Alignment of offset, length and buffer of direct reads, in bytes.
pub const PAGE: usize = 4096;

/// An array in a file.
#[derive(Debug)]
pub struct DirectArray {
    /// The file without the page cache.
    direct: Option<File>,
    file: File,
    path: PathBuf,
    /// Byte of the file at which the array starts.
    offset: usize,
    refused: AtomicBool,
}

impl DirectArray {
    /// Opens the array behind `mapped` once more; `None` for an array in memory.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn of<T: Pod>(mapped: &MappedSlice<T>) -> Result<Option<Self>> {
        let Some((path, offset)) = mapped.place() else { return Ok(None) };
        let file = File::open(path).map_err(Error::io(path, "open"))?;
        Ok(Some(Self { direct: direct(path), file, path: path.to_path_buf(), offset, refused: AtomicBool::new(false) }))
    }

    /// Words of memory that [`DirectArray::read`] needs for `items` items.
    pub fn words(items: usize) -> usize {
        ((4 * items).next_multiple_of(PAGE) + PAGE) / 4
    }

    /// Reads `items` into `out`, of [`DirectArray::words`] words from a multiple of [`PAGE`] on; returns the
    /// word where the first lies.
    ///
    /// # Errors
    /// [`Error::Io`], also where the file is too short.
    pub fn read(&self, items: Range<usize>, out: &mut [u32]) -> Result<usize> {
        let (from, to) = (self.offset + 4 * items.start, self.offset + 4 * items.end);
        let start = from / PAGE * PAGE;
        let bytes = &mut bytemuck::cast_slice_mut(out)[..(to - start).next_multiple_of(PAGE)];
        let direct = self.direct.as_ref().filter(|_| !self.refused.load(Ordering::Relaxed));
        let mut result = fill(direct.unwrap_or(&self.file), bytes, start);
        if direct.is_some() && result.as_ref().is_err_and(|error| error.kind() == ErrorKind::InvalidInput) {
            self.refused.store(true, Ordering::Relaxed);
            result = fill(&self.file, bytes, start);
        }
        let done = result.map_err(Error::io(&self.path, "read"))?;
        if done < to - start {
            return Err(Error::io(&self.path, "read")(ErrorKind::UnexpectedEof.into()));
        }
        Ok((from - start) / 4)
    }
}

/// Reads until `bytes` are full or the file ends; returns how many there are.
fn fill(file: &File, bytes: &mut [u8], start: usize) -> std::io::Result<usize> {
    let mut done = 0;
    while done < bytes.len() {
        match file.read_at(&mut bytes[done..], (start + done) as u64) {
            Ok(0) => break,
            Ok(more) => done += more,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(done)
}

#[cfg(target_os = "linux")]
fn direct(path: &Path) -> Option<File> {
    use std::os::unix::fs::OpenOptionsExt;
    OpenOptions::new().read(true).custom_flags(libc::O_DIRECT).open(path).ok()
}

#[cfg(not(target_os = "linux"))]
fn direct(_: &Path) -> Option<File> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::npy;

    #[test]
    fn every_piece_is_what_the_mapping_shows_wherever_it_is_put() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("array.npy");
        let items: Vec<u32> = (0..30_000).map(|k| k * 7 + 1).collect();
        npy::write(&path, &items, 1, false).unwrap();
        let array = npy::open::<u32>(&path).unwrap();
        let direct = DirectArray::of(&array).unwrap().unwrap();
        for (range, shift) in
            [(0..30_000, 0), (0..1, 0), (29_999..30_000, 0), (992..993, 0), (5_000..9_100, 0), (7..20_000, 3)]
        {
            let mut memory = vec![0u32; DirectArray::words(range.len()) + PAGE / 4 + shift];
            // The system refuses unaligned memory; such pieces are read as usual.
            let skip = memory.as_ptr().align_offset(PAGE) + shift;
            let first = direct.read(range.clone(), &mut memory[skip..]).unwrap();
            assert_eq!(&memory[skip + first..][..range.len()], &items[range]);
        }
        let file = OpenOptions::new().write(true).open(&path).unwrap();
        file.set_len(60_000).unwrap();
        assert!(direct.read(14_000..16_000, &mut vec![0; DirectArray::words(2000)]).is_err());
        assert!(DirectArray::of(&MappedSlice::from(items)).unwrap().is_none());
    }
}
