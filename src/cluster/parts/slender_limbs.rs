//! Slender limbs: a limb that no part ends at is cut off.
//!
//! A thin tail that continues the line of a back lies in one cluster with the back, since it turns nowhere and hardly
//! has any area, in most members of the ensemble. Then no merge is ever asked about it. But hardly anything is surer to
//! be a part: on the benchmark, 92 % of the people have each of the 140 limbs whose area is below .35 of their squared
//! length, and the ensemble has cut them all (docs/dev/segmentation-experiments.md). So where it has not, the
//! probability that such a limb belongs to the rest is that of people.
//!
//! Where limbs overlap, as those of two tips on one limb do, the more slender one comes first. An arc of a ring around
//! the point farthest from the body is no limb: it is attached at both ends.
//!
//! Cost: a pass over cells and pairs for each slender one of at most 16 limbs, and R² where one is cut off.

use super::cell_graph::CellGraph;
use super::cell_labels::{class_sums, connected_pieces};
use super::matrix::Square;
use super::symmetry::limbs::LimbRegion;
use crate::base::sort::sort_by;

/// Maximum flatness of a slender limb.
const SLENDER: f64 = 0.35;
/// Minimum area of a limb, as a share of the total.
const LEAST: f64 = 0.003;
/// Minimum share of a limb that lies in one part and on no limb before it.
const WITHIN: f64 = 0.8;
/// Maximum share of the part.
const OF_PART: f64 = 0.6;
/// The probability that people have a slender limb and the rest of its part in one part.
const TOGETHER: f64 = 0.08;

/// Those of `limbs` that are slender, the most slender first.
pub(super) fn slender_limbs(mut limbs: Vec<LimbRegion>) -> Vec<LimbRegion> {
    limbs.retain(|limb| limb.flatness < SLENDER && limb.area >= LEAST);
    sort_by(&mut limbs, |a, b| a.flatness.total_cmp(&b.flatness).then_with(|| a.cells.cmp(&b.cells)));
    limbs
}

/// The limb that each of `cells` lies on, numbered from 1, or 0, if some of the `slender` limbs are within one of the
/// parts `label` (S). Cells have the areas `shares` (S).
pub(super) fn uncut_limbs(
    cells: &CellGraph,
    slender: &[LimbRegion],
    shares: &[f64],
    label: &[u32],
) -> Option<Vec<u32>> {
    let parts = label.iter().max().map_or(0, |&most| most as usize + 1);
    let whole = class_sums(label, shares, parts);
    let (mut found, mut count) = (vec![0; label.len()], 0);
    for limb in slender {
        let mut within = vec![0.0; parts];
        let free = || limb.cells.iter().copied().filter(|&i| found[i as usize] == 0);
        free().for_each(|i| within[label[i as usize] as usize] += shares[i as usize]);
        let Some(part) = (0..parts).rev().max_by(|&a, &b| within[a].total_cmp(&within[b])) else { continue };
        let is_uncut = within[part] >= WITHIN * limb.area && within[part] <= OF_PART * whole[part];
        if is_uncut && is_attached_once(limb, cells) {
            count += 1;
            let there: Vec<u32> = free().filter(|&i| label[i as usize] as usize == part).collect();
            there.into_iter().for_each(|i| found[i as usize] = count);
        }
    }
    (count > 0).then_some(found)
}

/// Whether the cells beside a limb, and those beside these, are connected.
fn is_attached_once(limb: &LimbRegion, cells: &CellGraph) -> bool {
    const LIMB: u32 = 1;
    const BESIDE: u32 = 2;
    let mut class = vec![0; cells.len()];
    limb.cells.iter().for_each(|&i| class[i as usize] = LIMB);
    for near in [LIMB, BESIDE] {
        let now = class.clone();
        for &[i, j] in &cells.pairs {
            for (i, j) in [(i as usize, j as usize), (j as usize, i as usize)] {
                if now[i] == near && now[j] == 0 {
                    class[j] = BESIDE;
                }
            }
        }
    }
    let (piece, _) = connected_pieces(&cells.pairs, &class);
    let mut beside = piece.iter().zip(&class).filter(|(_, class)| **class == BESIDE).map(|(piece, _)| piece);
    let first = beside.next();
    first.is_some_and(|first| beside.all(|piece| piece == first))
}

/// Lowers the co-association between superfaces on different limbs, given the limb of each (R).
pub(super) fn cut_off(co_association: &mut Square, limb: &[u32]) {
    for (i, a) in limb.iter().enumerate() {
        let row = co_association.row_mut(i).iter_mut().zip(limb);
        row.filter(|(_, b)| *b != a).for_each(|(c, _)| *c = c.min(TOGETHER));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A limb of these cells of a surface of `n` cells of the same area.
    fn limb(cells: std::ops::Range<u32>, n: usize, flatness: f64) -> LimbRegion {
        let area = cells.len() as f64 / n as f64;
        LimbRegion { cells: cells.collect(), area, flatness }
    }

    /// The limb of each cell, of those of `limbs` that are slender.
    fn uncut_of(cells: &CellGraph, limbs: &[LimbRegion], shares: &[f64], label: &[u32]) -> Option<Vec<u32>> {
        uncut_limbs(cells, &slender_limbs(limbs.to_vec()), shares, label)
    }

    /// A row of `n` cells of the same area, closed to a ring or not.
    fn row(n: u32, closed: bool) -> (CellGraph, Vec<f64>) {
        let ends = closed.then_some([n - 1, 0]);
        let pairs = (1..n).map(|i| [i - 1, i]).chain(ends).collect();
        let area = vec![1. / f64::from(n); n as usize];
        (CellGraph { area: area.clone(), pairs, ..CellGraph::default() }, area)
    }

    #[test]
    fn a_slender_limb_within_a_part_is_cut_off() {
        let (n, (cells, shares)) = (100, row(100, false));
        let uncut = |limbs: &[LimbRegion], label: &[u32]| uncut_of(&cells, limbs, &shares, label);
        let whole = vec![0; n];
        let expected: Vec<u32> = (0..100).map(|i| u32::from(i < 10)).collect();
        assert_eq!(uncut(&[limb(0..10, n, 0.2)], &whole), Some(expected));
        // Not a thick one, a tiny one, most of its part, or one that is a part.
        assert_eq!(uncut(&[limb(0..10, n, 0.4)], &whole), None);
        assert_eq!(uncut(&[LimbRegion { area: 0.002, ..limb(0..10, n, 0.2) }], &whole), None);
        assert_eq!(uncut(&[limb(0..70, n, 0.2)], &whole), None);
        let cut: Vec<u32> = (0..100).map(|i| u32::from(i < 11)).collect();
        assert_eq!(uncut(&[limb(0..10, n, 0.2)], &cut), None);
        // Nor one that a cut divides.
        let halved: Vec<u32> = (0..100).map(|i| u32::from(i < 5)).collect();
        assert_eq!(uncut(&[limb(0..10, n, 0.2)], &halved), None);
        assert_eq!(uncut_of(&CellGraph::default(), &[], &[], &[]), None);
    }

    /// Regression: a quarter of the rim of a wheel was cut off.
    #[test]
    fn an_arc_of_a_ring_is_no_limb() {
        let (cells, shares) = row(100, true);
        assert_eq!(uncut_of(&cells, &[limb(0..10, 100, 0.2)], &shares, &[0; 100]), None);
    }

    #[test]
    fn of_limbs_that_overlap_the_more_slender_comes_first() {
        let (n, (cells, shares)) = (100, row(100, false));
        let limbs = [limb(0..12, n, 0.25), limb(0..10, n, 0.2), limb(0..30, n, 0.3)];
        let expected: Vec<u32> = (0..100).map(|i| u32::from(i < 10)).collect();
        assert_eq!(uncut_of(&cells, &limbs, &shares, &[0; 100]), Some(expected));
        // Another one at the other end, which reaches into a cell of a longer one.
        let limbs = [limb(90..100, n, 0.2), limb(0..91, n, 0.3), limb(79..100, n, 0.32)];
        let expected: Vec<u32> = (0..100).map(|i| u32::from(i >= 90)).collect();
        assert_eq!(uncut_of(&cells, &limbs, &shares, &[0; 100]), Some(expected));
    }

    #[test]
    fn a_limb_is_apart_from_the_rest_and_other_limbs_alone() {
        let mut c = Square::from_values(3, vec![1., 0.9, 0.01, 0.9, 1., 0.5, 0.01, 0.5, 1.]);
        cut_off(&mut c, &[0, 1, 2]);
        assert_eq!(c, Square::from_values(3, vec![1., 0.08, 0.01, 0.08, 1., 0.08, 0.01, 0.08, 1.]));
        let mut c = Square::from_values(2, vec![1., 0.9, 0.9, 1.]);
        cut_off(&mut c, &[3, 3]);
        assert_eq!(c, Square::from_values(2, vec![1., 0.9, 0.9, 1.]));
    }
}
