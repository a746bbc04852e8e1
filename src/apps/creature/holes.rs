//! Faces left out: a disc in the middle of some patches, so that the mesh has open borders.
//!
//! All discs have the same place in their patch, so one table of a patch's rows serves to find the
//! k-th face that is left. Memory: 8 bytes a row of a patch, O(√faces).

use super::permutation::Permutation;
use crate::base::{Error, Result, random};

/// Share of a patch's side that a hole's radius takes.
const RADIUS: f64 = 0.3;

/// Which faces there are, as squares of patches.
#[derive(Clone, Debug)]
pub(super) struct Holes {
    m: u64,
    /// Faces before each patch, and in total.
    starts: Vec<u64>,
    /// Faces left before each row of a patch with a hole, and in total. Empty without holes.
    rows: Vec<u64>,
}

/// A face: its patch, row, column, and which half of that square.
pub(super) type Square = (usize, u64, u64, u64);

/// First column of the disc in a row of `m` squares, and the one past its last.
fn gap(m: u64, row: u64) -> (u64, u64) {
    let reach = 2.0 * RADIUS * m as f64;
    let dy = (2 * row + 1) as f64 - m as f64;
    let half = reach * reach - dy * dy;
    if half < 0.0 {
        return (m, m);
    }
    let half = half.sqrt();
    let first = ((m as f64 - half - 1.0) * 0.5).ceil().max(0.0) as u64;
    (first, m - first.min(m / 2))
}

impl Holes {
    /// `count` holes in `patches` patches of `m` by `m` squares, chosen under `seed`.
    ///
    /// # Errors
    /// [`Error::Parameter`] when there are more holes than patches.
    pub fn new(patches: usize, m: u64, count: usize, seed: u64) -> Result<Self> {
        if count > patches {
            return Err(Error::parameter(
                "--holes",
                format!("{count} holes, but the creature has {patches} patches"),
                format!("ask for at most {patches}"),
            ));
        }
        let order = Permutation::new(patches as u64, &mut random::stream(seed, "creature holes"));
        let mut holed = vec![false; patches];
        for k in 0..count {
            holed[order.forward(k as u64) as usize] = true;
        }
        let mut rows = Vec::new();
        if count > 0 {
            rows.push(0);
            let mut total = 0;
            for row in 0..m {
                let (first, end) = gap(m, row);
                total += 2 * (m - (end - first));
                rows.push(total);
            }
        }
        let mut starts = vec![0];
        let mut total = 0;
        for holed in holed {
            total += if holed { rows[m as usize] } else { 2 * m * m };
            starts.push(total);
        }
        Ok(Self { m, starts, rows })
    }

    /// Number of faces.
    pub fn count(&self) -> u64 {
        self.starts[self.starts.len() - 1]
    }

    /// The patch of face number `face`, which is below [`Holes::count`], and its number in there.
    #[inline]
    pub fn patch(&self, face: u64) -> (usize, u64) {
        let patch = self.starts.partition_point(|&start| start <= face) - 1;
        (patch, face - self.starts[patch])
    }

    /// The square and half of face number `face`, which is below [`Holes::count`].
    #[inline]
    pub fn square(&self, face: u64) -> Square {
        let (patch, rest) = self.patch(face);
        let whole = self.starts[patch + 1] - self.starts[patch] == 2 * self.m * self.m;
        if whole {
            let (row, rest) = (rest / (2 * self.m), rest % (2 * self.m));
            return (patch, row, rest / 2, rest % 2);
        }
        let row = self.rows.partition_point(|&start| start <= rest) - 1;
        let rest = rest - self.rows[row];
        let (first, end) = gap(self.m, row as u64);
        let column = rest / 2;
        let column = if column < first { column } else { column + (end - first) };
        (patch, row as u64, column, rest % 2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_faces_left_are_those_outside_the_discs() {
        for m in [2, 3, 8, 21] {
            let holes = Holes::new(5, m, 2, 3).unwrap();
            let mut seen: Vec<Square> = (0..holes.count()).map(|f| holes.square(f)).collect();
            assert!(seen.windows(2).all(|w| w[0] < w[1]));
            seen.retain(|&(_, row, column, _)| {
                let (first, end) = gap(m, row);
                (first..end).contains(&column)
            });
            let disc: u64 = (0..m).map(|row| gap(m, row).1 - gap(m, row).0).sum();
            assert!(disc > 0);
            assert_eq!(holes.count(), 5 * 2 * m * m - 2 * 2 * disc);
            assert_eq!(seen.len() as u64, 3 * 2 * disc, "only whole patches have faces there");
        }
    }
}
