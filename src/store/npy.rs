//! Arrays as NumPy's `.npy` files that map in place.
//!
//! Files are written under `NAME.partial` with their blocks reserved (so that a full disk is an error at once and not a
//! signal later), and renamed when complete; unfinished files are removed. The header is padded to [`HEADER`] bytes, a
//! multiple of 64, so that the data are aligned here and in NumPy, and so that a streamed array can fill in its length
//! at the end.

use super::in_memory::InMemoryArrays;
use super::mapped::AlignedBuffer;
use super::mapped::{MappedBytes, MappedSlice, MappedSliceMut};
use super::new_file::{create_for, partial_name, reserve_file};
use super::npy_header;
use crate::base::{Error, Result};
use bytemuck::Pod;
use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Header bytes of every file written here.
pub const HEADER: usize = 128;

/// Item types that NumPy knows by a name.
pub trait Item: Pod + Send + Sync {
    /// NumPy's type string of a scalar, little-endian.
    const DESCR: &'static str;
    /// Scalars per item: the length of the array's last axis where items are records.
    const WIDTH: usize = 1;
}

impl Item for u8 {
    const DESCR: &'static str = "|u1";
}
impl Item for u16 {
    const DESCR: &'static str = "<u2";
}
impl Item for u32 {
    const DESCR: &'static str = "<u4";
}
impl Item for u64 {
    const DESCR: &'static str = "<u8";
}
impl Item for f32 {
    const DESCR: &'static str = "<f4";
}
impl Item for f64 {
    const DESCR: &'static str = "<f8";
}

impl Item for [u8; 3] {
    const DESCR: &'static str = "|u1";
    const WIDTH: usize = 3;
}
impl Item for [f32; 3] {
    const DESCR: &'static str = "<f4";
    const WIDTH: usize = 3;
}
impl Item for [f32; 8] {
    const DESCR: &'static str = "<f4";
    const WIDTH: usize = 8;
}

/// The header of a C-ordered array of type `descr` and `shape`, padded to [`HEADER`] bytes.
pub(super) fn header(descr: &str, shape: &[usize]) -> Vec<u8> {
    let dims: Vec<String> = shape.iter().map(ToString::to_string).collect();
    let tuple = if dims.len() == 1 { format!("({},)", dims[0]) } else { format!("({})", dims.join(", ")) };
    // Record types are given as a list of names and types, without quotes.
    let quote = if descr.starts_with('[') { "" } else { "'" };
    let mut text = format!("{{'descr': {quote}{descr}{quote}, 'fortran_order': False, 'shape': {tuple}, }}");
    let room = HEADER - 10;
    while text.len() < room - 1 {
        text.push(' ');
    }
    text.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((room as u16).to_le_bytes());
    bytes.extend(text.bytes());
    bytes
}

/// Where an array is being written.
#[derive(Debug)]
enum Place {
    /// In a file under its temporary name, renamed when complete.
    File(Arc<File>, Unfinished),
    /// In memory, registered when complete.
    Memory(Arc<InMemoryArrays>),
}

/// Registers the array for `path` in `arrays`, and returns its first `len` items; an empty array has no memory but is
/// registered too.
pub(super) fn register<T: Item>(
    path: &Path,
    arrays: &InMemoryArrays,
    bytes: Option<MappedBytes>,
    len: usize,
) -> Result<MappedSlice<T>> {
    registered(path, arrays, bytes, len * size_of::<T>()).slice(path, 0, len)
}

fn registered(path: &Path, arrays: &InMemoryArrays, bytes: Option<MappedBytes>, len: usize) -> MappedBytes {
    let bytes = bytes.unwrap_or_else(|| Vec::<u64>::new().into());
    arrays.keep(&path.file_name().unwrap_or_default().to_string_lossy(), bytes.clone(), len);
    bytes
}

/// An array of known shape being filled through a mapping; [`ArrayMut::finish`] makes it a file. If dropped before
/// that, it leaves nothing.
#[derive(Debug)]
pub struct ArrayMut<T> {
    path: PathBuf,
    /// Declared first, so that it is dropped before the file is removed.
    data: MappedSliceMut<T>,
    place: Place,
    early: bool,
}

impl<T: Item> ArrayMut<T> {
    /// Creates `path.partial` for an array of `shape`, counted in scalars.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn create(path: &Path, shape: &[usize]) -> Result<Self> {
        let len = shape.iter().product::<usize>() / T::WIDTH;
        let (file, unfinished) = reserved(path, len * size_of::<T>(), &header(T::DESCR, shape))?;
        let data = MappedSliceMut::map(&file, &partial_name(path), HEADER, len)?;
        Ok(Self { path: path.to_path_buf(), data, place: Place::File(file, unfinished), early: false })
    }

    /// The same, but with `early`, finishing starts writeback without waiting: for arrays that will be synced a while
    /// later.
    #[must_use]
    pub fn written_early(self, early: bool) -> Self {
        Self { early, ..self }
    }

    /// Where it will be.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// An array of `shape` in `buffer`, to be registered in `arrays` under the name of `path`.
    pub fn in_memory(path: &Path, shape: &[usize], buffer: AlignedBuffer, arrays: Arc<InMemoryArrays>) -> Self {
        let data = MappedSliceMut::held(buffer, shape.iter().product::<usize>() / T::WIDTH);
        Self { path: path.to_path_buf(), data, place: Place::Memory(arrays), early: false }
    }

    /// The mapped items.
    pub fn data(&mut self) -> &mut MappedSliceMut<T> {
        &mut self.data
    }

    /// The mapped items, read-only.
    pub fn items(&self) -> &[T] {
        &self.data
    }

    /// Renames the file to its final name, after syncing it to the disk where `durable`, and
    /// maps it for reading.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn finish(self, durable: bool) -> Result<MappedSlice<T>> {
        let (file, unfinished) = match self.place {
            Place::File(file, unfinished) => (file, unfinished),
            Place::Memory(arrays) => {
                let len = self.data.len();
                return register(&self.path, &arrays, self.data.freeze(), len);
            }
        };
        if durable {
            self.data.sync().and_then(|()| file.sync_all()).map_err(Error::io(&self.path, "sync"))?;
        } else if let (true, Some(writeback)) = (self.early, self.data.writeback()) {
            writeback.start(0..self.data.len());
        }
        // From here on the array is only read.
        drop(self.data);
        unfinished.publish(&self.path)?;
        open(&self.path)
    }
}

/// Initial capacity in bytes for an array of unknown length.
const LEAST_BUFFER: usize = 1 << 16;

/// A file under its temporary name, removed when dropped there.
#[derive(Debug)]
struct Unfinished(Option<PathBuf>);

impl Unfinished {
    /// Renames the complete file to `path`.
    fn publish(mut self, path: &Path) -> Result<()> {
        std::fs::rename(partial_name(path), path).map_err(Error::io(path, "rename"))?;
        self.0 = None;
        Ok(())
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        if let Some(partial) = self.0.take() {
            let _ = std::fs::remove_file(partial);
        }
    }
}

/// The file of an array of `bytes` under its temporary name, with its blocks reserved and its header written.
fn reserved(path: &Path, bytes: usize, header: &[u8]) -> Result<(Arc<File>, Unfinished)> {
    let mut file = reserve_file(path, (HEADER + bytes) as u64)?;
    let unfinished = Unfinished(Some(partial_name(path)));
    file.write_all(header).map_err(Error::io(path, "write"))?;
    Ok((Arc::new(file), unfinished))
}

/// The file of an array under its temporary name, ready for the items.
fn start_file(path: &Path) -> Result<(BufWriter<File>, Unfinished)> {
    let partial = partial_name(path);
    let mut out = BufWriter::with_capacity(1 << 18, create_for(path, &partial)?);
    let unfinished = Unfinished(Some(partial));
    out.write_all(&[0; HEADER]).map_err(Error::io(path, "write"))?;
    Ok((out, unfinished))
}

/// The destination of an array written from front to back.
#[derive(Debug)]
enum Out {
    File(BufWriter<File>, Unfinished),
    /// In memory, which grows as needed; when the budget grants no more, the array moves to a file.
    Memory(Option<AlignedBuffer>, Arc<InMemoryArrays>),
}

/// The bytes of an array, written from front to back. Separate from [`ArrayWriter`], which is compiled for each item
/// type.
#[derive(Debug)]
struct ByteWriter {
    path: PathBuf,
    out: Out,
    /// Bytes so far.
    len: usize,
}

impl ByteWriter {
    fn push(&mut self, bytes: &[u8]) -> Result<()> {
        let start = self.len;
        self.len += bytes.len();
        let (buffer, arrays) = match &mut self.out {
            Out::File(file, _) => return file.write_all(bytes).map_err(Error::io(&self.path, "write")),
            Out::Memory(buffer, arrays) => (buffer, arrays),
        };
        let (end, there) = (start + bytes.len(), buffer.as_ref().map_or(0, |buffer| buffer.bytes().len()));
        if end > there {
            let mut larger = arrays.take(end.max(2 * there).max(LEAST_BUFFER));
            match (&mut larger, &*buffer) {
                (Some(larger), Some(old)) => larger.bytes_mut()[..start].copy_from_slice(&old.bytes()[..start]),
                (None, old) => {
                    self.path = arrays.file(self.path.file_name().unwrap_or_default());
                    let (mut file, unfinished) = start_file(&self.path)?;
                    let so_far = old.as_ref().map_or(&[][..], |old| &old.bytes()[..start]);
                    let written = file.write_all(so_far).and_then(|()| file.write_all(bytes));
                    written.map_err(Error::io(&self.path, "write"))?;
                    self.out = Out::File(file, unfinished);
                    return Ok(());
                }
                _ => {}
            }
            *buffer = larger;
        }
        if let Some(buffer) = buffer {
            buffer.bytes_mut()[start..end].copy_from_slice(bytes);
        }
        Ok(())
    }

    /// The bytes of a complete array in memory, or `None` for a file, which gets the `header`, is synced where
    /// `durable`, and is renamed.
    fn finish(self, header: &[u8], durable: bool) -> Result<Option<MappedBytes>> {
        let (mut out, unfinished) = match self.out {
            Out::File(out, unfinished) => (out, unfinished),
            Out::Memory(buffer, arrays) => {
                let bytes = buffer.and_then(|buffer| MappedSliceMut::<u8>::held(buffer, self.len).freeze());
                return Ok(Some(registered(&self.path, &arrays, bytes, self.len)));
            }
        };
        let mut end = || -> std::io::Result<()> {
            out.seek(SeekFrom::Start(0))?;
            out.write_all(header)?;
            out.flush()?;
            if durable { out.get_ref().sync_all() } else { Ok(()) }
        };
        end().map_err(Error::io(&self.path, "write"))?;
        unfinished.publish(&self.path)?;
        Ok(None)
    }
}

/// A one- or two-dimensional array written from front to back, its length known only at the end. Its file is removed on
/// failure.
#[derive(Debug)]
pub struct ArrayWriter<T> {
    bytes: ByteWriter,
    row: usize,
    item: std::marker::PhantomData<T>,
}

impl<T: Item> ArrayWriter<T> {
    /// Starts `path.partial`; rows have `row` scalars (1: a plain vector).
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn create(path: &Path, row: usize) -> Result<Self> {
        let (file, unfinished) = start_file(path)?;
        Ok(Self::of(path, Out::File(file, unfinished), row))
    }

    /// Starts an array in `buffer`, or, without one or beyond its size, in memory acquired as needed; it will be
    /// registered in `arrays` under the name of `path`.
    pub fn in_memory(path: &Path, row: usize, buffer: Option<AlignedBuffer>, arrays: Arc<InMemoryArrays>) -> Self {
        Self::of(path, Out::Memory(buffer, arrays), row)
    }

    fn of(path: &Path, out: Out, row: usize) -> Self {
        let bytes = ByteWriter { path: path.to_path_buf(), out, len: 0 };
        Self { bytes, row: row.max(1), item: std::marker::PhantomData }
    }

    /// Appends items.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn push(&mut self, items: &[T]) -> Result<()> {
        self.push_bytes(bytemuck::cast_slice(items))
    }

    /// Appends items given as their bytes, whatever their alignment.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn push_bytes(&mut self, bytes: &[u8]) -> Result<()> {
        self.bytes.push(bytes)
    }

    /// Number of items so far.
    pub fn len(&self) -> usize {
        self.bytes.len / size_of::<T>()
    }

    /// Writes the header, syncs where `durable`, and renames.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Parameter`] if the items do not fill rows.
    pub fn finish(self, durable: bool) -> Result<MappedSlice<T>> {
        let (items, path, row) = (self.len(), self.bytes.path.clone(), self.row);
        let scalars = items * T::WIDTH;
        if !scalars.is_multiple_of(row) {
            let problem = format!("{scalars} numbers do not make rows of {row}");
            return Err(Error::parameter("row", problem, "choose a length that divides them"));
        }
        let shape = if row == 1 { vec![items] } else { vec![scalars / row, row] };
        match self.bytes.finish(&header(T::DESCR, &shape), durable)? {
            Some(bytes) => bytes.slice(&path, 0, items),
            None => open(&path),
        }
    }
}

/// A `.npy` file whose items are of type `descr`, of `width` scalars each: its bytes, where the data begin, the number
/// of items, and the shape.
fn opened(path: &Path, descr: &str, width: usize) -> Result<(MappedBytes, usize, usize, Vec<u64>)> {
    let bytes = MappedBytes::open(path)?;
    let wrong =
        |problem: String| Error::malformed(path, "header", problem, "it is not an array of this program; recreate it");
    let header = npy_header::parse(&bytes).map_err(wrong)?;
    if header.descr != descr || header.fortran {
        return Err(wrong(format!("items are {}, expected '{descr}' in C order", header.descr)));
    }
    let (shape, offset) = (header.shape, header.data);
    let len = shape.iter().product::<u64>() as usize;
    if !len.is_multiple_of(width) {
        return Err(Error::malformed(path, "header", format!("shape {shape:?}"), "recreate the file"));
    }
    Ok((bytes, offset, len / width, shape))
}

/// Opens a `.npy` file as an array of any shape, flattened.
///
/// # Errors
/// [`Error::Io`], or [`Error::Malformed`] when it is not such an array or too short.
pub fn open<T: Item>(path: &Path) -> Result<MappedSlice<T>> {
    Ok(open_shaped(path)?.0)
}

/// Opens a `.npy` file and returns its shape as well.
///
/// # Errors
/// As [`open`].
pub fn open_shaped<T: Item>(path: &Path) -> Result<(MappedSlice<T>, Vec<u64>)> {
    let (bytes, offset, len, shape) = opened(path, T::DESCR, T::WIDTH)?;
    Ok((bytes.slice(path, offset, len)?, shape))
}

/// Writes a whole array from memory in rows of `row` numbers, by rename.
///
/// # Errors
/// [`Error::Io`]; [`Error::Parameter`] if the items do not fill rows.
pub fn write<T: Item>(path: &Path, items: &[T], row: usize, durable: bool) -> Result<MappedSlice<T>> {
    let mut writer = ArrayWriter::create(path, row)?;
    writer.push(items)?;
    writer.finish(durable)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Regression: on a full disk the beginning of an output was left.
    #[test]
    fn an_array_that_cannot_be_finished_leaves_no_file() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.npy");
        drop(ArrayWriter::<u32>::create(&path, 1).unwrap());
        assert!(!partial_name(&path).exists());
        std::fs::create_dir(&path).unwrap();
        assert!(write(&path, &[1u32], 1, true).is_err() && !partial_name(&path).exists());
    }

    /// Regression: the shape of a file was rounded down, so that readers left out its last numbers.
    #[test]
    fn rows_that_the_items_do_not_fill_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.npy");
        for row in [2, 4] {
            let refused = write(&path, &[1u32, 2, 3], row, false);
            assert!(matches!(refused, Err(Error::Parameter { .. })) && !path.exists(), "{row}");
        }
        assert!(!partial_name(&path).exists());
    }

    #[test]
    fn arrays_come_back_and_keep_their_shape() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.npy");
        let mut array = ArrayMut::<f32>::create(&path, &[2, 3]).unwrap();
        array.data().copy_from_slice(&[1., 2., 3., 4., 5., 6.]);
        assert!(!path.exists());
        assert_eq!(*array.finish(true).unwrap(), [1., 2., 3., 4., 5., 6.]);
        assert_eq!(open_shaped::<f32>(&path).unwrap().1, [2, 3]);
        assert!(open::<u32>(&path).is_err());
        let shape = |text: &str| {
            let mut bytes = header("<f4", &[1]);
            let at = bytes.windows(4).position(|four| four == b"(1,)").unwrap();
            bytes.splice(at..at + 4, text.bytes());
            bytes.truncate(HEADER - 1);
            bytes.extend([b'\n', 0, 0, 0, 0]);
            std::fs::write(&path, bytes).unwrap();
            open::<f32>(&path)
        };
        assert_eq!(shape("(1,)").unwrap().len(), 1);
        for text in ["(4611686018427387904, 8)", "(18446744073709551615,)", "(-1,)", "(2,)"] {
            assert!(shape(text).is_err(), "{text}");
        }
        write::<u64>(&path, &[], 1, false).unwrap();
        assert_eq!(open_shaped::<u64>(&path).unwrap().1, [0]);
    }

    #[test]
    fn a_header_that_does_not_parse_is_told_in_one_line() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.npy");
        write::<u32>(&path, &[1, 2, 3], 1, false).unwrap();
        let mut bytes = std::fs::read(&path).unwrap();
        bytes[40] = 0xa9;
        std::fs::write(&path, &bytes).unwrap();
        let error = open::<u32>(&path).unwrap_err().to_string();
        assert!(!error.contains('\n'), "{error}");
    }

    #[test]
    fn a_truncated_array_is_an_error() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.npy");
        write::<u32>(&path, &[1, 2, 3], 1, false).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        for len in [0, 5, 20, HEADER, bytes.len() - 1] {
            std::fs::write(&path, &bytes[..len]).unwrap();
            assert!(open::<u32>(&path).is_err(), "{len} bytes");
        }
    }
}
