//! Writing the elements of a labelled file one after the other, for any encoding in and out.
//!
//! Elements that do not change are copied; faces are copied value by value with the added ones
//! behind; where the encoding changes every number is read and written anew. 50–200 MB/s; the
//! common case has a faster way (`fixed`).

use super::cursor::{Binary, Cursor, Fault, Text};
use super::document::Document;
use super::encode::Encoder;
use super::header::CUT_SHORT;
use super::labelling::{Labelling, VERTEX_LABEL, kept};
use super::model::{Encoding, Scalar};
use super::output::Gather;
use super::surface::Mesh;
use super::vertex_labels::VertexLabels;
use crate::base::{Error, Result};
use crate::store::Run;
use std::cell::RefCell;

/// Records between two looks at the stop flag; bytes copied at a time.
const CHUNK: usize = 1 << 14;
const PIECE: usize = 1 << 22;

/// A labelled file being written.
pub(super) struct Task<'a> {
    pub document: &'a Document,
    pub mesh: &'a Mesh,
    pub labelling: &'a Labelling<'a>,
    pub target: Encoding,
    /// Labels of vertices, where they are wanted.
    pub votes: Option<RefCell<VertexLabels<'a>>>,
    pub run: &'a Run<'a>,
}

impl Task<'_> {
    /// Writes all elements.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Cancelled`]; [`Error::Malformed`] should the file have changed since
    /// it was opened, or a list be too long for its count.
    pub(super) fn elements(&self, out: &mut Gather) -> Result<()> {
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
            } else if number != document.face && voted != Some(number) && self.target == document.header.encoding {
                self.copy(number, out)?;
            } else {
                self.rewrite::<C>(number, out)?;
            }
        }
        Ok(())
    }

    /// An element as it stands.
    fn copy(&self, number: usize, out: &mut Gather) -> Result<()> {
        let range = self.document.ranges[number].clone();
        for piece in self.document.bytes[range.clone()].chunks(PIECE) {
            self.run.cancel.check()?;
            out.pass(piece)?;
        }
        if self.target == Encoding::Ascii && !range.is_empty() {
            out.buffer.push(b'\n');
        }
        Ok(())
    }

    /// The faces that strips became.
    fn triangles(&self, out: &mut Gather) -> Result<()> {
        let faces = self.mesh.faces.len();
        let encoder = Encoder { target: self.target };
        for start in (0..faces).step_by(CHUNK) {
            self.run.cancel.check()?;
            self.mesh.faces.for_each(start..faces.min(start + CHUNK), |face, corners| {
                encoder.integer(Scalar::U8, corners.len() as i64, &mut out.buffer);
                for &corner in corners {
                    encoder.integer(Scalar::I32, corner.into(), &mut out.buffer);
                }
                self.labelling.append(face, self.target, out);
                if self.target == Encoding::Ascii {
                    out.buffer.push(b'\n');
                }
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
        let verbatim = self.target == document.header.encoding;
        let encoder = Encoder { target: self.target };
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
                moved.map_err(|fault| self.error(number, record, fault))?;
                if kept && verbatim {
                    out.buffer.extend_from_slice(&bytes[start..cursor.at()]);
                    if self.target == Encoding::Ascii {
                        out.buffer.push(b' ');
                    }
                }
            }
            if is_face {
                self.labelling.append(record, self.target, out);
            } else if let Some(votes) = votes {
                let label = votes.borrow_mut().get(record)?.map_or(-1., f64::from);
                encoder.real(Scalar::F32, label, &mut out.buffer);
            }
            if !is_face && self.target == Encoding::Ascii {
                out.buffer.pop_if(|last| *last == b' ');
            }
            if self.target == Encoding::Ascii {
                out.buffer.push(b'\n');
            }
            out.settle()?;
        }
        Ok(())
    }

    fn error(&self, number: usize, record: usize, fault: Fault) -> Error {
        let place = format!("{} {record}", self.document.header.elements[number].name.escape_debug());
        match fault {
            Fault::Length(length) => Error::malformed(
                &self.document.path,
                place,
                format!("a list of {length} items is too long for the type of its count"),
                "write the labels in the input's own encoding",
            ),
            _ => Error::malformed(&self.document.path, place, "the file changed while it was in use", CUT_SHORT),
        }
    }
}
