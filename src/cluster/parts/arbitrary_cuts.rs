//! Arbitrary cuts: a component that would be cut, but at no place in particular, is left whole.
//!
//! A long tube, such as a hose, a spring or a snake, has no places where people would cut. Each over-segmentation cuts
//! it somewhere, since its far ends are hardly one part; in the mean of the ensemble these ends are then apart, though
//! hardly any over-segmentation cuts where the labelling of greatest expected Rand index does. So a component stays
//! whole if C across the boundaries of its parts is nearly what it is within them. One boundary with a place of its own
//! suffices to keep all, since the others may well follow from it. Sheets are left out: planar outlines with arms have
//! .7 to .95 everywhere, yet people cut the arms off.
//!
//! The mean of C across boundaries is .82 to .98 on knots, springs and snakes, and at most .70 on 190 models of the
//! benchmark (a pair of glasses). To judge single boundaries is worse: parts that people do have, such as the ear of a
//! dog, have up to .96 across theirs (docs/dev/segmentation-experiments.md).
//!
//! Cost: a pass over the boundaries between cells.

use super::area_vectors::area_vectors;
use super::cell_graph::CellGraph;
use super::cell_labels::{compact, connected_pieces, majorities};
use super::ensemble::Superfaces;
use super::matrix::Square;
use std::collections::BTreeMap;

/// Minimum mean of C, a probability, across all boundaries between the parts of a component that is joined.
const MIN_MEAN_C: f64 = 0.8;
/// Minimum mean of C across each of these boundaries: one with less has a place of its own.
const MIN_BOUNDARY_C: f64 = 0.6;

/// Joins the parts of each connected component that is cut at no place in particular. Returns labels (R) of the
/// superfaces of `cells`, numbered by first appearance; C is R × R.
pub(super) fn without_arbitrary(
    cells: &CellGraph,
    superfaces: &Superfaces,
    co_association: &Square,
    label: &[u32],
) -> Vec<u32> {
    let boundaries = superfaces.shared_boundaries(cells);
    let pairs: Vec<[u32; 2]> = boundaries.iter().map(|&(a, b, _)| [a, b]).collect();
    let (component, count) = connected_pieces(&pairs, &vec![0; label.len()]);
    // Between two parts of a component: the integral of C along their boundary, and its length.
    let mut cuts: BTreeMap<(u32, u32, u32), (f64, f64)> = BTreeMap::new();
    for &(a, b, between) in &boundaries {
        let [i, j] = [a, b].map(|x| label[x as usize]);
        if i != j {
            let (c, length) = cuts.entry((component[a as usize], i.min(j), i.max(j))).or_default();
            *c += between * co_association[(a as usize, b as usize)];
            *length += between;
        }
    }
    let mut sums = vec![(0., 0., true); count];
    for ((component, ..), (c, length)) in cuts {
        let (all_c, all, no_place) = &mut sums[component as usize];
        *all_c += c;
        *all += length;
        *no_place &= c >= MIN_BOUNDARY_C * length;
    }
    let vectors = area_vectors(cells, &superfaces.of_cell, &component, count);
    let is_arbitrary = |&component: &u32| {
        let (c, all, no_place) = sums[component as usize];
        all > 0. && c >= MIN_MEAN_C * all && no_place && vectors[component as usize].is_closed()
    };
    // A part may have pieces in other components, which keep its label.
    let most = majorities(&component, count, label, &superfaces.area);
    let joined = |(&label, component): (&u32, &u32)| {
        if is_arbitrary(component) { most[*component as usize] } else { label }
    };
    compact(&label.iter().zip(&component).map(joined).collect::<Vec<_>>()).0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Labels of superfaces of one cell each, in chains of six with parts of three, where neighbours have the given C
    /// in each chain.
    fn cut(chains: &[[f64; 5]]) -> Vec<u32> {
        let n = 6 * chains.len();
        let beside = |i: usize| (i % 6 < 5).then(|| [i as u32, i as u32 + 1]);
        let pairs: Vec<[u32; 2]> = (0..n).filter_map(beside).collect();
        let cells = CellGraph { area: vec![1.; n], length: vec![0.5; pairs.len()], pairs, ..CellGraph::default() };
        let superfaces = Superfaces::kept((0..n as u32).collect(), vec![1.; n]).unwrap();
        let mut c = Square::zeros(n);
        for [i, j] in cells.pairs.iter().map(|pair| pair.map(|x| x as usize)) {
            c.add_both(i, j, chains[i / 6][i % 6]);
        }
        let label: Vec<u32> = (0..n as u32).map(|i| i / 3).collect();
        without_arbitrary(&cells, &superfaces, &c, &label)
    }

    #[test]
    fn a_component_without_a_place_to_cut_stays_whole() {
        assert_eq!(cut(&[[0.9; 5]]), [0; 6]);
        assert_eq!(cut(&[[0.9, 0.9, 0.6, 0.9, 0.9]]), [0, 0, 0, 1, 1, 1]);
    }

    /// The head of a long snake is a part, and where it is cut elsewhere may follow from that.
    #[test]
    fn one_boundary_with_a_place_keeps_all() {
        let n = 20;
        let pairs: Vec<[u32; 2]> = (1..n).map(|i| [i - 1, i]).collect();
        let label: Vec<u32> = (0..n).map(|i| i / 4).collect();
        let parts = |head: f64| {
            let length = vec![0.5; pairs.len()];
            let cells = CellGraph { area: vec![1.; n as usize], length, pairs: pairs.clone(), ..CellGraph::default() };
            let superfaces = Superfaces::kept((0..n).collect(), vec![1.; n as usize]).unwrap();
            let mut c = Square::zeros(n as usize);
            (1..n as usize).for_each(|i| c.add_both(i - 1, i, if i == 4 { head } else { 0.95 }));
            without_arbitrary(&cells, &superfaces, &c, &label)
        };
        assert_eq!(parts(0.4), label);
        assert_eq!(parts(0.7), vec![0; n as usize]);
    }

    #[test]
    fn a_sheet_keeps_its_parts() {
        let parts = |turn: f64| {
            let pairs: Vec<[u32; 2]> = (1..6).map(|i| [i - 1, i]).collect();
            let normal = (0..6).map(|i| [(turn * f64::from(i)).cos(), (turn * f64::from(i)).sin(), 0.]).collect();
            let (area, length) = (vec![1.; 6], vec![0.5; 5]);
            let cells = CellGraph { area: area.clone(), normal, length, pairs, ..CellGraph::default() };
            let superfaces = Superfaces::kept((0..6).collect(), area).unwrap();
            let mut c = Square::zeros(6);
            (1..6).for_each(|i| c.add_both(i - 1, i, 0.95));
            without_arbitrary(&cells, &superfaces, &c, &[0, 0, 0, 1, 1, 1])
        };
        assert_eq!(parts(0.3), [0, 0, 0, 1, 1, 1]);
        assert_eq!(parts(std::f64::consts::TAU / 6.), [0; 6]);
    }

    #[test]
    fn each_component_is_judged_by_itself() {
        let some = cut(&[[0.9; 5], [0.3; 5], [0.9; 5]]);
        assert_eq!(some, [0, 0, 0, 0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3, 3, 3, 3]);
    }

    #[test]
    fn what_is_not_cut_stays_as_it_is() {
        let superfaces = Superfaces::kept(vec![0, 1], vec![1.; 2]).unwrap();
        let cells = CellGraph { area: vec![1.; 2], ..CellGraph::default() };
        assert_eq!(without_arbitrary(&cells, &superfaces, &Square::zeros(2), &[5, 5]), [0, 0]);
    }
}
