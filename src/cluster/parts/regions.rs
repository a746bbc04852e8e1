//! Regions of cells: their sums, what speaks for uniting two of them, and merging all the way down.
//!
//! Sums over cells ([`Regions`]) add up when regions merge, so no merge looks at a cell again.
//!
//! The order of merges: cost = W / min(A)^.75 · conv³ with W the strength of the common boundary, A the
//! areas and conv the share of cell pairs across it that see each other as convex, relative to
//! the regions' own shares, so that the inside of a cup stays whole. The probability that people
//! keep the two in one part is a logistic function of that cost and nine other features, its
//! constants fitted to the human segmentations of half of the Princeton benchmark (Chen,
//! Golovinskiy, Funkhouser, SIGGRAPH 2009). The target of the fit is what most people do at a merge; its weight is
//! how much that matters to the Rand index: |2t − 1| times the pairs it joins (to the
//! power .6, so that few large merges do not decide), t being the share of people who join them.
//! `tools/fit` fits them again.
//!
//! Cost for R regions, some thirty: R costs per merge, R² comparisons at the most; nine R × R matrices.

use super::cell_graph::CellGraph;
use super::convexity::PairSums;
use super::matrix::{Square, eigenvalues3};
use crate::spectral::anchor::AnchorEmbedding;

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
        };
        for (&r, q) in region.iter().zip(moments) {
            out.moments[r as usize].iter_mut().zip(q).for_each(|(sum, x)| *sum += x);
        }
        for (k, &[i, j]) in cells.pairs.iter().enumerate() {
            let (a, b) = (region[i as usize] as usize, region[j as usize] as usize);
            if a != b {
                let length = cells.length[k];
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

    /// Adds region `j` to region `i`; `j`'s own sums are then stale.
    pub fn merge(&mut self, i: usize, j: usize) {
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

/// The logarithm of the cost is clipped to ± this before it enters the probability.
const COST_CLIP: f64 = 6.0;
/// Least height of a region over its own centroid, in units of √(total area).
const HEIGHT_FLOOR: f64 = 0.005;
/// Number of features that the probability is made from.
pub const FEATURES: usize = 10;

/// The constants. The default ones are those of all decisions; others are for fitting them (`tools/fit`).
#[derive(Clone, Debug, PartialEq)]
pub struct MergeModel {
    /// Exponent of the smaller area in the cost.
    pub area_power: f64,
    /// Exponent of the relative convexity in the cost.
    pub convexity_power: f64,
    /// Constant term of the log odds.
    pub constant: f64,
    /// Weights of the [`merge_features`] in the log odds.
    pub weights: [f64; FEATURES],
}

impl Default for MergeModel {
    fn default() -> Self {
        MergeModel {
            area_power: 0.75,
            convexity_power: 3.0,
            constant: -6.581,
            weights: [2.041, 1.444, 0.830, -0.544, -1.553, 1.541, 7.587, -5.470, -6.812, -8.383],
        }
    }
}

fn log(x: f64) -> f64 {
    x.max(1e-6).ln()
}

/// The features of one region that the probability uses.
struct RegionShape {
    length: f64,
    width: f64,
    normal: f64,
    height: f64,
    embedding: [f64; EMBEDDING_DIMENSIONS],
    log_thickness: f64,
}

impl RegionShape {
    fn of(q: &CellMoments) -> RegionShape {
        let a = q[0].max(1e-300);
        let x: [f64; 3] = std::array::from_fn(|c| q[1 + c] / a);
        let n: [f64; 3] = std::array::from_fn(|c| q[10 + c] / a);
        let product = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];
        let e = eigenvalues3(std::array::from_fn(|k| q[4 + k] / a - x[product[k].0] * x[product[k].1]));
        let root = |v: f64| v.max(1e-8).sqrt();
        RegionShape {
            length: root(e[0]),
            width: root(e[1]),
            normal: (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt(),
            height: q[13] / a - (n[0] * x[0] + n[1] * x[1] + n[2] * x[2]),
            embedding: std::array::from_fn(|k| q[14 + k] / a),
            log_thickness: q[MOMENTS - 1] / a,
        }
    }
}

/// What the probability uses of the common boundary of two regions: means along it.
struct SharedBoundary {
    length: f64,
    convex: f64,
    concave: f64,
    log_thickness: f64,
    thickness_jump: f64,
}

impl SharedBoundary {
    fn of(r: &Regions, i: usize, j: usize) -> SharedBoundary {
        let length = r.length[(i, j)];
        let mean = |sum: f64| sum / length.max(1e-300);
        SharedBoundary {
            length,
            convex: mean(r.convex[(i, j)]),
            concave: mean(r.concave[(i, j)]),
            log_thickness: mean(r.boundary_thickness[(i, j)]),
            thickness_jump: (r.thickness_jump[(i, j)] + 1e-12) / (r.all[(i, j)] + 1e-11),
        }
    }
}

/// The ten features of uniting neighbours `i` and `j` with the given logarithm of the cost: that, clipped; cosine of
/// the mean embeddings; length of the smaller's mean normal (open patch 1, closed limb 0); |ln| of the ratio of widths;
/// ln of the larger's length; ln of boundary over the smaller's height; mean convex angle of the boundary; root of the
/// mean |difference| of ln thickness between cells on either side of it; its mean concave angle; ln of how much thinner
/// the body is along it than in the thinner of the two (≤ 0).
pub fn merge_features(r: &Regions, i: usize, j: usize, log_cost: f64) -> [f64; FEATURES] {
    let (i, j) = if r.area(i) <= r.area(j) { (i, j) } else { (j, i) };
    let boundary = SharedBoundary::of(r, i, j);
    let (a, b) = (RegionShape::of(&r.moments[i]), RegionShape::of(&r.moments[j]));
    let inner = |x: &[f64; EMBEDDING_DIMENSIONS], y: &[f64; EMBEDDING_DIMENSIONS]| {
        x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>()
    };
    let norm = inner(&a.embedding, &a.embedding).sqrt() * inner(&b.embedding, &b.embedding).sqrt();
    [
        log_cost.clamp(-COST_CLIP, COST_CLIP),
        inner(&a.embedding, &b.embedding) / norm.max(1e-9),
        a.normal,
        (a.width / b.width).ln().abs(),
        b.length.ln(),
        (boundary.length.max(1e-6) / a.height.max(HEIGHT_FLOOR)).ln(),
        boundary.convex,
        boundary.thickness_jump.sqrt(),
        boundary.concave,
        (boundary.log_thickness - a.log_thickness.min(b.log_thickness)).min(0.0),
    ]
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
        let z = self.constant + features.iter().zip(&self.weights).map(|(x, w)| x * w).sum::<f64>();
        1.0 / (1.0 + (-z).exp())
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
