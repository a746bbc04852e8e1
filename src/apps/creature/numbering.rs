//! Which vertex has which number: closed forms both ways, for patches of `m` by `m` squares.
//!
//! Vertices are numbered patch by patch and row by row; one on a common side or corner belongs to
//! the first patch that has it, so every vertex has one number and no table of the mesh's size is
//! needed. Nearby numbers are nearby vertices, but for the patches' rims. Memory: a few words a
//! patch; time: a binary search over patches, or less.

use super::cage::Patch;

/// A grid point: patch, row (`v`) and column (`u`), both `0..=m`.
pub(super) type Point = (usize, u64, u64);

/// Vertex numbers of the skin at one resolution.
#[derive(Clone, Debug)]
pub(super) struct Numbering {
    m: u64,
    /// First number of each patch, and the total.
    starts: Vec<u64>,
    rims: Vec<Rim>,
}

/// What a patch needs to know of its rim.
#[derive(Clone, Debug)]
struct Rim {
    owns_side: [bool; 4],
    owns_corner: [bool; 4],
    across: [(usize, usize); 4],
    first: [(usize, usize); 4],
}

/// Grid point of corner `s`.
fn corner(m: u64, s: usize) -> (u64, u64) {
    [(0, 0), (0, m), (m, m), (m, 0)][s]
}

/// Grid point `t` steps along side `s`.
fn along(m: u64, s: usize, t: u64) -> (u64, u64) {
    [(0, t), (t, m), (m, m - t), (m - t, 0)][s]
}

/// Which rim a grid point lies on.
enum Spot {
    Inside,
    Side(usize, u64),
    Corner(usize),
}

fn spot(m: u64, row: u64, column: u64) -> Spot {
    match (row == 0, row == m, column == 0, column == m) {
        (false, false, false, false) => Spot::Inside,
        (true, _, true, _) => Spot::Corner(0),
        (true, _, _, true) => Spot::Corner(1),
        (_, true, _, true) => Spot::Corner(2),
        (_, true, true, _) => Spot::Corner(3),
        (true, ..) => Spot::Side(0, column),
        (_, _, _, true) => Spot::Side(1, row),
        (_, true, ..) => Spot::Side(2, m - column),
        _ => Spot::Side(3, m - row),
    }
}

impl Rim {
    /// Length of the first row, of each inner row, and of the last.
    fn rows(&self, m: u64) -> [u64; 3] {
        let (side, corner) = (self.owns_side.map(u64::from), self.owns_corner.map(u64::from));
        [
            corner[0] + side[0] * (m - 1) + corner[1],
            side[3] + (m - 1) + side[1],
            corner[3] + side[2] * (m - 1) + corner[2],
        ]
    }

    /// Column of the `k`-th vertex of a rim row: corners `from`, `to`, side `s` between them.
    fn rim_column(&self, m: u64, k: u64, from: usize, s: usize) -> u64 {
        match (self.owns_corner[from], self.owns_side[s]) {
            (true, _) if k == 0 => 0,
            (owned, true) if k < m - 1 + u64::from(owned) => k + 1 - u64::from(owned),
            _ => m,
        }
    }
}

impl Numbering {
    /// Numbers for `patches` of `m` by `m` squares, `m` at least 1.
    pub fn new(patches: &[Patch], m: u64) -> Self {
        let four = [0, 1, 2, 3];
        let rims: Vec<Rim> = patches
            .iter()
            .enumerate()
            .map(|(p, patch)| Rim {
                owns_side: four.map(|s| patch.across[s].0 >= p),
                owns_corner: four.map(|s| patch.first[s] == (p, s)),
                across: patch.across,
                first: patch.first,
            })
            .collect();
        let mut starts = vec![0];
        let mut total = 0;
        for rim in &rims {
            let [first, inner, last] = rim.rows(m);
            total += first + inner * (m - 1) + last;
            starts.push(total);
        }
        Self { m, starts, rims }
    }

    /// Squares along a patch's side.
    pub fn m(&self) -> u64 {
        self.m
    }

    /// Number of vertices.
    pub fn count(&self) -> u64 {
        self.starts[self.rims.len()]
    }

    /// The number of a grid point.
    #[inline]
    pub fn number(&self, (patch, row, column): Point) -> u64 {
        let m = self.m;
        let rim = &self.rims[patch];
        match spot(m, row, column) {
            Spot::Inside => self.owned(patch, row, column),
            Spot::Side(s, t) if rim.owns_side[s] => {
                let (row, column) = along(m, s, t);
                self.owned(patch, row, column)
            }
            Spot::Side(s, t) => {
                let (other, side) = rim.across[s];
                let (row, column) = along(m, side, m - t);
                self.owned(other, row, column)
            }
            Spot::Corner(s) => {
                let (other, s) = rim.first[s];
                let (row, column) = corner(m, s);
                self.owned(other, row, column)
            }
        }
    }

    /// The number of a grid point that belongs to `patch`.
    #[inline]
    fn owned(&self, patch: usize, row: u64, column: u64) -> u64 {
        let rim = &self.rims[patch];
        let m = self.m;
        let [first, inner, _] = rim.rows(m);
        let rim_place = |from: usize, s: usize| {
            u64::from(column > 0 && rim.owns_corner[from]) + u64::from(rim.owns_side[s]) * column.saturating_sub(1)
        };
        self.starts[patch]
            + match row {
                0 => rim_place(0, 0),
                row if row == m => first + inner * (m - 1) + rim_place(3, 2),
                row => first + inner * (row - 1) + column - u64::from(!rim.owns_side[3]),
            }
    }

    /// The grid point of a number below [`Numbering::count`], in the patch it belongs to.
    #[inline]
    pub fn point(&self, number: u64) -> Point {
        let patch = self.starts.partition_point(|&start| start <= number) - 1;
        let rim = &self.rims[patch];
        let m = self.m;
        let [first, inner, _] = rim.rows(m);
        let rest = number - self.starts[patch];
        if rest < first {
            return (patch, 0, rim.rim_column(m, rest, 0, 0));
        }
        let rest = rest - first;
        if rest < inner * (m - 1) {
            return (patch, 1 + rest / inner, rest % inner + u64::from(!rim.owns_side[3]));
        }
        (patch, m, rim.rim_column(m, rest - inner * (m - 1), 3, 2))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::apps::creature::cage;

    #[test]
    fn numbers_and_points_are_inverse_and_rims_agree() {
        let patches = cage::patches();
        for m in [1, 2, 3, 7] {
            let numbering = Numbering::new(&patches, m);
            for v in 0..numbering.count() {
                assert_eq!(numbering.number(numbering.point(v)), v, "m {m}");
            }
            let mut used = vec![false; numbering.count() as usize];
            for patch in 0..patches.len() {
                for row in 0..=m {
                    for column in 0..=m {
                        used[numbering.number((patch, row, column)) as usize] = true;
                    }
                }
            }
            assert!(used.iter().all(|&used| used));
            let squares = patches.len() as u64 * m * m;
            assert_eq!(numbering.count(), squares + 2, "Euler: V - 2F + F = 2");
        }
    }
}
