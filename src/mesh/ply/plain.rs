//! Writes a mesh with custom numbers on its vertices and faces: labels, colours, whatever was carried over.
//!
//! Positions at full precision, faces, then the columns; other properties of the input are dropped (see
//! [`super::labelled`] for a writer that keeps them). One sequential pass through a buffer of one mebibyte.

use super::element::{Encoding, Scalar};
use super::header::HeaderWriter;
use super::values::Encoder;
use crate::base::Result;
use crate::mesh::geometry::{Faces, Mesh};
use crate::mesh::output::{Gather, publish};
use crate::store::Run;
use std::io::Write;
use std::path::Path;

/// Records between two checks of the stop flag.
const CHUNK: usize = 1 << 14;
/// The comment that names the program.
const REMARK: &str = "comment made by nystrom-stream";

/// One number per vertex or face.
pub struct Column<'a> {
    /// Name of the property.
    pub name: String,
    /// Its type in the file; values are cast to it.
    pub scalar: Scalar,
    /// The value of each record.
    pub value: Box<dyn Fn(usize) -> f64 + 'a>,
}

impl<'a> Column<'a> {
    /// The column `name` of numbers of type `scalar`: `value` of each record.
    pub fn new(name: impl Into<String>, scalar: Scalar, value: impl Fn(usize) -> f64 + 'a) -> Self {
        Self { name: name.into(), scalar, value: Box::new(value) }
    }
}

/// Red, green, blue as columns.
pub fn colours<'a>(colour: impl Fn(usize) -> [u8; 3] + Copy + 'a) -> Vec<Column<'a>> {
    let channel = |(k, name): (usize, &str)| Column::new(name, Scalar::U8, move |record| f64::from(colour(record)[k]));
    ["red", "green", "blue"].into_iter().enumerate().map(channel).collect()
}

/// Writes `mesh` with columns on its vertices and faces to `path`, little-endian, by rename.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub fn write_annotated(path: &Path, mesh: &Mesh, vertices: &[Column], faces: &[Column], run: &Run) -> Result<()> {
    let ply = PlainPly { mesh, target: Encoding::Little, vertices, faces, remarks: &[] };
    publish(path, 0, |file| ply.write(path, file, run))
}

/// The type of corner counts for `faces`.
pub(super) fn counting_corners(faces: &Faces) -> Scalar {
    Scalar::counting(match faces {
        Faces::Triangles { .. } => 3,
        Faces::Polygons { starts, .. } => starts.windows(2).map(|w| w[1] - w[0]).max().unwrap_or(0),
    })
}

/// A mesh with columns on its vertices and faces, as a file.
pub(super) struct PlainPly<'a> {
    pub mesh: &'a Mesh,
    pub target: Encoding,
    pub vertices: &'a [Column<'a>],
    pub faces: &'a [Column<'a>],
    /// Additional comments of the header.
    pub remarks: &'a [Vec<u8>],
}

impl PlainPly<'_> {
    /// Writes the file to a stream, called `path` in messages.
    pub(super) fn write(&self, path: &Path, writer: &mut dyn Write, run: &Run) -> Result<()> {
        let Self { mesh, target, vertices, faces, remarks } = *self;
        let (count, real) = (counting_corners(&mesh.faces), Scalar::coordinate(mesh.positions.is_double()));
        let (n, m) = (mesh.positions.len(), mesh.faces.len());
        let mut header = HeaderWriter::new(target);
        header.remark(REMARK);
        remarks.iter().for_each(|remark| _ = header.remark(remark));
        header.element("vertex", n as u64).positions(mesh.positions.is_double());
        vertices.iter().for_each(|column| _ = header.property(&column.name, column.scalar));
        header.element("face", m as u64).corners(count, Scalar::U32);
        faces.iter().for_each(|column| _ = header.property(&column.name, column.scalar));
        let encoder = Encoder { target };
        let mut out = Gather::new(path, writer);
        out.pass(&header.finish())?;
        for v in 0..n {
            if v % CHUNK == 0 {
                run.cancel.check()?;
            }
            mesh.positions.get(v as u32).into_iter().for_each(|x| encoder.real(real, x, &mut out.buffer));
            vertices.iter().for_each(|column| encoder.scalar(column.scalar, (column.value)(v), &mut out.buffer));
            encoder.end(&mut out.buffer);
            out.flush_if_full()?;
        }
        for start in (0..m).step_by(CHUNK) {
            run.cancel.check()?;
            mesh.faces.try_for_each(start..(start + CHUNK).min(m), |face, corners| {
                encoder.integer(count, corners.len() as i64, &mut out.buffer);
                corners.iter().for_each(|&v| encoder.integer(Scalar::U32, v.into(), &mut out.buffer));
                faces.iter().for_each(|column| encoder.scalar(column.scalar, (column.value)(face), &mut out.buffer));
                encoder.end(&mut out.buffer);
                out.flush_if_full()
            })?;
        }
        out.finish()
    }
}
