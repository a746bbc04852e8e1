//! Regions of cells: their sums, what speaks for uniting two of them, and merging all the way down.
//!
//! Sums over cells ([`Regions`]) add up when regions merge, so no merge looks at a cell again.
//!
//! The order of merges: cost = W / min(A)^.75 · conv³ with W the strength of the common boundary, A the
//! areas and conv the share of cell pairs across it that see each other as convex, relative to
//! the regions' own shares, so that the inside of a cup stays whole. The probability that people
//! keep the two in one part comes from boosted trees ([`super::merge_odds`]) over that cost and other features of both regions and
//! of their boundary ([`super::merge_features`]).
//!
//! Cost for R regions, some thirty: R costs per merge, R² comparisons at the most; 23 R × R matrices.

use super::cell_graph::CellGraph;
use super::convexity::PairSums;
use super::matrix::Square;
use super::merge_features::{FEATURES, merge_features};
use super::merge_odds::BoostedTrees;
use crate::spectral::anchor::AnchorEmbedding;
use std::borrow::Cow;

/// Coordinates of the mean embedding kept per region.
pub const EMBEDDING_DIMENSIONS: usize = 12;
/// Numbers kept per region: area, then area times x, xxᵀ, n, n·x, the embedding and the logarithm of the thickness.
pub const MOMENTS: usize = 15 + EMBEDDING_DIMENSIONS;
/// A boundary's strength is length · exp(−(concave + this · convex angle)/[`FADE`]).
const CONVEX_SHARE: f64 = 0.1;
/// Radians of turning over which a boundary loses a factor e of its strength.
const FADE: f64 = 0.5;

/// Per region, area-weighted sums: \[A, A·x (3), A·(xx, yy, zz, xy, xz, yz), A·n (3), A·n·x,
/// A·embedding (12, zeros where there are fewer coordinates), A·ln thickness\].
pub type CellMoments = [f64; MOMENTS];

/// The moments of each cell (S): what region sums are made of. `thickness`: its logarithm (S).
pub fn cell_moments(cells: &CellGraph, embedding: &AnchorEmbedding, thickness: &[f64]) -> Vec<CellMoments> {
    (0..cells.len())
        .map(|i| {
            let (a, x, n) = (cells.area[i], cells.centre[i], cells.normal[i]);
            let mut q = [0.0; MOMENTS];
            q[0] = 1.0;
            q[1..4].copy_from_slice(&x);
            q[4..10].copy_from_slice(&[x[0] * x[0], x[1] * x[1], x[2] * x[2], x[0] * x[1], x[0] * x[2], x[1] * x[2]]);
            q[10..13].copy_from_slice(&n);
            q[13] = n[0] * x[0] + n[1] * x[1] + n[2] * x[2];
            let width = embedding.width.min(EMBEDDING_DIMENSIONS);
            if width > 0 {
                q[14..14 + width].copy_from_slice(&embedding.point(i)[..width]);
            }
            q[MOMENTS - 1] = thickness[i];
            q.map(|v| v * a)
        })
        .collect()
}

/// A labelling of the cells that is constant on superfaces.
#[derive(Clone, Copy, Debug)]
pub struct RegionLabels<'a> {
    /// Region of each cell (S), below `count`.
    pub of_cell: &'a [u32],
    /// Region of each superface.
    pub of_superface: &'a [u32],
    /// Number of regions R.
    pub count: usize,
}

/// Sums over R regions and over pairs of them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Regions {
    /// Sums over cells (R).
    pub moments: Vec<CellMoments>,
    /// Strength of the common boundary: Σ length · exp(−(concave + .1 convex)/.5) (R × R, diagonal 0).
    pub strength: Square,
    /// Length of the common boundary; > 0 exactly for neighbours.
    pub length: Square,
    /// Σ length · convex angle at radius .04.
    pub convex: Square,
    /// Σ length · concave angle.
    pub concave: Square,
    /// Σ length · mean logarithm of the thickness on both sides.
    pub boundary_thickness: Square,
    /// Pairs of cells that see each other as convex, at one width (diagonal: each pair twice).
    pub seen: Square,
    /// All pairs of cells within the cut of that width.
    pub all: Square,
    /// |difference| of the logarithms of thickness over all those pairs.
    pub thickness_jump: Square,
    /// Where and how sharp boundaries are (R × R, row-major): of the common boundary, and on the diagonal of the pairs of cells
    /// within a region.
    pub edges: Vec<EdgeSums>,
    /// Length of the boundary of each region (R).
    pub perimeter: Vec<f64>,
}

/// Numbers of [`EdgeSums`].
const EDGE_SUMS: usize = 15;
/// Concave angles above these count as concave, and as sharp; convex ones above the second as convex.
const SHARP: [f64; 2] = [0.1, 0.3];

/// Sums over pairs of touching cells, by the length of their common boundary L: \[L, L·x (3), L·(xx, yy, zz, xy, xz, yz),
/// L·concave², L where concave > .1, L where concave > .3, L·convex, L where convex > .3\], x being the middle between the
/// cells' centroids.
pub type EdgeSums = [f64; EDGE_SUMS];

/// The sums of pair `k` of touching cells.
fn edge_sums(cells: &CellGraph, k: usize) -> EdgeSums {
    let [i, j] = cells.pairs[k].map(|i| cells.centre[i as usize]);
    let x: [f64; 3] = std::array::from_fn(|c| 0.5 * (i[c] + j[c]));
    let (concave, convex) = (cells.concave[k], cells.convex[k]);
    let above = |angle: f64, limit: f64| f64::from(u8::from(angle > limit));
    [
        1.0,
        x[0],
        x[1],
        x[2],
        x[0] * x[0],
        x[1] * x[1],
        x[2] * x[2],
        x[0] * x[1],
        x[0] * x[2],
        x[1] * x[2],
        concave * concave,
        above(concave, SHARP[0]),
        above(concave, SHARP[1]),
        convex,
        above(convex, SHARP[1]),
    ]
    .map(|sum| sum * cells.length[k])
}

fn add(to: &mut EdgeSums, sums: &EdgeSums) {
    to.iter_mut().zip(sums).for_each(|(sum, x)| *sum += x);
}

impl Regions {
    /// Sums over the regions that `labels` name.
    ///
    /// `moments` are the cells' own (S), `sums` those between superfaces; `width` selects the pair width among
    /// [`super::convexity::WIDTHS`].
    pub fn gather(
        cells: &CellGraph,
        moments: &[CellMoments],
        sums: &[PairSums],
        labels: RegionLabels<'_>,
        width: usize,
    ) -> Regions {
        let RegionLabels { of_cell: region, of_superface, count: n } = labels;
        let zeros = || Square::zeros(n);
        let mut out = Regions {
            moments: vec![[0.0; MOMENTS]; n],
            strength: zeros(),
            length: zeros(),
            convex: zeros(),
            concave: zeros(),
            boundary_thickness: zeros(),
            seen: zeros(),
            all: zeros(),
            thickness_jump: zeros(),
            edges: vec![[0.0; EDGE_SUMS]; n * n],
            perimeter: vec![0.0; n],
        };
        for (&r, q) in region.iter().zip(moments) {
            out.moments[r as usize].iter_mut().zip(q).for_each(|(sum, x)| *sum += x);
        }
        for (k, &[i, j]) in cells.pairs.iter().enumerate() {
            let (a, b) = (region[i as usize] as usize, region[j as usize] as usize);
            let edge = edge_sums(cells, k);
            add(&mut out.edges[a * n + b], &edge);
            if a != b {
                add(&mut out.edges[b * n + a], &edge);
                let length = cells.length[k];
                out.perimeter[a] += length;
                out.perimeter[b] += length;
                let turning = cells.concave[k] + CONVEX_SHARE * cells.convex[k];
                out.strength.add_both(a, b, length * (-turning / FADE).exp());
                out.length.add_both(a, b, length);
                out.convex.add_both(a, b, length * cells.convex04[k]);
                out.concave.add_both(a, b, length * cells.concave[k]);
                let thickness = |i: u32| moments[i as usize][MOMENTS - 1] / moments[i as usize][0];
                out.boundary_thickness.add_both(a, b, length * 0.5 * (thickness(i) + thickness(j)));
            }
        }
        // Both halves of the three matrices sum the same numbers in the same order: one half of all three at a time.
        let mut half = vec![[0.0; 3]; n * n];
        for s in sums {
            let (a, b) = (of_superface[s.a as usize] as usize, of_superface[s.b as usize] as usize);
            let twice = if a == b && s.a != s.b { 2.0 } else { 1.0 };
            let sum = &mut half[a.min(b) * n + a.max(b)];
            for (sum, x) in sum.iter_mut().zip([s.seen[width], s.all[width], s.thickness_jump[width]]) {
                *sum += twice * x;
            }
        }
        for a in 0..n {
            for b in a..n {
                let [seen, all, thickness_jump] = half[a * n + b];
                for (square, x) in
                    [(&mut out.seen, seen), (&mut out.all, all), (&mut out.thickness_jump, thickness_jump)]
                {
                    square[(a, b)] = x;
                    square[(b, a)] = x;
                }
            }
        }
        out
    }

    /// Number of regions R.
    pub fn len(&self) -> usize {
        self.moments.len()
    }

    /// Whether there is no region.
    pub fn is_empty(&self) -> bool {
        self.moments.is_empty()
    }

    /// Area of region `i`.
    pub fn area(&self, i: usize) -> f64 {
        self.moments[i][0]
    }

    /// Sums over the common boundary of `i` and `j`, or within `i` where they are the same.
    pub fn edge(&self, i: usize, j: usize) -> &EdgeSums {
        &self.edges[i * self.len() + j]
    }

    /// Adds region `j` to region `i`; `j`'s own sums are then stale.
    pub fn merge(&mut self, i: usize, j: usize) {
        let n = self.len();
        self.perimeter[i] = (self.perimeter[i] + self.perimeter[j] - 2.0 * self.length[(i, j)]).max(0.0);
        let (common, within) = (*self.edge(i, j), *self.edge(j, j));
        add(&mut self.edges[i * n + i], &common);
        add(&mut self.edges[i * n + i], &within);
        for k in (0..n).filter(|&k| k != i && k != j) {
            let other = *self.edge(j, k);
            add(&mut self.edges[i * n + k], &other);
            self.edges[k * n + i] = self.edges[i * n + k];
        }
        let other = self.moments[j];
        self.moments[i].iter_mut().zip(other).for_each(|(sum, x)| *sum += x);
        let Regions { strength, length, convex, concave, boundary_thickness, seen, all, thickness_jump, .. } = self;
        for sums in [seen, all, thickness_jump] {
            sums.fold(i, j);
        }
        for boundary in [strength, length, convex, concave, boundary_thickness] {
            boundary.fold(i, j);
            boundary[(i, i)] = 0.0;
        }
    }
}

/// What decides the order of merges and their probabilities. The default is that of all decisions; others are for fitting
/// (`tools/fit`).
#[derive(Clone, Debug, PartialEq)]
pub struct MergeModel {
    /// Exponent of the smaller area in the cost.
    pub area_power: f64,
    /// Exponent of the relative convexity in the cost.
    pub convexity_power: f64,
    /// Log odds that people keep two regions together, of the [`merge_features`].
    pub odds: Cow<'static, BoostedTrees>,
}

impl Default for MergeModel {
    fn default() -> Self {
        MergeModel { area_power: 0.75, convexity_power: 3.0, odds: Cow::Borrowed(BoostedTrees::fitted()) }
    }
}

fn log(x: f64) -> f64 {
    x.max(1e-6).ln()
}

impl MergeModel {
    /// Natural logarithm of the cost of uniting regions `i` and `j`: the greater the sooner.
    pub fn log_cost(&self, r: &Regions, i: usize, j: usize) -> f64 {
        let share = |a: usize, b: usize, e: f64| (r.seen[(a, b)] + e) / (r.all[(a, b)] + e);
        let own = share(i, i, 1e-9) * share(j, j, 1e-9);
        let conv = (share(i, j, 1e-12) / own.sqrt().max(1e-12)).min(1.0);
        log(r.strength[(i, j)]) - self.area_power * log(r.area(i).min(r.area(j))) + self.convexity_power * log(conv)
    }

    /// Probability that people keep two regions with such [`merge_features`] in one part.
    pub fn probability(&self, features: &[f64; FEATURES]) -> f64 {
        1.0 / (1.0 + (-self.odds.log_odds(features)).exp())
    }
}

/// One union: region `j` goes into region `i` < `j`, which keeps its name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegionMerge {
    /// The region that stays.
    pub i: usize,
    /// The region that ends.
    pub j: usize,
    /// Natural logarithm of the cost at which they merged.
    pub log_cost: f64,
    /// What the probability is made from.
    pub features: [f64; FEATURES],
    /// Probability that people keep them in one part.
    pub probability: f64,
}

/// All merges in order, until no two regions touch or `stop(ln cost, regions left)` says so.
pub fn merges(mut r: Regions, model: &MergeModel, mut stop: impl FnMut(f64, usize) -> bool) -> Vec<RegionMerge> {
    let n = r.len();
    let mut alive = vec![true; n];
    let mut cost = Square::from_values(n, vec![f64::NEG_INFINITY; n * n]);
    for i in 0..n {
        for j in (i + 1..n).filter(|&j| r.length[(i, j)] > 0.0) {
            cost[(i, j)] = model.log_cost(&r, i, j);
        }
    }
    // The greatest of each row right of the diagonal; rows are rescanned only when theirs changes.
    let scan = |cost: &Square, i: usize| {
        let mut best = (f64::NEG_INFINITY, n);
        for (j, &c) in cost.row(i).iter().enumerate().skip(i + 1) {
            if c > best.0 {
                best = (c, j);
            }
        }
        best
    };
    let mut best: Vec<(f64, usize)> = (0..n).map(|i| scan(&cost, i)).collect();
    let mut out = Vec::new();
    loop {
        let mut top = (f64::NEG_INFINITY, n, n);
        for (i, &(c, j)) in best.iter().enumerate() {
            if c > top.0 {
                top = (c, i, j);
            }
        }
        let (c, i, j) = top;
        if j == n || stop(c, n - out.len()) {
            return out;
        }
        let features = merge_features(&r, i, j, c);
        out.push(RegionMerge { i, j, log_cost: c, features, probability: model.probability(&features) });
        r.merge(i, j);
        alive[j] = false;
        for k in 0..n {
            for e in [i, j] {
                cost[(e.min(k), e.max(k))] = f64::NEG_INFINITY;
            }
        }
        for k in (0..n).filter(|&k| k != i && alive[k] && r.length[(i, k)] > 0.0) {
            cost[(i.min(k), i.max(k))] = model.log_cost(&r, i, k);
        }
        best[j] = (f64::NEG_INFINITY, n);
        best[i] = scan(&cost, i);
        for k in (0..n).filter(|&k| k != i && alive[k]) {
            let fresh = if k < i { cost[(k, i)] } else { f64::NEG_INFINITY };
            if best[k].1 == i || best[k].1 == j {
                best[k] = scan(&cost, k);
            } else if fresh > best[k].0 || (fresh == best[k].0 && fresh > f64::NEG_INFINITY && i < best[k].1) {
                best[k] = (fresh, i);
            }
        }
    }
}

/// The probability at the lowest common merge of any two of `n` regions: 1 on the diagonal, 0
/// for regions that never meet.
pub fn meeting_probability(n: usize, merges: &[RegionMerge]) -> Square {
    let mut p = Square::zeros(n);
    let mut merged_into: Vec<Vec<usize>> = (0..n).map(|i| vec![i]).collect();
    for i in 0..n {
        p[(i, i)] = 1.0;
    }
    for m in merges {
        let joined = std::mem::take(&mut merged_into[m.j]);
        for &a in &merged_into[m.i] {
            for &b in &joined {
                p[(a, b)] = m.probability;
                p[(b, a)] = m.probability;
            }
        }
        merged_into[m.i].extend(joined);
    }
    p
}

/// The class of each of `n` regions after the first merges, named by its least region.
pub fn classes_after(n: usize, merges: &[RegionMerge]) -> Vec<u32> {
    let mut into: Vec<u32> = (0..n as u32).collect();
    for m in merges {
        into.iter_mut().filter(|k| **k == m.j as u32).for_each(|k| *k = m.i as u32);
    }
    into
}
