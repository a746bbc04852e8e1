//! Regions of cells, represented by sums.
//!
//! Sums over cells ([`Regions`]) add up when regions merge, so no merge has to examine a cell again. The cost of a
//! merge, and the probability that people would make it, are computed from these sums alone ([`super::merge_features`],
//! [`super::merges`]).
//!
//! Cost for R regions, mostly some thirty, hundreds under strong noise: 23 R × R matrices ([`region_bytes`]). Regions
//! without a common boundary never merge: those of an object of loose pieces, perhaps thousands, are summed piece by
//! piece ([`RegionPieces`]).

use super::cell_graph::CellGraph;
use super::convexity::PairSums;
use super::matrix::Square;
use super::region_pieces::RegionPieces;
use crate::base::moments::products;
use crate::base::vector::{MapEach, dot};
use crate::spectral::anchor::AnchorEmbedding;
use crate::spectral::exp::exp64;
use bytemuck::{Pod, Zeroable};

/// Coordinates of the mean embedding stored per region.
pub const EMBEDDING_DIMENSIONS: usize = 12;
/// A boundary's strength is length · exp(−(concave + this · convex angle)/[`FADE`]).
const CONVEX_SHARE: f64 = 0.1;
/// Radians of turning that reduce a boundary's strength by a factor of e.
const FADE: f64 = 0.5;

/// Sums over the cells of a region; all except the area are weighted by it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct CellMoments {
    /// Area A.
    pub area: f64,
    /// A·x of the centroids x.
    pub centre: [f64; 3],
    /// A·(xx, yy, zz, xy, xz, yz).
    pub products: [f64; 6],
    /// A·n of the normals n.
    pub normal: [f64; 3],
    /// A·n·x: three times the volume of the cone to the origin.
    pub height: f64,
    /// A·embedding, padded with zeros.
    pub embedding: [f64; EMBEDDING_DIMENSIONS],
    /// A·ln thickness.
    pub log_thickness: f64,
}

/// The moments of each cell (S), from which region sums are formed. `thickness`: its logarithm (S).
pub fn cell_moments(cells: &CellGraph, embedding: &AnchorEmbedding, thickness: &[f64]) -> Vec<CellMoments> {
    (0..cells.len())
        .map(|i| {
            let (area, x, n) = (cells.area[i], cells.centre[i], cells.normal[i]);
            let point = embedding.point(i);
            let coordinate = |k: usize| if k < embedding.width { point[k] } else { 0.0 };
            CellMoments {
                area,
                centre: x.map(|x| x * area),
                products: products(x).map(|x| x * area),
                normal: n.map(|n| n * area),
                height: dot(n, x) * area,
                embedding: std::array::from_fn(|k| coordinate(k) * area),
                log_thickness: thickness[i] * area,
            }
        })
        .collect()
}

/// A labelling of the cells that is constant on superfaces.
#[derive(Clone, Copy, Debug)]
pub struct RegionLabels<'a> {
    /// Region of each cell (S).
    pub of_cell: &'a [u32],
    /// Region of each superface.
    pub of_superface: &'a [u32],
    /// The pieces by which regions are summed.
    pub pieces: &'a RegionPieces,
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
    /// Pairs of cells that see each other as convex, at one width (on the diagonal each pair counts twice).
    pub seen: Square,
    /// All pairs of cells within the cutoff of that width.
    pub all: Square,
    /// |difference| of the logarithms of thickness over all those pairs.
    pub thickness_jump: Square,
    /// Positions and sharpness of boundaries (R × R, row-major): of common boundaries, and on the diagonal of the pairs
    /// of cells within a region.
    pub edges: Vec<EdgeSums>,
    /// Length of the boundary of each region (R).
    pub perimeter: Vec<f64>,
    /// How folded the whole surface is ([`super::folding::log_folding`]).
    pub log_folding: f64,
}

/// Bytes that the sums over `count` regions take while they are formed and merged.
pub fn region_bytes(count: usize) -> u64 {
    let pair = 8 * size_of::<f64>() + size_of::<EdgeSums>() + size_of::<[f64; 3]>();
    (count * count * pair + count * size_of::<CellMoments>()) as u64
}

/// Concave angles above these count as concave, and as sharp; convex ones above the second as sharp.
const SHARP: [f64; 2] = [0.1, 0.3];

/// Sums over pairs of adjacent cells, weighted by the length of their common boundary.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct EdgeSums {
    /// Length L.
    pub length: f64,
    /// L·x, where x is the midpoint of the cells' centroids.
    pub centre: [f64; 3],
    /// L·(xx, yy, zz, xy, xz, yz).
    pub products: [f64; 6],
    /// L·concave².
    pub squared_concave: f64,
    /// L if the concave angle is above .1.
    pub creased: f64,
    /// L if it is above .3.
    pub sharp: f64,
    /// L·convex.
    pub convex: f64,
    /// L if the convex angle is above .3.
    pub sharply_convex: f64,
}

/// The sums of pair `k` of adjacent cells.
fn edge_sums(cells: &CellGraph, k: usize) -> EdgeSums {
    let [i, j] = cells.pairs[k].map(|i| cells.centre[i as usize]);
    let x: [f64; 3] = std::array::from_fn(|c| 0.5 * (i[c] + j[c]));
    let (length, concave, convex) = (cells.length[k], cells.concave[k], cells.convex[k]);
    let above = |angle: f64, limit: f64| if angle > limit { length } else { 0.0 };
    EdgeSums {
        length,
        centre: x.map(|x| x * length),
        products: products(x).map(|x| x * length),
        squared_concave: concave * concave * length,
        creased: above(concave, SHARP[0]),
        sharp: above(concave, SHARP[1]),
        convex: convex * length,
        sharply_convex: above(convex, SHARP[1]),
    }
}

/// Adds sums field by field.
fn add<T: Pod>(to: &mut T, sums: &T) {
    let to: &mut [f64] = bytemuck::cast_slice_mut(std::slice::from_mut(to));
    to.iter_mut().zip(bytemuck::cast_slice(std::slice::from_ref(sums))).for_each(|(sum, x): (_, &f64)| *sum += x);
}

impl Regions {
    /// Zero sums of `n` regions.
    fn zeros(n: usize) -> Regions {
        let zeros = || Square::zeros(n);
        Regions {
            moments: vec![CellMoments::default(); n],
            strength: zeros(),
            length: zeros(),
            convex: zeros(),
            concave: zeros(),
            boundary_thickness: zeros(),
            seen: zeros(),
            all: zeros(),
            thickness_jump: zeros(),
            edges: vec![EdgeSums::default(); n * n],
            perimeter: vec![0.0; n],
            log_folding: 0.0,
        }
    }

    /// Sums over the regions given by `labels`, for each piece that they lie in.
    ///
    /// `moments` are the cells' own (S), `sums` those between superfaces, in chunks; `width` selects the pair width
    /// among [`super::convexity::WIDTHS`]. The surface is assumed to have no folds.
    pub fn gather(
        cells: &CellGraph,
        moments: &[CellMoments],
        sums: &[Vec<PairSums>],
        labels: RegionLabels<'_>,
        width: usize,
    ) -> Vec<Regions> {
        let RegionLabels { of_cell: region, of_superface, pieces } = labels;
        let mut out: Vec<Regions> = pieces.sizes().map(Regions::zeros).collect();
        for (&r, q) in region.iter().zip(moments) {
            let (piece, place) = pieces.place(r);
            add(&mut out[piece].moments[place], q);
        }
        for (k, &[i, j]) in cells.pairs.iter().enumerate() {
            let [(piece, a), (_, b)] = [i, j].map_each(|i| pieces.place(region[i as usize]));
            let out = &mut out[piece];
            let (n, edge) = (out.len(), edge_sums(cells, k));
            add(&mut out.edges[a * n + b], &edge);
            if a != b {
                add(&mut out.edges[b * n + a], &edge);
                let length = cells.length[k];
                out.perimeter[a] += length;
                out.perimeter[b] += length;
                let turning = cells.concave[k] + CONVEX_SHARE * cells.convex[k];
                out.strength.add_both(a, b, length * exp64(-turning / FADE));
                out.length.add_both(a, b, length);
                out.convex.add_both(a, b, length * cells.convex04[k]);
                out.concave.add_both(a, b, length * cells.concave[k]);
                let thickness = |i: u32| moments[i as usize].log_thickness / moments[i as usize].area;
                out.boundary_thickness.add_both(a, b, length * 0.5 * (thickness(i) + thickness(j)));
            }
        }
        // Both halves of the three matrices sum the same numbers in the same order, so only one half is computed, for
        // all three at once.
        let mut halves: Vec<_> = out.iter().map(|regions| vec![[0.0; 3]; regions.len() * regions.len()]).collect();
        for s in sums.iter().flatten() {
            let [(piece, a), (_, b)] = [s.a, s.b].map_each(|s| pieces.place(of_superface[s as usize]));
            let twice = if a == b && s.a != s.b { 2.0 } else { 1.0 };
            let sum = &mut halves[piece][a.min(b) * out[piece].len() + a.max(b)];
            for (sum, x) in sum.iter_mut().zip([s.seen[width], s.all[width], s.thickness_jump[width]]) {
                *sum += twice * x;
            }
        }
        for (out, half) in out.iter_mut().zip(halves) {
            let n = out.len();
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
        }
        out
    }

    /// Number of regions R.
    pub fn len(&self) -> usize {
        self.moments.len()
    }

    /// Area of region `i`.
    pub fn area(&self, i: usize) -> f64 {
        self.moments[i].area
    }

    /// Sums over the common boundary of `i` and `j`, or within `i` if they are equal.
    pub fn edge(&self, i: usize, j: usize) -> &EdgeSums {
        &self.edges[i * self.len() + j]
    }

    /// Merges region `j` into region `i`; the sums of `j` itself are then stale.
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
        add(&mut self.moments[i], &other);
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
