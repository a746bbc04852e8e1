//! Wavefront OBJ: `v` and `f` lines; texture coordinates, normals, groups, materials, lines and points are passed over.
//!
//! Negative numbers of vertices count back from the line they stand on. Curves and surfaces have no faces to cut.

use super::lines::Lines;
use super::{Counts, Target, check};
use crate::base::Result;
use crate::mesh::cursor::integer_of;
use crate::mesh::header::shown;
use crate::mesh::model::Scalar;
use std::path::Path;

/// What the mesh has.
pub(super) fn count(path: &Path, bytes: &[u8]) -> Result<Counts> {
    let mut counts = Counts { double: true, ..Counts::default() };
    for line in Lines::new(bytes, true) {
        let mut words = line.words();
        match words.next() {
            Some(b"v") => counts.vertices += 1,
            Some(b"f" | b"fo") => counts.face(words.count() as u64),
            _ => {}
        }
    }
    check(path, counts)?;
    Ok(counts)
}

/// Writes the mesh.
pub(super) fn convert(bytes: &[u8], target: &mut Target) -> Result<()> {
    target.counts = count(target.path, bytes)?;
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
            Some(b"f" | b"fo") => {
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
