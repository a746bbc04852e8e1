//! The features from which the probability of a merge is computed: measures of two regions and of their common
//! boundary.
//!
//! All are independent of the mesh's size and position. The first ten describe how strong and how sharp the boundary is
//! and the shapes of the two regions; the others describe its share of the regions' perimeters, how much the regions
//! see each other, the shape of the boundary as a curve, the variation of its angles, and the creases within the
//! regions.
//!
//! Cost: constant per merge.

use super::matrix::Square;
use super::regions::{CellMoments, EMBEDDING_DIMENSIONS, EdgeSums, Regions};
use crate::base::moments;
use crate::base::vector::dot;
use libm::log as ln;

/// The logarithm of the cost is clipped to ± this value before use.
const COST_CLIP: f64 = 6.0;
/// Minimum height of a region over its own centroid, in units of √(total area).
const HEIGHT_FLOOR: f64 = 0.005;
/// Number of features.
pub const FEATURES: usize = 30;
/// Index of the feature ln of a boundary's length over its extent.
const CURVE_LENGTH: usize = 18;

/// The logarithm of a value that may be 0.
pub(super) fn log(x: f64) -> f64 {
    ln(x.max(1e-6))
}

/// Square roots of the eigenvalues, greatest first, of a distribution with the given means of x and of its products.
fn extents(mean: [f64; 3], products: [f64; 6]) -> [f64; 3] {
    let e = moments::eigenvalues(moments::about_mean(mean, products));
    e.map(|v| v.max(1e-8).sqrt())
}

/// The features of one region.
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
        let a = q.area.max(1e-300);
        let (x, n) = (q.centre.map(|x| x / a), q.normal.map(|n| n / a));
        let [length, width, _] = extents(x, q.products.map(|x| x / a));
        RegionShape {
            length,
            width,
            normal: dot(n, n).sqrt(),
            height: q.height / a - dot(n, x),
            embedding: q.embedding.map(|x| x / a),
            log_thickness: q.log_thickness / a,
        }
    }
}

/// The features of the common boundary of two regions: means along it.
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

/// The shape of a boundary as a curve, and the variation of its angles: ln of its second and of its third extent over
/// the first (0 and very small: a flat ring); ln of its length over its extent; deviation of the concave angle; share
/// of it that is concave, and sharply so; mean convex angle at radius .02; share of it that is sharply convex.
fn curve(sums: &EdgeSums, concave: f64) -> [f64; 8] {
    let length = sums.length.max(1e-12);
    let [first, second, third] = extents(sums.centre.map(|x| x / length), sums.products.map(|x| x / length));
    [
        log(second / first),
        log(third / first),
        log(sums.length / first),
        (sums.squared_concave / length - concave * concave).max(0.0).sqrt(),
        sums.creased / length,
        sums.sharp / length,
        sums.convex / length,
        sums.sharply_convex / length,
    ]
}

/// The creases within a region: mean squared concave angle, concave share, mean convex angle.
fn creases(sums: &EdgeSums) -> [f64; 3] {
    [sums.squared_concave, sums.creased, sums.convex].map(|sum| sum / sums.length.max(1e-9))
}

/// The features of merging neighbours `i` and `j` with the given logarithm of the cost, in this order:
///
/// - 0: that logarithm, clipped; 1: cosine of the mean embeddings;
/// - 2: length of the smaller's mean normal (open patch 1, closed limb 0); 3: |ln| of the ratio of widths; 4: ln of the
///   larger's length; 5: ln of boundary over the smaller's height;
/// - 6: mean convex angle of the boundary at radius .04; 7: root of the mean |difference| of ln thickness between cells
///   on either side of it; 8: its mean concave angle; 9: ln of how much thinner the body is along it than in the
///   thinner of the two (≤ 0);
/// - 10: the boundary's share of the smaller's perimeter, 11: of the larger's; 12: share of pairs of cells that see
///   each other as convex across the boundary, 13 and 14: within the smaller and the larger, 15: within both together;
/// - 16 to 23: its shape as a curve and the variation of its angles; 24 to 29: the creases within the two.
///
/// On a folded surface the lengths in 0, 4, 5 and 18 are those of the unfolded shape.
pub fn merge_features(r: &Regions, i: usize, j: usize, log_cost: f64) -> [f64; FEATURES] {
    let (i, j) = if r.area(i) <= r.area(j) { (i, j) } else { (j, i) };
    let boundary = SharedBoundary::of(r, i, j);
    let (a, b) = (RegionShape::of(&r.moments[i]), RegionShape::of(&r.moments[j]));
    let inner = |x: &[f64; EMBEDDING_DIMENSIONS], y: &[f64; EMBEDDING_DIMENSIONS]| {
        x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>()
    };
    let norm = inner(&a.embedding, &a.embedding).sqrt() * inner(&b.embedding, &b.embedding).sqrt();
    let share = |seen: f64, all: f64| (seen + 1e-12) / (all + 1e-12);
    let both = |sums: &Square| sums[(i, i)] + sums[(j, j)] + 2.0 * sums[(i, j)];
    let main = [
        (log_cost - 0.5 * r.log_folding).clamp(-COST_CLIP, COST_CLIP),
        inner(&a.embedding, &b.embedding) / norm.max(1e-9),
        a.normal,
        ln(a.width / b.width).abs(),
        ln(b.length) + 0.5 * r.log_folding,
        ln(boundary.length.max(1e-6) / a.height.max(HEIGHT_FLOOR)) - r.log_folding,
        boundary.convex,
        boundary.thickness_jump.sqrt(),
        boundary.concave,
        (boundary.log_thickness - a.log_thickness.min(b.log_thickness)).min(0.0),
        boundary.length / r.perimeter[i].max(1e-9),
        boundary.length / r.perimeter[j].max(1e-9),
        share(r.seen[(i, j)], r.all[(i, j)]),
        share(r.seen[(i, i)], r.all[(i, i)]),
        share(r.seen[(j, j)], r.all[(j, j)]),
        share(both(&r.seen), both(&r.all)),
    ];
    let rest =
        curve(r.edge(i, j), boundary.concave).into_iter().chain(creases(r.edge(i, i))).chain(creases(r.edge(j, j)));
    let mut out = [0.0; FEATURES];
    out.iter_mut().zip(main.into_iter().chain(rest)).for_each(|(slot, x)| *slot = x);
    out[CURVE_LENGTH] -= r.log_folding;
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cluster::parts::CellGraph;
    use crate::cluster::parts::convexity::WIDTHS;
    use crate::cluster::parts::region_pieces::RegionPieces;
    use crate::cluster::parts::regions::{RegionLabels, cell_moments};
    use crate::spectral::anchor::AnchorEmbedding;

    #[test]
    fn folds_change_lengths_alone() {
        let cells = CellGraph {
            area: vec![0.25; 4],
            centre: (0..4).map(|i| [0.5 * f64::from(i), 0.1 * f64::from(i % 2), 0.0]).collect(),
            normal: vec![[0.0, 0.0, 1.0]; 4],
            pairs: vec![[0, 1], [1, 2], [2, 3]],
            length: vec![0.5; 3],
            concave: vec![0.1, 0.5, 0.0],
            convex: vec![0.0; 3],
            convex04: vec![0.0; 3],
            ..CellGraph::default()
        };
        let embedding = AnchorEmbedding { values: vec![1.0; 4], width: 1 };
        let label = [0, 0, 1, 1];
        let labels = RegionLabels { of_cell: &label, of_superface: &label, pieces: &RegionPieces::whole(2) };
        let moments = cell_moments(&cells, &embedding, &[0.0; 4]);
        let regions = Regions::gather(&cells, &moments, &[], labels, WIDTHS.len() - 1).remove(0);
        let flat = merge_features(&regions, 0, 1, 2.0);
        let folded = merge_features(&Regions { log_folding: 0.8, ..regions }, 0, 1, 2.0);
        let change: Vec<_> = (0..FEATURES).map(|k| (k, folded[k] - flat[k])).filter(|(_, x)| *x != 0.0).collect();
        let wanted = [(0, -0.4), (4, 0.4), (5, -0.8), (18, -0.8)];
        assert_eq!(change.len(), wanted.len(), "{change:?}");
        for ((k, x), (l, y)) in change.into_iter().zip(wanted) {
            assert!(k == l && (x - y).abs() < 1e-12, "{k}: {x}");
        }
    }
}
