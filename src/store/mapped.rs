//! Typed views of mapped files: the only module with `unsafe`.
//!
//! # Why it is sound
//! A mapping is safe to read as bytes as long as nobody changes or truncates the file under it.
//!
//! - *Within this process* every mapping is claimed while it lives ([`super::claims`]): bytes mapped for writing are
//!   mapped once, and nobody maps them for reading, whatever name the file is opened under. A mapping that would
//!   overlap is an error. So is one beyond the end of its file.
//! - *Writes by descriptor* ([`Writeback::write`]) go to a file whose mapping belongs to one [`MappedSliceMut`]. They
//!   stay within that array, and only this crate can make them: the block cache, which writes blocks of a row while no
//!   slice of it is read.
//! - *Other processes of this program* are kept out by the lock on the work directory. Its files are written under a
//!   temporary name and renamed when whole.
//! - *Other programs* may write to any file, which no program can prevent. Numbers may then change between two reads;
//!   every index read from a file is checked by the slice that it indexes, so the worst outcome is a wrong number or a
//!   panic, which is caught. Should a file shrink, the kernel raises `SIGBUS`, which [`report_vanishing_files`] turns
//!   into an ordinary failure.
//!
//! Typed views go through `bytemuck`, which checks size and alignment and accepts only types for which
//! every bit pattern is a value.
//!
//! # Cost
//! A view costs no memory of its own; a page is read at its first access (about 0.1–0.25 µs per cached page of 4 KiB,
//! measured) and may be dropped by the kernel at any time. Large files are read in pages of 2 MiB where the kernel
//! can ([`super::access`]).
#![allow(unsafe_code)]

pub use super::access::Access;

use super::budget::{Budget, Grant};
use super::claims::Claim;
use crate::base::{Error, Result};
use bytemuck::Pod;
use memmap2::{Mmap, MmapMut};
use std::fs::File;
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

/// Zeroed memory from a budget, aligned for every item type.
#[derive(Debug)]
pub struct AlignedBuffer {
    words: Vec<u64>,
    _grant: Grant,
}

impl AlignedBuffer {
    /// The memory of `grant`, on large pages. The pages are not touched here.
    pub fn of(grant: Grant) -> Self {
        let words = vec![0; (grant.bytes() / 8) as usize];
        huge_pages(&words);
        Self { words, _grant: grant }
    }

    /// Memory for at least `bytes` bytes on large pages, if `budget` can spare them: [`Budget::left_to_stages`].
    /// The pages are first touched by the threads that fill them.
    pub fn try_new(budget: &Budget, bytes: usize) -> Option<Self> {
        let bytes = bytes.next_multiple_of(size_of::<u64>()) as u64;
        if budget.left() < bytes.saturating_add(Budget::left_to_stages(budget.total())) {
            return None;
        }
        Some(Self::of(budget.take("work arrays", bytes, bytes).ok()?))
    }

    /// A copy of `items`, if `budget` can spare the memory.
    pub fn copy_of<T: Pod>(budget: &Budget, items: &[T]) -> Option<Self> {
        let mut words = Self::try_new(budget, size_of_val(items))?;
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
    /// If it is shorter.
    pub fn items<T: Pod>(&self, len: usize) -> &[T] {
        bytemuck::cast_slice(&self.bytes()[..len * size_of::<T>()])
    }

    /// Its first `len` items, to be written.
    ///
    /// # Panics
    /// If it is shorter.
    pub fn items_mut<T: Pod>(&mut self, len: usize) -> &mut [T] {
        bytemuck::cast_slice_mut(&mut self.bytes_mut()[..len * size_of::<T>()])
    }
}

/// The bytes of a whole file, mapped read-only, or of an array in memory. Clones share them.
#[derive(Clone)]
pub struct MappedBytes {
    map: Option<Arc<Bytes>>,
}

/// Where bytes lie. The claim is dropped before its mapping: once a deleted file is unmapped, the system may give its
/// inode number to a new file. This is safe, since nobody uses a mapping that is being dropped.
#[derive(Debug)]
enum Bytes {
    File(#[expect(dead_code, reason = "given back when dropped")] Claim, Mmap, PathBuf),
    Held(AlignedBuffer),
    /// A caller's vector of 4-byte or of 8-byte items, kept with its type: so it is aligned and never copied.
    Words(Vec<u32>),
    DoubleWords(Vec<u64>),
}

/// Where bytes lie that are being written.
#[derive(Debug)]
enum BytesMut {
    File(#[expect(dead_code, reason = "given back when dropped")] Claim, MmapMut),
    Held(AlignedBuffer),
}

impl BytesMut {
    /// Maps `bytes` bytes of `file` from `offset` on. `None`, an overflowed length, is an error.
    fn map(file: &File, path: &Path, offset: usize, bytes: Option<usize>) -> Result<Self> {
        let metadata = file.metadata().map_err(Error::io(path, "access"))?;
        let end =
            bytes.and_then(|bytes| (offset as u64).checked_add(bytes as u64)).filter(|&end| end <= metadata.len());
        let (Some(bytes), Some(end)) = (bytes, end) else {
            return Err(Error::internal(&format!("{}: mapped beyond its end", path.display())));
        };
        let claim = Claim::writing(&metadata, offset as u64..end).ok_or_else(|| claimed(path))?;
        // SAFETY: see the module's text: no other mapping of this process covers these bytes as
        // long as the claim lives.
        let map = unsafe { memmap2::MmapOptions::new().offset(offset as u64).len(bytes).map_mut(file) };
        let map = map.map_err(Error::io(path, "map"))?;
        Ok(Self::File(claim, map))
    }
}

impl MappedBytes {
    /// Maps the file at `path`; an empty file maps to an empty slice.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be opened or mapped; [`Error::Internal`] while this process writes to it.
    pub fn open(path: &Path) -> Result<Self> {
        let file = File::open(path).map_err(Error::io(path, "open"))?;
        let metadata = file.metadata().map_err(Error::io(path, "access"))?;
        if metadata.is_dir() {
            return Err(Error::unusable(path, "is a folder, not a file", "give a file"));
        }
        if metadata.len() == 0 {
            return Ok(Self { map: None });
        }
        let claim = Claim::reading(&metadata).ok_or_else(|| claimed(path))?;
        // SAFETY: see the module's text: nobody in this process writes to the file as long as the claim lives, and
        // every use of its content is checked.
        let map = unsafe { Mmap::map(&file) }.map_err(Error::io(path, "map"))?;
        advise(&map, Access::Local);
        Ok(Self { map: Some(Arc::new(Bytes::File(claim, map, path.to_path_buf()))) })
    }

    /// Advises the kernel how the bytes will be read. Failures are ignored.
    pub fn advise(&self, access: Access) {
        if let Some(Bytes::File(_, map, _)) = self.map.as_deref() {
            advise(map, access);
        }
    }

    /// A typed view of `len` items from byte `offset` on.
    ///
    /// # Errors
    /// [`Error::Malformed`] naming `path` when the file is too short or the offset misaligned.
    pub fn slice<T: Pod>(&self, path: &Path, offset: usize, len: usize) -> Result<MappedSlice<T>> {
        let end = len.checked_mul(size_of::<T>()).and_then(|bytes| bytes.checked_add(offset));
        if end.is_none_or(|end| end > self.len()) || !offset.is_multiple_of(align_of::<T>()) {
            return Err(self.misfit(path, offset, len, size_of::<T>()));
        }
        Ok(MappedSlice { bytes: self.clone(), offset, len, item: PhantomData })
    }

    fn misfit(&self, path: &Path, offset: usize, len: usize, item: usize) -> Error {
        let problem = format!("{len} items of {item} bytes do not fit in the file's {} bytes", self.len());
        Error::malformed(path, format!("byte {offset}"), problem, "the file is damaged; recreate it")
    }
}

impl Deref for MappedBytes {
    type Target = [u8];
    #[inline]
    fn deref(&self) -> &[u8] {
        match self.map.as_deref() {
            None => &[],
            Some(Bytes::File(_, map, _)) => map,
            Some(Bytes::Held(words)) => words.bytes(),
            Some(Bytes::Words(words)) => bytemuck::cast_slice(words),
            Some(Bytes::DoubleWords(words)) => bytemuck::cast_slice(words),
        }
    }
}

impl From<Vec<u32>> for MappedBytes {
    /// Takes the bytes of `words` over without a copy.
    fn from(words: Vec<u32>) -> Self {
        Self { map: Some(Arc::new(Bytes::Words(words))) }
    }
}

impl From<Vec<u64>> for MappedBytes {
    /// Takes the bytes of `words` over without a copy.
    fn from(words: Vec<u64>) -> Self {
        Self { map: Some(Arc::new(Bytes::DoubleWords(words))) }
    }
}

/// A read-only array in a mapped file; dereferences to a slice. Clones share the mapping.
#[derive(Clone, Debug)]
pub struct MappedSlice<T> {
    bytes: MappedBytes,
    offset: usize,
    len: usize,
    item: PhantomData<T>,
}

impl<T: Pod> MappedSlice<T> {
    /// An empty array without a file.
    pub fn empty() -> Self {
        Self { bytes: MappedBytes { map: None }, offset: 0, len: 0, item: PhantomData }
    }

    /// Advises the kernel how the array will be read.
    pub fn advise(&self, access: Access) {
        self.bytes.advise(access);
    }

    /// The file that the array lies in, and the byte where it begins; `None` for one in memory.
    pub fn place(&self) -> Option<(&Path, usize)> {
        let Some(Bytes::File(_, _, path)) = self.bytes.map.as_deref() else { return None };
        Some((path, self.offset))
    }
}

impl<T: Pod> From<Vec<T>> for MappedSlice<T>
where
    MappedBytes: From<Vec<T>>,
{
    /// Takes the array `items` over without a copy.
    fn from(items: Vec<T>) -> Self {
        let len = items.len();
        Self { bytes: items.into(), offset: 0, len, item: PhantomData }
    }
}

impl<T: Pod> Deref for MappedSlice<T> {
    type Target = [T];
    #[inline]
    fn deref(&self) -> &[T] {
        if self.len == 0 {
            return &[];
        }
        bytemuck::cast_slice(&self.bytes[self.offset..self.offset + self.len * size_of::<T>()])
    }
}

/// A writable array in a mapped file of this program, or in memory; dereferences to a mutable slice.
#[derive(Debug)]
pub struct MappedSliceMut<T> {
    map: Option<BytesMut>,
    file: Option<Arc<File>>,
    /// Byte of the file at which the array starts.
    offset: usize,
    len: usize,
    item: PhantomData<T>,
}

impl<T: Pod> MappedSliceMut<T> {
    /// Maps `len` items from byte `offset` of `file`. Their blocks must exist already.
    ///
    /// # Errors
    /// [`Error::Io`] naming `path` when the mapping fails; [`Error::Internal`] where the file is too short, or while
    /// any of these bytes is mapped elsewhere in this process.
    pub fn map(file: &Arc<File>, path: &Path, offset: usize, len: usize) -> Result<Self> {
        if len == 0 {
            return Ok(Self { map: None, file: None, offset, len: 0, item: PhantomData });
        }
        let map = BytesMut::map(file, path, offset, len.checked_mul(size_of::<T>()))?;
        Ok(Self { map: Some(map), file: Some(file.clone()), offset, len, item: PhantomData })
    }

    /// The first `len` items of `words`, or fewer if it is shorter, in memory.
    pub fn held(words: AlignedBuffer, len: usize) -> Self {
        let len = len.min(words.bytes().len() / size_of::<T>().max(1));
        Self { map: Some(BytesMut::Held(words)), file: None, offset: 0, len, item: PhantomData }
    }

    /// The bytes of an array in memory, now read-only; `None` for one in a file.
    pub fn freeze(self) -> Option<MappedBytes> {
        match self.map {
            Some(BytesMut::Held(words)) => Some(MappedBytes { map: Some(Arc::new(Bytes::Held(words))) }),
            _ => None,
        }
    }

    /// A handle that flushes parts of the array to the disk while it is written.
    pub fn writeback(&self) -> Option<Writeback> {
        let file = self.file.clone()?;
        Some(Writeback { file, offset: self.offset, item: size_of::<T>(), len: self.len })
    }

    /// Replaces all items. Those of a file are written to the file, not through the mapping: one page fault per page
    /// costs more than a copy.
    ///
    /// # Errors
    /// The operating system's; `InvalidInput` if the number of items differs.
    pub fn overwrite(&mut self, items: &[T]) -> std::io::Result<()> {
        use std::os::unix::fs::FileExt;
        if items.len() != self.len {
            return Err(std::io::ErrorKind::InvalidInput.into());
        }
        match &self.file {
            Some(file) => file.write_all_at(bytemuck::cast_slice(items), self.offset as u64),
            None => {
                self.copy_from_slice(items);
                Ok(())
            }
        }
    }

    /// Writes modified pages to the disk and waits.
    ///
    /// # Errors
    /// The operating system's.
    pub fn sync(&self) -> std::io::Result<()> {
        if let Some(BytesMut::File(_, map)) = &self.map { map.flush() } else { Ok(()) }
    }

    /// Advises the kernel how the array will be used.
    pub fn advise(&self, access: Access) {
        if let Some(BytesMut::File(_, map)) = &self.map {
            advise(map, access);
        }
    }
}

impl<T: Pod> Deref for MappedSliceMut<T> {
    type Target = [T];
    #[inline]
    fn deref(&self) -> &[T] {
        match &self.map {
            None => &[],
            Some(BytesMut::File(_, map)) => bytemuck::cast_slice(&map[..self.len * size_of::<T>()]),
            Some(BytesMut::Held(words)) => bytemuck::cast_slice(&words.bytes()[..self.len * size_of::<T>()]),
        }
    }
}

impl<T: Pod> DerefMut for MappedSliceMut<T> {
    #[inline]
    fn deref_mut(&mut self) -> &mut [T] {
        match &mut self.map {
            None => &mut [],
            Some(BytesMut::File(_, map)) => bytemuck::cast_slice_mut(&mut map[..self.len * size_of::<T>()]),
            Some(BytesMut::Held(words)) => {
                bytemuck::cast_slice_mut(&mut words.bytes_mut()[..self.len * size_of::<T>()])
            }
        }
    }
}

/// The file behind a mapped array: flushes parts of it early, or writes them past the mapping. See
/// [`MappedSliceMut::writeback`].
#[derive(Clone, Debug)]
pub struct Writeback {
    file: Arc<File>,
    offset: usize,
    item: usize,
    len: usize,
}

impl Writeback {
    /// Starts writing the modified pages of `items`. Advice only: failures are ignored.
    pub fn start(&self, items: std::ops::Range<usize>) {
        #[cfg(target_os = "linux")]
        {
            use std::os::fd::AsRawFd;
            let (from, bytes) = (self.offset + items.start * self.item, items.len() * self.item);
            // SAFETY: the descriptor is open; the call starts I/O and touches no memory.
            unsafe {
                libc::sync_file_range(
                    self.file.as_raw_fd(),
                    from as libc::off64_t,
                    bytes as libc::off64_t,
                    libc::SYNC_FILE_RANGE_WRITE,
                );
            }
        }
        #[cfg(not(target_os = "linux"))]
        let _ = (&self.file, self.offset, self.item, items);
    }

    /// Writes `items` from the item `first` on, to the file rather than through the mapping.
    ///
    /// # Errors
    /// The operating system's; `InvalidInput` for items beyond the array or of another size.
    pub(crate) fn write<T: Pod>(&self, first: usize, items: &[T]) -> std::io::Result<()> {
        use std::os::unix::fs::FileExt;
        if size_of::<T>() != self.item || first > self.len || items.len() > self.len - first {
            return Err(std::io::ErrorKind::InvalidInput.into());
        }
        self.file.write_all_at(bytemuck::cast_slice(items), (self.offset + first * self.item) as u64)
    }

    /// Reads items back from the item `first` on.
    ///
    /// # Errors
    /// The operating system's.
    pub fn read<T: Pod>(&self, first: usize, items: &mut [T]) -> std::io::Result<()> {
        use std::os::unix::fs::FileExt;
        self.file.read_exact_at(bytemuck::cast_slice_mut(items), (self.offset + first * self.item) as u64)
    }
}

/// Requests pages of 2 MiB under `slice`, in memory not touched yet: one fault instead of 512. Advice only.
pub fn huge_pages<T>(slice: &[T]) {
    #[cfg(target_os = "linux")]
    advise_pages(slice, libc::MADV_HUGEPAGE);
    #[cfg(not(target_os = "linux"))]
    let _ = slice;
}

/// Asks the kernel to read the pages of `slice` soon, without waiting. Advice only. Linux honours each such call only
/// up to its read-ahead size, so there is one call per [`ASKED`] bytes.
pub fn will_need<T>(slice: &[T]) {
    for piece in slice.chunks((ASKED / size_of::<T>().max(1)).max(1)) {
        advise_pages(piece, libc::MADV_WILLNEED);
    }
}

/// Linux's default read-ahead size.
const ASKED: usize = 128 << 10;

/// Advises the kernel how the pages of `slice` will be used.
pub fn advise<T>(slice: &[T], access: Access) {
    access.advice(size_of_val(slice)).for_each(|advice| advise_pages(slice, advice));
}

/// Bytes of a page of memory: 4 KiB on most machines, 16 or 64 KiB on others.
pub fn page_bytes() -> usize {
    static BYTES: OnceLock<usize> = OnceLock::new();
    // SAFETY: the call reads a constant of the system.
    *BYTES.get_or_init(|| usize::try_from(unsafe { libc::sysconf(libc::_SC_PAGESIZE) }).unwrap_or(0).max(1 << 12))
}

/// Gives advice that affects only how pages are kept and read.
fn advise_pages<T>(slice: &[T], advice: libc::c_int) {
    let page = page_bytes();
    let start = slice.as_ptr() as usize / page * page;
    let bytes = slice.as_ptr() as usize + size_of_val(slice) - start;
    // SAFETY: such advice changes no memory, whatever lies in the pages; a bad range is an error that is ignored.
    unsafe {
        libc::madvise(start as *mut libc::c_void, bytes, advice);
    }
}

/// Prefetches the cache line at `slice[index]`; does nothing where that is out of bounds.
#[inline(always)]
pub fn prefetch<T>(slice: &[T], index: usize) {
    #[cfg(target_arch = "x86_64")]
    if index < slice.len() {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a prefetch has no effect on memory, and the address lies inside the slice.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(slice.as_ptr().add(index).cast()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (slice, index);
}

/// Turns the `SIGBUS` of a mapped file that shrank or whose disk failed into a message on standard error and exit code
/// 1, leaving the work directory as it is. Also ignores `SIGXFSZ`, so that writing beyond a limit on file sizes
/// (`ulimit -f`) fails with an error like that of a full disk. Call once at start.
pub fn report_vanishing_files() {
    extern "C" fn on_sigbus(_: libc::c_int) {
        const TEXT: &[u8] = b"nystrom-stream: a mapped file shrank or could not be read while in use (input changed, or disk failed); run again when the file is whole\n";
        // SAFETY: write and _exit are async-signal-safe; the text is static.
        unsafe {
            let _ = libc::write(2, TEXT.as_ptr().cast(), TEXT.len());
            libc::_exit(1);
        }
    }
    let handler: extern "C" fn(libc::c_int) = on_sigbus;
    // SAFETY: installing a handler that calls only async-signal-safe functions, and ignoring a signal.
    unsafe {
        libc::signal(libc::SIGBUS, handler as libc::sighandler_t);
        libc::signal(libc::SIGXFSZ, libc::SIG_IGN);
    }
}

/// The error for a mapping that would overlap another one of this process.
fn claimed(path: &Path) -> Error {
    Error::internal(&format!("{}: is mapped elsewhere while it is written", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Regression: a claim outlived its mapping, so a new file that got the inode of a removed one was refused.
    #[test]
    fn a_new_file_with_the_number_of_a_removed_one_is_free() {
        let dir = tempfile::tempdir().unwrap();
        std::thread::scope(|scope| {
            for thread in 0..4 {
                let path = dir.path().join(thread.to_string());
                scope.spawn(move || {
                    for round in 0..3000 {
                        std::fs::write(&path, [0; 64]).unwrap();
                        let file = Arc::new(std::fs::OpenOptions::new().read(true).write(true).open(&path).unwrap());
                        if round % 2 == 0 {
                            let map = MappedSliceMut::<u8>::map(&file, &path, 0, 64).unwrap();
                            std::fs::remove_file(&path).unwrap();
                            drop(file);
                            drop(map);
                        } else {
                            drop(file);
                            let map = MappedBytes::open(&path).unwrap();
                            std::fs::remove_file(&path).unwrap();
                            drop(map);
                        }
                    }
                });
            }
        });
    }

    #[test]
    fn views_check_length_and_alignment() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x");
        std::fs::write(&path, [0u8; 16]).unwrap();
        let bytes = MappedBytes::open(&path).unwrap();
        assert_eq!(bytes.slice::<u32>(&path, 4, 3).unwrap().len(), 3);
        assert!(bytes.slice::<u32>(&path, 4, 4).is_err());
        assert!(bytes.slice::<u32>(&path, 2, 1).is_err());
        assert!(bytes.slice::<u32>(&path, 0, usize::MAX).is_err());
    }

    #[test]
    fn vectors_are_viewed_without_a_copy() {
        let (words, wide) = (vec![1u32, 2, 3], vec![4u64, 5]);
        let at = words.as_ptr();
        let (words, wide) = (MappedSlice::from(words), MappedSlice::from(wide));
        assert_eq!((&words[..], words.as_ptr(), &wide[..]), (&[1, 2, 3][..], at, &[4, 5][..]));
        assert!(MappedSlice::<u32>::from(Vec::new()).is_empty());
    }

    /// Regression: a row could have two writable slices, or others could write to one.
    #[test]
    fn mappings_never_alias() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x");
        std::fs::write(&path, [0u8; 64]).unwrap();
        let file = Arc::new(File::options().read(true).write(true).open(&path).unwrap());
        let map = |offset, len| MappedSliceMut::<u32>::map(&file, &path, offset, len);
        let mut first = map(0, 8).unwrap();
        let second = map(32, 8).unwrap();
        assert!(map(0, 8).is_err() && map(28, 2).is_err() && MappedBytes::open(&path).is_err());
        first.overwrite(&[7; 8]).unwrap();
        assert!(first.overwrite(&[7; 9]).is_err());
        assert_eq!((&first[..], second[0]), (&[7; 8][..], 0));
        drop((first, second));
        let read = MappedBytes::open(&path).unwrap();
        assert!(map(0, 8).is_err());
        drop(read);
        assert!(map(0, 16).is_ok());
        for (offset, len) in [(0, 17), (64, 1), (0, usize::MAX), (usize::MAX, 1)] {
            assert!(map(offset, len).is_err(), "{len} items from byte {offset}");
        }
    }

    #[test]
    fn an_empty_file_is_an_empty_slice() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x");
        std::fs::write(&path, []).unwrap();
        assert!(MappedBytes::open(&path).unwrap().is_empty());
    }
}
