//! Writes the mesh file in another order: faces and vertices permuted, everything else kept.
//!
//! Records of the two elements are cut into pieces of 16 bytes, which an external sort by position puts in order,
//! whatever their sizes and encodings. Corners, and the ends of an `edge` element, are renumbered; other elements are
//! copied. New vertex numbers are random accesses into 4 bytes per vertex, which should stay in memory if the file's
//! order is scattered. Cost: 24 bytes per piece through the sort, written and read once where memory does not hold
//! them; 50–200 MB/s.

use super::document::{Document, Remarks};
use super::element::{Encoding, Kind, Property, Scalar};
use super::labelled::PlyForm;
use super::values::{Binary, Cursor, Encoder, Fault, Text};
use crate::base::{Error, Result};
use crate::mesh::geometry::Mesh;
use crate::mesh::output::{Gather, publish};
use crate::store::Context;
use crate::store::shuffle::{BudgetedShuffle, Producer};

use std::io::Write;
use std::path::Path;

/// Records between two checks of the stop flag.
const CHUNK: usize = 1 << 14;
/// The property added with [`Rearrangement::original`].
const FACE: &str = "original_face";
const VERTEX: &str = "original_vertex";

/// A new order of the faces and vertices of a mesh.
#[derive(Clone, Copy, Debug)]
pub struct Rearrangement<'a> {
    /// The new position of each face (n): a permutation.
    pub places: &'a [u32],
    /// The new number of each vertex (v): a permutation.
    pub numbers: &'a [u32],
    /// Whether faces and vertices get their old numbers as properties, `original_face` and `original_vertex`.
    pub original: bool,
}

/// Writes the rearranged file `out`, by rename; `out` may be the file that `mesh` was opened from.
///
/// # Errors
/// [`Error::Parameter`] if the order does not match the mesh; [`Error::Unusable`] for a mesh from arrays, which has no
/// file to rearrange; [`Error::Io`]; [`Error::Memory`]; [`Error::Cancelled`]; [`Error::Malformed`] if the input has
/// changed since it was opened.
pub fn write(mesh: &Mesh, out: &Path, order: &Rearrangement, form: PlyForm, context: Context<'_>) -> Result<()> {
    publish(out, 0, |file| stream(mesh, out, file, order, form, context))
}

/// Writes the rearranged file to a stream, called `name` in messages.
///
/// # Errors
/// As [`write()`].
pub fn write_to(
    mesh: &Mesh,
    name: &str,
    writer: &mut dyn Write,
    order: &Rearrangement,
    form: PlyForm,
    context: Context<'_>,
) -> Result<()> {
    stream(mesh, Path::new(name), writer, order, form, context)
}

fn stream(
    mesh: &Mesh,
    path: &Path,
    writer: &mut dyn Write,
    order: &Rearrangement,
    form: PlyForm,
    context: Context<'_>,
) -> Result<()> {
    let fit = |name: &str, given: usize, needed: usize| {
        let problem = format!("{given} numbers for {needed}");
        if given == needed { Ok(()) } else { Err(Error::parameter(name, problem, "give one for each")) }
    };
    fit("places", order.places.len(), mesh.faces.len())?;
    fit("numbers", order.numbers.len(), mesh.positions.len())?;
    let document = mesh.document().ok_or_else(|| {
        Error::unusable(
            mesh.path(),
            "was made from arrays: there is no file to rearrange",
            "write it and open that file",
        )
    })?;
    let encoder = Encoder { target: form.encoding(document.header.encoding) };
    let task = RearrangedWriter { document, mesh, order, encoder, context };
    let mut out = Gather::new(path, writer);
    out.pass(&task.header())?;
    for number in 0..document.header.elements.len() {
        match document.header.encoding {
            Encoding::Ascii => task.element::<Text>(number, &mut out)?,
            Encoding::Little => task.element::<Binary<false>>(number, &mut out)?,
            Encoding::Big => task.element::<Binary<true>>(number, &mut out)?,
        }
    }
    out.finish()
}

/// How an element is handled.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Role {
    Faces,
    Vertices,
    /// Records with vertex indices, in their order.
    Edges,
    Other,
}

struct RearrangedWriter<'a> {
    document: &'a Document,
    mesh: &'a Mesh,
    order: &'a Rearrangement<'a>,
    encoder: Encoder,
    context: Context<'a>,
}

impl<'a> RearrangedWriter<'a> {
    fn role(&self, number: usize) -> Role {
        let elements = &self.document.header.elements;
        let element = &elements[number];
        match number {
            _ if number == self.document.face => Role::Faces,
            _ if number == self.document.vertex => Role::Vertices,
            _ if element.is("edge") && element.properties.iter().any(names_vertex) => Role::Edges,
            _ => Role::Other,
        }
    }

    /// The property added to an element, if any.
    fn added(&self, number: usize) -> Option<&'static str> {
        match self.role(number) {
            Role::Faces if self.order.original => Some(FACE),
            Role::Vertices if self.order.original => Some(VERTEX),
            _ => None,
        }
    }

    /// Which properties of an element are kept.
    fn kept_properties(&self, number: usize) -> Vec<bool> {
        let added = self.added(number);
        let stays =
            |(k, name): (usize, &str)| (number == self.document.face && k == self.document.list) || Some(name) != added;
        let names = self.document.header.elements[number].properties.iter().map(|property| property.name.as_str());
        names.enumerate().map(stays).collect()
    }

    fn header(&self) -> Vec<u8> {
        let added = |element| self.added(element).map(|name| (name, Scalar::U32)).into_iter().collect();
        let kept = |element, property: usize| self.kept_properties(element)[property];
        let count = |element| self.document.count(element, self.mesh.faces.len());
        self.document.header_of_copy(self.encoder.target, count, Remarks::NONE, kept, added)
    }

    fn element<C: Cursor<'a>>(&self, number: usize, out: &mut Gather) -> Result<()> {
        let (document, role) = (self.document, self.role(number));
        let (element, path) = (&document.header.elements[number], &document.path);
        if role == Role::Faces && document.strips {
            let bytes = 16 * self.mesh.faces.len();
            return sorted(self.order.places, bytes, out, (path, self.context), &|push| self.strips(push));
        }
        if element.properties.is_empty() {
            return Ok(());
        }
        let places = match role {
            Role::Faces => self.order.places,
            Role::Vertices => self.order.numbers,
            Role::Other if self.encoder.target == document.header.encoding => {
                return document.copy_element(number, out, self.context.run);
            }
            Role::Edges | Role::Other => {
                return self.records::<C>(number, |_, bytes| {
                    out.buffer.extend_from_slice(bytes);
                    out.flush_if_full()
                });
            }
        };
        // Text in another encoding can be longer or shorter; this affects only the number of buckets.
        let bytes = document.ranges[number].len().max(element.least_size() * element.count);
        let produce = |push: Push<'_>| self.records::<C>(number, |record, bytes| push(record, bytes));
        sorted(places, bytes, out, (path, self.context), &produce)
    }

    /// The records of an element in file order, encoded for the output.
    fn records<C: Cursor<'a>>(&self, number: usize, mut each: impl FnMut(usize, &[u8]) -> Result<()>) -> Result<()> {
        let document = self.document;
        let element = &document.header.elements[number];
        let (role, kept, text) =
            (self.role(number), self.kept_properties(number), self.encoder.target == Encoding::Ascii);
        let bytes = &document.bytes[..document.ranges[number].end];
        let mut cursor = C::new(bytes, document.ranges[number].start);
        let verbatim = self.encoder.target == document.header.encoding;
        let mut record_bytes = Vec::new();
        for record in 0..element.count {
            if record % CHUNK == 0 {
                self.context.run.cancel.check()?;
            }
            record_bytes.clear();
            let out = &mut record_bytes;
            for (k, (property, &kept)) in element.properties.iter().zip(&kept).enumerate() {
                let start = cursor.seek();
                let moved = if role == Role::Faces && k == document.list {
                    self.corners(&mut cursor, property.kind, out)
                } else if role == Role::Edges && names_vertex(property) {
                    self.end(&mut cursor, property.kind, out)
                } else if kept && !verbatim {
                    self.encoder.value(&mut cursor, property.kind, out)
                } else {
                    let skipped = cursor.skip_value(property.kind);
                    if kept && skipped.is_ok() {
                        out.extend_from_slice(&bytes[start..cursor.at()]);
                        if text {
                            out.push(b' ');
                        }
                    }
                    skipped
                };
                moved.map_err(|fault| document.changed(number, record, fault))?;
            }
            if self.added(number).is_some() {
                self.encoder.integer(Scalar::U32, record as i64, out);
            }
            self.encoder.end(out);
            each(record, &record_bytes)?;
        }
        Ok(())
    }

    /// The triangles of strips.
    fn strips(&self, push: &mut dyn FnMut(usize, &[u8]) -> Result<()>) -> Result<()> {
        let faces = self.mesh.faces.len();
        let (mut record, encoder) = (Vec::new(), self.encoder);
        let index = Scalar::numbering(self.mesh.positions.len() as u64);
        for start in (0..faces).step_by(CHUNK) {
            self.context.run.cancel.check()?;
            self.mesh.faces.try_for_each(start..faces.min(start + CHUNK), |face, corners| {
                record.clear();
                encoder.integer(Scalar::U8, corners.len() as i64, &mut record);
                for &corner in corners {
                    encoder.integer(index, self.order.numbers[corner as usize].into(), &mut record);
                }
                if self.order.original {
                    encoder.integer(Scalar::U32, face as i64, &mut record);
                }
                encoder.end(&mut record);
                push(face, &record)
            })?;
        }
        Ok(())
    }

    /// Writes a list of corners with new vertex numbers.
    fn corners<C: Cursor<'a>>(&self, cursor: &mut C, kind: Kind, out: &mut Vec<u8>) -> Result<(), Fault> {
        let new = |v: i64| self.order.numbers.get(usize::try_from(v).ok()?).map(|&new| i64::from(new));
        self.encoder.vertices(cursor, kind, new, out)
    }

    /// Writes an end of an edge with its new number; an invalid index is kept.
    fn end<C: Cursor<'a>>(&self, cursor: &mut C, kind: Kind, out: &mut Vec<u8>) -> Result<(), Fault> {
        let Kind::One(scalar) = kind else { return self.encoder.value(cursor, kind, out) };
        let v = cursor.integer(scalar)?;
        let new = usize::try_from(v).ok().and_then(|v| self.order.numbers.get(v)).map_or(v, |&new| i64::from(new));
        if u64::try_from(new).is_ok_and(|new| new > scalar.greatest()) && self.encoder.target != Encoding::Ascii {
            return Err(Fault::Text(format!("vertex {new}")));
        }
        self.encoder.integer(scalar, new, out);
        Ok(())
    }
}

/// Whether a property of an `edge` element is a vertex index.
fn names_vertex(property: &Property) -> bool {
    let integer = matches!(property.kind, Kind::One(scalar) if !scalar.is_real());
    integer && ["vertex1", "vertex2", "vertex_1", "vertex_2"].contains(&property.name.as_str())
}

/// Record bytes in a piece: records are cut into pieces, each with its record's position and its own index, so that the
/// sort sees items of one size.
const PIECE: usize = 16;

/// Position, index of the piece · 32 + number of bytes, and the bytes.
type Piece = [u32; 2 + PIECE / 4];
/// The longest record: the number of a piece has 27 bits beside the 5 of its length.
const LONGEST: usize = PIECE << 27;

/// Receives records as they are made: number and bytes.
type Push<'a> = &'a mut dyn FnMut(usize, &[u8]) -> Result<()>;

/// Calls `produce` to make records of the mesh `path`, about `bytes` in all, and writes record r at position
/// `places[r]`.
fn sorted(
    places: &[u32],
    bytes: usize,
    out: &mut Gather,
    (path, Context { work, run }): (&Path, Context<'_>),
    produce: &dyn Fn(Push<'_>) -> Result<()>,
) -> Result<()> {
    let n = places.len().max(1);
    // Up to four sorted buckets per thread wait as bytes while another is sorted.
    let (pieces, copies) = ((bytes / PIECE + n) as u64, 6 * run.threads as u64);
    let sized = BudgetedShuffle::<Piece>::new(work.spill("pieces.tmp"), "records", pieces, copies, 1, run)?;
    let shuffle = &sized.shuffle;
    let mut producer: Producer<'_, Piece> = shuffle.producer();
    produce(&mut |record, bytes| {
        let place = places[record];
        let bucket = (u64::from(place) * shuffle.buckets() as u64 / n as u64) as usize;
        if bytes.len() > LONGEST {
            let problem = format!("record {record} of an element has {} bytes, too many to be sorted", bytes.len());
            return Err(Error::unusable(path, problem, "split its lists, or leave them out"));
        }
        for (k, part) in bytes.chunks(PIECE).enumerate() {
            let mut piece: Piece = [0; 2 + PIECE / 4];
            piece[..2].copy_from_slice(&[place, (k as u32) << 5 | part.len() as u32]);
            bytemuck::cast_slice_mut::<u32, u8>(&mut piece[2..])[..part.len()].copy_from_slice(part);
            producer.push(bucket, piece)?;
        }
        Ok(())
    })?;
    producer.finish()?;
    let sort = |bucket: usize, (): &mut ()| {
        let mut pieces = shuffle.take(bucket)?;
        pieces.sort_unstable_by_key(|piece| (piece[0], piece[1]));
        let mut bytes = Vec::with_capacity(PIECE * pieces.len());
        for piece in &pieces {
            bytes.extend_from_slice(&bytemuck::cast_slice::<u32, u8>(&piece[2..])[..piece[1] as usize & 31]);
        }
        Ok(bytes)
    };
    run.in_order(shuffle.buckets(), || (), sort, |_, bytes| out.pass(&bytes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::{Run, WorkDir};

    #[test]
    fn ends_of_edges_beyond_their_type_are_refused_instead_of_cut_off() {
        const VERTICES: u32 = 300;
        let dir = tempfile::tempdir().unwrap();
        let (path, out) = (dir.path().join("a.ply"), dir.path().join("b.ply"));
        let mut text = format!(
            "ply\nformat ascii 1.0\nelement vertex {VERTICES}\nproperty float x\nproperty float y\nproperty float z\n\
             element face 1\nproperty list uchar int vertex_indices\n\
             element edge 2\nproperty uchar vertex1\nproperty char vertex2\nend_header\n"
        );
        (0..VERTICES).for_each(|v| text += &format!("{v} {} 0\n", v % 2));
        std::fs::write(&path, text + "3 0 1 2\n0 1\n200 -1\n").unwrap();
        let run = Run::new(&());
        let work = WorkDir::temporary(dir.path()).unwrap();
        let mesh = Mesh::open(&path).unwrap();
        let written = |numbers: &[u32], form| {
            let order = Rearrangement { places: &[0], numbers, original: false };
            write(&mesh, &out, &order, form, Context::new(&work, &run)).map(|()| std::fs::read(&out).unwrap())
        };
        let turned: Vec<u32> = (0..VERTICES).rev().collect();
        let said = written(&turned, PlyForm::Binary).unwrap_err().to_string();
        assert!(said.contains("edge 0: vertex 299 does not fit the type"), "{said}");
        assert!(written(&turned, PlyForm::Ascii).unwrap().ends_with(b"299 298\n99 -1\n"));
        // Invalid indices are kept.
        let kept: Vec<u32> = (0..VERTICES).collect();
        assert!(written(&kept, PlyForm::Binary).unwrap().ends_with(&[0, 1, 200, 255]));
    }
}
