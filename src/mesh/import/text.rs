//! Text meshes, read line by line: OBJ and OFF, with any line ending. Needs no memory.

use super::target::{CORRECT, Counts, Target, check};
use crate::base::printable::counted;
use crate::base::{Cancel, Error, Result};
use crate::mesh::ply::element::Scalar;
use crate::mesh::ply::header::{CUT_SHORT, shown};
use crate::mesh::ply::values::{integer_of, real_of};
use std::path::Path;

/// A line and its number.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line<'a> {
    /// From 1.
    pub number: u64,
    /// Without its line ending and without a comment.
    pub text: &'a [u8],
}

/// `bytes` without a byte-order mark.
pub(super) fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)
}

/// `text` without trailing zeros, or the DOS end-of-file character, that some programs append.
pub(super) fn without_padding(text: &[u8]) -> &[u8] {
    let end = text.iter().rposition(|byte| !matches!(byte, 0 | 0x1a)).map_or(0, |last| last + 1);
    &text[..end]
}

/// The words of a line: a backslash that joins it with the next one is a blank.
#[inline]
pub(crate) fn words(text: &[u8]) -> impl Iterator<Item = &[u8]> + Clone {
    text.split(|&byte| byte <= b' ' || byte == b'\\').filter(|word| !word.is_empty())
}

/// The lines that are not blank; `#` starts a comment ([`remark`]). With `joined`, as in OBJ, a backslash at the end,
/// before blanks if there are any, continues on the next line.
pub(super) struct Lines<'a> {
    rest: &'a [u8],
    number: u64,
    joined: bool,
}

impl<'a> Lines<'a> {
    /// The lines of `bytes`.
    pub(super) fn new(bytes: &'a [u8], joined: bool) -> Self {
        Self { rest: without_mark(bytes), number: 0, joined }
    }

    /// The end of the line, and the start of the next one.
    fn end(&self, from: usize) -> (usize, usize) {
        let rest = &self.rest[from..];
        let end = from + rest.iter().position(|&byte| byte == b'\n' || byte == b'\r').unwrap_or(rest.len());
        let crlf = self.rest[end..].starts_with(b"\r\n");
        (end, self.rest.len().min(end + if crlf { 2 } else { 1 }))
    }
}

/// Where a comment starts in a line. A `#` is no comment within numbers of Microsoft's library (`1.#INF`), nor,
/// `in_obj`, in names of materials and their libraries (`Material #2`), which go on to the end of the line.
#[inline]
fn remark(text: &[u8], in_obj: bool) -> Option<usize> {
    let mut from = 0;
    loop {
        let at = from + text[from..].iter().position(|&byte| byte == b'#')?;
        let in_number = text[..at].ends_with(b".") && text.get(at + 1).is_some_and(u8::is_ascii_uppercase);
        let front = text[..at].trim_ascii_start();
        if !in_number && !(in_obj && (front.starts_with(b"usemtl") || front.starts_with(b"mtllib"))) {
            return Some(at);
        }
        from = at + 1;
    }
}

impl<'a> Iterator for Lines<'a> {
    type Item = Line<'a>;

    #[inline]
    fn next(&mut self) -> Option<Line<'a>> {
        while !self.rest.is_empty() {
            self.number += 1;
            let number = self.number;
            let (mut from, (mut end, mut next)) = (0, self.end(0));
            // Blanks after the backslash cannot be seen in an editor.
            while self.joined && self.rest[from..end].trim_ascii_end().ends_with(b"\\") && next < self.rest.len() {
                from = next;
                (end, next) = self.end(next);
                self.number += 1;
            }
            let text = &self.rest[..end];
            self.rest = &self.rest[next..];
            let text = match text.first() {
                Some(b'#') => &[][..],
                // Most lines have no comment; look for one only if something follows the numbers.
                _ => remark(text, self.joined).map_or(text, |at| &text[..at]),
            }
            .trim_ascii();
            let text = without_padding(text).trim_ascii_end();
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
        words(self.text)
    }

    /// Parses the next three numbers of `words` as a position; further ones are ignored.
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

/// Wavefront OBJ: `v` and `f` lines; texture coordinates, normals, groups, materials, lines and points are ignored.
///
/// Negative vertex numbers count back from the current line. Curves and surfaces have no faces to cut.
pub(super) mod obj {
    use super::*;

    /// The first words of all statements; those of curves, surfaces and rendering are ignored.
    const KEYWORDS: [&[u8]; 37] = [
        b"v",
        b"vn",
        b"vt",
        b"vp",
        b"f",
        b"fo",
        b"l",
        b"p",
        b"o",
        b"g",
        b"s",
        b"mg",
        b"mtllib",
        b"usemtl",
        b"maplib",
        b"usemap",
        b"cstype",
        b"deg",
        b"bmat",
        b"step",
        b"curv",
        b"curv2",
        b"surf",
        b"parm",
        b"trim",
        b"hole",
        b"scrv",
        b"sp",
        b"con",
        b"end",
        b"lod",
        b"bevel",
        b"c_interp",
        b"d_interp",
        b"ctech",
        b"stech",
        b"call",
    ];

    /// Whether `word` begins a statement.
    pub(crate) fn is_keyword(word: &[u8]) -> bool {
        KEYWORDS.contains(&word)
    }

    /// Whether a statement that begins with `keyword` is a face: `fo` is its old name.
    #[inline]
    pub(crate) fn is_face(keyword: &[u8]) -> bool {
        keyword == b"f" || keyword == b"fo"
    }

    /// Counts the elements of the mesh.
    pub(crate) fn count(path: &Path, bytes: &[u8], cancel: &Cancel) -> Result<Counts> {
        let mut counts = Counts { double: true, ..Counts::default() };
        for line in Lines::new(bytes, true) {
            cancel.check()?;
            let mut words = line.words();
            match words.next() {
                Some(b"v") => counts.vertices += 1,
                Some(keyword) if is_face(keyword) => counts.face(words.count() as u64),
                _ => {}
            }
        }
        check(path, counts)?;
        Ok(counts)
    }

    /// Writes the mesh.
    pub(crate) fn convert(bytes: &[u8], target: &mut Target) -> Result<()> {
        target.counts = count(target.path, bytes, &target.run.cancel)?;
        target.header();
        for line in Lines::new(bytes, true) {
            let mut words = line.words();
            if words.next() == Some(b"v") {
                let place = line.place(words, Scalar::F64, target.path)?;
                target.vertex(place)?;
            }
        }
        let mut before = 0;
        for line in Lines::new(bytes, true) {
            let mut words = line.words();
            match words.next() {
                Some(b"v") => before += 1,
                Some(keyword) if is_face(keyword) => {
                    target.face(words.clone().count() as u64)?;
                    for word in words {
                        let number = word.split(|&byte| byte == b'/').next().unwrap_or(word);
                        let Some(shown) = integer_of(number) else {
                            return Err(line.wrong(target.path, &format!("{} is not a vertex's number", shown(word))));
                        };
                        let from_zero = match shown {
                            0 => None,
                            1.. => Some(shown - 1),
                            _ => Some(before + shown),
                        };
                        target.corner(from_zero, shown, line.number)?;
                    }
                }
                _ => {}
            }
        }
        Ok(())
    }
}

/// Text OFF: one vertex per line, then one face per line; colours, normals and texture coordinates are ignored.
///
/// The keyword may have the prefixes `C`, `N` or `ST`; the counts may be on its line. Binary files and points in four
/// or n dimensions are rejected.
pub(super) mod off {
    use super::*;

    /// Whether `word` is an OFF keyword, of any dimension.
    pub(crate) fn is_keyword(word: &[u8]) -> bool {
        let Some(front) = word.strip_suffix(b"OFF") else { return false };
        front.len() <= 5 && front.iter().all(|byte| b"STCN4n".contains(byte))
    }

    /// The lines after the counts, and the counts of vertices and faces.
    fn open<'a>(path: &Path, bytes: &'a [u8]) -> Result<(Lines<'a>, u64, u64)> {
        let mut lines = Lines::new(bytes, false);
        let missing = || Error::malformed(path, "header", "the numbers of vertices and faces are missing", CORRECT);
        let mut line = lines.next().ok_or_else(missing)?;
        let mut words: Vec<&[u8]> = line.words().take(4).collect();
        if words.first().is_some_and(|word| is_keyword(word)) {
            if words[0].contains(&b'4') || words[0].contains(&b'n') {
                let problem = format!("{} has points that are not three-dimensional", shown(words[0]));
                return Err(Error::unusable(path, problem, "export the mesh as plain OFF, OBJ or PLY"));
            }
            words.remove(0);
            if words.first().is_some_and(|word| word.eq_ignore_ascii_case(b"binary")) {
                return Err(Error::unusable(path, "is a binary OFF file", "export the mesh as text OFF, or as PLY"));
            }
            if words.is_empty() {
                line = lines.next().ok_or_else(missing)?;
                words = line.words().take(4).collect();
            }
        }
        let count = |k: usize| {
            let word = words.get(k).copied().ok_or_else(missing)?;
            let number = integer_of(word).and_then(|number| u64::try_from(number).ok());
            number.ok_or_else(|| line.wrong(path, &format!("{} is not a number of vertices or faces", shown(word))))
        };
        Ok((lines, count(0)?, count(1)?))
    }

    /// The next line; a missing one is an error.
    fn next<'a>(lines: &mut Lines<'a>, what: &str, k: u64, path: &Path) -> Result<Line<'a>> {
        let missing = || Error::malformed(path, format!("{what} {k}"), "the file ends here", CUT_SHORT);
        lines.next().ok_or_else(missing)
    }

    /// The number of corners of the face on `line`.
    fn corners(line: &Line, path: &Path) -> Result<u64> {
        let word = line.words().next().unwrap_or_default();
        let number = integer_of(word).and_then(|number| u64::try_from(number).ok());
        // A count above the number of bytes in the line must be wrong.
        let number = number.filter(|&number| number <= line.text.len() as u64);
        number.ok_or_else(|| line.wrong(path, &format!("{} is not a number of corners", shown(word))))
    }

    /// Counts the elements of the mesh.
    pub(crate) fn count(path: &Path, bytes: &[u8], cancel: &Cancel) -> Result<Counts> {
        let (mut lines, vertices, faces) = open(path, bytes)?;
        let mut counts = Counts { vertices, double: true, ..Counts::default() };
        check(path, counts)?;
        for k in 0..vertices {
            cancel.check()?;
            next(&mut lines, "vertex", k, path)?;
        }
        for k in 0..faces {
            cancel.check()?;
            let line = next(&mut lines, "face", k, path)?;
            counts.face(corners(&line, path)?);
        }
        Ok(counts)
    }

    /// Writes the mesh.
    pub(crate) fn convert(bytes: &[u8], target: &mut Target) -> Result<()> {
        let path = target.path;
        target.counts = count(path, bytes, &target.run.cancel)?;
        target.header();
        let (mut lines, vertices, faces) = open(path, bytes)?;
        for k in 0..vertices {
            let line = next(&mut lines, "vertex", k, path)?;
            target.vertex(line.place(line.words(), Scalar::F64, path)?)?;
        }
        for k in 0..faces {
            let line = next(&mut lines, "face", k, path)?;
            let size = corners(&line, path)?;
            target.face(size)?;
            let mut words = line.words().skip(1);
            for _ in 0..size {
                let short = || format!("a face of {} ends early", counted(size as usize, "corner"));
                let word = words.next().ok_or_else(|| line.wrong(path, &short()))?;
                let number = integer_of(word)
                    .ok_or_else(|| line.wrong(path, &format!("{} is not a vertex's number", shown(word))))?;
                target.corner(Some(number), number, line.number)?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blanks_may_follow_the_backslash_that_continues_a_line() {
        // Regression: the face ended at such a backslash, and the next line, its other corners, was ignored.
        let text = b"f 1 2 \\ \t\n3 4\nf 1 2\\\r\n  \r\nv 0 0 0\nf 1 2 \\ ";
        let lines = |joined| {
            let words = |line: Line| line.words().map(String::from_utf8_lossy).collect::<Vec<_>>().join(" ");
            Lines::new(text, joined).map(|line| (line.number, words(line))).collect::<Vec<_>>()
        };
        let joined = [(1, "f 1 2 3 4"), (3, "f 1 2"), (5, "v 0 0 0"), (6, "f 1 2")];
        assert_eq!(lines(true), joined.map(|(number, words)| (number, words.to_string())));
        assert_eq!(lines(false).len(), 5);
    }

    #[test]
    fn numbers_and_names_with_a_hash_are_no_remarks() {
        // Regression: the z of `v 0 0 -1.#IND` was -1, and `Material #1` and `Material #2` became one material.
        let text =
            b"v 1 2 -1.#IND # odd\nv 1.#INF 0 0\n# v\nv 3 2 1.# end\nusemtl Material #2\nmtllib a#b.mtl\nf 1 2 3#x\n";
        let lines =
            |joined| Lines::new(text, joined).map(|line| String::from_utf8_lossy(line.text)).collect::<Vec<_>>();
        let obj = ["v 1 2 -1.#IND", "v 1.#INF 0 0", "v 3 2 1.", "usemtl Material #2", "mtllib a#b.mtl", "f 1 2 3"];
        assert_eq!(lines(true), obj);
        assert_eq!(lines(false)[3..], ["usemtl Material", "mtllib a", "f 1 2 3"]);
        let first = Lines::new(text, true).next().unwrap();
        let place = first.place(first.words().skip(1), Scalar::F64, Path::new("x.obj")).unwrap();
        assert!(place[..2] == [1., 2.] && place[2].is_nan(), "{place:?}");
    }
}
