//! The faces of one part after another, for formats with a file or an object per part.
//!
//! Small parts are listed together, as many as [`LISTED`] faces have room for, in one pass over the labels; a larger
//! part has passes of its own. So ten thousand parts cost a few passes instead of ten thousand. Memory: 4 bytes per
//! listed face, and 8 per part.

use super::CHUNK;
use crate::base::Result;
use crate::store::Run;

/// Maximum number of listed faces.
const LISTED: usize = 1 << 20;

/// The faces of a part.
pub(super) struct PartFaces<'a> {
    pub part: u32,
    labels: &'a [u32],
    /// Its faces, if they are listed.
    listed: Option<&'a [u32]>,
    run: &'a Run<'a>,
}

impl PartFaces<'_> {
    /// Calls `visit` with the numbers of the faces, ascending.
    pub fn each(&self, mut visit: impl FnMut(usize) -> Result<()>) -> Result<()> {
        if let Some(faces) = self.listed {
            return faces.chunks(CHUNK).try_for_each(|faces| {
                self.run.cancel.check()?;
                faces.iter().try_for_each(|&face| visit(face as usize))
            });
        }
        for (chunk, labels) in self.labels.chunks(CHUNK).enumerate() {
            self.run.cancel.check()?;
            (0..labels.len()).filter(|&at| labels[at] == self.part).try_for_each(|at| visit(chunk * CHUNK + at))?;
        }
        Ok(())
    }
}

/// Calls `visit` with the faces of each of the `parts` parts, in order; `labels` are less than `parts`.
pub(super) fn each_part(
    labels: &[u32],
    parts: usize,
    run: &Run,
    visit: impl FnMut(&PartFaces<'_>) -> Result<()>,
) -> Result<()> {
    each_part_listing(LISTED, labels, parts, run, visit)
}

/// [`each_part`] with at most `most` listed faces.
fn each_part_listing(
    most: usize,
    labels: &[u32],
    parts: usize,
    run: &Run,
    mut visit: impl FnMut(&PartFaces<'_>) -> Result<()>,
) -> Result<()> {
    let mut sizes = vec![0usize; parts];
    for labels in labels.chunks(CHUNK) {
        run.cancel.check()?;
        labels.iter().for_each(|&label| sizes[label as usize] += 1);
    }
    let mut listed = Vec::new();
    let mut first = 0;
    while first < parts {
        // Where the next face of each part goes in the list, for the parts that have room there together.
        let (mut nexts, mut total) = (Vec::new(), 0);
        for &size in &sizes[first..] {
            if total + size > most {
                break;
            }
            nexts.push(total);
            total += size;
        }
        let part = first as u32;
        if nexts.is_empty() {
            visit(&PartFaces { part, labels, listed: None, run })?;
            first += 1;
            continue;
        }
        listed.resize(total, 0u32);
        for (chunk, labels) in labels.chunks(CHUNK).enumerate() {
            run.cancel.check()?;
            for (face, &label) in (chunk * CHUNK..).zip(labels) {
                if let Some(next) = (label as usize).checked_sub(first).and_then(|k| nexts.get_mut(k)) {
                    listed[*next] = face as u32;
                    *next += 1;
                }
            }
        }
        // By now each is where its part ends.
        let mut start = 0;
        for (part, &end) in (part..).zip(&nexts) {
            visit(&PartFaces { part, labels, listed: Some(&listed[start..end]), run })?;
            start = end;
        }
        first += nexts.len();
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_has_its_faces_whether_listed_or_not() {
        let labels: Vec<u32> = (0..200_000u32).map(|face| (face * 7919 % 211).min(200)).collect();
        let run = Run::new(&());
        // One part has more faces than the others; part 201 has none.
        for most in [1, 900, 1_000, 3_000, 100_000, 200_000] {
            let (mut seen, mut parts) = (0, 0);
            each_part_listing(most, &labels, 202, &run, |faces| {
                assert_eq!(faces.part, parts);
                parts += 1;
                let mut before = None;
                faces.each(|face| {
                    assert!(labels[face] == faces.part && before.is_none_or(|before| before < face));
                    before = Some(face);
                    seen += 1;
                    Ok(())
                })
            })
            .unwrap();
            assert_eq!((seen, parts), (labels.len(), 202));
        }
    }
}
