//! Writes the labelled file in parallel: if all face records have one size, every byte's position is known.
//!
//! Runs at the speed of the page cache; a thread buffers [`FACES`] faces.

use super::document::Document;
use super::element::Encoding;
use super::header::CUT_SHORT;
use super::labelling::{Labelling, PlyOptions, kept_properties};
use super::values::{Binary, Cursor};
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::{Error, Result};
use crate::mesh::geometry::Mesh;
use std::ops::Range;

/// Faces assembled at a time.
const FACES: usize = 1 << 15;
/// Bytes copied at a time.
const COPY: usize = 1 << 21;

/// The plan of a labelled file whose face records are all of one size and whose encoding is unchanged: the position of
/// every byte is known, so chunks are assembled and written in parallel.
pub(super) struct FixedRecords<'a> {
    document: &'a Document,
    labelling: &'a Labelling<'a>,
    /// Bytes of a face in the input, and the ranges of them that are kept.
    stride: usize,
    pieces: Vec<Range<usize>>,
    /// Bytes of a face in the output.
    size: usize,
    faces: usize,
    /// What to write, in file order, and the offset of each.
    jobs: Vec<(Job, u64)>,
    total: u64,
}

/// A part of the output.
enum Job {
    /// Bytes of the input, unchanged.
    Copy(Range<usize>),
    /// The chunk of faces of this number.
    Faces(usize),
}

impl<'a> FixedRecords<'a> {
    /// The header and the plan of the labelled file; `None` if record sizes or the encoding differ.
    ///
    /// # Errors
    /// [`Error::Malformed`] should the file have changed since it was opened.
    pub(super) fn plan(
        document: &'a Document,
        mesh: &Mesh,
        labelling: &'a Labelling<'a>,
        options: PlyOptions,
    ) -> Result<Option<(Vec<u8>, Self)>> {
        let encoding = document.header.encoding;
        if options.vertex_labels || options.split_faces || options.form.encoding(encoding) != encoding {
            return Ok(None);
        }
        let element = &document.header.elements[document.face];
        let Some(stride) = document.face_bytes.filter(|_| !document.strips) else { return Ok(None) };
        let start = document.ranges[document.face].start;
        let pieces = match encoding {
            Encoding::Ascii => return Ok(None),
            Encoding::Little => kept_ranges::<Binary<false>>(document, labelling, start),
            Encoding::Big => kept_ranges::<Binary<true>>(document, labelling, start),
        };
        let size = pieces.iter().map(Range::len).sum::<usize>() + labelling.size();
        let header = labelling.header(document, mesh, options, None);
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
    pub(super) fn total(&self) -> u64 {
        self.total
    }

    /// Number of parts.
    pub(super) fn jobs(&self) -> usize {
        self.jobs.len()
    }

    /// Part `k`: its offset in the output and its bytes, in `buffer` unless they are the input's.
    pub(super) fn part<'b>(&'b self, k: usize, buffer: &'b mut Vec<u8>) -> (u64, &'b [u8]) {
        let (job, place) = &self.jobs[k];
        match job {
            Job::Copy(range) => (*place, &self.document.bytes[range.clone()]),
            Job::Faces(chunk) => {
                self.assemble(chunk_range(self.faces, FACES, *chunk), buffer);
                (*place, buffer)
            }
        }
    }

    // A copy is a call that is not inlined, and these are few bytes.
    #[allow(clippy::manual_memcpy)]
    fn assemble(&self, faces: Range<usize>, buffer: &mut Vec<u8>) {
        let start = self.document.ranges[self.document.face].start;
        let records = &self.document.bytes[start + faces.start * self.stride..start + faces.end * self.stride];
        buffer.resize(faces.len() * self.size, 0);
        let big = self.document.header.encoding == Encoding::Big;
        let added = self.labelling.size();
        let pairs = buffer.chunks_exact_mut(self.size).zip(records.chunks_exact(self.stride));
        match self.pieces[..] {
            // Triangles without properties, or only with others that are kept, have specialised loops.
            [Range { start: 0, end: 13 }] if added == 11 && !big => {
                for (face, (to, from)) in faces.zip(pairs) {
                    let (to, from, added) = (&mut to[..24], &from[..13], self.labelling.packed(face, false));
                    for k in 0..13 {
                        to[k] = from[k];
                    }
                    for k in 0..11 {
                        to[13 + k] = added[k];
                    }
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

/// The ranges of a face's record that are kept, adjacent ones merged.
fn kept_ranges<'a, C: Cursor<'a>>(document: &'a Document, labelling: &Labelling, start: usize) -> Vec<Range<usize>> {
    let mut cursor = C::new(&document.bytes, start);
    let mut pieces: Vec<Range<usize>> = Vec::new();
    let properties = &document.header.elements[document.face].properties;
    for (property, kept) in properties.iter().zip(kept_properties(document, labelling)) {
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
