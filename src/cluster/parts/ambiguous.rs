//! Ambiguous patches: parts that hardly anybody would have. Each is joined to the neighbour that it most probably
//! belongs to.
//!
//! A patch between two parts may belong to either, with a probability a little below ½ each. The labelling of greatest
//! expected Rand index then keeps it separate, since that is wrong about the fewest pairs; but no person has such a
//! part. So a part is joined if few people are expected to have it ([`super::agreement`]), a few more if it is small,
//! and if it may well belong to a neighbour. A part clearly distinct from all its neighbours stays, however small: a
//! finger, a horn.
//!
//! On the benchmark this removes 4 % of the parts, changes 1 − Rand by less than its noise and improves Hamming
//! distance and consistency (docs/dev/segmentation-experiments.md). In the hierarchy these parts reappear above ½, so a
//! finer cut still has them.
//!
//! On a surface with two sides a patch and its twin are joined together or not at all. Otherwise one shoulder of a man
//! was a part, the other was not.
//!
//! Cost: R² for each patch, of which there are at most a dozen.

use super::agreement::{confidence, of_boundaries};
use super::cell_graph::CellGraph;
use super::cell_labels::{class_sums, compact};
use super::ensemble::Superfaces;
use super::matrix::Square;
use super::symmetry::both_sides::Sides;

/// Share of people below which a patch of any area is joined. At .2 pairs of parts of pliers go that people do have.
const AGREEMENT: f64 = 0.15;
/// The same for patches below [`SMALL`]. With .3, and without the bound on the mean of C, 1 − Rand is .0004 to .0009
/// greater.
const AGREEMENT_SMALL: f64 = 0.25;
/// The same for patches below [`TINY`], such as one ear of a scanned horse.
const AGREEMENT_TINY: f64 = 0.333;
/// Share of the area below which a patch is small.
const SMALL: f64 = 0.015;
/// Share of the area below which a patch is tiny. Two of 190 models have a part that is removed by this bound alone.
const TINY: f64 = 0.0075;
/// Minimum mean of C between a patch and the neighbour that it joins.
const MEAN: f64 = 0.3;

/// Joins every ambiguous patch of `label` to a neighbour, and with a patch its twin, if the surface has two `sides`.
/// Returns labels (R) of the superfaces of `cells`, numbered by first appearance; C is R × R.
pub(super) fn without_ambiguous(
    cells: &CellGraph,
    superfaces: &Superfaces,
    co_association: &Square,
    sides: Option<&Sides>,
    label: &[u32],
) -> Vec<u32> {
    let total: f64 = superfaces.area.iter().sum();
    let shares: Vec<f64> = superfaces.area.iter().map(|area| area / total).collect();
    let boundaries = superfaces.shared_boundaries(cells);
    let (mut label, mut parts) = compact(label);
    // Joining a patch may make the other part one that stays, so patches are joined one at a time, the least likely
    // first.
    loop {
        let twin = sides.map_or_else(|| (0..parts).collect(), |sides| sides.twins(&label, parts));
        let patches = Patches::of(superfaces, co_association, &shares, &boundaries, &label, parts);
        let Some((patch, into)) = patches.worst(&twin) else { return label };
        let other = twin[patch];
        let beside = if [patch, into].contains(&other) { None } else { patches.joins(other, Some(twin[into])) };
        let mut join = |patch: usize, into: usize| {
            label.iter_mut().filter(|k| **k == patch as u32).for_each(|k| *k = into as u32);
        };
        join(patch, into);
        if let Some(beside) = beside {
            join(other, if beside == patch { into } else { beside });
        }
        (label, parts) = compact(&label);
    }
}

/// The parts of a labelling as patches that may be joined.
struct Patches<'a> {
    co_association: &'a Square,
    /// Share of the area of each superface (R).
    shares: &'a [f64],
    /// The part of each superface (R).
    label: &'a [u32],
    /// Share of the area.
    area: Vec<f64>,
    /// Length of the boundary between two.
    boundary: Square,
    /// The share of people who are expected to have each.
    agreement: Vec<f64>,
}

impl<'a> Patches<'a> {
    /// The `parts` of `label` (R); superfaces have these `shares` of the area (R) and the lengths of boundaries
    /// between two of them.
    fn of(
        superfaces: &Superfaces,
        co_association: &'a Square,
        shares: &'a [f64],
        boundaries: &[(u32, u32, f64)],
        label: &'a [u32],
        parts: usize,
    ) -> Patches<'a> {
        let area = class_sums(label, shares, parts);
        let mut boundary = Square::zeros(parts);
        for &(a, b, length) in boundaries {
            let (a, b) = (label[a as usize] as usize, label[b as usize] as usize);
            if a != b {
                boundary.add_both(a, b, length);
            }
        }
        let sure = confidence(superfaces, co_association, label, parts);
        let lengths: Vec<f64> = (0..parts).map(|k| boundary.row(k).iter().sum()).collect();
        let agreement = of_boundaries(label, &sure, shares, &lengths);
        Patches { co_association, shares, label, area, boundary, agreement }
    }

    /// The patch that the fewest people would have, twins considered together, and the neighbour that it joins.
    fn worst(&self, twin: &[usize]) -> Option<(usize, usize)> {
        let mut least: Option<(f64, (usize, usize))> = None;
        for patch in (0..self.area.len()).filter(|&k| self.area[k] > 0.) {
            let of_both = |values: &[f64]| 0.5 * (values[patch] + values[twin[patch]]);
            let agreement = of_both(&self.agreement);
            let bound = match of_both(&self.area) {
                area if area < TINY => AGREEMENT_TINY,
                area if area < SMALL => AGREEMENT_SMALL,
                _ => AGREEMENT,
            };
            if agreement >= bound || least.as_ref().is_some_and(|(before, _)| agreement >= *before) {
                continue;
            }
            if let Some(into) = self.joins(patch, None) {
                least = Some((agreement, (patch, into)));
            }
        }
        least.map(|(_, join)| join)
    }

    /// The neighbour that `patch` most probably belongs to, or `first`, if it may belong to that one.
    fn joins(&self, patch: usize, first: Option<usize>) -> Option<usize> {
        let mean = self.means_to(patch);
        let may_join = |&k: &usize| self.boundary[(patch, k)] > 0. && mean[k] > MEAN;
        let most = || (0..mean.len()).filter(may_join).max_by(|&a, &b| mean[a].total_cmp(&mean[b]).then(b.cmp(&a)));
        first.filter(may_join).or_else(most)
    }

    /// Area-weighted mean of C between part `one` and every part.
    fn means_to(&self, one: usize) -> Vec<f64> {
        let mut sums = vec![0.; self.area.len()];
        for (i, _) in self.label.iter().enumerate().filter(|&(_, &k)| k as usize == one) {
            for ((c, share), &k) in self.co_association.row(i).iter().zip(self.shares).zip(self.label) {
                sums[k as usize] += c * share * self.shares[i];
            }
        }
        sums.iter().zip(&self.area).map(|(sum, other)| sum / (self.area[one] * other).max(1e-300)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::symmetry::mirror_images::CellImages;
    use super::*;

    /// A row of parts of one superface and one cell each, with boundaries of .5 between neighbours: their shares, and C
    /// between neighbours; C is .3 between others.
    fn joined(shares: &[f64], between: &[f64]) -> Vec<u32> {
        joined_alike(shares, between, false)
    }

    /// The same of a row that is its own mirror image, if `alike`.
    fn joined_alike(shares: &[f64], between: &[f64], alike: bool) -> Vec<u32> {
        let n = shares.len();
        let numbers = || 0..n as u32;
        let cells = CellGraph {
            area: shares.to_vec(),
            pairs: (1..n as u32).map(|i| [i - 1, i]).collect(),
            length: vec![0.5; n - 1],
            ..CellGraph::default()
        };
        let superfaces = Superfaces::kept(numbers().collect(), shares.to_vec()).unwrap();
        let value = |k: usize| match (k / n).abs_diff(k % n) {
            0 => 1.,
            1 => between[(k / n).min(k % n)],
            _ => 0.3,
        };
        let c = Square::from_values(n, (0..n * n).map(value).collect());
        let map = CellImages { image: numbers().rev().collect(), weight: vec![1.; n] };
        let sides = alike.then(|| Sides::new(&superfaces, shares, &map));
        without_ambiguous(&cells, &superfaces, &c, sides.as_ref(), &numbers().collect::<Vec<_>>())
    }

    /// Regression: one shoulder of a man was a part, the other was not.
    #[test]
    fn a_patch_and_its_twin_are_joined_together_or_not_at_all() {
        let both = |c: f64| {
            let (shares, between) = ([0.3, 0.01, 0.38, 0.01, 0.3], [0.45, 0.48, c, c - 0.03]);
            (joined(&shares, &between), joined_alike(&shares, &between, true))
        };
        assert_eq!(both(0.36), (vec![0, 1, 1, 2, 3], vec![0, 1, 1, 1, 2]));
        assert_eq!(both(0.3), (vec![0, 1, 1, 2, 3], vec![0, 1, 2, 3, 4]));
    }

    #[test]
    fn a_patch_joins_the_neighbour_that_it_most_probably_belongs_to() {
        assert_eq!(joined(&[0.5, 0.01, 0.49], &[0.44, 0.47]), [0, 1, 1]);
        assert_eq!(joined(&[0.5, 0.01, 0.49], &[0.47, 0.44]), [0, 0, 1]);
    }

    #[test]
    fn what_hardly_anybody_has_goes_however_large() {
        // The middle part belongs to its neighbours nearly as surely as to itself.
        assert_eq!(joined(&[0.5, 0.03, 0.47], &[0.95, 0.97]), [0, 1, 1]);
    }

    #[test]
    fn what_is_large_or_clearly_apart_stays() {
        assert_eq!(joined(&[0.5, 0.03, 0.47], &[0.44, 0.47]), [0, 1, 2]);
        assert_eq!(joined(&[0.5, 0.01, 0.49], &[0.2, 0.25]), [0, 1, 2]);
        // An isolated part has no neighbour to join.
        assert_eq!(joined(&[0.01], &[]), [0]);
    }

    #[test]
    fn patches_beside_each_other_go_one_after_the_other() {
        assert_eq!(joined(&[0.5, 0.004, 0.004, 0.492], &[0.4, 0.45, 0.35]), [0, 0, 0, 1]);
    }
}
