//! Numbers in the encoding of an output: read by a cursor in that of the input, written to a buffer.
//!
//! 5–50 ns a number; nothing is held.

use super::cursor::{Cursor, Fault};
use super::model::{Encoding, Kind, Scalar};
use std::io::Write as _;

/// A writer of numbers, each followed by a blank where they are text.
#[derive(Clone, Copy)]
pub(super) struct Encoder {
    pub target: Encoding,
}

impl Encoder {
    /// Reads a value and writes it.
    pub fn value<'b, C: Cursor<'b>>(self, cursor: &mut C, kind: Kind, out: &mut Vec<u8>) -> Result<(), Fault> {
        match kind {
            Kind::One(scalar) => self.number(cursor, scalar, out),
            Kind::List { count, item } => {
                let length = cursor.length(count)?;
                self.length(count, length, out)?;
                for _ in 0..length {
                    self.number(cursor, item, out)?;
                }
                Ok(())
            }
        }
    }

    /// Writes the length of a list, unless it is too long for its type.
    pub fn length(self, count: Scalar, length: u64, out: &mut Vec<u8>) -> Result<(), Fault> {
        if length > count.greatest() && self.target != Encoding::Ascii {
            return Err(Fault::Length(length as i64));
        }
        self.integer(count, length as i64, out);
        Ok(())
    }

    #[inline]
    fn number<'b, C: Cursor<'b>>(self, cursor: &mut C, of: Scalar, out: &mut Vec<u8>) -> Result<(), Fault> {
        if of.is_real() {
            self.real(of, cursor.real(of)?, out);
        } else {
            self.integer(of, cursor.integer(of)?, out);
        }
        Ok(())
    }

    /// Appends an integer.
    #[inline]
    pub fn integer(self, scalar: Scalar, value: i64, out: &mut Vec<u8>) {
        if self.target == Encoding::Ascii {
            out.extend_from_slice(itoa::Buffer::new().format(value).as_bytes());
            out.push(b' ');
            return;
        }
        // Text may hold a number beyond its type; it keeps its low bits, as in C.
        let (all, size) = (value.to_le_bytes(), scalar.size());
        let start = out.len();
        out.extend_from_slice(&all[..size]);
        if self.target == Encoding::Big {
            out[start..].reverse();
        }
    }

    /// Appends a floating-point number.
    pub fn real(self, scalar: Scalar, value: f64, out: &mut Vec<u8>) {
        let start = out.len();
        // Writing into a Vec cannot fail.
        let _ = match (self.target, scalar) {
            (Encoding::Ascii, Scalar::F32) => write!(out, "{:?} ", value as f32),
            (Encoding::Ascii, _) => write!(out, "{value:?} "),
            (_, Scalar::F32) => out.write_all(&(value as f32).to_le_bytes()),
            _ => out.write_all(&value.to_le_bytes()),
        };
        if self.target == Encoding::Big {
            out[start..].reverse();
        }
    }
}
