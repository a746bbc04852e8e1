//! A mesh written with numbers of our own on its vertices and faces: colours and whatever was carried over.
//!
//! Little-endian binary: positions as exact as they were, faces, then the columns; other properties of the input are
//! left behind (see [`super::labelled`] for a writer that keeps them). One sequential pass through a buffer of a mebibyte.

use super::model::Scalar;
use super::output::{Gather, by_rename};
use super::surface::{Faces, Mesh};
use crate::base::Result;
use crate::store::Run;
use std::path::Path;

/// Records between two looks at the stop flag.
const CHUNK: usize = 1 << 14;

/// A number a vertex or a face.
pub struct Column<'a> {
    /// Name of the property.
    pub name: String,
    /// Its type in the file; values are cast to it.
    pub scalar: Scalar,
    /// The value of each record.
    pub value: Box<dyn Fn(usize) -> f64 + 'a>,
}

impl Column<'_> {
    fn append(&self, record: usize, out: &mut Vec<u8>) {
        let value = (self.value)(record);
        match self.scalar {
            Scalar::I8 => out.extend((value as i8).to_le_bytes()),
            Scalar::U8 => out.extend((value as u8).to_le_bytes()),
            Scalar::I16 => out.extend((value as i16).to_le_bytes()),
            Scalar::U16 => out.extend((value as u16).to_le_bytes()),
            Scalar::I32 => out.extend((value as i32).to_le_bytes()),
            Scalar::U32 => out.extend((value as u32).to_le_bytes()),
            Scalar::F32 => out.extend((value as f32).to_le_bytes()),
            Scalar::F64 => out.extend(value.to_le_bytes()),
        }
    }
}

/// Red, green, blue as columns.
pub fn colours<'a>(colour: impl Fn(usize) -> [u8; 3] + Copy + 'a) -> Vec<Column<'a>> {
    let channel = |(k, name): (usize, &str)| Column {
        name: name.into(),
        scalar: Scalar::U8,
        value: Box::new(move |record| f64::from(colour(record)[k])),
    };
    ["red", "green", "blue"].into_iter().enumerate().map(channel).collect()
}

/// Writes `mesh` with columns on its vertices and faces to `path`, by rename.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub fn write_annotated(path: &Path, mesh: &Mesh, vertices: &[Column], faces: &[Column], run: &Run) -> Result<()> {
    let wide = mesh.positions.is_double();
    let largest = match &mesh.faces {
        Faces::Triangles { .. } => 3,
        Faces::Polygons { starts, .. } => starts.windows(2).map(|w| w[1] - w[0]).max().unwrap_or(0),
    };
    let (count, real) = (if largest < 256 { "uchar" } else { "uint" }, if wide { "double" } else { "float" });
    let (n, m) = (mesh.positions.len(), mesh.faces.len());
    let mut header = format!(
        "ply\nformat binary_little_endian 1.0\ncomment made by nystrom-stream\nelement vertex {n}\n\
         property {real} x\nproperty {real} y\nproperty {real} z\n"
    );
    let announce = |columns: &[Column]| -> String {
        columns.iter().map(|column| format!("property {} {}\n", column.scalar.word(), column.name)).collect()
    };
    header += &announce(vertices);
    header += &format!("element face {m}\nproperty list {count} uint vertex_indices\n{}end_header\n", announce(faces));
    by_rename(path, 0, true, |file| {
        let mut out = Gather::new(path, file);
        out.pass(header.as_bytes())?;
        for v in 0..n {
            if v % CHUNK == 0 {
                run.cancel.check()?;
            }
            for x in mesh.positions.get(v as u32) {
                if wide { out.buffer.extend(x.to_le_bytes()) } else { out.buffer.extend((x as f32).to_le_bytes()) }
            }
            vertices.iter().for_each(|column| column.append(v, &mut out.buffer));
            out.settle()?;
        }
        for start in (0..m).step_by(CHUNK) {
            run.cancel.check()?;
            let mut result = Ok(());
            mesh.faces.for_each(start..(start + CHUNK).min(m), |face, corners| {
                if largest < 256 {
                    out.buffer.push(corners.len() as u8);
                } else {
                    out.buffer.extend((corners.len() as u32).to_le_bytes());
                }
                corners.iter().for_each(|v| out.buffer.extend(v.to_le_bytes()));
                faces.iter().for_each(|column| column.append(face, &mut out.buffer));
                if result.is_ok() {
                    result = out.settle();
                }
            });
            result?;
        }
        out.finish()
    })
}
