//! Opening a mesh file: PLY of any flavour, or OBJ, OFF, STL, which are converted to PLY first (`import`).
//!
//! The header is checked against the size of the file before anything is allocated or looped over. A binary
//! little-endian file of triangles is used in place (one verifying pass, no copy); anything else is decoded once into
//! arrays of the scratch folder; a compressed or streamed file is copied there first.

use super::geometry::{Mesh, check_size, empty, no_faces, too_many_vertices};
use super::import::{self, Format};
use super::ply::document::Document;
use super::ply::element::{Element, Kind};
use super::ply::header::{self, CUT_SHORT, Header};
use super::ply::read::{Decoder, decode};
use super::size::is_pipe;
use crate::base::printable::counted;
use crate::base::{Error, Result};
use crate::store::leftovers::{DECOMPRESSED, SPOOLED};
use crate::store::mapped::Access;
use crate::store::new_file::by_rename;
use crate::store::{MappedBytes, Run, private_folder};
use flate2::bufread::MultiGzDecoder;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::sync::Arc;

/// Bytes of a stream copied at a time.
const BUFFER: usize = 1 << 20;

impl Mesh {
    /// Opens the PLY, OBJ, OFF or STL file at `path`, optionally compressed with gzip. Arrays that have to be decoded
    /// go to a temporary folder of the system, which is removed with the mesh: some 24 bytes per vertex and 13 per
    /// triangle, nothing for a binary little-endian PLY of triangles. Use [`Mesh::open_under`] to follow the progress,
    /// and [`open()`] to choose the folder too.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # let dir = tempfile::tempdir()?;
    /// # let path = dir.path().join("triangle.obj");
    /// std::fs::write(&path, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")?;
    /// let mesh = nystrom_stream::mesh::Mesh::open(&path)?;
    /// assert_eq!(mesh.faces.with(0, |corners| corners.to_vec()), [0, 1, 2]);
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// As [`open()`].
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        Self::open_under(path, &Run::new(&()))
    }

    /// The same under `run`, which receives progress and can cancel.
    ///
    /// # Errors
    /// As [`open()`].
    pub fn open_under(path: impl AsRef<Path>, run: &Run) -> Result<Self> {
        let scratch = private_folder(&std::env::temp_dir())?;
        let mut mesh = open(path.as_ref(), scratch.path(), run)?;
        mesh._scratch = Some(Arc::new(scratch));
        Ok(mesh)
    }
}

/// Opens the PLY, OBJ, OFF or STL file at `path`, optionally compressed with gzip, or a named pipe. Arrays that have to
/// be decoded, and the uncompressed file, go to the folder `scratch`, which must outlive the result. Progress is
/// reported as stage `read`, in faces.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use nystrom_stream::{mesh, store::Run};
/// # let dir = tempfile::tempdir()?;
/// # let path = dir.path().join("square.off");
/// std::fs::write(&path, "OFF\n4 1 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n")?;
/// let mesh = mesh::open(&path, dir.path(), &Run::new(&()))?;
/// assert_eq!((mesh.positions.len(), mesh.faces.len(), mesh.faces.corner_count()), (4, 1, 4));
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// [`Error::Malformed`] or [`Error::Unusable`], in one line, for everything that is not a mesh with faces;
/// [`Error::Io`]; [`Error::Cancelled`].
pub fn open(path: &Path, scratch: &Path, run: &Run) -> Result<Mesh> {
    if is_pipe(path) {
        // A pipe cannot be mapped.
        return open_stream(Pipe::open(path)?, path, &scratch.join(SPOOLED), run);
    }
    open_bytes(path, MappedBytes::open(path)?, true, scratch, run)
}

/// A pipe or a terminal. A read that has waited for a tenth of a second returns `Interrupted`, so that the reader can
/// check whether the run was cancelled: a signal alone does not end the read.
#[derive(Debug)]
pub struct Pipe(pub File);

impl Pipe {
    /// Opens the pipe or device at `path`. Does not wait for a writer of a named pipe, which no signal would end:
    /// reading waits for it.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn open(path: &Path) -> Result<Self> {
        let opened = File::options().read(true).custom_flags(libc::O_NONBLOCK).open(path);
        opened.map(Self).map_err(Error::io(path, "open"))
    }
}

impl Read for Pipe {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let wait = Timespec { tv_sec: 0, tv_nsec: 100_000_000 };
        if poll(&mut [PollFd::new(&self.0, PollFlags::IN)], Some(&wait))? == 0 {
            return Err(ErrorKind::Interrupted.into());
        }
        self.0.read(buffer).map_err(|error| match error.kind() {
            // Another reader was faster.
            ErrorKind::WouldBlock => ErrorKind::Interrupted.into(),
            _ => error,
        })
    }
}

/// Opens a mesh file that arrives as a stream. It is first copied to the file `to`; decoded arrays lie beside it.
/// `name` stands for the path in messages. If the source is a [`Pipe`], reading stops when the run is cancelled.
///
/// # Errors
/// As [`open`].
pub fn open_reader(source: impl Read, name: &str, to: &Path, run: &Run) -> Result<Mesh> {
    open_stream(source, Path::new(name), to, run)
}

fn open_stream(mut source: impl Read, path: &Path, to: &Path, run: &Run) -> Result<Mesh> {
    let bytes = spool(path, &mut source, to, run)?;
    open_bytes(path, bytes, false, to.parent().unwrap_or(Path::new("")), run)
}

/// Opens the mesh in `bytes`. `is_file`: they are the file at `path` itself, not decompressed or streamed data.
fn open_bytes(path: &Path, bytes: MappedBytes, is_file: bool, scratch: &Path, run: &Run) -> Result<Mesh> {
    let compressed = import::is_compressed(&bytes);
    let bytes = if compressed { decompress(path, &bytes, scratch, run)? } else { bytes };
    if bytes.is_empty() {
        return Err(empty(path));
    }
    let mut notes = Vec::new();
    let (bytes, is_file) = match import::recognise(path, &bytes)? {
        Format::Ply => (bytes, is_file && !compressed),
        format => (import::convert(format, path, &bytes, scratch, &mut notes, run)?, false),
    };
    let header = header::parse(path, &bytes)?;
    header.check_counts(path, bytes.len())?;
    let (face, list, strips) = find_faces(path, &header)?;
    let (vertex, axes) = find_vertices(path, &header)?;
    let decoder = Decoder { path, scratch, run, header: &header, bytes: &bytes, vertex, axes, face, list, strips };
    let decoded = decode(&decoder)?;
    if decoded.faces.is_empty() {
        return Err(no_faces(path));
    }
    if strips {
        let faces = counted(decoded.faces.len(), "face");
        notes.push(format!("{}: triangle strips were expanded to {faces}", path.display()));
    }
    let end = decoded.ranges.last().map_or(header.payload, |range| range.end);
    let rest = bytes[end..].iter().take(1 << 16).any(|byte| !byte.is_ascii_whitespace());
    if rest {
        let rest = counted(bytes.len() - end, "byte");
        notes.push(format!("{}: ignored {rest} after the last element", path.display()));
    }
    bytes.advise(Access::Local);
    let (positions, faces, ranges, face_bytes) = (decoded.positions, decoded.faces, decoded.ranges, decoded.face_bytes);
    let path = path.to_path_buf();
    let document = Document { path, header, bytes, is_file, ranges, vertex, axes, face, list, strips, face_bytes };
    Ok(Mesh::with_source(positions, faces, document.path.clone(), Some(document), notes))
}

/// The vertex element and its x, y, z.
fn find_vertices(path: &Path, header: &Header) -> Result<(usize, [usize; 3])> {
    let wrong = |problem: &str| Error::malformed(path, "header", problem, "export the mesh again");
    let number = header.elements.iter().position(|element| element.is("vertex"));
    let number = number.ok_or_else(|| wrong("there is no vertex element"))?;
    let element = &header.elements[number];
    if u32::try_from(element.count).is_err() {
        return Err(too_many_vertices(path));
    }
    let axes = element.axes().ok_or_else(|| wrong("the vertices have no x, y and z"))?;
    Ok((number, axes))
}

/// The property that lists a face's vertices.
fn vertex_list(element: &Element) -> Option<usize> {
    let is_list =
        |number: &usize| matches!(element.properties[*number].kind, Kind::List { item, .. } if !item.is_real());
    let named = ["vertex_indices", "vertex_index"].iter().find_map(|name| element.find(name).filter(is_list));
    // A sole list of integers must be it, whatever its name.
    let mut lists = (0..element.properties.len()).filter(is_list);
    named.or_else(|| lists.next().filter(|_| lists.next().is_none()))
}

/// The element that holds the faces, its vertex list, and whether it holds triangle strips.
fn find_faces(path: &Path, header: &Header) -> Result<(usize, usize, bool)> {
    for (name, strips) in [("face", false), ("tristrips", true)] {
        let of_name = |element: &Element| element.is(name) && element.count > 0;
        let Some(number) = header.elements.iter().position(of_name) else { continue };
        let element = &header.elements[number];
        if !strips {
            // Assumes at least three corners per face.
            check_size(element.count as u64, (element.count as u64).saturating_mul(3), path)?;
        }
        let list = vertex_list(element).ok_or_else(|| {
            let problem = format!("the {name} element has no list vertex_indices or vertex_index of integers");
            Error::malformed(path, "header", problem, "export the mesh again")
        })?;
        return Ok((number, list, strips));
    }
    if header.elements.iter().any(|element| element.is("vertex")) {
        return Err(no_faces(path));
    }
    Err(Error::malformed(path, "header", "there is no vertex element and no face element", "export the mesh again"))
}

/// Writes all of `source` to the file `to`, by rename (an earlier one may still be mapped), and maps it. `path` names
/// the source in errors. A kilobyte of gzip can be a gigabyte of mesh, and the length of a stream is unknown, so a
/// sixteenth of the free disk space is left.
///
/// # Errors
/// [`Error::Io`], [`Error::Cancelled`]; [`Error::Malformed`] when compressed data are damaged; [`Error::Unusable`] for
/// more data than there is room for.
fn spool(path: &Path, source: &mut impl Read, to: &Path, run: &Run) -> Result<MappedBytes> {
    let free = to.parent().and_then(|folder| fs4::available_space(folder).ok()).unwrap_or(u64::MAX);
    by_rename(to, 0, false, |file| copy(path, source, (to, free - free / 16), file, run))?;
    MappedBytes::open(to)
}

/// Copies `source` to `file`, whose path is `to`, but no more than `room` bytes.
fn copy(path: &Path, source: &mut impl Read, (to, room): (&Path, u64), file: &mut File, run: &Run) -> Result<()> {
    let mut buffer = vec![0; BUFFER];
    let mut total = 0u64;
    loop {
        run.cancel.check()?;
        let count = match source.read(&mut buffer) {
            Ok(0) => return Ok(()),
            Ok(count) => count,
            Err(error) if error.kind() == ErrorKind::Interrupted => continue,
            // How flate2 reports data that are not gzip, damaged or cut short.
            Err(error)
                if matches!(
                    error.kind(),
                    ErrorKind::InvalidInput | ErrorKind::InvalidData | ErrorKind::UnexpectedEof
                ) =>
            {
                let place = format!("byte {total} of the uncompressed data");
                return Err(Error::malformed(path, place, format!("cannot be decompressed ({error})"), CUT_SHORT));
            }
            Err(error) => return Err(Error::io(path, "read")(error)),
        };
        total += count as u64;
        if total > room {
            let problem =
                format!("has more than {room} bytes uncompressed, which would fill the disk of {}", to.display());
            return Err(Error::unusable(
                path,
                problem,
                "choose a folder with more space with `temporary_folder` or `work_dir`",
            ));
        }
        file.write_all(&buffer[..count]).map_err(Error::io(to, "write"))?;
    }
}

/// Decompresses `bytes`, the content of `path`, into `scratch` and maps the result.
///
/// # Errors
/// As [`spool`].
fn decompress(path: &Path, bytes: &[u8], scratch: &Path, run: &Run) -> Result<MappedBytes> {
    spool(path, &mut MultiGzDecoder::new(bytes), &scratch.join(DECOMPRESSED), run)
}

#[cfg(test)]
mod tests {
    use super::*;
    use flate2::Compression;
    use flate2::write::GzEncoder;

    /// Regression: a few kilobytes of gzip filled the disk.
    #[test]
    fn compressed_data_may_not_outgrow_the_disk() {
        let dir = tempfile::tempdir().unwrap();
        let mut bomb = GzEncoder::new(Vec::new(), Compression::best());
        (0..64).for_each(|_| bomb.write_all(&[0; 1 << 20]).unwrap());
        let bomb = bomb.finish().unwrap();
        assert!(bomb.len() < 1 << 17);
        let to = dir.path().join("input.ply");
        let unpack = |room: u64| {
            let mut file = File::create(&to).unwrap();
            let source = &mut MultiGzDecoder::new(&bomb[..]);
            let copied = copy(Path::new("bomb.ply.gz"), source, (&to, room), &mut file, &Run::new(&()));
            (copied, file.metadata().unwrap().len())
        };
        let (refused, written) = unpack(10 << 20);
        let said = refused.unwrap_err().to_string();
        assert!(said.contains("bomb.ply.gz: has more than 10485760 bytes") && written <= 10 << 20, "{said}");
        let (copied, written) = unpack(64 << 20);
        assert!(copied.is_ok() && written == 64 << 20);
    }
}
