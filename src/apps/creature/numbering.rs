//! The numbering of vertices and faces, in closed form both ways: patches of `m` by `m` squares, without holes, in scan
//! order or in random order.
//!
//! Vertices are numbered patch by patch and row by row; one on a common side or corner belongs to the first patch that
//! has it, so every vertex has one number and no table of the mesh's size is needed. Nearby numbers are nearby
//! vertices, except across patch boundaries. Memory: a few words per patch, 8 bytes per row of a patch with a hole;
//! time: at most a binary search over patches, and 10–20 ns per item in random order.

use super::cage::Patch;
use crate::base::random::{Random, splitmix_finalise};
use crate::base::{Error, Result, random};
use rand_xoshiro::rand_core::Rng;

/// A grid point: patch, row (`v`) and column (`u`), both `0..=m`.
pub(super) type Point = (usize, u64, u64);

/// Vertex numbers of the skin at one resolution.
#[derive(Clone, Debug)]
pub(super) struct Numbering {
    m: u64,
    /// First number of each patch, and the total.
    starts: Vec<u64>,
    boundaries: Vec<PatchBoundary>,
}

/// The boundary data of a patch.
#[derive(Clone, Debug)]
struct PatchBoundary {
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

/// The kind of boundary on which a grid point lies.
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

impl PatchBoundary {
    /// Length of the first row, of each inner row, and of the last.
    fn rows(&self, m: u64) -> [u64; 3] {
        let (side, corner) = (self.owns_side.map(u64::from), self.owns_corner.map(u64::from));
        [
            corner[0] + side[0] * (m - 1) + corner[1],
            side[3] + (m - 1) + side[1],
            corner[3] + side[2] * (m - 1) + corner[2],
        ]
    }

    /// Column of the `k`-th vertex of a boundary row: corners `from`, `to`, side `s` between them.
    fn boundary_column(&self, m: u64, k: u64, from: usize, s: usize) -> u64 {
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
        let boundaries: Vec<PatchBoundary> = patches
            .iter()
            .enumerate()
            .map(|(p, patch)| PatchBoundary {
                owns_side: four.map(|s| patch.across[s].0 >= p),
                owns_corner: four.map(|s| patch.first[s] == (p, s)),
                across: patch.across,
                first: patch.first,
            })
            .collect();
        let mut starts = vec![0];
        let mut total = 0;
        for boundary in &boundaries {
            let [first, inner, last] = boundary.rows(m);
            total += first + inner * (m - 1) + last;
            starts.push(total);
        }
        Self { m, starts, boundaries }
    }

    /// Squares along a patch's side.
    pub fn m(&self) -> u64 {
        self.m
    }

    /// Number of vertices.
    pub fn count(&self) -> u64 {
        self.starts[self.boundaries.len()]
    }

    /// The number of a grid point.
    #[inline]
    pub fn number(&self, (patch, row, column): Point) -> u64 {
        let m = self.m;
        let boundary = &self.boundaries[patch];
        match spot(m, row, column) {
            Spot::Inside => self.owned(patch, row, column),
            Spot::Side(s, t) if boundary.owns_side[s] => {
                let (row, column) = along(m, s, t);
                self.owned(patch, row, column)
            }
            Spot::Side(s, t) => {
                let (other, side) = boundary.across[s];
                let (row, column) = along(m, side, m - t);
                self.owned(other, row, column)
            }
            Spot::Corner(s) => {
                let (other, s) = boundary.first[s];
                let (row, column) = corner(m, s);
                self.owned(other, row, column)
            }
        }
    }

    /// The number of a grid point that belongs to `patch`.
    #[inline]
    fn owned(&self, patch: usize, row: u64, column: u64) -> u64 {
        let boundary = &self.boundaries[patch];
        let m = self.m;
        let [first, inner, _] = boundary.rows(m);
        let boundary_place = |from: usize, s: usize| {
            u64::from(column > 0 && boundary.owns_corner[from])
                + u64::from(boundary.owns_side[s]) * column.saturating_sub(1)
        };
        self.starts[patch]
            + match row {
                0 => boundary_place(0, 0),
                row if row == m => first + inner * (m - 1) + boundary_place(3, 2),
                row => first + inner * (row - 1) + column - u64::from(!boundary.owns_side[3]),
            }
    }

    /// The grid point of a number below [`Numbering::count`], in the patch that owns it.
    #[inline]
    pub fn point(&self, number: u64) -> Point {
        let patch = self.starts.partition_point(|&start| start <= number) - 1;
        let boundary = &self.boundaries[patch];
        let m = self.m;
        let [first, inner, _] = boundary.rows(m);
        let rest = number - self.starts[patch];
        if rest < first {
            return (patch, 0, boundary.boundary_column(m, rest, 0, 0));
        }
        let rest = rest - first;
        if rest < inner * (m - 1) {
            return (patch, 1 + rest / inner, rest % inner + u64::from(!boundary.owns_side[3]));
        }
        (patch, m, boundary.boundary_column(m, rest - inner * (m - 1), 3, 2))
    }
}

// Removed faces: a disc in the middle of some patches, so that the mesh has open borders.
//
// All discs have the same position in their patch, so one table of a patch's rows suffices to find the k-th remaining
// face. Memory: 8 bytes per row of a patch, O(√faces).

/// Radius of a hole, relative to a patch's side.
const RADIUS: f64 = 0.3;

/// The existing faces, as squares of patches.
#[derive(Clone, Debug)]
pub(super) struct Holes {
    m: u64,
    /// Whether whole patches are numbered tile by tile rather than row by row.
    tiles: bool,
    /// Faces before each patch, and in total.
    starts: Vec<u64>,
    /// Remaining faces before each row of a patch with a hole, and in total. Empty without holes.
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

/// Squares along the side of a tile: a tile has some eight thousand faces, which fit on a few pages of an array.
const TILE: u64 = 64;

/// Row and column of square number `square` of `m` by `m`, numbered tile by tile of `side` by `side` squares, row by
/// row within a tile; the last tiles are truncated.
#[inline]
fn in_tiles(m: u64, side: u64, square: u64) -> (u64, u64) {
    let (band, rest) = (square / (side * m), square % (side * m));
    let height = side.min(m - band * side);
    let (tile, rest) = (rest / (side * height), rest % (side * height));
    let width = side.min(m - tile * side);
    (band * side + rest / width, tile * side + rest % width)
}

impl Holes {
    /// `count` holes in `patches` patches of `m` by `m` squares, chosen by `seed`; patches without one in `tiles`.
    ///
    /// # Errors
    /// [`Error::Parameter`] when there are more holes than patches.
    pub fn new(patches: usize, m: u64, count: usize, tiles: bool, seed: u64) -> Result<Self> {
        if count > patches {
            return Err(Error::parameter(
                "holes",
                format!("{count} holes, but the creature has {patches} patches"),
                format!("request at most {patches}"),
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
        Ok(Self { m, tiles, starts, rows })
    }

    /// Number of faces.
    pub fn count(&self) -> u64 {
        self.starts[self.starts.len() - 1]
    }

    /// The patch of face number `face`, below [`Holes::count`], and its number within the patch.
    #[inline]
    pub fn patch(&self, face: u64) -> (usize, u64) {
        let patch = self.starts.partition_point(|&start| start <= face) - 1;
        (patch, face - self.starts[patch])
    }

    /// The square and half of face number `face`, below [`Holes::count`].
    #[inline]
    pub fn square(&self, face: u64) -> Square {
        let (patch, rest) = self.patch(face);
        let whole = self.starts[patch + 1] - self.starts[patch] == 2 * self.m * self.m;
        if whole {
            let side = if self.tiles { TILE } else { self.m };
            let (row, column) = in_tiles(self.m, side, rest / 2);
            return (patch, row, column, rest % 2);
        }
        let row = self.rows.partition_point(|&start| start <= rest) - 1;
        let rest = rest - self.rows[row];
        let (first, end) = gap(self.m, row as u64);
        let column = rest / 2;
        let column = if column < first { column } else { column + (end - first) };
        (patch, row as u64, column, rest % 2)
    }
}

// A random order that needs no memory: a seeded bijection of `0..n`, with its inverse in closed form.
//
// Four Feistel rounds over the least power of two that holds `n`, iterated until the result is below `n` (cycle
// walking, fewer than two iterations on average). Some 10–20 ns per item.

const ROUNDS: usize = 4;

/// A bijection of `0..n`.
#[derive(Clone, Debug)]
pub(super) struct Permutation {
    n: u64,
    low_bits: u32,
    masks: [u64; 2],
    keys: [u64; ROUNDS],
}

impl Permutation {
    /// A bijection of `0..n`, its keys drawn from `random`.
    pub fn new(n: u64, random: &mut Random) -> Self {
        let bits = (64 - n.saturating_sub(1).leading_zeros()).max(2);
        let low_bits = bits / 2;
        let masks = [(1 << low_bits) - 1, (1 << (bits - low_bits)) - 1];
        Self { n, low_bits, masks, keys: std::array::from_fn(|_| random.next_u64()) }
    }

    /// One pass over the power of two; `order` lists the rounds.
    #[inline]
    fn pass(&self, x: u64, order: impl Iterator<Item = usize>) -> u64 {
        let mut halves = [x & self.masks[0], x >> self.low_bits];
        for round in order {
            let (to, from) = (round % 2, 1 - round % 2);
            halves[to] ^= splitmix_finalise(halves[from] ^ self.keys[round]) & self.masks[to];
        }
        halves[0] | halves[1] << self.low_bits
    }

    /// The image of `x`.
    #[inline]
    pub fn forward(&self, mut x: u64) -> u64 {
        loop {
            x = self.pass(x, 0..ROUNDS);
            if x < self.n {
                return x;
            }
        }
    }

    /// The preimage of `x`.
    #[inline]
    pub fn backward(&self, mut x: u64) -> u64 {
        loop {
            x = self.pass(x, (0..ROUNDS).rev());
            if x < self.n {
                return x;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::apps::creature::cage;
    use crate::base::random::stream;

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

    #[test]
    fn the_faces_left_are_those_outside_the_discs() {
        for m in [3, 4, 8, 21] {
            let holes = Holes::new(5, m, 2, false, 3).unwrap();
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

    #[test]
    fn tiles_have_every_square_once_and_neighbours_near() {
        for (m, side) in [(1, 64), (5, 2), (64, 64), (130, 64), (7, 7)] {
            let squares: Vec<(u64, u64)> = (0..m * m).map(|square| in_tiles(m, side, square)).collect();
            let mut sorted = squares.clone();
            sorted.sort_unstable();
            sorted.dedup();
            assert!(sorted.len() as u64 == m * m && sorted.iter().all(|&(row, column)| row < m && column < m));
            let tiles = squares.iter().map(|(row, column)| (row / side, column / side));
            assert!(tiles.is_sorted(), "{m} {side}");
        }
        let rows: Vec<(u64, u64)> = (0..9).map(|square| in_tiles(3, 3, square)).collect();
        assert!(rows.is_sorted());
    }

    #[test]
    fn it_is_a_bijection_and_looks_random() {
        for n in [1u64, 2, 3, 100, 4097, 65_536] {
            let order = Permutation::new(n, &mut stream(7, "test"));
            let mut seen = vec![false; n as usize];
            let mut jumps = 0.0;
            for x in 0..n {
                let y = order.forward(x);
                assert_eq!(order.backward(y), x);
                assert!(!std::mem::replace(&mut seen[y as usize], true));
                jumps += y.abs_diff(x) as f64;
            }
            if n > 1000 {
                let mean = jumps / (n * n) as f64;
                assert!((mean - 1.0 / 3.0).abs() < 0.02, "mean jump {mean} of n");
            }
        }
    }
}
