//! The share of people who would have a given part: small for bands, slivers and crumbs, and for patches of a surface
//! without clear parts.
//!
//! A logistic function of a part's mean confidence and of its width, fitted to the parts that the program finds on the
//! Princeton benchmark. Its target is the share of people whose segmentation has such a part: one that overlaps it by
//! more than half of their union. Two measures suffice: the confidence shows whether the boundary is essential to the
//! decision, the width whether the part is one that people name. Adding area, compactness and neighbours predicted no
//! better on held-out models.
//!
//! It is reported, and [`super::ambiguous`] uses it to select patches. Cost: a pass over the cells.
//!
//! Also here: the certainty of a superface's label ([`confidence`]), in R² steps from the co-association, and the share
//! of pairs of points on which people are expected to differ from a segmentation ([`disagreement`]).

use super::cell_labels::class_sums;
use super::ensemble::Superfaces;
use super::hierarchy::PartTree;
use super::matrix::Square;
use crate::spectral::exp::logistic;
use libm::log as ln;

/// Below this share a part is uncertain: most people would not have it.
pub const UNSURE: f64 = 0.5;
/// Area-weighted mean share of people below which a surface may have no clear parts, and the [`disagreement`] above
/// which it then has none. Plates have surer parts than terrain, bodies less disagreement.
const UNCLEAR: (f64, f64) = (0.725, 0.155);
/// Constant, coefficient of the confidence, coefficient of the logarithm of the width.
const FITTED: [f64; 3] = [0.68, 3.28, 0.96];
/// Constant and factor that convert the disagreement expected by the ensemble to that of people.
const PEOPLE: [f64; 2] = [0.04, 1.27];
/// Widths are clamped to this range: a part with no boundary has no width.
const WIDTHS: [f64; 2] = [1e-3, 1.];

/// The share of people, 0 to 1, expected to have a part of mean confidence `confidence`, 0 to 1, and `width`: twice its
/// area over the length of its boundary with other parts, in units of the square root of the total area.
pub fn expected(confidence: f64, width: f64) -> f64 {
    let [constant, sure, wide] = FITTED;
    logistic(constant + sure * confidence + wide * ln(width.clamp(WIDTHS[0], WIDTHS[1])))
}

/// Whether people would agree on the parts of a surface, of which they are expected to have this area-weighted mean
/// share and about which this [`disagreement`] is expected.
pub fn is_clear(mean_share: f64, disagreement: f64) -> bool {
    mean_share >= UNCLEAR.0 || disagreement <= UNCLEAR.1
}

/// The share of pairs of points, 0 to 1, on which a person is expected to differ, given the ensemble's own estimate
/// `expected`.
///
/// The probabilities of merges are fitted to the decision of the majority, not to the share of people who make it, and
/// people draw boundaries in different places. The ensemble is therefore overconfident: its estimate is about two
/// fifths of the actual disagreement, and close to 0 where people still differ by .04. A line corrects that, fitted to
/// the parts found on the Princeton benchmark and validated on held-out categories; a power is no better.
pub fn disagreement(expected: f64) -> f64 {
    let [least, factor] = PEOPLE;
    (least + factor * expected).min(1.)
}

/// [`expected`] for each of the `parts` given by `label` (S) on the cells of `tree`, whose labels have this
/// `confidence` (S) and which have these `shares` of the area (S).
pub(super) fn of_parts(tree: &PartTree, label: &[u32], parts: usize, confidence: &[f64], shares: &[f64]) -> Vec<f64> {
    let mut boundary = vec![0.; parts];
    for (&[i, j], &length) in tree.pairs.iter().zip(&tree.length) {
        let (a, b) = (label[i as usize] as usize, label[j as usize] as usize);
        if a != b {
            boundary[a] += f64::from(length);
            boundary[b] += f64::from(length);
        }
    }
    of_boundaries(label, confidence, shares, &boundary)
}

/// [`expected`] for each part of the labels `label` of arbitrary pieces of a surface with this `confidence` and these
/// `shares` of the area; `boundary` is the length of each part's boundary with others.
pub(super) fn of_boundaries(label: &[u32], confidence: &[f64], shares: &[f64], boundary: &[f64]) -> Vec<f64> {
    let sure: Vec<f64> = confidence.iter().zip(shares).map(|(c, a)| c * a).collect();
    let parts = boundary.len();
    let (sure, area) = (class_sums(label, &sure, parts), class_sums(label, shares, parts));
    (0..parts).map(|k| expected(sure[k] / area[k].max(1e-300), 2. * area[k] / boundary[k].max(1e-9))).collect()
}

/// The certainty of each superface's label: its mean C to the rest of its own part minus the greatest mean to another
/// part, clamped to \[0, 1\].
pub fn confidence(superfaces: &Superfaces, co_association: &Square, label: &[u32], parts: usize) -> Vec<f64> {
    let area = class_sums(label, &superfaces.area, parts);
    let mut weighted = vec![0.; superfaces.len()];
    (0..superfaces.len())
        .map(|i| {
            for ((x, c), a) in weighted.iter_mut().zip(co_association.row(i)).zip(&superfaces.area) {
                *x = c * a;
            }
            weighted[i] = 0.0;
            let pull = class_sums(label, &weighted, parts);
            let own = label[i] as usize;
            let rest = area[own] - superfaces.area[i];
            let inside = if rest > 1e-12 * area[own] { pull[own] / rest } else { 1.0 };
            let outside = (0..parts).filter(|&k| k != own && area[k] > 0.0).map(|k| pull[k] / area[k]);
            (inside - outside.fold(0.0, f64::max)).clamp(0.0, 1.0)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::cell_graph::CellGraph;
    use super::*;

    #[test]
    fn people_differ_more_than_the_ensemble_expects() {
        assert_eq!([disagreement(0.), disagreement(1.)], [PEOPLE[0], 1.]);
        // Fifths of the benchmark's models: the ensemble's expectation, and the measured 1 − Rand to people.
        for (expected, found) in [(0.0052, 0.042), (0.0136, 0.060), (0.0235, 0.071), (0.0382, 0.083), (0.0717, 0.137)] {
            assert!((disagreement(expected) - found).abs() < 0.01, "{expected}: {}", disagreement(expected));
        }
    }

    #[test]
    fn terrain_is_unclear_and_plates_and_bodies_are_not() {
        // A mountain, a flat starfish and a dragon: mean share of people, and expected disagreement.
        assert_eq!([(0.709, 0.179), (0.729, 0.346), (0.565, 0.133)].map(|(a, b)| is_clear(a, b)), [false, true, true]);
    }

    #[test]
    fn narrow_and_doubtful_parts_are_expected_of_fewer_people() {
        assert!(expected(0.9, 0.4) > 0.9 && expected(0.2, 0.05) < 0.2);
        assert!(expected(0.5, 0.3) > expected(0.4, 0.3) && expected(0.5, 0.3) > expected(0.5, 0.1));
        assert_eq!([expected(0.5, 0.), expected(0.5, f64::INFINITY)], [expected(0.5, 1e-3), expected(0.5, 1.)]);
        // Four cells in a row: a narrow one between wide ones, and an isolated one.
        let cells = CellGraph {
            area: vec![0.4, 0.02, 0.38, 0.2],
            pairs: vec![[0, 1], [1, 2]],
            length: vec![0.5; 2],
            ..CellGraph::default()
        };
        let tree = PartTree::new(&cells, [], 0.003);
        let all = of_parts(&tree, &[0, 1, 2, 3], 4, &[0.8; 4], &cells.area);
        let near = |k: usize, width: f64| (all[k] - expected(0.8, width)).abs() < 1e-6;
        assert!(near(0, 1.6) && near(1, 0.04) && near(2, 1.52) && near(3, 1.), "{all:?}");
        assert!(all[1] < UNSURE + 0.1 && all[1] < all[2]);
    }
}
