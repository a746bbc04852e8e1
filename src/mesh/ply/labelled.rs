//! The labelled mesh file: the input with `int label`, `uchar red green blue` and `float quality` on its faces, and
//! everything else kept.
//!
//! Elements and properties of the input stay, in their order; face properties of the names above are replaced; triangle
//! strips become faces. On request faces are split along smooth boundaries: the first piece of a face takes its place,
//! the others follow after all faces, and new vertices after all vertices. A file whose face records are all of one
//! size is written in parallel ([`FixedRecords`]). Any other is streamed through one buffer at 50–200 MB/s
//! ([`LabelledWriter`]). For a mesh from arrays, its positions, faces and labels are written.

use super::document::Document;
use super::element::{Encoding, Scalar};
use super::fixed_records::FixedRecords;
pub use super::labelling::{GREY, Labelling, PlyForm, PlyOptions, REPEATED, UNLABELLED, colour_of};
use super::labelling::{VERTEX_PROPERTIES, kept_properties, of_vertices};
use super::names;
use super::plain::{Column, PlainPly, colours};
use super::split_records::SplitRecords;
use super::split_vertices;
use super::values::{Binary, Cursor, Encoder, Text};
use super::vertex_labels::VertexLabels;
use crate::base::{Error, Result};
use crate::mesh::geometry::Mesh;
use crate::mesh::output::{Gather, publish};
use crate::mesh::split_faces::Piece;
use crate::store::Run;
use std::cell::RefCell;
use std::fs::File;
use std::io::Write;
use std::iter::Peekable;
use std::path::Path;

/// Writes the labelled file `out`, by rename; `out` may be the file that `mesh` was opened from.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use nystrom_stream::mesh::{Labelling, Mesh, PlyForm, write_labelled};
/// use nystrom_stream::store::Run;
/// # let dir = tempfile::tempdir()?;
/// # let out = dir.path().join("labelled.ply");
/// let mesh = Mesh::from_slices(&[[0f32, 0., 0.], [1., 0., 0.], [0., 1., 0.], [1., 1., 1.]], &[[0, 1, 2], [1, 3, 2]])?;
/// let colours = [[230, 159, 0], [86, 180, 233]];
/// let labelling = Labelling { labels: &[0, 1], colours: &colours, quality: None, names: &[], fine: None };
/// write_labelled(&mesh, &out, &labelling, PlyForm::Ascii, &Run::new(&()))?;
/// let text = std::fs::read_to_string(&out)?;
/// assert!(text.ends_with("3 0 1 2 0 230 159 0\n3 1 3 2 1 86 180 233\n"));
/// assert_eq!(Mesh::open(&out)?.face_property("label", &Run::new(&()))?, [0, 1]);
/// # Ok(())
/// # }
/// ```
///
/// [`Error::Parameter`] if there is not one label (and one quality) per face, and for labels beyond `i32`, or beyond
/// 2²⁴ if vertices have them too; [`Error::Io`]; [`Error::Cancelled`]; [`Error::Malformed`] if the input has changed
/// since it was opened.
pub fn write_labelled(
    mesh: &Mesh,
    out: &Path,
    labelling: &Labelling,
    options: impl Into<PlyOptions>,
    run: &Run,
) -> Result<()> {
    let file = LabelledFile { mesh, labelling, options: options.into(), run };
    file.check()?;
    if cfg!(unix)
        && !file.options.split_vertices
        && let Some(document) = mesh.document()
        && let Some((header, plan)) = FixedRecords::plan(document, mesh, labelling, file.options)?
    {
        return publish(out, plan.total(), |file| {
            write_at(file, &header, 0, out)?;
            let write = |k: usize, buffer: &mut Vec<u8>| {
                let (place, bytes) = plan.part(k, buffer);
                write_at(file, bytes, place, out)
            };
            run.map_chunks(plan.jobs(), Vec::new, write).map(drop)
        });
    }
    publish(out, 0, |writer| file.write(out, writer))
}

/// Writes the labelled file to a stream, such as standard output or a socket, called `name` in messages.
///
/// # Errors
/// As [`write_labelled`].
pub fn write_labelled_to(
    mesh: &Mesh,
    name: &str,
    writer: &mut dyn Write,
    labelling: &Labelling,
    options: impl Into<PlyOptions>,
    run: &Run,
) -> Result<()> {
    let file = LabelledFile { mesh, labelling, options: options.into(), run };
    file.check()?;
    file.write(Path::new(name), writer)
}

/// What to write, and how.
struct LabelledFile<'a> {
    mesh: &'a Mesh,
    labelling: &'a Labelling<'a>,
    options: PlyOptions,
    run: &'a Run<'a>,
}

impl LabelledFile<'_> {
    /// Writes the file to a stream, called `path` in messages.
    fn write(&self, path: &Path, writer: &mut dyn Write) -> Result<()> {
        let Self { mesh, labelling, options, run } = *self;
        if options.split_vertices {
            return split_vertices::stream(mesh, path, writer, labelling, options.form, run);
        }
        let Some(document) = mesh.document() else { return self.write_arrays(path, writer) };
        if let Some((header, plan)) = FixedRecords::plan(document, mesh, labelling, options)? {
            let mut out = Gather::new(path, writer);
            out.pass(&header)?;
            let mut buffer = Vec::new();
            for k in 0..plan.jobs() {
                run.cancel.check()?;
                out.pass(plan.part(k, &mut buffer).1)?;
            }
            return out.finish();
        }
        let split = options.split_faces.then(|| labelling.split(mesh, run)).transpose()?;
        let encoder = Encoder { target: options.form.encoding(document.header.encoding) };
        let split = split.as_ref().map(|split| SplitRecords { document, mesh, split, encoder, run });
        if let Some(records) = &split {
            records.check()?;
            records.split.tell(run);
        }
        let mut out = Gather::new(path, writer);
        out.pass(&labelling.header(document, mesh, options, split.as_ref().map(|records| records.split)))?;
        let votes = options.vertex_labels.then(|| VertexLabels::new(mesh, labelling.labels, run)).transpose()?;
        LabelledWriter { document, mesh, labelling, encoder, votes: votes.map(RefCell::new), split, run }
            .elements(&mut out)?;
        out.finish()
    }

    /// The same for a mesh without a file.
    fn write_arrays(&self, path: &Path, writer: &mut dyn Write) -> Result<()> {
        let Self { mesh, labelling, options, run } = *self;
        if options.split_faces {
            let split = labelling.split(mesh, run)?;
            split.tell(run);
            let whole = split.applied(mesh, labelling.labels, labelling.quality, run)?;
            let labelling = Labelling { labels: &whole.labels, quality: whole.quality.as_deref(), ..*labelling };
            let options = options.form.into();
            return LabelledFile { mesh: &whole.mesh, labelling: &labelling, options, run }.write_arrays(path, writer);
        }
        // Reserved first, since the tally takes all that is left.
        let held = if options.vertex_labels { mesh.positions.len() } else { 0 };
        let bytes = (held * size_of::<Option<u32>>()) as u64;
        let _grant = run.budget.take("labels of vertices", bytes, bytes)?;
        let mut voted = Vec::with_capacity(held);
        let mut votes = options.vertex_labels.then(|| VertexLabels::new(mesh, labelling.labels, run)).transpose()?;
        if let Some(votes) = &mut votes {
            for v in 0..held {
                voted.push(votes.get(v)?);
            }
        }
        let mut vertices = Vec::new();
        if votes.is_some() {
            let (name, scalar) = VERTEX_PROPERTIES[0];
            vertices.push(Column::new(name, scalar, |v| voted[v].map_or(-1., f64::from)));
            vertices.extend(colours(|v| labelling.colour_of(voted[v])));
        }
        let mut faces = vec![Column::new("label", Scalar::I32, |face| labelling.labels[face].into())];
        faces.extend(colours(|face| labelling.colour(face)));
        faces.extend(labelling.quality.map(|quality| Column::new("quality", Scalar::F32, |face| quality[face].into())));
        let target = options.form.encoding(Encoding::Little);
        let remarks = names::remarks(labelling.names);
        PlainPly { mesh, target, vertices: &vertices, faces: &faces, remarks: &remarks }.write(path, writer, run)
    }

    /// Rejects labels that do not match the faces, and conflicting options.
    fn check(&self) -> Result<()> {
        let Self { mesh, labelling, options, .. } = *self;
        if options.split_faces && (options.split_vertices || options.vertex_labels) {
            let problem = "cannot be combined with vertex labels or split vertices";
            return Err(Error::parameter("split_faces", problem, "choose one of them"));
        }
        labelling.fit(mesh.faces.len())?;
        labelling.fit_ply(options.vertex_labels || options.split_vertices)
    }
}

fn write_at(file: &File, bytes: &[u8], place: u64, out: &Path) -> Result<()> {
    std::os::unix::fs::FileExt::write_all_at(file, bytes, place).map_err(Error::io(out, "write"))
}

/// Records between two checks of the stop flag.
const CHUNK: usize = 1 << 14;

/// Writes a labelled file element by element, for any combination of encodings: unchanged elements are copied, faces
/// are written value by value with the added properties at the end.
struct LabelledWriter<'a> {
    document: &'a Document,
    mesh: &'a Mesh,
    labelling: &'a Labelling<'a>,
    encoder: Encoder,
    /// Labels of vertices, if requested.
    votes: Option<RefCell<VertexLabels<'a>>>,
    /// Faces in pieces, if requested.
    split: Option<SplitRecords<'a>>,
    run: &'a Run<'a>,
}

impl LabelledWriter<'_> {
    /// Writes all elements.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Cancelled`]; [`Error::Malformed`] should the file have changed since
    /// it was opened, or a list be too long for its count.
    fn elements(&self, out: &mut Gather) -> Result<()> {
        match self.document.header.encoding {
            Encoding::Ascii => self.all::<Text>(out),
            Encoding::Little => self.all::<Binary<false>>(out),
            Encoding::Big => self.all::<Binary<true>>(out),
        }
    }

    fn all<'b, C: Cursor<'b>>(&'b self, out: &mut Gather) -> Result<()> {
        let document = self.document;
        for number in 0..document.header.elements.len() {
            if number == document.face && document.strips {
                self.triangles(out)?;
            } else if number != document.face
                && !(number == document.vertex && self.votes.is_some())
                && self.is_verbatim()
            {
                self.document.copy_element(number, out, self.run)?;
            } else {
                self.rewrite::<C>(number, out)?;
            }
            if let Some(split) = self.split.as_ref().filter(|_| number == document.vertex) {
                split.vertices::<C>(number, out)?;
            }
        }
        Ok(())
    }

    /// Whether kept values are copied byte by byte.
    fn is_verbatim(&self) -> bool {
        self.encoder.target == self.document.header.encoding
    }

    /// Writes the triangles of strips.
    fn triangles(&self, out: &mut Gather) -> Result<()> {
        let faces = self.mesh.faces.len();
        let encoder = self.encoder;
        let vertices = self.split.as_ref().map_or(self.mesh.positions.len(), |split| split.split.vertex_count());
        let index = Scalar::numbering(vertices as u64);
        let mut changed = self.changed();
        let split = |piece: &Piece, out: &mut Gather| {
            let Some(split) = &self.split else { return };
            split.corners(piece, Scalar::U8, index, &mut out.buffer);
            self.labelling.append_piece(piece.face as usize, piece.label, encoder, &mut out.buffer);
            encoder.end(&mut out.buffer);
        };
        for start in (0..faces).step_by(CHUNK) {
            self.run.cancel.check()?;
            self.mesh.faces.for_each(start..faces.min(start + CHUNK), |face, corners| {
                if let Some(pieces) = changed.next_if(|pieces| pieces[0].face as usize == face) {
                    return split(&pieces[0], out);
                }
                encoder.integer(Scalar::U8, corners.len() as i64, &mut out.buffer);
                for &corner in corners {
                    encoder.integer(index, corner.into(), &mut out.buffer);
                }
                self.labelling.append(face, encoder, &mut out.buffer);
                encoder.end(&mut out.buffer);
            });
            out.flush_if_full()?;
        }
        for piece in self.changed().flat_map(|pieces| &pieces[1..]) {
            split(piece, out);
            out.flush_if_full()?;
        }
        Ok(())
    }

    /// The pieces of each face that is split or only changes its label.
    fn changed(&self) -> Peekable<impl Iterator<Item = &[Piece]>> {
        let pieces = self.split.as_ref().map_or(&[][..], |records| &records.split.pieces);
        pieces.chunk_by(|a, b| a.face == b.face).peekable()
    }

    /// Writes an element value by value; faces with their added properties.
    fn rewrite<'b, C: Cursor<'b>>(&'b self, number: usize, out: &mut Gather) -> Result<()> {
        let document = self.document;
        let element = &document.header.elements[number];
        let is_face = number == document.face;
        let votes = self.votes.as_ref().filter(|_| number == document.vertex);
        let kept = match votes {
            _ if is_face => kept_properties(document, self.labelling),
            Some(_) => element.properties.iter().map(|property| !of_vertices(&property.name)).collect(),
            None => vec![true; element.properties.len()],
        };
        if element.properties.is_empty() {
            return Ok(());
        }
        let bytes = &document.bytes[..document.ranges[number].end];
        let mut cursor = C::new(bytes, document.ranges[number].start);
        let (verbatim, encoder) = (self.is_verbatim(), self.encoder);
        let mut changed = self.changed();
        // Where the records of faces in several pieces begin.
        let mut places = Vec::new();
        let write_piece = |piece: &Piece, place: usize, out: &mut Gather| {
            let mut cursor = C::new(bytes, place);
            if let Some(split) = &self.split {
                split.piece(&mut cursor, piece, &kept, &mut out.buffer)?;
            }
            self.labelling.append_piece(piece.face as usize, piece.label, encoder, &mut out.buffer);
            encoder.end(&mut out.buffer);
            out.flush_if_full().map(|()| cursor)
        };
        for record in 0..element.count {
            if record % CHUNK == 0 {
                self.run.cancel.check()?;
            }
            if is_face && let Some(pieces) = changed.next_if(|pieces| pieces[0].face as usize == record) {
                places.push(cursor.seek());
                cursor = write_piece(&pieces[0], cursor.at(), out)?;
                continue;
            }
            for (k, (property, &kept)) in element.properties.iter().zip(&kept).enumerate() {
                let start = cursor.seek();
                let moved = if is_face && k == document.list && !verbatim {
                    encoder.vertices(&mut cursor, property.kind, Some, &mut out.buffer)
                } else if kept && !verbatim {
                    encoder.value(&mut cursor, property.kind, &mut out.buffer)
                } else {
                    cursor.skip_value(property.kind)
                };
                moved.map_err(|fault| document.changed(number, record, fault))?;
                if kept && verbatim {
                    out.buffer.extend_from_slice(&bytes[start..cursor.at()]);
                    if encoder.target == Encoding::Ascii {
                        out.buffer.push(b' ');
                    }
                }
            }
            if is_face {
                self.labelling.append(record, encoder, &mut out.buffer);
            } else if let Some(votes) = votes {
                self.labelling.append_vertex(votes.borrow_mut().get(record)?, encoder, &mut out.buffer);
            }
            encoder.end(&mut out.buffer);
            out.flush_if_full()?;
        }
        for (pieces, place) in self.changed().zip(places) {
            for piece in &pieces[1..] {
                write_piece(piece, place, out)?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Budget;

    #[test]
    fn labels_of_the_vertices_of_arrays_come_from_the_budget() {
        // Regression: another eight bytes per vertex were used beyond the budget.
        let points = vec![[0f32; 3]; 1 << 16];
        let mesh = Mesh::from_vecs(points, vec![[0, 1, 2]]).unwrap();
        let labelling = Labelling { labels: &[5], colours: &[], quality: None, names: &[], fine: None };
        let options = PlyOptions { vertex_labels: true, ..PlyOptions::default() };
        let written = |bytes: u64| {
            let (mut out, run) = (Vec::new(), Run { budget: Budget::new(bytes), ..Run::new(&()) });
            write_labelled_to(&mesh, "x.ply", &mut out, &labelling, options, &run).map(|()| out)
        };
        assert!(matches!(written(500_000), Err(Error::Memory { .. })));
        // The tally runs in several blocks here.
        assert_eq!(written(700_000).unwrap(), written(1 << 30).unwrap());
    }
}
