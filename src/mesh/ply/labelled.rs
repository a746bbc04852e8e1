//! The labelled mesh file: the input with `int label`, `uchar red green blue` and `float quality`
//! on its faces, and everything else kept.
//!
//! Elements and properties of the input stay, in their order; face properties of the names above
//! are replaced; triangle strips become faces. A file whose faces are all of one size is put
//! together in parallel at the speed of the page cache ([`FixedRecords`]): a thread holds [`FACES`] faces. Any other
//! streams through one buffer at 50–200 MB/s ([`LabelledWriter`]). A mesh of arrays has no file to be kept; its
//! positions, faces and labels are written.

use super::document::Document;
use super::header::{CUT_SHORT, Encoding, Scalar};
use super::plain::{self, Column};
use super::values::{Binary, Cursor, Encoder, Text};
use super::vertex_labels::VertexLabels;
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::{Error, Result};
use crate::mesh::geometry::Mesh;
use crate::mesh::output::{Gather, by_rename};
use crate::store::Run;
use std::cell::RefCell;
use std::fs::File;
use std::io::Write;
use std::ops::Range;
use std::path::Path;

/// The encoding of a labelled file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PlyForm {
    /// The input's; kept text stays as it stands.
    #[default]
    Same,
    /// Little-endian.
    Binary,
    /// Text; floating-point numbers as short as they come back exactly.
    Ascii,
}

/// What a labelled file is to be, besides labelled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct PlyOptions {
    /// Its encoding.
    pub form: PlyForm,
    /// Whether each vertex gets the label that most faces around it have, as `float scalar_label` (-1 without faces):
    /// a scalar field in CloudCompare, which knows none of faces.
    pub vertex_labels: bool,
}

impl PlyOptions {
    /// A file of the encoding `form`, with labels of vertices where `vertex_labels`.
    pub fn new(form: PlyForm, vertex_labels: bool) -> Self {
        Self { form, vertex_labels }
    }
}

impl From<PlyForm> for PlyOptions {
    fn from(form: PlyForm) -> Self {
        Self { form, vertex_labels: false }
    }
}

impl PlyForm {
    /// The encoding of an output that may copy `input`.
    pub(super) fn encoding(self, input: Encoding) -> Encoding {
        match self {
            Self::Same => input,
            Self::Binary => Encoding::Little,
            Self::Ascii => Encoding::Ascii,
        }
    }
}

/// Writes the labelled file `out`, by rename, after syncing it to the disk where `durable`; `out` may be the file that
/// `mesh` was opened from.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use nystrom_stream::mesh::{Labelling, Mesh, PlyForm, write_labelled};
/// use nystrom_stream::store::Run;
/// # let dir = tempfile::tempdir()?;
/// # let out = dir.path().join("labelled.ply");
/// let mesh = Mesh::from_slices(&[[0f32, 0., 0.], [1., 0., 0.], [0., 1., 0.], [1., 1., 1.]], &[[0, 1, 2], [1, 3, 2]])?;
/// let labelling = Labelling { labels: &[0, 1], colours: &[[230, 159, 0], [86, 180, 233]], quality: None };
/// write_labelled(&mesh, &out, &labelling, PlyForm::Ascii, false, &Run::new(&()))?;
/// let text = std::fs::read_to_string(&out)?;
/// assert!(text.ends_with("3 0 1 2 0 230 159 0\n3 1 3 2 1 86 180 233\n"));
/// assert_eq!(Mesh::open(&out)?.face_property("label", &Run::new(&()))?, [0, 1]);
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// [`Error::Parameter`] when there is not one label (and one quality) for every face; [`Error::Io`];
/// [`Error::Cancelled`]; [`Error::Malformed`] should the input have changed since it was opened.
pub fn write_labelled(
    mesh: &Mesh,
    out: &Path,
    labelling: &Labelling,
    options: impl Into<PlyOptions>,
    durable: bool,
    run: &Run,
) -> Result<()> {
    check(labelling, mesh)?;
    let options = options.into();
    if cfg!(unix)
        && let Some(document) = mesh.document()
        && let Some((header, plan)) = FixedRecords::plan(document, mesh, labelling, options)?
    {
        return by_rename(out, plan.total(), durable, |file| {
            write_at(file, &header, 0, out)?;
            let write = |k: usize, buffer: &mut Vec<u8>| {
                let (place, bytes) = plan.part(k, buffer);
                write_at(file, bytes, place, out)
            };
            run.map_chunks(plan.jobs(), Vec::new, write).map(drop)
        });
    }
    by_rename(out, 0, durable, |file| stream(mesh, out, file, labelling, options, run))
}

/// Writes the labelled file to a stream, `name` in messages: standard output, a socket.
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
    check(labelling, mesh)?;
    stream(mesh, Path::new(name), writer, labelling, options.into(), run)
}

fn stream(
    mesh: &Mesh,
    path: &Path,
    writer: &mut dyn Write,
    labelling: &Labelling,
    options: PlyOptions,
    run: &Run,
) -> Result<()> {
    let Some(document) = mesh.document() else { return stream_arrays(mesh, path, writer, labelling, options, run) };
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
    let mut out = Gather::new(path, writer);
    out.pass(&labelling.header(document, mesh, options))?;
    let votes = options.vertex_labels.then(|| VertexLabels::new(mesh, labelling.labels, run)).transpose()?;
    let encoder = Encoder { target: options.form.encoding(document.header.encoding) };
    LabelledWriter { document, mesh, labelling, encoder, votes: votes.map(RefCell::new), run }.elements(&mut out)?;
    out.finish()
}

/// The labelled file of a mesh without a file.
fn stream_arrays(
    mesh: &Mesh,
    path: &Path,
    writer: &mut dyn Write,
    labelling: &Labelling,
    options: PlyOptions,
    run: &Run,
) -> Result<()> {
    let mut votes = options.vertex_labels.then(|| VertexLabels::new(mesh, labelling.labels, run)).transpose()?;
    let mut voted = Vec::new();
    if let Some(votes) = &mut votes {
        for v in 0..mesh.positions.len() {
            voted.push(votes.get(v)?.map_or(-1., f64::from));
        }
    }
    let vertices = votes.map(|_| Column::new(VERTEX_LABEL, Scalar::F32, |v| voted[v]));
    let mut faces = vec![Column::new("label", Scalar::I32, |face| labelling.labels[face].into())];
    faces.extend(plain::colours(|face| labelling.colour(face)));
    faces.extend(labelling.quality.map(|quality| Column::new("quality", Scalar::F32, |face| quality[face].into())));
    let target = options.form.encoding(Encoding::Little);
    plain::stream(path, writer, mesh, target, (vertices.as_slice(), &faces), run)
}

/// Refuses labels that do not fit the faces.
fn check(labelling: &Labelling, mesh: &Mesh) -> Result<()> {
    let faces = mesh.faces.len();
    let wrong = |name: &str, count: usize| {
        let problem = format!("{count} values for {faces} faces");
        Err(Error::parameter(name, problem, "give one for every face of the file"))
    };
    match labelling.quality {
        _ if labelling.labels.len() != faces => wrong("labels", labelling.labels.len()),
        Some(quality) if quality.len() != faces => wrong("quality", quality.len()),
        _ => Ok(()),
    }
}

fn write_at(file: &File, bytes: &[u8], place: u64, out: &Path) -> Result<()> {
    std::os::unix::fs::FileExt::write_all_at(file, bytes, place).map_err(Error::io(out, "write"))
}

/// Labels, colours and qualities of all faces, in file order.
#[derive(Clone, Copy, Debug)]
pub struct Labelling<'a> {
    /// One label per face.
    pub labels: &'a [u32],
    /// One colour (sRGB) per label; grey for labels beyond the last.
    pub colours: &'a [[u8; 3]],
    /// One quality per face, if there is one.
    pub quality: Option<&'a [f32]>,
}

/// The remark that says where labels come from.
const REMARK: &[u8] = b"comment labelled by nystrom-stream";
/// The colour of labels beyond the last colour.
const GREY: [u8; 3] = [128; 3];

impl Labelling<'_> {
    /// The colour of `face`: its label's, or grey.
    pub(crate) fn colour(&self, face: usize) -> [u8; 3] {
        self.colours.get(self.labels[face] as usize).copied().unwrap_or(GREY)
    }

    /// Names and types of the properties that a face gets.
    pub(crate) fn properties(&self) -> &'static [(&'static str, Scalar)] {
        let all: &[_; 5] = &[
            ("label", Scalar::I32),
            ("red", Scalar::U8),
            ("green", Scalar::U8),
            ("blue", Scalar::U8),
            ("quality", Scalar::F32),
        ];
        if self.quality.is_some() { all } else { &all[..4] }
    }

    /// Bytes that a binary face grows by.
    fn size(&self) -> usize {
        if self.quality.is_some() { 11 } else { 7 }
    }

    /// The added numbers of `face` as a binary file holds them; the first [`Labelling::size`]
    /// bytes count.
    #[inline]
    fn packed(&self, face: usize, big: bool) -> [u8; 11] {
        let (label, colour) = (self.labels[face], self.colour(face));
        let quality = self.quality.map_or(0.0, |quality| quality[face]);
        let (label, quality) = if big {
            (label.to_be_bytes(), quality.to_be_bytes())
        } else {
            (label.to_le_bytes(), quality.to_le_bytes())
        };
        let mut packed = [0; 11];
        packed[..4].copy_from_slice(&label);
        packed[4..7].copy_from_slice(&colour);
        packed[7..].copy_from_slice(&quality);
        packed
    }

    /// Appends the numbers of [`Labelling::properties`] of `face`.
    pub(crate) fn append(&self, face: usize, encoder: Encoder, out: &mut Vec<u8>) {
        encoder.integer(Scalar::I32, i64::from(self.labels[face] as i32), out);
        for part in self.colour(face) {
            encoder.integer(Scalar::U8, part.into(), out);
        }
        if let Some(quality) = self.quality {
            encoder.real(Scalar::F32, quality[face].into(), out);
        }
    }

    /// The header of the labelled file.
    fn header(&self, document: &Document, mesh: &Mesh, options: PlyOptions) -> Vec<u8> {
        let vertex = document.vertex().filter(|_| options.vertex_labels);
        let faces = kept(document, self);
        let stays = |element: usize, property: usize| match element {
            _ if element == document.face => faces[property],
            _ => vertex != Some(element) || document.header.elements[element].properties[property].name != VERTEX_LABEL,
        };
        let added = |element: usize| match element {
            _ if element == document.face => self.properties().to_vec(),
            _ if vertex == Some(element) => vec![(VERTEX_LABEL, Scalar::F32)],
            _ => Vec::new(),
        };
        let target = options.form.encoding(document.header.encoding);
        document.header_of_copy(target, mesh.faces.len(), Some(REMARK), stays, added)
    }
}

/// Which properties of the face element stay: all but those that are written anew.
fn kept(document: &Document, labelling: &Labelling) -> Vec<bool> {
    let properties = document.header.elements[document.face].properties.iter().enumerate();
    properties
        .map(|(number, property)| {
            number == document.list
                || !document.strips && labelling.properties().iter().all(|(name, _)| *name != property.name)
        })
        .collect()
}

/// The vertex property that CloudCompare shows as a scalar field called `label`.
const VERTEX_LABEL: &str = "scalar_label";

/// Records between two looks at the stop flag.
const CHUNK: usize = 1 << 14;

/// A labelled file being written one element after the other, for any encoding in and out: elements that do not change
/// are copied, faces value by value with the added ones behind.
struct LabelledWriter<'a> {
    document: &'a Document,
    mesh: &'a Mesh,
    labelling: &'a Labelling<'a>,
    encoder: Encoder,
    /// Labels of vertices, where they are wanted.
    votes: Option<RefCell<VertexLabels<'a>>>,
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
        let voted = document.vertex().filter(|_| self.votes.is_some());
        for number in 0..document.header.elements.len() {
            if number == document.face && document.strips {
                self.triangles(out)?;
            } else if number != document.face && voted != Some(number) && self.is_verbatim() {
                self.document.copy_element(number, out, self.run)?;
            } else {
                self.rewrite::<C>(number, out)?;
            }
        }
        Ok(())
    }

    /// Whether values that stay are copied byte by byte.
    fn is_verbatim(&self) -> bool {
        self.encoder.target == self.document.header.encoding
    }

    /// The faces that strips became.
    fn triangles(&self, out: &mut Gather) -> Result<()> {
        let faces = self.mesh.faces.len();
        let encoder = self.encoder;
        for start in (0..faces).step_by(CHUNK) {
            self.run.cancel.check()?;
            self.mesh.faces.for_each(start..faces.min(start + CHUNK), |face, corners| {
                encoder.integer(Scalar::U8, corners.len() as i64, &mut out.buffer);
                for &corner in corners {
                    encoder.integer(Scalar::I32, corner.into(), &mut out.buffer);
                }
                self.labelling.append(face, encoder, &mut out.buffer);
                encoder.end(&mut out.buffer);
            });
            out.settle()?;
        }
        Ok(())
    }

    /// An element value by value; the faces with what is added to them.
    fn rewrite<'b, C: Cursor<'b>>(&'b self, number: usize, out: &mut Gather) -> Result<()> {
        let document = self.document;
        let element = &document.header.elements[number];
        let is_face = number == document.face;
        let votes = self.votes.as_ref().filter(|_| document.vertex() == Some(number));
        let kept = match votes {
            _ if is_face => kept(document, self.labelling),
            Some(_) => element.properties.iter().map(|property| property.name != VERTEX_LABEL).collect(),
            None => vec![true; element.properties.len()],
        };
        if element.properties.is_empty() {
            return Ok(());
        }
        let bytes = &document.bytes[..document.ranges[number].end];
        let mut cursor = C::new(bytes, document.ranges[number].start);
        let (verbatim, encoder) = (self.is_verbatim(), self.encoder);
        for record in 0..element.count {
            if record % CHUNK == 0 {
                self.run.cancel.check()?;
            }
            for (property, &kept) in element.properties.iter().zip(&kept) {
                let start = cursor.seek();
                let moved = if kept && !verbatim {
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
                let label = votes.borrow_mut().get(record)?.map_or(-1., f64::from);
                encoder.real(Scalar::F32, label, &mut out.buffer);
            }
            encoder.end(&mut out.buffer);
            out.settle()?;
        }
        Ok(())
    }
}

/// Faces put together at a time.
const FACES: usize = 1 << 15;
/// Bytes copied at a time where records are of one size.
const COPY: usize = 1 << 21;

/// How to put a labelled file together where all face records are of one size and the encoding stays: every byte's
/// place is known, so that chunks are put together and written in parallel, at their places.
struct FixedRecords<'a> {
    document: &'a Document,
    labelling: &'a Labelling<'a>,
    /// Bytes of a face in the input, and those of them that stay.
    stride: usize,
    pieces: Vec<Range<usize>>,
    /// Bytes of a face in the output.
    size: usize,
    faces: usize,
    /// What to write, in file order, and where each begins.
    jobs: Vec<(Job, u64)>,
    total: u64,
}

/// A part of the output.
enum Job {
    /// Bytes of the input as they stand.
    Copy(Range<usize>),
    /// The chunk of faces of this number.
    Faces(usize),
}

impl<'a> FixedRecords<'a> {
    /// The header and the plan of the labelled file; `None` where records differ in size or in encoding.
    ///
    /// # Errors
    /// [`Error::Malformed`] should the file have changed since it was opened.
    fn plan(
        document: &'a Document,
        mesh: &Mesh,
        labelling: &'a Labelling<'a>,
        options: PlyOptions,
    ) -> Result<Option<(Vec<u8>, Self)>> {
        let encoding = document.header.encoding;
        if options.vertex_labels || options.form.encoding(encoding) != encoding {
            return Ok(None);
        }
        let element = &document.header.elements[document.face];
        let Some(stride) = document.face_bytes.filter(|_| !document.strips) else { return Ok(None) };
        let start = document.ranges[document.face].start;
        let pieces = match encoding {
            Encoding::Ascii => return Ok(None),
            Encoding::Little => stays::<Binary<false>>(document, labelling, start),
            Encoding::Big => stays::<Binary<true>>(document, labelling, start),
        };
        let size = pieces.iter().map(Range::len).sum::<usize>() + labelling.size();
        let header = labelling.header(document, mesh, options);
        let mut plan = Self {
            document,
            labelling,
            stride,
            pieces,
            size,
            faces: element.count,
            jobs: Vec::new(),
            total: header.len() as u64,
        };
        if plan.pieces.iter().any(|piece| piece.end > stride)
            || document.bytes.len() < start + stride.saturating_mul(element.count)
        {
            return Err(Error::malformed(&document.path, "faces", "the file changed while it was in use", CUT_SHORT));
        }
        for (number, range) in document.ranges.iter().enumerate() {
            let is_face = number == document.face;
            let (len, chunk) = if is_face { (element.count, FACES) } else { (range.len(), COPY) };
            for k in 0..chunk_count(len, chunk) {
                let part = chunk_range(len, chunk, k);
                let bytes = part.len() * if is_face { plan.size } else { 1 };
                let job =
                    if is_face { Job::Faces(k) } else { Job::Copy(range.start + part.start..range.start + part.end) };
                plan.jobs.push((job, plan.total));
                plan.total += bytes as u64;
            }
        }
        Ok(Some((header, plan)))
    }

    /// Bytes of the whole output, header included.
    fn total(&self) -> u64 {
        self.total
    }

    /// Number of parts.
    fn jobs(&self) -> usize {
        self.jobs.len()
    }

    /// Part `k`: its place in the output and its bytes, in `buffer` where they are not the input's.
    fn part<'b>(&'b self, k: usize, buffer: &'b mut Vec<u8>) -> (u64, &'b [u8]) {
        let (job, place) = &self.jobs[k];
        match job {
            Job::Copy(range) => (*place, &self.document.bytes[range.clone()]),
            Job::Faces(chunk) => {
                self.assemble(chunk_range(self.faces, FACES, *chunk), buffer);
                (*place, buffer)
            }
        }
    }

    fn assemble(&self, faces: Range<usize>, buffer: &mut Vec<u8>) {
        let start = self.document.ranges[self.document.face].start;
        let records = &self.document.bytes[start + faces.start * self.stride..start + faces.end * self.stride];
        buffer.resize(faces.len() * self.size, 0);
        let big = self.document.header.encoding == Encoding::Big;
        let added = self.labelling.size();
        let pairs = buffer.chunks_exact_mut(self.size).zip(records.chunks_exact(self.stride));
        match self.pieces[..] {
            // Triangles without properties, or with others of no concern, get loops of their own.
            [Range { start: 0, end: 13 }] if added == 11 && !big => {
                for (face, (to, from)) in faces.zip(pairs) {
                    to[..13].copy_from_slice(&from[..13]);
                    to[13..24].copy_from_slice(&self.labelling.packed(face, false));
                }
            }
            _ => {
                for (face, (to, from)) in faces.zip(pairs) {
                    let mut at = 0;
                    for piece in &self.pieces {
                        to[at..at + piece.len()].copy_from_slice(&from[piece.clone()]);
                        at += piece.len();
                    }
                    to[at..].copy_from_slice(&self.labelling.packed(face, big)[..added]);
                }
            }
        }
    }
}

/// The bytes of a face's record that stay, neighbours joined.
fn stays<'a, C: Cursor<'a>>(document: &'a Document, labelling: &Labelling, start: usize) -> Vec<Range<usize>> {
    let mut cursor = C::new(&document.bytes, start);
    let mut pieces: Vec<Range<usize>> = Vec::new();
    let properties = &document.header.elements[document.face].properties;
    for (property, kept) in properties.iter().zip(kept(document, labelling)) {
        let from = cursor.at() - start;
        if cursor.skip_value(property.kind).is_err() {
            break;
        }
        let to = cursor.at() - start;
        match pieces.last_mut() {
            Some(last) if kept && last.end == from => last.end = to,
            _ if kept => pieces.push(from..to),
            _ => {}
        }
    }
    pieces
}
