//! OFF, of text: a vertex a line, then a face a line; colours, normals and texture coordinates are passed over.
//!
//! The keyword may carry `C`, `N`, `ST`; the counts may stand beside it. Binary files and points in four or n dimensions
//! are refused.

use super::lines::{Line, Lines};
use super::{CORRECT, Counts, Target, check};
use crate::base::{Error, Result};
use crate::mesh::cursor::integer_of;
use crate::mesh::header::{CUT_SHORT, shown};
use crate::mesh::model::Scalar;
use std::path::Path;

/// Whether `word` is a keyword of OFF, of any dimension.
pub(super) fn is_keyword(word: &[u8]) -> bool {
    let Some(front) = word.strip_suffix(b"OFF") else { return false };
    front.len() <= 5 && front.iter().all(|byte| b"STCN4n".contains(byte))
}

/// The lines after the counts, and what the header promises.
fn open<'a>(path: &Path, bytes: &'a [u8]) -> Result<(Lines<'a>, u64, u64)> {
    let mut lines = Lines::new(bytes, false);
    let missing = || Error::malformed(path, "header", "the numbers of vertices and faces are missing", CORRECT);
    let mut line = lines.next().ok_or_else(missing)?;
    let mut words: Vec<&[u8]> = line.words().take(4).collect();
    if is_keyword(words[0]) {
        if words[0].contains(&b'4') || words[0].contains(&b'n') {
            let problem = format!("{} has points in other than three dimensions", shown(words[0]));
            return Err(Error::unusable(path, problem, "export the mesh as plain OFF, OBJ or PLY"));
        }
        words.remove(0);
        if words.first().is_some_and(|word| word.eq_ignore_ascii_case(b"binary")) {
            return Err(Error::unusable(path, "is a binary OFF file", "export the mesh as OFF of text, or as PLY"));
        }
        if words.is_empty() {
            line = lines.next().ok_or_else(missing)?;
            words = line.words().take(4).collect();
        }
    }
    let count = |k: usize| {
        let word = words.get(k).copied().ok_or_else(missing)?;
        let number = integer_of(word).and_then(|number| u64::try_from(number).ok());
        number.ok_or_else(|| line.wrong(path, &format!("{} is no number of vertices or faces", shown(word))))
    };
    Ok((lines, count(0)?, count(1)?))
}

/// The next line, which must be there.
fn next<'a>(lines: &mut Lines<'a>, what: &str, k: u64, path: &Path) -> Result<Line<'a>> {
    let missing = || Error::malformed(path, format!("{what} {k}"), "the file ends here", CUT_SHORT);
    lines.next().ok_or_else(missing)
}

/// How many corners the face on `line` has.
fn corners(line: &Line, path: &Path) -> Result<u64> {
    let word = line.words().next().unwrap_or_default();
    let number = integer_of(word).and_then(|number| u64::try_from(number).ok());
    // More corners than the line has bytes: no need to look for them.
    let number = number.filter(|&number| number <= line.text.len() as u64);
    number.ok_or_else(|| line.wrong(path, &format!("{} is no number of corners that follow", shown(word))))
}

/// What the mesh has.
pub(super) fn count(path: &Path, bytes: &[u8]) -> Result<Counts> {
    let (mut lines, vertices, faces) = open(path, bytes)?;
    let mut counts = Counts { vertices, double: true, ..Counts::default() };
    check(path, counts)?;
    for k in 0..vertices {
        next(&mut lines, "vertex", k, path)?;
    }
    for k in 0..faces {
        let line = next(&mut lines, "face", k, path)?;
        counts.face(corners(&line, path)?);
    }
    Ok(counts)
}

/// Writes the mesh.
pub(super) fn convert(bytes: &[u8], target: &mut Target) -> Result<()> {
    let path = target.path;
    target.counts = count(path, bytes)?;
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
            let word = words.next().ok_or_else(|| line.wrong(path, &format!("a face of {size} corners ends early")))?;
            let number = integer_of(word)
                .ok_or_else(|| line.wrong(path, &format!("{} is not a vertex's number", shown(word))))?;
            target.corner(Some(number), number, line.number)?;
        }
    }
    Ok(())
}
