//! The thickness of the body behind each cell: the shape diameter, computed from the cells alone.
//!
//! Rays are cast from a cell into the body, one along its normal and two rings around that, and end at the nearest disc
//! (a cell, with the same area) that faces away; the median of their lengths is the thickness (after Shapira, Shamir
//! and Cohen-Or, *The Visual Computer* 2008, who cast rays at triangles). People separate parts where the thickness
//! changes at a boundary: a limb from a body, but not a fish from its own tapering end.
//!
//! Cells are ordered so that neighbours follow each other, so whole runs of them lie outside a cone: S²/8 bounding
//! balls are tested, and the cells in the remaining ones. Cost: a few milliseconds, a few dozen bytes per cell.

use super::cell_graph::CellGraph;
use crate::base::Result;
use crate::base::simd::{SimdKernel, dispatch};
use crate::base::vector::{MapEach, add_scaled, cross, dot, length, minus, narrow};
use crate::store::run::Run;
use libm::log as ln;
use std::f64::consts::TAU;
use std::ops::Range;

/// Rings of rays: their number, and the tangent of their angle with the normal.
const RINGS: [(usize, f64); 3] = [(1, 0.0), (6, 0.4), (8, 0.85)];
/// The tangent of the widest ring.
const REACH: f64 = RINGS[2].1;
/// All rays of a cell, and a dummy that hits nothing.
const RAYS: usize = 16;
/// Minimum thickness, in units of √(total area): half a cell.
const FLOOR: f64 = 0.01;
/// Thickness if no ray of any cell hits anything.
const UNKNOWN: f64 = 0.1;
/// Rounds of medians over a cell and its neighbours.
const ROUNDS: usize = 2;
/// Cells tested together, in single precision, before the exact test of those in the cone.
const LANES: usize = 8;
/// The error bound of that test.
const SLACK: f32 = 1e-5;
/// Cells per chunk of the parallel pass.
const CHUNK: usize = 64;

/// Natural logarithm of the thickness behind each cell, in units of √(total area) (S). A cell with nothing behind it,
/// as on an open sheet, gets the median of all.
///
/// # Errors
/// Cancellation.
pub fn log_thickness(cells: &CellGraph, run: &Run) -> Result<Vec<f64>> {
    let discs = Discs::of(cells);
    let scene = discs.scene(cells);
    let chunks = run.map_ranges(cells.len(), CHUNK, |range| Ok(dispatch(CastRays { range, scene })))?;
    let found = chunks.concat();
    let usual = median(&mut found.iter().filter_map(|x| *x).collect::<Vec<_>>()).unwrap_or(UNKNOWN);
    let mut out: Vec<f64> = found.iter().map(|x| ln(x.unwrap_or(usual).max(FLOOR))).collect();
    let beside = cells.neighbours();
    let mut near = Vec::new();
    for _ in 0..ROUNDS {
        let last = out.clone();
        for (x, beside) in out.iter_mut().zip(&beside) {
            near.clear();
            near.push(*x);
            near.extend(beside.iter().map(|&j| last[j as usize]));
            *x = median(&mut near).unwrap_or(*x);
        }
    }
    Ok(out)
}

/// Where the rays meet the plane at unit distance behind a cell, axis by axis.
fn rays() -> [[f64; RAYS]; 2] {
    let all = RINGS.iter().flat_map(|&(count, tangent)| {
        (0..count).map(move |k| {
            let (sin, cos) = libm::sincos(k as f64 * TAU / count as f64);
            [tangent * cos, tangent * sin]
        })
    });
    let mut rays = [[f64::INFINITY; RAYS]; 2];
    for (k, [p, q]) in all.enumerate() {
        (rays[0][k], rays[1][k]) = (p, q);
    }
    rays
}

/// The radii of the cells' discs (S), their blocks and bounding balls, and the rays.
struct Discs {
    radius: Vec<f64>,
    blocks: Vec<DiscBlock>,
    balls: Vec<BallBlock>,
    rays: [[f64; RAYS]; 2],
}

impl Discs {
    fn of(cells: &CellGraph) -> Self {
        let radius = cells.radii();
        Self { blocks: blocks(cells, &radius), balls: balls(cells, &radius), rays: rays(), radius }
    }

    fn scene<'a>(&'a self, cells: &'a CellGraph) -> RayScene<'a> {
        RayScene { cells, radius: &self.radius, blocks: &self.blocks, balls: &self.balls, rays: &self.rays }
    }
}

/// Cells and their [`Discs`], as used by the loops.
#[derive(Clone, Copy)]
struct RayScene<'a> {
    cells: &'a CellGraph,
    radius: &'a [f64],
    blocks: &'a [DiscBlock],
    balls: &'a [BallBlock],
    rays: &'a [[f64; RAYS]; 2],
}

impl RayScene<'_> {
    /// The multiple of `way` at which a ray from `from` leaves the body through the tilted disc of `cell`; `None` if it
    /// does not, or if less than `least` of `way` is along the disc's normal.
    #[inline(always)]
    fn meets(self, cell: u32, from: [f64; 3], way: [f64; 3], least: f64) -> Option<f64> {
        let j = cell as usize;
        let (d, n, reach) = (minus(self.cells.centre[j], from), self.cells.normal[j], COVER * self.radius[j]);
        let facing = dot(way, n);
        let length = dot(d, n) / facing;
        let off = add_scaled(d, -length, way);
        (facing > least && dot(off, off) <= reach * reach).then_some(length)
    }
}

/// [`thickness_behind`] for a range of cells, on wide vectors.
struct CastRays<'a> {
    range: Range<usize>,
    scene: RayScene<'a>,
}

impl SimdKernel for CastRays<'_> {
    type Output = Vec<Option<f64>>;

    #[inline(always)]
    fn run(self) -> Vec<Option<f64>> {
        let mut out = Vec::with_capacity(self.range.len());
        for i in self.range {
            out.push(thickness_behind(self.scene, i));
        }
        out
    }
}

/// Median length of the rays from cell `i` that hit something.
#[inline(always)]
fn thickness_behind(scene: RayScene<'_>, i: usize) -> Option<f64> {
    let rays = scene.rays;
    let mut seen = Depths { rays, depths: [f64::INFINITY; RAYS] };
    visit_discs_behind(scene, i, REACH, &mut seen);
    let depths = seen.depths;
    let (mut lengths, mut count) = ([0.0; RAYS], 0);
    for k in (0..RAYS).filter(|&k| depths[k].is_finite()) {
        lengths[count] = depths[k] * (1.0 + rays[0][k] * rays[0][k] + rays[1][k] * rays[1][k]).sqrt();
        count += 1;
    }
    median(&mut lengths[..count])
}

/// The first cells hit by rays from each of `from`, in the order of the rays: along the normal, then around it.
///
/// # Errors
/// Cancellation.
pub(super) fn first_hits(cells: &CellGraph, from: &[u32], run: &Run) -> Result<Vec<Vec<u32>>> {
    let discs = Discs::of(cells);
    let scene = discs.scene(cells);
    let hit = |&i: &u32| {
        let mut hits = FirstHits::from(scene, i as usize);
        visit_discs_behind(scene, i as usize, REACH, &mut hits);
        hits.cell.into_iter().flatten().collect::<Vec<u32>>()
    };
    let chunks = run.map_ranges(from.len(), CHUNK, |range| Ok(from[range].iter().map(hit).collect::<Vec<_>>()))?;
    Ok(chunks.concat())
}

/// The cell directly behind each cell, and the distance of their centres: the first disc that the inward normal ray
/// meets among those that face away (S).
///
/// # Errors
/// Cancellation.
pub(super) fn opposite_cells(cells: &CellGraph, run: &Run) -> Result<Vec<Option<(u32, f64)>>> {
    let discs = Discs::of(cells);
    let scene = discs.scene(cells);
    let chunks = run.map_ranges(cells.len(), CHUNK, |range| Ok(dispatch(OppositeCells { range, scene })))?;
    Ok(chunks.concat())
}

/// [`opposite_cells`] for a range of cells, on wide vectors.
struct OppositeCells<'a> {
    range: Range<usize>,
    scene: RayScene<'a>,
}

impl SimdKernel for OppositeCells<'_> {
    type Output = Vec<Option<(u32, f64)>>;

    #[inline(always)]
    fn run(self) -> Vec<Option<(u32, f64)>> {
        let mut out = Vec::with_capacity(self.range.len());
        for i in self.range {
            let mut nearest = Nearest { scene: self.scene, from: i, length: f64::INFINITY, found: None };
            visit_discs_behind(self.scene, i, 0.0, &mut nearest);
            out.push(nearest.found);
        }
        out
    }
}

/// Minimum cosine of the angle between the normals of opposite sides; the two sides of a sharp edge do not count as
/// opposite.
const OPPOSITE: f64 = 0.5;

/// The first tilted disc on the normal ray, and the distance of its centre.
struct Nearest<'a> {
    scene: RayScene<'a>,
    from: usize,
    length: f64,
    found: Option<(u32, f64)>,
}

impl VisitDisc for Nearest<'_> {
    #[inline(always)]
    fn visit(&mut self, disc: DiscBehind) {
        let cells = self.scene.cells;
        let (from, inward) = (cells.centre[self.from], cells.normal[self.from].map_each(|c| -c));
        if let Some(length) = self.scene.meets(disc.cell, from, inward, OPPOSITE).filter(|x| *x < self.length) {
            let d = minus(cells.centre[disc.cell as usize], from);
            (self.length, self.found) = (length, Some((disc.cell, dot(d, d).sqrt())));
        }
    }
}

/// Receives the discs behind a cell. A trait, since closures are not inlined into code compiled for wide vectors.
trait VisitDisc {
    fn visit(&mut self, disc: DiscBehind);
}

/// The depth of the nearest disc on each ray.
struct Depths<'a> {
    rays: &'a [[f64; RAYS]; 2],
    depths: [f64; RAYS],
}

impl VisitDisc for Depths<'_> {
    #[inline(always)]
    fn visit(&mut self, DiscBehind { depth, centre: [p, q], radius, .. }: DiscBehind) {
        let (rays, depths) = (self.rays, &mut self.depths);
        for k in 0..RAYS {
            let (p, q) = (p - rays[0][k], q - rays[1][k]);
            let hit = (depth < depths[k]) & (p * p + q * q < radius * radius);
            depths[k] = if hit { depth } else { depths[k] };
        }
    }
}

/// Discs are enlarged by this factor when rays must hit what is really behind: at the original size there are gaps.
const COVER: f64 = 1.1;
/// A ray that meets a disc at a smaller sine passes by.
const GRAZING: f64 = 1e-3;

/// The first tilted disc on each ray. For a thickness, treating discs as facing the ray is accurate enough.
struct FirstHits<'a> {
    scene: RayScene<'a>,
    from: [f64; 3],
    ways: [[f64; 3]; RAYS],
    length: [f64; RAYS],
    cell: [Option<u32>; RAYS],
}

impl<'a> FirstHits<'a> {
    fn from(scene: RayScene<'a>, i: usize) -> Self {
        let n = scene.cells.normal[i];
        let [u, v] = tangents(n);
        let [p, q] = scene.rays;
        let ways = std::array::from_fn(|k| [0, 1, 2].map_each(|c| p[k] * u[c] + q[k] * v[c] - n[c]));
        Self { scene, from: scene.cells.centre[i], ways, length: [f64::INFINITY; RAYS], cell: [None; RAYS] }
    }
}

impl VisitDisc for FirstHits<'_> {
    fn visit(&mut self, disc: DiscBehind) {
        for k in 0..RAYS {
            let met = self.scene.meets(disc.cell, self.from, self.ways[k], GRAZING);
            if let Some(length) = met.filter(|x| *x < self.length[k]) {
                (self.length[k], self.cell[k]) = (length, Some(disc.cell));
            }
        }
    }
}

/// A disc behind a cell, as seen by its rays.
struct DiscBehind {
    /// Its cell.
    cell: u32,
    /// The depth of its centre.
    depth: f64,
    /// Its centre and radius scaled to a depth of 1.
    centre: [f64; 2],
    radius: f64,
}

/// Visits the discs behind cell `i` that face away, within the cone of width `reach` at depth 1.
#[inline(always)]
fn visit_discs_behind(scene: RayScene<'_>, i: usize, reach: f64, to: &mut impl VisitDisc) {
    let RayScene { cells, radius, blocks, balls, .. } = scene;
    let (x, n) = (cells.centre[i], cells.normal[i]);
    let [u, v] = tangents(n);
    let cone = RayCone::behind(x, n, reach);
    for (at, balls) in (0..).step_by(LANES).zip(balls) {
        let near = balls.near(cone);
        for b in (0..LANES).filter(|&k| near[k]).map(|k| at + k) {
            let seen = blocks[b].seen(cone);
            for j in (0..LANES).filter(|&k| seen[k]).map(|k| b * LANES + k) {
                let d = minus(cells.centre[j], x);
                let depth = -dot(d, n);
                if depth <= 0.0 || dot(cells.normal[j], d) <= 0.0 {
                    continue;
                }
                let across = dot(d, d) - depth * depth;
                if across > (reach * depth + radius[j]) * (reach * depth + radius[j]) {
                    continue;
                }
                let centre = [dot(d, u) / depth, dot(d, v) / depth];
                to.visit(DiscBehind { cell: j as u32, depth, centre, radius: radius[j] / depth });
            }
        }
    }
}

/// Bounding balls of blocks, several at once; NaN after the last block.
struct BallBlock {
    x: [[f32; LANES]; 3],
    radius: [f32; LANES],
    /// The radius, and that plus the radius of the largest disc.
    radius_and_disc: [f32; LANES],
}

/// Bounding balls of the blocks of `cells`.
fn balls(cells: &CellGraph, radius: &[f64]) -> Vec<BallBlock> {
    let ball = |(at, inside): (usize, &[[f64; 3]])| {
        let x: [f64; 3] = std::array::from_fn(|c| inside.iter().map(|x| x[c]).sum::<f64>() / inside.len() as f64);
        let square = |p: &[f64; 3]| (0..3).map(|c| (p[c] - x[c]) * (p[c] - x[c])).sum::<f64>();
        let ball = inside.iter().map(square).fold(0.0, f64::max).sqrt();
        let largest = radius[at * LANES..].iter().take(LANES).fold(0.0, |a: f64, &b| a.max(b));
        (x, ball, ball + largest)
    };
    let all: Vec<_> = cells.centre.chunks(LANES).enumerate().map(ball).collect();
    all.chunks(LANES).map(several).collect()
}

/// Up to [`LANES`] balls: centres, radii, radii plus the largest disc.
fn several(balls: &[([f64; 3], f64, f64)]) -> BallBlock {
    let mut out =
        BallBlock { x: [[f32::NAN; LANES]; 3], radius: [f32::NAN; LANES], radius_and_disc: [f32::NAN; LANES] };
    for (k, &(x, radius, radius_and_disc)) in balls.iter().enumerate() {
        (0..3).for_each(|c| out.x[c][k] = x[c] as f32);
        (out.radius[k], out.radius_and_disc[k]) = (radius as f32, radius_and_disc as f32);
    }
    out
}

impl BallBlock {
    /// Which of the balls may reach into `cone`.
    #[inline(always)]
    fn near(&self, cone: RayCone) -> [bool; LANES] {
        let mut out = [false; LANES];
        for k in 0..LANES {
            out[k] = cone.meets(cone.to(&self.x, k), self.radius[k], self.radius_and_disc[k]);
        }
        out
    }
}

/// Several cells in vector layout: x, n, radius; NaN after the last cell.
struct DiscBlock {
    x: [[f32; LANES]; 3],
    n: [[f32; LANES]; 3],
    radius: [f32; LANES],
}

fn blocks(cells: &CellGraph, radius: &[f64]) -> Vec<DiscBlock> {
    let get = |values: &[[f64; 3]], i: usize, c: usize| values.get(i).map_or(f32::NAN, |x| x[c] as f32);
    let block = |i: usize| DiscBlock {
        x: std::array::from_fn(|c| std::array::from_fn(|k| get(&cells.centre, i + k, c))),
        n: std::array::from_fn(|c| std::array::from_fn(|k| get(&cells.normal, i + k, c))),
        radius: std::array::from_fn(|k| radius.get(i + k).map_or(f32::NAN, |r| *r as f32)),
    };
    (0..cells.len()).step_by(LANES).map(block).collect()
}

impl DiscBlock {
    /// Which of the cells may lie in `cone` and face away: most do not.
    #[inline(always)]
    fn seen(&self, cone: RayCone) -> [bool; LANES] {
        let mut out = [false; LANES];
        for k in 0..LANES {
            let d = cone.to(&self.x, k);
            let facing = d[0] * self.n[0][k] + d[1] * self.n[1][k] + d[2] * self.n[2][k];
            out[k] = cone.meets(d, 0.0, self.radius[k]) & (facing > -slack(d));
        }
        out
    }
}

/// The cone of the rays behind `x` with normal `n`, in single precision: a conservative filter.
#[derive(Clone, Copy)]
struct RayCone {
    x: [f32; 3],
    n: [f32; 3],
    reach: f32,
}

impl RayCone {
    #[inline(always)]
    fn behind(x: [f64; 3], n: [f64; 3], reach: f64) -> Self {
        Self { x: narrow(x, 1.), n: narrow(n, 1.), reach: reach as f32 }
    }

    /// The vector to the `k`-th of several points.
    #[inline(always)]
    fn to(self, points: &[[f32; LANES]; 3], k: usize) -> [f32; 3] {
        [points[0][k] - self.x[0], points[1][k] - self.x[1], points[2][k] - self.x[2]]
    }

    /// Whether something at offset `d`, extending `deeper` into the cone and `radius_and_disc` beyond its side, may
    /// meet it.
    #[inline(always)]
    fn meets(self, d: [f32; 3], deeper: f32, radius_and_disc: f32) -> bool {
        let (n, reach) = (self.n, self.reach);
        let depth = -dot(d, n);
        let deepest = depth + deeper;
        let limit = reach * deepest + radius_and_disc;
        (deepest > -slack(d)) & (dot(d, d) - depth * depth < limit * limit + slack(d))
    }
}

/// The error bound of single precision at offset `d`.
#[inline(always)]
fn slack(d: [f32; 3]) -> f32 {
    SLACK * (1.0 + dot(d, d))
}

/// Two unit vectors perpendicular to `n` and to each other.
#[inline(always)]
pub(super) fn tangents(n: [f64; 3]) -> [[f64; 3]; 2] {
    let other = if n[0].abs() < 0.6 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
    let u = add_scaled(other, -dot(other, n), n);
    let norm = length(u).max(1e-12);
    let u = u.map_each(|c| c / norm);
    [u, cross(n, u)]
}

/// The upper median.
fn median(values: &mut [f64]) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cells on a closed tube of radius `r(z)` and length 1, with neighbours around and along.
    fn tube(around: usize, along: usize, r: impl Fn(f64) -> f64) -> CellGraph {
        let mut g = CellGraph::default();
        for k in 0..along {
            let z = (k as f64 + 0.5) / along as f64;
            for i in 0..around {
                let t = TAU * i as f64 / around as f64;
                g.centre.push([r(z) * t.cos(), r(z) * t.sin(), z]);
                g.normal.push([t.cos(), t.sin(), 0.0]);
                g.area.push(TAU * r(z) / (around * along) as f64);
                let here = (k * around + i) as u32;
                g.pairs.push([here, (k * around + (i + 1) % around) as u32]);
                if k + 1 < along {
                    g.pairs.push([here, here + around as u32]);
                }
            }
        }
        g
    }

    #[test]
    fn a_tube_is_as_thick_as_it_is_and_a_thinner_half_by_as_much() {
        let g = tube(24, 60, |z| if z < 0.5 { 0.1 } else { 0.05 });
        let t = log_thickness(&g, &Run::new(&())).unwrap();
        let at = |z: usize| t[z * 24 + 5].exp();
        assert!((at(15) - 0.2).abs() < 0.03 && (at(45) - 0.1).abs() < 0.015, "{} {}", at(15), at(45));
    }

    #[test]
    fn a_sheet_has_one_thickness_and_nothing_is_not_a_number() {
        let mut g = CellGraph::default();
        assert!(log_thickness(&g, &Run::new(&())).unwrap().is_empty());
        for i in 0..20 {
            g.centre.push([f64::from(i), 0.0, 0.0]);
            g.normal.push(if i == 7 { [0.0; 3] } else { [0.0, 0.0, 1.0] });
            g.area.push(1.0);
        }
        assert_eq!(log_thickness(&g, &Run::new(&())).unwrap(), vec![ln(UNKNOWN); 20]);
    }

    #[test]
    fn balls_leave_out_nothing() {
        let g = tube(18, 40, |z| 0.02 + 0.1 * (7.0 * z).sin().abs());
        let discs = Discs::of(&g);
        let (blocks, balls) = (&discs.blocks, &discs.balls);
        // Balls around everything.
        let all = |b: &BallBlock| BallBlock { x: b.x, radius: [9.0; LANES], radius_and_disc: [9.0; LANES] };
        let all: Vec<BallBlock> = balls.iter().map(all).collect();
        let cone = |i: usize| RayCone::behind(g.centre[i], g.normal[i], REACH);
        let near = |i| balls.iter().flat_map(|b| b.near(cone(i))).filter(|x| *x).count();
        for i in 0..g.len() {
            let scene = discs.scene(&g);
            assert_eq!(thickness_behind(scene, i), thickness_behind(RayScene { balls: &all, ..scene }, i));
        }
        assert!((0..g.len()).map(near).sum::<usize>() < g.len() * blocks.len() * 2 / 3);
    }

    #[test]
    fn the_opposite_cell_in_a_tube_lies_straight_behind() {
        let g = tube(24, 60, |_| 0.1);
        for (i, behind) in (0..).zip(opposite_cells(&g, &Run::new(&())).unwrap()) {
            let (cell, depth) = behind.unwrap();
            assert_eq!((cell, (depth * 1e6).round()), (i / 24 * 24 + (i + 12) % 24, 2e5));
        }
    }

    #[test]
    fn threads_change_nothing() {
        let g = tube(20, 30, |z| 0.05 + 0.1 * z);
        let with = |threads| log_thickness(&g, &Run { threads, ..Run::new(&()) }).unwrap();
        assert_eq!(with(1), with(3));
    }
}
