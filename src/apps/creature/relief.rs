//! The positions of the points of every patch: from coarse grids, relaxed once, to any resolution.
//!
//! Once, on first use: the patches' corners, then ever finer grids up to [`GRID`] squares per side, are moved to the
//! middle of their neighbours and back onto the surface, those on a border of parts back into the valley; so squares
//! become even and borders lie exactly in the valleys. A point of the finished mesh is then the bilinear point of a
//! coarse square, projected onto the surface by Newton's method (along a border, first onto the border's own curve,
//! faded out over the square). That depends only on its position: no state, any order, some 150–300 ns. About 400 kB.

use super::cage::{self, Patch};
use super::numbering::Numbering;
use super::shape::{FILLET, NAMES, PartSet, Shape, Vec3};
use std::sync::OnceLock;

/// Coarse squares along a patch's side; a power of two.
const GRID: usize = 8;
/// Points along a patch's side.
const POINTS: usize = GRID + 1;
/// Rounds of relaxation with 1, 2, 4, 8 squares per side.
const ROUNDS: [usize; 4] = [3, 20, 40, 30];
/// How far a point moves towards the middle of its neighbours in a round.
const STRIDE: f64 = 0.5;

/// Initial outward offset of a new point of a finer grid, as a share of its square's diagonal: from outside, the tip of
/// a limb is the nearest surface; from inside, its flanks are.
const LIFT: f64 = 0.5;

/// By how much a point inside a part is kept nearer to it than to others, with one square per side.
const MARGIN: f64 = 0.14;
/// Number of rows next to a valley that are kept away from it, each one step farther.
const REACH: u64 = 3;

/// The creature's skin at any resolution.
#[derive(Debug)]
pub(super) struct Relief {
    /// The patches.
    pub patches: Vec<Patch>,
    /// Total area, measured on the coarse grid.
    pub area: f64,
    shape: Shape,
    sheets: Vec<Sheet>,
}

/// A patch's coarse grid.
#[derive(Debug)]
struct Sheet {
    points: Vec<Vec3>,
    /// The parts close enough to affect the patch.
    near: PartSet,
    /// Its own part, and the part across each side if that is another.
    part: usize,
    valley: [Option<usize>; 4],
    /// One bit per square: whether its second diagonal is the shorter.
    diagonals: u64,
}

/// The skin, built on first use.
pub(super) fn relief() -> &'static Relief {
    static RELIEF: OnceLock<Relief> = OnceLock::new();
    RELIEF.get_or_init(Relief::new)
}

/// The part across each side of a patch, if it is another.
fn valleys(patches: &[Patch], p: usize) -> [Option<usize>; 4] {
    patches[p].across.map(|(q, _)| Some(patches[q].part).filter(|&part| part != patches[p].part))
}

/// A part and those it borders on.
fn app(patches: &[Patch]) -> Vec<PartSet> {
    let mut sets: Vec<PartSet> = (0..NAMES.len()).map(|part| 1 << part).collect();
    for p in 0..patches.len() {
        for other in valleys(patches, p).into_iter().flatten() {
            sets[patches[p].part] |= 1 << other;
        }
    }
    sets
}

/// The constraints of a vertex during relaxation: its part; the part across, if it lies in a valley; and its minimum
/// distance from other parts, in steps of the margin.
type Hold = (usize, Option<usize>, f64);

/// Projects `points` onto the surface, and moves them `rounds` times along it to the middle of their neighbours;
/// returns their normals.
fn relax(shape: &Shape, patches: &[Patch], numbering: &Numbering, points: &mut [Vec3], rounds: usize) -> Vec<Vec3> {
    let m = numbering.m();
    let sets = app(patches);
    let mut holds: Vec<Hold> = vec![(0, None, 1.0); points.len()];
    let mut edges: Vec<(u32, u32)> = Vec::new();
    for (p, patch) in patches.iter().enumerate() {
        let at = |row: u64, column: u64| numbering.number((p, row, column)) as usize;
        let across = valleys(patches, p);
        for row in 0..=m {
            for column in 0..=m {
                let sides = [row == 0, column == m, row == m, column == 0];
                let other = (0..4).find_map(|s| across[s].filter(|_| sides[s]));
                let steps = [row, m - column, m - row, column];
                let steps = (0..4).filter_map(|s| across[s].map(|_| steps[s])).min().unwrap_or(1).min(REACH) as f64;
                let hold = &mut holds[at(row, column)];
                if hold.1.is_none() {
                    *hold = (patch.part, other, hold.2.max(steps));
                }
                if row < m && column < m {
                    let ring = [at(row, column), at(row, column + 1), at(row + 1, column + 1), at(row + 1, column)];
                    edges.extend((0..4).map(|k| (ring[k] as u32, ring[(k + 1) % 4] as u32)));
                }
            }
        }
    }
    let mut normals = vec![Vec3::zeros(); points.len()];
    for _ in 0..=rounds {
        let mut sums = vec![(Vec3::zeros(), 0.0); points.len()];
        for &(from, to) in &edges {
            sums[from as usize].0 += points[to as usize];
            sums[from as usize].1 += 1.0;
        }
        for (v, &(part, other, steps)) in holds.iter().enumerate() {
            let (sum, count) = sums[v];
            let normal = normals[v];
            let mut stride = (sum / count - points[v]) * STRIDE;
            stride = if normal == Vec3::zeros() { normal } else { stride - normal * normal.dot(&stride) };
            let target = points[v] + stride;
            let (point, gradient) = match other {
                Some(other) => shape.onto_valley(sets[part] | sets[other], part, other, target),
                None => {
                    shape.onto_surface(sets[part], own_side(shape, sets[part], part, target, steps * MARGIN / m as f64))
                }
            };
            (points[v], normals[v]) = (point, gradient.normalize());
        }
    }
    normals
}

/// Moves `x` away from the other parts of `set` until it is nearer to `part` than to them, by `margin`.
fn own_side(shape: &Shape, set: PartSet, part: usize, mut x: Vec3, margin: f64) -> Vec3 {
    for other in (0..NAMES.len()).filter(|&other| other != part && set >> other & 1 == 1) {
        let (own, other) = (shape.part(part, &x), shape.part(other, &x));
        let excess = own.value - other.value + margin;
        if excess > 0.0 {
            let across = own.gradient - other.gradient;
            x -= across * (excess / across.norm_squared().max(0.05));
        }
    }
    x
}

/// The bilinear point of four corners in the order of a patch's.
#[inline]
fn bilinear(corners: [&Vec3; 4], u: f64, v: f64) -> Vec3 {
    let [a, b, c, d] = corners;
    (a * (1.0 - u) + b * u) * (1.0 - v) + (d * (1.0 - u) + c * u) * v
}

/// The relaxed points, numbered with [`GRID`] squares a side.
fn relaxed(shape: &Shape, patches: &[Patch]) -> (Numbering, Vec<Vec3>) {
    let mut numbering = Numbering::new(patches, 1);
    let rough = |v| {
        let (p, row, column) = numbering.point(v);
        patches[p].rough[[[0, 1], [3, 2]][row as usize][column as usize]]
    };
    let mut points: Vec<Vec3> = (0..numbering.count()).map(rough).collect();
    let mut normals = Vec::new();
    for (level, &rounds) in ROUNDS.iter().enumerate() {
        if level > 0 {
            let fine = Numbering::new(patches, numbering.m() * 2);
            let between = |v| {
                let (p, row, column) = fine.point(v);
                let at = |row: u64, column: u64| numbering.number((p, row, column)) as usize;
                let (r, c) = (row / 2, column / 2);
                let (r1, c1) = (row.div_ceil(2), column.div_ceil(2));
                let corners = [at(r, c), at(r, c1), at(r1, c1), at(r1, c)];
                let middle = bilinear(corners.map(|k| &points[k]), 0.5, 0.5);
                let [a, b, c, d] = corners.map(|k| points[k]);
                let facing = (c - a).cross(&(d - b)).try_normalize(1e-12);
                let outward = facing.unwrap_or_else(|| bilinear(corners.map(|k| &normals[k]), 0.5, 0.5));
                middle + outward * (LIFT * (c - a).norm())
            };
            points = (0..fine.count()).map(between).collect();
            numbering = fine;
        }
        normals = relax(shape, patches, &numbering, &mut points, rounds);
    }
    (numbering, points)
}

impl Relief {
    fn new() -> Self {
        let (shape, patches) = (Shape::quadruped(), cage::patches());
        let (numbering, points) = relaxed(&shape, &patches);
        let mut area = 0.0;
        let sheets = (0..patches.len())
            .map(|p| {
                let at = |k: usize| points[numbering.number((p, (k / POINTS) as u64, (k % POINTS) as u64)) as usize];
                let points: Vec<Vec3> = (0..POINTS * POINTS).map(at).collect();
                let mut sheet =
                    Sheet { near: 0, part: patches[p].part, valley: valleys(&patches, p), points, diagonals: 0 };
                for square in 0..GRID * GRID {
                    let [a, b, c, d] = sheet.corners(square / GRID, square % GRID);
                    area += 0.5 * (c - a).cross(&(d - b)).norm();
                    sheet.diagonals |= u64::from((d - b).norm() < (c - a).norm()) << square;
                }
                sheet.near = near(&shape, &sheet);
                sheet
            })
            .collect();
        Self { patches, area, shape, sheets }
    }

    /// The point `row / m`, `column / m` of patch `p`, and the outward unit normal there.
    #[inline]
    pub fn place(&self, p: usize, row: u64, column: u64, m: u64) -> (Vec3, Vec3) {
        let sheet = &self.sheets[p];
        let (r, v) = split(row, m);
        let (c, u) = split(column, m);
        let corners = sheet.corners(r, c);
        let mut x = bilinear(corners, u, v);
        // The sides of the patch at which this square lies: how far from each, and how far along it.
        let sides =
            [(r == 0, v, u), (c + 1 == GRID, 1.0 - u, v), (r + 1 == GRID, 1.0 - v, 1.0 - u), (c == 0, u, 1.0 - v)];
        for (s, (touches, away, along)) in sides.into_iter().enumerate() {
            if let (true, Some(other)) = (touches, sheet.valley[s]) {
                let chord = corners[s].lerp(corners[(s + 1) % 4], along);
                let (curve, gradient) = self.shape.onto_valley(sheet.near, sheet.part, other, chord);
                if away == 0.0 {
                    return (curve, gradient.normalize());
                }
                x += (curve - chord) * (1.0 - away);
            }
        }
        let (x, gradient) = self.shape.onto_surface(sheet.near, x);
        (x, gradient.normalize())
    }

    /// Whether the square at `row`, `column` of `m` is split along its second diagonal (from corner 1 to corner 3),
    /// which is then the shorter.
    #[inline]
    pub fn second_diagonal(&self, p: usize, row: u64, column: u64, m: u64) -> bool {
        let cell = |k: u64| (2 * k + 1) * GRID as u64 / (2 * m);
        self.sheets[p].diagonals >> (cell(row) * GRID as u64 + cell(column)) & 1 == 1
    }
}

/// The coarse square into which grid line `k` of `m` falls, and the position in it (0 to 1).
#[inline]
fn split(k: u64, m: u64) -> (usize, f64) {
    let at = k * GRID as u64;
    let square = (at / m).min(GRID as u64 - 1);
    (square as usize, (at - square * m) as f64 / m as f64)
}

impl Sheet {
    #[inline]
    fn corners(&self, row: usize, column: usize) -> [&Vec3; 4] {
        let first = row * POINTS + column;
        [first, first + 1, first + POINTS + 1, first + POINTS].map(|k| &self.points[k])
    }
}

/// The parts that can affect any point of a patch: those whose distance at some grid point is within two fillets plus a
/// margin for points between grid points.
fn near(shape: &Shape, sheet: &Sheet) -> PartSet {
    const BETWEEN: f64 = 0.1;
    let mut set = 1 << sheet.part;
    for part in 0..NAMES.len() {
        if sheet.points.iter().any(|x| shape.part(part, x).value < 2.0 * FILLET + BETWEEN) {
            set |= 1 << part;
        }
    }
    set
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::apps::creature::shape::ALL;

    #[test]
    fn points_lie_on_the_whole_surface_and_on_their_own_parts_side() {
        let relief = relief();
        let m = 37;
        for (p, patch) in relief.patches.iter().enumerate() {
            for row in 0..=m {
                for column in 0..=m {
                    let (x, normal) = relief.place(p, row, column, m);
                    let whole = relief.shape.whole(ALL, &x);
                    assert!(whole.value.abs() < 1e-6, "patch {p}: off the surface by {}", whole.value);
                    assert!(normal.dot(&whole.gradient) > 0.0);
                    let own = relief.shape.part(patch.part, &x).value;
                    for (part, name) in NAMES.iter().enumerate() {
                        let slack = own - relief.shape.part(part, &x).value;
                        assert!(slack < 1e-6, "patch {p} of {}: {slack} nearer {name}", NAMES[patch.part]);
                    }
                }
            }
        }
    }
}
