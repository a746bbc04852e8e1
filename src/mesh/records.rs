//! Writing the elements of a labelled file one after the other, for any encoding in and out.
//!
//! Elements that do not change are copied; faces are copied value by value with the added ones
//! behind; where the encoding changes every number is read and written anew. 50–200 MB/s; the
//! common case has a faster way (`fixed`).

use super::cursor::{Binary, Cursor, Fault, Text};
use super::document::Document;
use super::header::CUT_SHORT;
use super::labelling::{Labelling, VERTEX_LABEL, kept};
use super::model::{Encoding, Kind, Scalar};
use super::output::Gather;
use super::surface::Mesh;
use super::vertex_labels::VertexLabels;
use crate::base::{Error, Result};
use crate::store::Run;
use std::cell::RefCell;
use std::io::Write as _;

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
        for start in (0..faces).step_by(CHUNK) {
            self.run.cancel.check()?;
            self.mesh.faces.for_each(start..faces.min(start + CHUNK), |face, corners| {
                self.integer(Scalar::U8, corners.len() as i64, out);
                for &corner in corners {
                    self.integer(Scalar::I32, corner.into(), out);
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
        for record in 0..element.count {
            if record % CHUNK == 0 {
                self.run.cancel.check()?;
            }
            for (property, &kept) in element.properties.iter().zip(&kept) {
                let start = cursor.seek();
                let moved = if kept && !verbatim {
                    self.value(&mut cursor, property.kind, out)
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
                self.real(Scalar::F32, votes.borrow_mut().get(record)?.map_or(-1., f64::from), out);
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

    /// Reads a value and writes it in the target's encoding.
    fn value<'b, C: Cursor<'b>>(&self, cursor: &mut C, kind: Kind, out: &mut Gather) -> std::result::Result<(), Fault> {
        match kind {
            Kind::One(scalar) => self.number(cursor, scalar, out),
            Kind::List { count, item } => {
                let length = cursor.length(count)?;
                if length > count.greatest() && self.target != Encoding::Ascii {
                    return Err(Fault::Length(length as i64));
                }
                self.integer(count, length as i64, out);
                for _ in 0..length {
                    self.number(cursor, item, out)?;
                }
                Ok(())
            }
        }
    }

    #[inline]
    fn number<'b, C: Cursor<'b>>(
        &self,
        cursor: &mut C,
        of: Scalar,
        out: &mut Gather,
    ) -> std::result::Result<(), Fault> {
        if of.is_real() {
            self.real(of, cursor.real(of)?, out);
        } else {
            self.integer(of, cursor.integer(of)?, out);
        }
        Ok(())
    }

    /// Appends an integer in the target's encoding.
    #[inline]
    fn integer(&self, scalar: Scalar, value: i64, out: &mut Gather) {
        if self.target == Encoding::Ascii {
            out.decimal(value);
            out.buffer.push(b' ');
            return;
        }
        // Text may hold a number beyond its type; it keeps its low bits, as in C.
        let (all, size) = (value.to_le_bytes(), scalar.size());
        let start = out.buffer.len();
        out.buffer.extend_from_slice(&all[..size]);
        if self.target == Encoding::Big {
            out.buffer[start..].reverse();
        }
    }

    /// Appends a floating-point number in the target's encoding.
    fn real(&self, scalar: Scalar, value: f64, out: &mut Gather) {
        let start = out.buffer.len();
        // Writing into a Vec cannot fail.
        let _ = match (self.target, scalar) {
            (Encoding::Ascii, Scalar::F32) => write!(out.buffer, "{:?} ", value as f32),
            (Encoding::Ascii, _) => write!(out.buffer, "{value:?} "),
            (_, Scalar::F32) => out.buffer.write_all(&(value as f32).to_le_bytes()),
            _ => out.buffer.write_all(&value.to_le_bytes()),
        };
        if self.target == Encoding::Big {
            out.buffer[start..].reverse();
        }
    }
}
