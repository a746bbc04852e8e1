//! The mesh file in another order: faces at their places, vertices at their numbers, everything else kept.
//!
//! Records of the two elements are cut into pieces of 16 bytes, which an external sort by place brings in order,
//! whatever their sizes and encodings; corners, and the ends of an `edge` element, get the vertices' new numbers; other
//! elements are copied. New numbers are looked up where they lie: 4 B a vertex that want to stay in memory where
//! the file's order is scattered. Cost: 24 B a piece through the sort, read and written once; 50–200 MB/s.

use super::cursor::{Binary, Cursor, Fault, Text};
use super::document::Document;
use super::encode::Encoder;
use super::header::{CUT_SHORT, Line};
use super::labelled::PlyForm;
use super::model::{Element, Encoding, Kind, Scalar};
use super::output::{Gather, by_rename};
use super::pieces;
use super::surface::Mesh;
use crate::base::{Error, Result};
use crate::store::Context;
use std::io::Write;
use std::path::Path;

/// Records between two looks at the stop flag; bytes copied at a time.
const CHUNK: usize = 1 << 14;
const COPY: usize = 1 << 22;
/// What is added with [`Rearrangement::original`].
const FACE: &str = "original_face";
const VERTEX: &str = "original_vertex";

/// A new order.
#[derive(Clone, Copy, Debug)]
pub struct Rearrangement<'a> {
    /// The place of each face (n): a permutation.
    pub places: &'a [u32],
    /// The new number of each vertex (v): a permutation.
    pub numbers: &'a [u32],
    /// Whether faces and vertices get properties that tell their old numbers, `original_face` and `original_vertex`.
    pub original: bool,
}

/// Writes the rearranged file `out`, by rename. `mesh` and `document` come from the same [`super::open()`]; `out` may
/// be the input itself.
///
/// # Errors
/// [`Error::Parameter`] where the order does not fit the mesh; [`Error::Io`]; [`Error::Memory`]; [`Error::Cancelled`];
/// [`Error::Malformed`] should the input have changed since it was opened.
pub fn write(
    document: &Document,
    mesh: &Mesh,
    out: &Path,
    order: &Rearrangement,
    form: PlyForm,
    context: Context<'_>,
) -> Result<()> {
    by_rename(out, 0, false, |file| stream(document, mesh, out, file, order, form, context))
}

/// Writes the rearranged file to a stream, `name` in messages.
///
/// # Errors
/// As [`write()`].
pub fn write_to(
    document: &Document,
    mesh: &Mesh,
    name: &str,
    writer: &mut dyn Write,
    order: &Rearrangement,
    form: PlyForm,
    context: Context<'_>,
) -> Result<()> {
    stream(document, mesh, Path::new(name), writer, order, form, context)
}

fn stream(
    document: &Document,
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
    let target = form.encoding(document);
    let task = Task { document, mesh, order, encoder: Encoder { target }, context };
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

/// What becomes of an element.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Role {
    Faces,
    Vertices,
    /// Records that name vertices, where they stand.
    Edges,
    Other,
}

struct Task<'a> {
    document: &'a Document,
    mesh: &'a Mesh,
    order: &'a Rearrangement<'a>,
    encoder: Encoder,
    context: Context<'a>,
}

impl<'a> Task<'a> {
    fn role(&self, number: usize) -> Role {
        let elements = &self.document.header.elements;
        let vertices = elements.iter().position(|element| element.is("vertex"));
        let element = &elements[number];
        match number {
            _ if number == self.document.face => Role::Faces,
            _ if Some(number) == vertices => Role::Vertices,
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

    /// Which properties of an element stay.
    fn kept(&self, number: usize) -> Vec<bool> {
        let added = self.added(number);
        let stays =
            |(k, name): (usize, &str)| (number == self.document.face && k == self.document.list) || Some(name) != added;
        let names = self.document.header.elements[number].properties.iter().map(|property| property.name.as_str());
        names.enumerate().map(stays).collect()
    }

    fn header(&self) -> Vec<u8> {
        let (document, header) = (self.document, &self.document.header);
        let mut out = format!("ply\nformat {} 1.0\n", self.encoder.target.word());
        let mut bytes = Vec::new();
        let close = |out: &mut String, element: Option<usize>| {
            if let Some(name) = element.and_then(|number| self.added(number)) {
                *out += &format!("property uint {name}\n");
            }
        };
        let mut open = None;
        for line in &header.lines {
            match line {
                Line::Remark(text) => {
                    // A remark need not be Unicode.
                    bytes.append(&mut std::mem::take(&mut out).into_bytes());
                    bytes.extend_from_slice(text);
                    bytes.push(b'\n');
                }
                Line::Element(number) => {
                    close(&mut out, open);
                    open = Some(*number);
                    let element = &header.elements[*number];
                    let strips = *number == document.face && document.strips;
                    let (name, count) =
                        if strips { ("face", self.mesh.faces.len()) } else { (element.name.as_str(), element.count) };
                    out += &format!("element {name} {count}\n");
                    if strips {
                        out += "property list uchar int vertex_indices\n";
                    }
                }
                Line::Property(element, number) => {
                    let strips = *element == document.face && document.strips;
                    let property = &header.elements[*element].properties[*number];
                    if strips || !self.kept(*element)[*number] {
                        continue;
                    }
                    out += &match property.kind {
                        Kind::One(scalar) => format!("property {} {}\n", scalar.word(), property.name),
                        Kind::List { count, item } => {
                            format!("property list {} {} {}\n", count.word(), item.word(), property.name)
                        }
                    };
                }
            }
        }
        close(&mut out, open);
        bytes.append(&mut (out + "end_header\n").into_bytes());
        bytes
    }

    fn element<C: Cursor<'a>>(&self, number: usize, out: &mut Gather) -> Result<()> {
        let (document, role) = (self.document, self.role(number));
        let element = &document.header.elements[number];
        if role == Role::Faces && document.strips {
            let bytes = 16 * self.mesh.faces.len();
            return pieces::sorted(self.order.places, bytes, out, self.context, |push| self.strips(push));
        }
        if element.properties.is_empty() {
            return Ok(());
        }
        let places = match role {
            Role::Faces => self.order.places,
            Role::Vertices => self.order.numbers,
            Role::Other if self.encoder.target == document.header.encoding => return self.copy(number, out),
            Role::Edges | Role::Other => {
                return self.records::<C>(number, |_, bytes| {
                    out.buffer.extend_from_slice(bytes);
                    out.settle()
                });
            }
        };
        // Text of another encoding can be longer or shorter; only the number of buckets depends on it.
        let bytes = document.ranges[number].len().max(element.least_size() * element.count);
        let produce = |push: pieces::Push<'_>| self.records::<C>(number, |record, bytes| push(record, bytes));
        pieces::sorted(places, bytes, out, self.context, produce)
    }

    /// An element as it stands.
    fn copy(&self, number: usize, out: &mut Gather) -> Result<()> {
        let range = self.document.ranges[number].clone();
        for piece in self.document.bytes[range.clone()].chunks(COPY) {
            self.context.run.cancel.check()?;
            out.pass(piece)?;
        }
        if self.encoder.target == Encoding::Ascii && !range.is_empty() {
            out.buffer.push(b'\n');
        }
        Ok(())
    }

    /// The records of an element in the order of the file, as the output is to have them.
    fn records<C: Cursor<'a>>(&self, number: usize, mut each: impl FnMut(usize, &[u8]) -> Result<()>) -> Result<()> {
        let document = self.document;
        let element = &document.header.elements[number];
        let (role, kept, text) = (self.role(number), self.kept(number), self.encoder.target == Encoding::Ascii);
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
                moved.map_err(|fault| self.error(element, record, fault))?;
            }
            if self.added(number).is_some() {
                self.encoder.integer(Scalar::U32, record as i64, out);
            }
            if text {
                out.pop_if(|last| *last == b' ');
                out.push(b'\n');
            }
            each(record, &record_bytes)?;
        }
        Ok(())
    }

    /// The faces that strips became.
    fn strips(&self, push: &mut dyn FnMut(usize, &[u8]) -> Result<()>) -> Result<()> {
        let faces = self.mesh.faces.len();
        let (mut record, encoder) = (Vec::new(), self.encoder);
        for start in (0..faces).step_by(CHUNK) {
            self.context.run.cancel.check()?;
            let mut result = Ok(());
            self.mesh.faces.for_each(start..faces.min(start + CHUNK), |face, corners| {
                record.clear();
                encoder.integer(Scalar::U8, corners.len() as i64, &mut record);
                for &corner in corners {
                    encoder.integer(Scalar::I32, self.order.numbers[corner as usize].into(), &mut record);
                }
                if self.order.original {
                    encoder.integer(Scalar::U32, face as i64, &mut record);
                }
                if encoder.target == Encoding::Ascii {
                    record.pop_if(|last| *last == b' ');
                    record.push(b'\n');
                }
                if result.is_ok() {
                    result = push(face, &record);
                }
            });
            result?;
        }
        Ok(())
    }

    /// A list of corners, with the vertices' new numbers.
    fn corners<C: Cursor<'a>>(&self, cursor: &mut C, kind: Kind, out: &mut Vec<u8>) -> Result<(), Fault> {
        let Kind::List { count, item } = kind else { return Err(Fault::End) };
        let length = cursor.length(count)?;
        self.encoder.length(count, length, out)?;
        for _ in 0..length {
            let v = cursor.integer(item)?;
            let new = usize::try_from(v).ok().and_then(|v| self.order.numbers.get(v)).ok_or(Fault::End)?;
            self.encoder.integer(item, i64::from(*new), out);
        }
        Ok(())
    }

    /// An edge's end; what is no vertex stays as it is.
    fn end<C: Cursor<'a>>(&self, cursor: &mut C, kind: Kind, out: &mut Vec<u8>) -> Result<(), Fault> {
        let Kind::One(scalar) = kind else { return self.encoder.value(cursor, kind, out) };
        let v = cursor.integer(scalar)?;
        let new = usize::try_from(v).ok().and_then(|v| self.order.numbers.get(v)).map_or(v, |&new| i64::from(new));
        self.encoder.integer(scalar, new, out);
        Ok(())
    }

    fn error(&self, element: &Element, record: usize, fault: Fault) -> Error {
        let place = format!("{} {record}", element.name.escape_debug());
        match fault {
            Fault::Length(length) => Error::malformed(
                &self.document.path,
                place,
                format!("a list of {length} items is too long for the type of its count"),
                "write the mesh in the input's own encoding",
            ),
            _ => Error::malformed(&self.document.path, place, "the file changed while it was in use", CUT_SHORT),
        }
    }
}

/// Whether a property of an `edge` is an end of it.
fn names_vertex(property: &super::model::Property) -> bool {
    let integer = matches!(property.kind, Kind::One(scalar) if !scalar.is_real());
    integer && ["vertex1", "vertex2", "vertex_1", "vertex_2"].contains(&property.name.as_str())
}
