//! Writes the PLY that a file of another format is converted to.
//!
//! Records are streamed through one buffer.

use crate::base::{Error, Result};
use crate::mesh::geometry::too_many_vertices;
use crate::mesh::output::Gather;
use crate::mesh::ply::element::{Encoding, Scalar};
use crate::mesh::ply::header::HeaderWriter;
use crate::store::Run;
use std::path::Path;

/// The remedy for invalid text.
pub(super) const CORRECT: &str = "correct the file or export it again";
/// Records between two checks of the stop flag, and between two writes.
const CHUNK: usize = 1 << 12;

/// Element counts of a mesh.
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
    /// Whether coordinates are stored in 8 bytes.
    pub double: bool,
}

impl Counts {
    /// Bytes of the PLY that the mesh is converted to, and of what is decoded from that.
    pub fn bytes(&self) -> u64 {
        let vertices = if self.double { 24 } else { 12 } * self.vertices;
        let decoded = if self.corners == 3 * self.faces { 0 } else { 4 * self.corners + 8 * self.faces };
        vertices + self.faces + 4 * self.corners + decoded
    }

    pub(super) fn face(&mut self, corners: u64) {
        (self.faces, self.corners, self.most) = (self.faces + 1, self.corners + corners, self.most.max(corners));
    }
}

/// The PLY being written.
pub(super) struct Target<'a, 'g> {
    pub out: &'a mut Gather<'g>,
    pub run: &'a Run<'a>,
    pub path: &'a Path,
    pub counts: Counts,
    pub records: usize,
}

impl Target<'_, '_> {
    pub(super) fn header(&mut self) {
        let Counts { vertices, faces, .. } = self.counts;
        let mut header = HeaderWriter::new(Encoding::Little);
        header.element("vertex", vertices).positions(self.counts.double);
        header.element("face", faces).corners(Scalar::counting(self.counts.most), Scalar::numbering(vertices));
        self.out.buffer.append(&mut header.finish());
    }

    /// Counts a record; every so many it checks for cancellation and writes what is gathered.
    pub(super) fn count_record(&mut self) -> Result<()> {
        self.records += 1;
        if self.records.is_multiple_of(CHUNK) {
            self.run.cancel.check()?;
            self.out.flush_if_full()?;
        }
        Ok(())
    }

    pub(super) fn vertex(&mut self, place: [f64; 3]) -> Result<()> {
        place.iter().for_each(|x| self.out.buffer.extend_from_slice(&x.to_le_bytes()));
        self.count_record()
    }

    /// Begins a face of `corners` corners.
    pub(super) fn face(&mut self, corners: u64) -> Result<()> {
        match self.counts.most <= 255 {
            true => self.out.buffer.push(corners as u8),
            false => self.out.buffer.extend_from_slice(&(corners as u32).to_le_bytes()),
        }
        self.count_record()
    }

    /// Adds a corner to the current face: vertex `number` from 0, or an error that shows the number `shown` and the
    /// `line` of the file.
    pub(super) fn corner(&mut self, number: Option<i64>, shown: i64, line: u64) -> Result<()> {
        let vertices = self.counts.vertices;
        match number.and_then(|number| u64::try_from(number).ok()).filter(|&number| number < vertices) {
            Some(number) => {
                self.out.buffer.extend_from_slice(&(number as u32).to_le_bytes());
                if self.out.buffer.len() > 1 << 20 { self.out.flush_if_full() } else { Ok(()) }
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

/// Rejects more vertices than a face can index.
pub(super) fn check(path: &Path, counts: Counts) -> Result<()> {
    if u32::try_from(counts.vertices).is_err() {
        return Err(too_many_vertices(path));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Regression: an STL of more than 715 million triangles was refused: its vertices did not fit a signed number.
    #[test]
    fn all_vertices_that_a_mesh_may_have_can_be_numbered() {
        let path = Path::new("big.stl");
        let check = |vertices: u64| check(path, Counts { vertices, ..Counts::default() });
        assert_eq!([1 << 31, (1 << 31) + 1].map(Scalar::numbering), [Scalar::I32, Scalar::U32]);
        assert!(check(u64::from(u32::MAX)).is_ok());
        assert!(check(1 << 32).unwrap_err().to_string().contains("2^32"));
    }
}
