//! Lines of a text file and the words on them, whatever ends a line.

use super::CORRECT;
use crate::base::{Error, Result};
use crate::mesh::cursor::real_of;
use crate::mesh::header::shown;
use crate::mesh::model::Scalar;
use std::path::Path;

/// A line and its number.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line<'a> {
    /// From 1.
    pub number: u64,
    /// Without what ends it and without a remark.
    pub text: &'a [u8],
}

/// The lines that are not blank; `#` begins a remark. With `joined`, a backslash at the end goes on with the next line.
pub(super) struct Lines<'a> {
    rest: &'a [u8],
    number: u64,
    joined: bool,
}

impl<'a> Lines<'a> {
    /// The lines of `bytes`.
    pub(super) fn new(bytes: &'a [u8], joined: bool) -> Self {
        let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        Self { rest: bytes, number: 0, joined }
    }

    /// Where the line ends, and where the next begins.
    fn end(&self, from: usize) -> (usize, usize) {
        let rest = &self.rest[from..];
        let end = from + rest.iter().position(|&byte| byte == b'\n' || byte == b'\r').unwrap_or(rest.len());
        let crlf = self.rest[end..].starts_with(b"\r\n");
        (end, self.rest.len().min(end + if crlf { 2 } else { 1 }))
    }
}

impl<'a> Iterator for Lines<'a> {
    type Item = Line<'a>;

    #[inline]
    fn next(&mut self) -> Option<Line<'a>> {
        while !self.rest.is_empty() {
            self.number += 1;
            let number = self.number;
            let (mut end, mut next) = self.end(0);
            while self.joined && self.rest[..end].ends_with(b"\\") && next < self.rest.len() {
                (end, next) = self.end(next);
                self.number += 1;
            }
            let text = &self.rest[..end];
            self.rest = &self.rest[next..];
            let text = match text.first() {
                Some(b'#') => &[][..],
                // Most lines have no remark; only where numbers are followed by one is it looked for.
                _ => text.iter().position(|&byte| byte == b'#').map_or(text, |at| &text[..at]),
            }
            .trim_ascii();
            if !text.is_empty() {
                return Some(Line { number, text });
            }
        }
        None
    }
}

impl<'a> Line<'a> {
    /// Its words.
    #[inline]
    pub(super) fn words(&self) -> impl Iterator<Item = &'a [u8]> + Clone + use<'a> {
        self.text.split(|&byte| byte <= b' ' || byte == b'\\').filter(|word| !word.is_empty())
    }

    /// The next three numbers of `words`; more do not matter.
    pub(super) fn place(&self, mut words: impl Iterator<Item = &'a [u8]>, of: Scalar, path: &Path) -> Result<[f64; 3]> {
        let mut place = [0.; 3];
        for x in &mut place {
            let word = words.next().ok_or_else(|| self.wrong(path, "a vertex needs three coordinates"))?;
            let number = real_of(word, of);
            *x = number.ok_or_else(|| self.wrong(path, &format!("{} is not a number", shown(word))))?;
        }
        Ok(place)
    }

    /// An error on this line.
    pub(super) fn wrong(&self, path: &Path, problem: &str) -> Error {
        Error::malformed(path, format!("line {}", self.number), problem, CORRECT)
    }
}
