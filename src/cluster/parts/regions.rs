//! What is known of a region: sums over its cells that add when regions merge.

use super::anchor::Embedding;
use super::cells::CellGraph;
use super::convexity::PairSums;
use super::matrix::Square;

/// Coordinates of the mean embedding kept a region.
pub const EMBEDDED: usize = 12;
/// Numbers kept a region: area, then area times x, xxᵀ, n, n·x, the embedding and the logarithm of the thickness.
pub const COLUMNS: usize = 15 + EMBEDDED;
/// A boundary's strength is length · exp(−(concave + this · convex angle)/[`FADE`]).
const CONVEX_SHARE: f64 = 0.1;
/// Radians of turning over which a boundary loses a factor e of its strength.
const FADE: f64 = 0.5;

/// Per region, area-weighted sums: \[A, A·x (3), A·(xx, yy, zz, xy, xz, yz), A·n (3), A·n·x,
/// A·embedding (12, zeros where there are fewer coordinates), A·ln thickness\].
pub type Columns = [f64; COLUMNS];

/// The columns of each cell (S): what region sums are made of. `thickness`: its logarithm (S).
pub fn cell_columns(cells: &CellGraph, embedding: &Embedding, thickness: &[f64]) -> Vec<Columns> {
    (0..cells.len())
        .map(|i| {
            let (a, x, n) = (cells.area[i], cells.centre[i], cells.normal[i]);
            let mut q = [0.0; COLUMNS];
            q[0] = 1.0;
            q[1..4].copy_from_slice(&x);
            q[4..10].copy_from_slice(&[x[0] * x[0], x[1] * x[1], x[2] * x[2], x[0] * x[1], x[0] * x[2], x[1] * x[2]]);
            q[10..13].copy_from_slice(&n);
            q[13] = n[0] * x[0] + n[1] * x[1] + n[2] * x[2];
            let width = embedding.width.min(EMBEDDED);
            if width > 0 {
                q[14..14 + width].copy_from_slice(&embedding.point(i)[..width]);
            }
            q[COLUMNS - 1] = thickness[i];
            q.map(|v| v * a)
        })
        .collect()
}

/// Sums over R regions and over pairs of them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Regions {
    /// Sums over cells (R).
    pub columns: Vec<Columns>,
    /// Strength of the common boundary: Σ length · exp(−(concave + .1 convex)/.5) (R × R, diagonal 0).
    pub strength: Square,
    /// Length of the common boundary; > 0 exactly for neighbours.
    pub length: Square,
    /// Σ length · convex angle at radius .04.
    pub convex: Square,
    /// Σ length · concave angle.
    pub concave: Square,
    /// Σ length · mean logarithm of the thickness on both sides.
    pub neck: Square,
    /// Pairs of cells that see each other as convex, at one width (diagonal: each pair twice).
    pub seen: Square,
    /// All pairs of cells within the cut of that width.
    pub all: Square,
    /// |difference| of the logarithms of thickness over all those pairs.
    pub step: Square,
}

impl Regions {
    /// Sums over the regions that `region` (below `n`, a cell each) names.
    ///
    /// `sums` are between atoms, of which `of_atom` gives the region; `width` selects the pair
    /// width among [`super::convexity::WIDTHS`].
    pub fn gather(
        cells: &CellGraph,
        columns: &[Columns],
        region: &[u32],
        n: usize,
        sums: &[PairSums],
        of_atom: &[u32],
        width: usize,
    ) -> Regions {
        let zeros = || Square::zeros(n);
        let mut out = Regions {
            columns: vec![[0.0; COLUMNS]; n],
            strength: zeros(),
            length: zeros(),
            convex: zeros(),
            concave: zeros(),
            neck: zeros(),
            seen: zeros(),
            all: zeros(),
            step: zeros(),
        };
        for (&r, q) in region.iter().zip(columns) {
            out.columns[r as usize].iter_mut().zip(q).for_each(|(sum, x)| *sum += x);
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
                let thickness = |i: u32| columns[i as usize][COLUMNS - 1] / columns[i as usize][0];
                out.neck.add_both(a, b, length * 0.5 * (thickness(i) + thickness(j)));
            }
        }
        // Both halves of the three matrices sum the same numbers in the same order: one half of all three at a time.
        let mut half = vec![[0.0; 3]; n * n];
        for s in sums {
            let (a, b) = (of_atom[s.a as usize] as usize, of_atom[s.b as usize] as usize);
            let twice = if a == b && s.a != s.b { 2.0 } else { 1.0 };
            let sum = &mut half[a.min(b) * n + a.max(b)];
            for (sum, x) in sum.iter_mut().zip([s.seen[width], s.all[width], s.step[width]]) {
                *sum += twice * x;
            }
        }
        for a in 0..n {
            for b in a..n {
                let [seen, all, step] = half[a * n + b];
                for (square, x) in [(&mut out.seen, seen), (&mut out.all, all), (&mut out.step, step)] {
                    square[(a, b)] = x;
                    square[(b, a)] = x;
                }
            }
        }
        out
    }

    /// Number of regions R.
    pub fn len(&self) -> usize {
        self.columns.len()
    }

    /// Whether there is no region.
    pub fn is_empty(&self) -> bool {
        self.columns.is_empty()
    }

    /// Area of region `i`.
    pub fn area(&self, i: usize) -> f64 {
        self.columns[i][0]
    }

    /// Adds region `j` to region `i`; `j`'s own sums are then stale.
    pub fn merge(&mut self, i: usize, j: usize) {
        let other = self.columns[j];
        self.columns[i].iter_mut().zip(other).for_each(|(sum, x)| *sum += x);
        let Regions { strength, length, convex, concave, neck, seen, all, step, .. } = self;
        for sums in [seen, all, step] {
            sums.fold(i, j);
        }
        for boundary in [strength, length, convex, concave, neck] {
            boundary.fold(i, j);
            boundary[(i, i)] = 0.0;
        }
    }
}
