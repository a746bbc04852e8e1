//! The numbers of a payload, text or binary: a sequential reader, and a writer.
//!
//! A cursor moves over mapped bytes and allocates nothing; it is generic, so that each encoding gets its own compiled
//! loop: 2–5 ns per binary number, 15–30 ns per number in text. An encoder appends to a buffer, 5–50 ns per number.

use super::element::{Encoding, Kind, Scalar};
use super::header::{CUT_SHORT, shown};
use std::io::Write as _;

/// Why a number could not be read.
#[derive(Debug)]
pub(super) enum Fault {
    /// Unexpected end of the bytes.
    End,
    /// The text is not a number, or not of the property's type.
    Text(String),
    /// A list has a negative length.
    Length(i64),
}

impl Fault {
    /// The problem of an element of `declared` records that could not be read, and the remedy.
    pub(super) fn explained(self, declared: usize) -> (String, &'static str) {
        match self {
            Self::End => (format!("the file ends here, but {declared} were declared"), CUT_SHORT),
            Self::Text(text) => {
                (format!("{text} is not a number of the right type"), "correct the file or export it again")
            }
            Self::Length(length) => (format!("a list has {length} items"), "the file is damaged; get it again"),
        }
    }
}

/// A position in a payload.
pub(super) trait Cursor<'a> {
    /// A cursor at byte `at` of `bytes`.
    fn new(bytes: &'a [u8], at: usize) -> Self;
    /// The next number, as an integer.
    fn integer(&mut self, of: Scalar) -> Result<i64, Fault>;
    /// The next number, rounded to `of` where that is a floating-point type.
    fn real(&mut self, of: Scalar) -> Result<f64, Fault>;
    /// Skips `items` numbers.
    fn skip(&mut self, of: Scalar, items: u64) -> Result<(), Fault>;
    /// Moves to the first byte of the next number, and returns its offset.
    fn seek(&mut self) -> usize;
    /// The byte after the last number read.
    fn at(&self) -> usize;

    /// The length of a list.
    fn length(&mut self, of: Scalar) -> Result<u64, Fault> {
        let length = self.integer(of)?;
        u64::try_from(length).map_err(|_| Fault::Length(length))
    }

    /// Skips a property's value.
    fn skip_value(&mut self, kind: Kind) -> Result<(), Fault> {
        match kind {
            Kind::One(scalar) => self.skip(scalar, 1),
            Kind::List { count, item } => {
                let items = self.length(count)?;
                self.skip(item, items)
            }
        }
    }
}

/// Numbers as text, separated by any whitespace, including line breaks.
pub(super) struct Text<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Text<'a> {
    #[inline]
    fn token(&mut self) -> Result<&'a [u8], Fault> {
        let start = self.seek();
        let rest = &self.bytes[start..];
        let len = rest.iter().position(|&byte| byte <= b' ').unwrap_or(rest.len());
        self.at = start + len;
        if len == 0 { Err(Fault::End) } else { Ok(&rest[..len]) }
    }
}

/// Parses a floating-point number in any common notation.
#[inline]
pub(in crate::mesh) fn real_of(token: &[u8], of: Scalar) -> Option<f64> {
    let text = std::str::from_utf8(token).ok()?;
    let parsed = match of {
        // Parsed in its own type: rounding to f64 first could be off by one unit in the last place.
        Scalar::F32 => text.parse::<f32>().map(f64::from),
        _ => text.parse::<f64>(),
    };
    // Microsoft's run-time library wrote 1.#INF, -1.#IND and 1.#QNAN, others nan(…).
    parsed.ok().or_else(|| {
        let negative = text.starts_with('-');
        if text.contains("#INF") {
            Some(if negative { f64::NEG_INFINITY } else { f64::INFINITY })
        } else if text.contains('#') || text.trim_start_matches(['-', '+']).to_ascii_lowercase().starts_with("nan") {
            Some(f64::NAN)
        } else {
            None
        }
    })
}

/// Parses an integer, including ones written as `3.0` or `3e0`.
#[inline]
pub(in crate::mesh) fn integer_of(token: &[u8]) -> Option<i64> {
    let (negative, digits) = match token {
        [b'-', digits @ ..] => (true, digits),
        [b'+', digits @ ..] => (false, digits),
        digits => (false, digits),
    };
    let (mut value, mut are_digits) = (0i64, (1..=18).contains(&digits.len()));
    for &digit in if are_digits { digits } else { &[] } {
        are_digits &= digit.is_ascii_digit();
        value = value * 10 + i64::from(digit & 15);
    }
    if are_digits {
        return Some(if negative { -value } else { value });
    }
    let value = real_of(token, Scalar::F64)?;
    (value.fract() == 0.0 && value.abs() < 1e15).then_some(value as i64)
}

impl<'a> Cursor<'a> for Text<'a> {
    fn new(bytes: &'a [u8], at: usize) -> Self {
        Self { bytes, at: at.min(bytes.len()) }
    }

    #[inline]
    fn integer(&mut self, _: Scalar) -> Result<i64, Fault> {
        let token = self.token()?;
        integer_of(token).ok_or_else(|| Fault::Text(shown(token)))
    }

    #[inline]
    fn real(&mut self, of: Scalar) -> Result<f64, Fault> {
        let token = self.token()?;
        real_of(token, of).ok_or_else(|| Fault::Text(shown(token)))
    }

    fn skip(&mut self, _: Scalar, items: u64) -> Result<(), Fault> {
        for _ in 0..items {
            self.token()?;
        }
        Ok(())
    }

    #[inline]
    fn seek(&mut self) -> usize {
        while self.bytes.get(self.at).is_some_and(|&byte| byte <= b' ') {
            self.at += 1;
        }
        self.at
    }

    fn at(&self) -> usize {
        self.at
    }
}

/// Packed numbers, big-endian if `BIG`.
pub(super) struct Binary<'a, const BIG: bool> {
    bytes: &'a [u8],
    at: usize,
}

impl<const BIG: bool> Binary<'_, BIG> {
    #[inline]
    fn take<const N: usize>(&mut self) -> Result<[u8; N], Fault> {
        let bytes = self.bytes.get(self.at..).and_then(<[u8]>::first_chunk::<N>).ok_or(Fault::End)?;
        self.at += N;
        let mut bytes = *bytes;
        if BIG {
            bytes.reverse();
        }
        Ok(bytes)
    }
}

impl<'a, const BIG: bool> Cursor<'a> for Binary<'a, BIG> {
    fn new(bytes: &'a [u8], at: usize) -> Self {
        Self { bytes, at: at.min(bytes.len()) }
    }

    #[inline]
    fn integer(&mut self, of: Scalar) -> Result<i64, Fault> {
        Ok(match of {
            Scalar::I8 => i8::from_le_bytes(self.take()?).into(),
            Scalar::U8 => u8::from_le_bytes(self.take()?).into(),
            Scalar::I16 => i16::from_le_bytes(self.take()?).into(),
            Scalar::U16 => u16::from_le_bytes(self.take()?).into(),
            Scalar::I32 => i32::from_le_bytes(self.take()?).into(),
            Scalar::U32 => u32::from_le_bytes(self.take()?).into(),
            Scalar::F32 => f32::from_le_bytes(self.take()?) as i64,
            Scalar::F64 => f64::from_le_bytes(self.take()?) as i64,
        })
    }

    #[inline]
    fn real(&mut self, of: Scalar) -> Result<f64, Fault> {
        Ok(match of {
            Scalar::F32 => f32::from_le_bytes(self.take()?).into(),
            Scalar::F64 => f64::from_le_bytes(self.take()?),
            _ => self.integer(of)? as f64,
        })
    }

    #[inline]
    fn skip(&mut self, of: Scalar, items: u64) -> Result<(), Fault> {
        let left = (self.bytes.len() - self.at) as u64;
        let bytes = items.checked_mul(of.size() as u64).filter(|&bytes| bytes <= left).ok_or(Fault::End)?;
        self.at += bytes as usize;
        Ok(())
    }

    fn seek(&mut self) -> usize {
        self.at
    }

    fn at(&self) -> usize {
        self.at
    }
}

/// A writer of numbers, each followed by a blank where they are text.
#[derive(Clone, Copy, Debug)]
pub struct Encoder {
    /// The encoding of the output.
    pub target: Encoding,
}

impl Encoder {
    /// Copies a value.
    pub(super) fn value<'b, C: Cursor<'b>>(self, cursor: &mut C, kind: Kind, out: &mut Vec<u8>) -> Result<(), Fault> {
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

    /// Copies a list of vertices, renumbered by `new`. In binary, a number beyond its type is an error.
    pub(super) fn vertices<'b, C: Cursor<'b>>(
        self,
        cursor: &mut C,
        kind: Kind,
        new: impl Fn(i64) -> Option<i64>,
        out: &mut Vec<u8>,
    ) -> Result<(), Fault> {
        let Kind::List { count, item } = kind else { return Err(Fault::End) };
        let length = cursor.length(count)?;
        self.length(count, length, out)?;
        for _ in 0..length {
            let v = new(cursor.integer(item)?).ok_or(Fault::End)?;
            if v as u64 > item.greatest() && self.target != Encoding::Ascii {
                return Err(Fault::Text(format!("vertex {v}")));
            }
            self.integer(item, v, out);
        }
        Ok(())
    }

    /// Writes the length of a list; one too long for its type is an error.
    pub(super) fn length(self, count: Scalar, length: u64, out: &mut Vec<u8>) -> Result<(), Fault> {
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

    /// Appends an integer; one beyond its type wraps, as in C.
    #[inline]
    pub fn integer(self, scalar: Scalar, value: i64, out: &mut Vec<u8>) {
        if self.target == Encoding::Ascii {
            out.extend_from_slice(itoa::Buffer::new().format(value).as_bytes());
            out.push(b' ');
            return;
        }
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

    /// Appends a number of any type.
    pub fn scalar(self, scalar: Scalar, value: f64, out: &mut Vec<u8>) {
        if scalar.is_real() {
            self.real(scalar, value, out);
        } else {
            self.integer(scalar, scalar.saturated(value), out);
        }
    }

    /// Ends a record: in text, a line break replaces the last blank.
    #[inline]
    pub fn end(self, out: &mut Vec<u8>) {
        if self.target == Encoding::Ascii {
            out.pop_if(|last| *last == b' ');
            out.push(b'\n');
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_numbers_of_every_writer_are_read() {
        let mut text = Text::new(b" 1\t-2.5e-1\r\n3.0 nan -inf 1.#QNAN -1.#INF .5 +7 x", 0);
        assert_eq!(text.integer(Scalar::I32).unwrap(), 1);
        assert_eq!(text.real(Scalar::F32).unwrap(), -0.25);
        assert_eq!(text.integer(Scalar::U8).unwrap(), 3);
        assert!(text.real(Scalar::F32).unwrap().is_nan());
        assert_eq!(text.real(Scalar::F64).unwrap(), f64::NEG_INFINITY);
        assert!(text.real(Scalar::F64).unwrap().is_nan());
        assert_eq!(text.real(Scalar::F64).unwrap(), f64::NEG_INFINITY);
        assert_eq!(text.real(Scalar::F64).unwrap(), 0.5);
        assert_eq!(text.integer(Scalar::F64).unwrap(), 7);
        assert!(matches!(text.integer(Scalar::I8), Err(Fault::Text(_))));
        assert!(matches!(text.integer(Scalar::I8), Err(Fault::End)));
    }

    #[test]
    fn binary_numbers_of_both_orders_are_read() {
        let bytes = [1, 2, 0xff, 0x3f, 0x80, 0, 0];
        let mut big = Binary::<true>::new(&bytes, 0);
        assert_eq!(big.integer(Scalar::U16).unwrap(), 258);
        assert_eq!(big.integer(Scalar::I8).unwrap(), -1);
        assert_eq!(big.real(Scalar::F32).unwrap(), 1.0);
        assert!(matches!(big.integer(Scalar::U8), Err(Fault::End)));
        let mut little = Binary::<false>::new(&bytes, 0);
        assert_eq!(little.integer(Scalar::U16).unwrap(), 513);
        assert!(little.skip(Scalar::F64, u64::MAX).is_err());
    }

    #[test]
    fn numbers_are_cast_as_rust_casts_them() {
        let written = |target, scalar, value| {
            let mut out = Vec::new();
            Encoder { target }.scalar(scalar, value, &mut out);
            out
        };
        for value in [0., -1., 3.7, -3.7, 255., 256., 1e6, -1e6, 1e20, -1e20, f64::NAN, f64::INFINITY] {
            assert_eq!(written(Encoding::Little, Scalar::I8, value), (value as i8).to_le_bytes());
            assert_eq!(written(Encoding::Little, Scalar::U8, value), (value as u8).to_le_bytes());
            assert_eq!(written(Encoding::Big, Scalar::I16, value), (value as i16).to_be_bytes());
            assert_eq!(written(Encoding::Little, Scalar::U32, value), (value as u32).to_le_bytes());
            assert_eq!(written(Encoding::Little, Scalar::F32, value), (value as f32).to_le_bytes());
            assert_eq!(written(Encoding::Ascii, Scalar::I32, value), format!("{} ", value as i32).as_bytes());
        }
    }
}
