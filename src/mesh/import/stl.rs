//! STL, text or binary: every triangle has three vertices of its own. The graph joins vertices at the same position.
//!
//! Normals and attributes are ignored. Binary files may begin with `solid` too; they are recognised by their size.

use super::target::{Counts, Target, check};
use super::text::{Lines, without_mark, without_padding};
use crate::base::printable::counted;
use crate::base::{Cancel, Error, Result};
use crate::mesh::ply::element::Scalar;
use crate::mesh::ply::header::CUT_SHORT;
use std::path::Path;

/// Bytes before the triangles of a binary file, and bytes per triangle.
const FRONT: usize = 84;
const RECORD: usize = 50;

/// The number of triangles stated in a binary file.
fn declared_triangles(bytes: &[u8]) -> Option<u64> {
    let count = bytes.get(80..FRONT)?.first_chunk::<4>()?;
    Some(u64::from(u32::from_le_bytes(*count)))
}

/// Whether the length of `bytes` agrees with the count in a binary header.
pub(super) fn has_binary_size(bytes: &[u8]) -> bool {
    declared_triangles(bytes)
        .is_some_and(|count| count > 0 && FRONT as u64 + RECORD as u64 * count == bytes.len() as u64)
}

/// Whether `bytes` are STL text.
pub(super) fn is_text(bytes: &[u8]) -> bool {
    let text = without_padding(without_mark(bytes));
    let solid = text.trim_ascii_start().get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid"));
    solid && !has_binary_size(bytes) && !text[..text.len().min(1 << 12)].contains(&0)
}

/// Counts the elements of the mesh.
pub(super) fn count(path: &Path, bytes: &[u8], cancel: &Cancel) -> Result<Counts> {
    Ok(examined(path, bytes, cancel)?.0)
}

/// The counts, and whether the file ends properly, as any binary file does.
fn examined(path: &Path, bytes: &[u8], cancel: &Cancel) -> Result<(Counts, bool)> {
    let (vertices, ended) = match is_text(bytes) {
        true => corners_of_text(path, bytes, cancel)?,
        false => (3 * triangles_of_binary(path, bytes)?, true),
    };
    let counts = Counts { vertices, faces: vertices / 3, corners: vertices, most: 3, double: false };
    check(path, counts)?;
    Ok((counts, ended))
}

fn triangles_of_binary(path: &Path, bytes: &[u8]) -> Result<u64> {
    let short = |problem: String| Error::malformed(path, "byte 80", problem, CUT_SHORT);
    let count = declared_triangles(bytes).ok_or_else(|| {
        short(format!("the number of triangles is missing: the file has {}", counted(bytes.len(), "byte")))
    })?;
    let size = FRONT as u64 + RECORD as u64 * count;
    if size > bytes.len() as u64 {
        let triangles =
            format!("{} {}", counted(count as usize, "triangle"), if count == 1 { "takes" } else { "take" });
        return Err(short(format!("{triangles} {size} bytes, but the file has {}", bytes.len())));
    }
    Ok(count)
}

/// Number of vertices in STL text, and whether it ends properly.
fn corners_of_text(path: &Path, bytes: &[u8], cancel: &Cancel) -> Result<(u64, bool)> {
    let (mut vertices, mut ended) = (0u64, false);
    for line in Lines::new(bytes, false) {
        cancel.check()?;
        let word = line.words().next().unwrap_or_default();
        if word.eq_ignore_ascii_case(b"vertex") {
            vertices += 1;
        } else if (word.eq_ignore_ascii_case(b"endloop") || word.eq_ignore_ascii_case(b"endfacet")) && vertices % 3 != 0
        {
            return Err(line.wrong(path, "a facet does not have three vertices"));
        }
        ended = word.eq_ignore_ascii_case(b"endsolid");
    }
    if vertices % 3 != 0 {
        return Err(Error::malformed(path, "end", "the file ends within a facet", CUT_SHORT));
    }
    Ok((vertices, ended))
}

/// Writes the mesh.
pub(super) fn convert(bytes: &[u8], target: &mut Target, notes: &mut Vec<String>) -> Result<()> {
    let path = target.path;
    let (counts, ended) = examined(path, bytes, &target.run.cancel)?;
    target.counts = counts;
    target.header();
    let faces = target.counts.faces;
    if is_text(bytes) {
        for line in Lines::new(bytes, false) {
            let mut words = line.words();
            if words.next().is_some_and(|word| word.eq_ignore_ascii_case(b"vertex")) {
                let place = line.place(words, Scalar::F32, path)?;
                place.iter().for_each(|&x| target.out.buffer.extend_from_slice(&(x as f32).to_le_bytes()));
                target.count_record()?;
            }
        }
        if !ended {
            notes.push(format!("{}: has no endsolid at its end; it may be cut short", path.display()));
        }
    } else {
        for record in bytes[FRONT..].chunks_exact(RECORD).take(faces as usize) {
            target.out.buffer.extend_from_slice(&record[12..48]);
            target.count_record()?;
        }
        let rest = bytes.len() as u64 - FRONT as u64 - RECORD as u64 * faces;
        if rest > 0 {
            let rest = counted(rest as usize, "byte");
            notes.push(format!("{}: ignored {rest} after the last triangle", path.display()));
        }
    }
    for face in 0..faces {
        target.face(3)?;
        (0..3).for_each(|k| target.out.buffer.extend_from_slice(&((3 * face + k) as u32).to_le_bytes()));
    }
    Ok(())
}
