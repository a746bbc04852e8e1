//! Meshes that are no PLY: OBJ, OFF and STL become one, in the scratch folder.
//!
//! A file streams through one buffer into a binary PLY of double coordinates (of STL: floats, as it has them), which
//! is then read where it lies; so whatever holds for PLY holds for these too, and labels go out as PLY. Text is walked
//! three times, to count, for vertices and for faces: some 40 ns a number in all. On disk 24 bytes a vertex and 13 a triangle.

mod lines;
mod obj;
mod off;
mod recognise;
mod stl;

pub(super) use recognise::{Format, recognise};

use super::output::{Gather, by_rename};
use crate::base::{Error, Result};
use crate::store::{MappedBytes, Run};
use std::path::Path;

/// What to do about text that is wrong.
const CORRECT: &str = "correct the file or export it again";
/// Records between two looks at the stop flag, and between two writes.
const CHUNK: usize = 1 << 12;

/// What a mesh has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Vertices.
    pub vertices: u64,
    /// Faces.
    pub faces: u64,
    /// Corners of all faces.
    pub corners: u64,
    /// Corners of the largest face.
    pub most: u64,
    /// Whether coordinates will have 8 bytes.
    pub double: bool,
}

impl Counts {
    /// Bytes of the PLY that the mesh becomes, and of what is decoded from that.
    pub fn bytes(&self) -> u64 {
        let vertices = if self.double { 24 } else { 12 } * self.vertices;
        let decoded = if self.corners == 3 * self.faces { 0 } else { 4 * self.corners + 8 * self.faces };
        vertices + self.faces + 4 * self.corners + decoded
    }

    fn face(&mut self, corners: u64) {
        (self.faces, self.corners, self.most) = (self.faces + 1, self.corners + corners, self.most.max(corners));
    }
}

/// The PLY being written.
struct Target<'a, 'g> {
    out: &'a mut Gather<'g>,
    run: &'a Run<'a>,
    path: &'a Path,
    counts: Counts,
    records: usize,
}

impl Target<'_, '_> {
    fn header(&mut self) {
        let real = if self.counts.double { "double" } else { "float" };
        let count = if self.counts.most <= 255 { "uchar" } else { "uint" };
        let Counts { vertices, faces, .. } = self.counts;
        let text = format!(
            "ply\nformat binary_little_endian 1.0\nelement vertex {vertices}\nproperty {real} x\nproperty {real} y\n\
             property {real} z\nelement face {faces}\nproperty list {count} int vertex_indices\nend_header\n"
        );
        self.out.buffer.extend_from_slice(text.as_bytes());
    }

    /// To be called once a record.
    fn settle(&mut self) -> Result<()> {
        self.records += 1;
        if self.records.is_multiple_of(CHUNK) {
            self.run.cancel.check()?;
            self.out.settle()?;
        }
        Ok(())
    }

    fn vertex(&mut self, place: [f64; 3]) -> Result<()> {
        place.iter().for_each(|x| self.out.buffer.extend_from_slice(&x.to_le_bytes()));
        self.settle()
    }

    /// Begins a face of `corners` corners.
    fn face(&mut self, corners: u64) -> Result<()> {
        match self.counts.most <= 255 {
            true => self.out.buffer.push(corners as u8),
            false => self.out.buffer.extend_from_slice(&(corners as u32).to_le_bytes()),
        }
        self.settle()
    }

    /// The next corner of the face begun last, vertex `number` from 0, of which `there` have come; `line` of the file.
    fn corner(&mut self, number: Option<i64>, shown: i64, line: u64) -> Result<()> {
        let vertices = self.counts.vertices;
        match number.and_then(|number| u64::try_from(number).ok()).filter(|&number| number < vertices) {
            Some(number) => {
                self.out.buffer.extend_from_slice(&(number as u32).to_le_bytes());
                if self.out.buffer.len() > 1 << 20 { self.out.settle() } else { Ok(()) }
            }
            None => Err(Error::malformed(
                self.path,
                format!("line {line}"),
                format!("a face names vertex {shown}, but there are {vertices}"),
                "repair the mesh or export it again",
            )),
        }
    }
}

/// Refuses more vertices than a face can name.
fn check(path: &Path, counts: Counts) -> Result<()> {
    if counts.vertices > i32::MAX as u64 {
        return Err(Error::unusable(path, "has more than 2^31 vertices", "cut it into several meshes"));
    }
    Ok(())
}

/// Writes the mesh in `bytes`, the content of `path`, to `scratch` as PLY and maps that; oddities go to `notes`.
///
/// # Errors
/// [`Error::Malformed`] naming the line, or the byte, that is wrong; [`Error::Unusable`]; [`Error::Io`];
/// [`Error::Cancelled`].
pub(super) fn convert(
    format: Format,
    path: &Path,
    bytes: &[u8],
    scratch: &Path,
    notes: &mut Vec<String>,
    run: &Run,
) -> Result<MappedBytes> {
    let to = scratch.join("converted.ply");
    by_rename(&to, 0, false, |file| {
        let mut out = Gather::new(&to, file);
        let mut target = Target { out: &mut out, run, path, counts: Counts::default(), records: 0 };
        match format {
            Format::Obj => obj::convert(bytes, &mut target)?,
            Format::Off => off::convert(bytes, &mut target)?,
            Format::Stl => stl::convert(bytes, &mut target, notes)?,
            Format::Ply => target.out.pass(bytes)?,
        }
        out.finish()
    })?;
    MappedBytes::open(&to)
}

/// What the mesh in `bytes`, the content of `path`, has, by a walk over its text; none of a PLY, whose header tells.
///
/// # Errors
/// [`Error::Malformed`], [`Error::Unusable`].
pub fn count(path: &Path, bytes: &[u8]) -> Result<Option<Counts>> {
    Ok(match recognise(path, bytes)? {
        Format::Ply => None,
        Format::Obj => Some(obj::count(path, bytes)?),
        Format::Off => Some(off::count(path, bytes)?),
        Format::Stl => Some(stl::count(path, bytes)?),
    })
}

/// Whether `head`, the first bytes of `path`, are those of a PLY.
pub fn is_ply(path: &Path, head: &[u8]) -> bool {
    recognise(path, head).is_ok_and(|format| format == Format::Ply)
}
