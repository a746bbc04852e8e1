//! How much two regions see each other as convex: sums over pairs of cells.
//!
//! Cells p and q see each other as convex if n_p·(x_q − x_p) < .05 |d| and n_q·(x_p − x_q) < .05 |d|: across a convex
//! body they do, across a notch they do not. A pair has the weight a_p a_q exp(−|d|²/2w²), cut off at |d| = 4w, for
//! three widths w at once, so that one pass over the pairs serves the whole ensemble. The same weights are used for the
//! difference in thickness of the body between the cells of a pair ([`super::thickness`]). Sums are stored between
//! superfaces and add up when superfaces are merged.
//!
//! No sums are needed between pieces without a common boundary, since they never merge.
//!
//! Cost: one exponential from a table per pair of cells within the cutoff, at most S²/2; 80 bytes per pair of
//! superfaces of one piece.

use super::cell_graph::CellGraph;
use super::region_pieces::RegionPieces;
use crate::base::Result;
use crate::base::simd::{SimdKernel, dispatch};
use crate::base::sort::order_by;
use crate::base::vector::{MapEach, dot, minus};
use crate::spectral::exp::exp64;
use crate::store::run::Run;
use std::ops::Range;

/// Widths w of the pair weight, in units of √(total area).
pub const WIDTHS: [f64; 3] = [0.08, 0.1, 0.12];
/// Sine of the angle below which a cell does not count as in front of another.
const TOLERANCE: f64 = 0.05;
/// The weight is cut off at this many widths.
const CUT: f64 = 4.0;
/// Superfaces per chunk of the parallel pass.
const CHUNK: usize = 8;
/// Nodes of the table of exponentials, with cubic interpolation between them; accurate to 2e-11.
const TABLE_NODES: usize = 2048;

/// The sums between two superfaces, for each of [`WIDTHS`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairSums {
    /// First superface.
    pub a: u32,
    /// Second superface, ≥ the first.
    pub b: u32,
    /// Pairs that see each other as convex; if a = b each pair counts twice.
    pub seen: [f64; 3],
    /// All pairs.
    pub all: [f64; 3],
    /// |difference| of the logarithms of thickness over all pairs.
    pub thickness_jump: [f64; 3],
}

/// One number per width, and an unused fourth: four fill a vector.
type PerWidth = [f64; 4];

/// exp(−x/2w²) for the three widths and x up to the widest cutoff.
struct ExpTable {
    /// The values at each node, and the position of the node.
    nodes: Vec<PerWidth>,
    scale: f64,
    rate: PerWidth,
    cut: PerWidth,
}

impl ExpTable {
    fn new() -> ExpTable {
        let [a, b, c] = WIDTHS.map(|w| 0.5 / (w * w));
        let cut = WIDTHS.map(|w| CUT * CUT * w * w);
        let scale = TABLE_NODES as f64 / cut[2];
        let node = |k: usize| {
            let at = |r: f64| exp64(-r * k as f64 / scale);
            [at(a), at(b), at(c), k as f64 / scale]
        };
        ExpTable {
            nodes: (0..TABLE_NODES + 2).map(node).collect(),
            scale,
            rate: [a, b, c, 0.0],
            cut: [cut[0], cut[1], cut[2], 0.0],
        }
    }

    /// The three weights at squared distance `x`, up to the widest cutoff.
    #[inline(always)]
    fn weights(&self, x: f64) -> PerWidth {
        let k = (x * self.scale + 0.5) as u32 as usize;
        let node = &self.nodes[k.min(TABLE_NODES + 1)];
        let rest = node[3] - x;
        let mut out = [0.0; 4];
        for w in 0..4 {
            let t = rest * self.rate[w];
            let e = node[w] * (1.0 + t * (1.0 + t * (0.5 + t * (1.0 / 6.0))));
            out[w] = if x <= self.cut[w] { e } else { 0.0 };
        }
        out
    }
}

/// A cell in the layout of the inner loop.
#[derive(Clone, Copy)]
struct CellPoint {
    x: [f64; 3],
    n: [f64; 3],
    area: f64,
    thickness: f64,
}

/// A bounding ball of a superface's centres, and the start of its cells.
struct SuperfaceBall {
    x: [f64; 3],
    radius: f64,
    start: usize,
    end: usize,
}

/// Sums between all pairs of superfaces of one piece that are within the cutoff, ordered by (a, b), in chunks as they
/// were computed: with two thousand superfaces one list of all would be a second copy of 80 MB.
///
/// `superface`: the superface of each cell; `thickness`: the logarithm of a length (S); `pieces` of the superfaces.
///
/// # Errors
/// Cancellation.
pub fn convexity(
    cells: &CellGraph,
    thickness: &[f64],
    superface: &[u32],
    pieces: &RegionPieces,
    run: &Run,
) -> Result<Vec<Vec<PairSums>>> {
    let superfaces = pieces.region_count();
    let (points, balls) = gather(cells, thickness, superface, superfaces);
    let table = ExpTable::new();
    run.map_ranges(superfaces, CHUNK, |range| {
        let mut sums = dispatch(PairsFrom { range, points: &points, balls: &balls, pieces, table: &table });
        sums.shrink_to_fit();
        Ok(sums)
    })
}

/// Cells ordered by superface, and the superfaces' balls.
fn gather(
    cells: &CellGraph,
    thickness: &[f64],
    superface: &[u32],
    superfaces: usize,
) -> (Vec<CellPoint>, Vec<SuperfaceBall>) {
    let order = order_by(cells.len(), |i, j| superface[i].cmp(&superface[j]));
    let point =
        |&i: &usize| CellPoint { x: cells.centre[i], n: cells.normal[i], area: cells.area[i], thickness: thickness[i] };
    let points: Vec<CellPoint> = order.iter().map(point).collect();
    let mut end = 0;
    let balls = (0..superfaces as u32)
        .map(|a| {
            let start = end;
            end += order[start..].partition_point(|&i| superface[i] == a);
            let inside = &points[start..end];
            let x = std::array::from_fn(|c| inside.iter().map(|p| p.x[c]).sum::<f64>() / inside.len().max(1) as f64);
            let radius = inside.iter().map(|p| square(p.x, x).sqrt()).fold(0.0, f64::max);
            SuperfaceBall { x, radius, start, end }
        })
        .collect();
    (points, balls)
}

#[inline(always)]
fn square(a: [f64; 3], b: [f64; 3]) -> f64 {
    let d = minus(a, b);
    dot(d, d)
}

/// Sums between the superfaces of a range and all later ones of the same piece.
struct PairsFrom<'a> {
    range: Range<usize>,
    points: &'a [CellPoint],
    balls: &'a [SuperfaceBall],
    pieces: &'a RegionPieces,
    table: &'a ExpTable,
}

impl SimdKernel for PairsFrom<'_> {
    type Output = Vec<PairSums>;

    #[inline(always)]
    fn run(self) -> Vec<PairSums> {
        let mut out = Vec::new();
        for a in self.range {
            let (piece, place) = self.pieces.place(a as u32);
            for &b in &self.pieces.regions(piece)[place..] {
                if let Some(sums) = between(self.points, self.balls, a, b as usize, self.table) {
                    out.push(sums);
                }
            }
        }
        out
    }
}

/// Sums between superfaces `a` and `b` ≥ `a`; `None` if all pairs lie beyond the cutoff.
#[inline(always)]
fn between(points: &[CellPoint], balls: &[SuperfaceBall], a: usize, b: usize, table: &ExpTable) -> Option<PairSums> {
    let (one, two) = (&balls[a], &balls[b]);
    let reach = CUT * WIDTHS[2] * (1.0 + 1e-9);
    if square(one.x, two.x) > (reach + one.radius + two.radius).powi(2) {
        return None;
    }
    let near = (reach + two.radius).powi(2);
    let (mut seen, mut all, mut thickness_jump): (PerWidth, PerWidth, PerWidth) = Default::default();
    for (i, p) in points[one.start..one.end].iter().enumerate() {
        if square(p.x, two.x) > near {
            continue;
        }
        let first = if a == b { one.start + i + 1 } else { two.start };
        let (mut row_seen, mut row_all, mut row_jump): (PerWidth, PerWidth, PerWidth) = Default::default();
        for q in &points[first..two.end] {
            let d = [q.x[0] - p.x[0], q.x[1] - p.x[1], q.x[2] - p.x[2]];
            let d2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
            if d2 > table.cut[2] {
                continue;
            }
            let ahead = p.n[0] * d[0] + p.n[1] * d[1] + p.n[2] * d[2];
            let back = -(q.n[0] * d[0] + q.n[1] * d[1] + q.n[2] * d[2]);
            let limit = TOLERANCE * TOLERANCE * d2;
            let sees = |out: f64| out < 0.0 || out * out < limit;
            let convex = if sees(ahead) && sees(back) { q.area } else { 0.0 };
            let differs = (p.thickness - q.thickness).abs() * q.area;
            let weight = table.weights(d2);
            for w in 0..4 {
                row_all[w] += q.area * weight[w];
                row_seen[w] += convex * weight[w];
                row_jump[w] += differs * weight[w];
            }
        }
        for w in 0..4 {
            all[w] += p.area * row_all[w];
            seen[w] += p.area * row_seen[w];
            thickness_jump[w] += p.area * row_jump[w];
        }
    }
    let twice = if a == b { 2.0 } else { 1.0 };
    let sums = |all: PerWidth| [0, 1, 2].map_each(|w| twice * all[w]);
    let (seen, all, thickness_jump) = (sums(seen), sums(all), sums(thickness_jump));
    (all[2] > 0.0).then_some(PairSums { a: a as u32, b: b as u32, seen, all, thickness_jump })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cells on a bumpy sphere of area about 1, and the sums by definition.
    fn bumpy(n: usize) -> CellGraph {
        let mut g = CellGraph::default();
        for i in 0..n {
            let z = 1.0 - (2.0 * i as f64 + 1.0) / n as f64;
            let t = 2.399963 * i as f64;
            let s = (1.0 - z * z).sqrt();
            let r = 0.28 * (1.0 + 0.2 * (5.0 * z).sin());
            g.centre.push([r * s * t.cos(), r * s * t.sin(), r * z]);
            g.normal.push([s * t.cos(), s * t.sin(), z]);
            g.area.push((1.0 + 0.3 * (i as f64).sin()) / n as f64);
        }
        g
    }

    #[test]
    fn sums_equal_the_definition() {
        let g = bumpy(150);
        let superface: Vec<u32> = (0..150).map(|i| i * 7 / 150).collect();
        let thickness: Vec<f64> = (0..150).map(|i| (0.7 * f64::from(i)).sin()).collect();
        let found = convexity(&g, &thickness, &superface, &RegionPieces::whole(7), &Run::new(&())).unwrap();
        let found = found.concat();
        for pair in &found {
            let (mut seen, mut all, mut thickness_jump) = ([0.0; 3], [0.0; 3], [0.0; 3]);
            for p in (0..150).filter(|&p| superface[p] == pair.a) {
                for q in (0..150).filter(|&q| superface[q] == pair.b && q != p) {
                    let d2 = square(g.centre[p], g.centre[q]);
                    let out = |p: usize, q: usize| -> f64 {
                        (0..3).map(|c| g.normal[p][c] * (g.centre[q][c] - g.centre[p][c])).sum()
                    };
                    let sees = out(p, q) < 0.05 * d2.sqrt() && out(q, p) < 0.05 * d2.sqrt();
                    for (w, width) in WIDTHS.iter().enumerate().filter(|(_, w)| d2 <= 16.0 * *w * *w) {
                        let m = g.area[p] * g.area[q] * (-d2 / (2.0 * width * width)).exp();
                        all[w] += m;
                        seen[w] += if sees { m } else { 0.0 };
                        thickness_jump[w] += m * (thickness[p] - thickness[q]).abs();
                    }
                }
            }
            for w in 0..3 {
                assert!((pair.all[w] - all[w]).abs() <= 1e-9 * all[w], "{pair:?} {all:?}");
                assert!((pair.seen[w] - seen[w]).abs() <= 1e-9 * all[w]);
                assert!((pair.thickness_jump[w] - thickness_jump[w]).abs() <= 1e-9 * all[w]);
            }
        }
        assert!(found.len() > 7 && found.iter().any(|p| p.seen[1] < p.all[1]));
    }

    #[test]
    fn threads_change_nothing() {
        let g = bumpy(300);
        let superface: Vec<u32> = (0..300).map(|i| i % 40).collect();
        let with = |threads| {
            convexity(&g, &[0.5; 300], &superface, &RegionPieces::whole(40), &Run { threads, ..Run::new(&()) }).unwrap()
        };
        assert_eq!(with(1), with(3));
    }
}
