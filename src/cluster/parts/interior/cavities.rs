//! Cavities that are closed surfaces of their own, as in models hollowed for printing.
//!
//! Every closed component is oriented outward, so normals do not tell a cavity from a body within. But in the file a
//! cavity is wound against the surface around it, and a body is not. So a cavity is a piece of surface that was flipped
//! unlike the rest, hardly borders on it, and is hidden by it from everywhere. Its normals are turned back. If pieces
//! that are not hidden were flipped as well, windings are accidental and tell nothing, as in many models of cars.
//!
//! Walls are often thinner than a cell. What hides a piece is another surface, so there a disc hides all that is behind
//! it; on one surface ([`super::exposure()`]) that would be the neighbours of a cell.
//!
//! Cost: nothing unless some cells were flipped and others not; then one or two exposures from few directions.

use super::exposure::{dark_pieces, exposure_behind_others};
use crate::base::Result;
use crate::cluster::parts::cell_graph::CellGraph;
use crate::cluster::parts::cell_labels::{class_sums, connected_pieces};
use crate::store::run::Run;
use std::f64::consts::PI;

/// Mean exposure below which a piece is hidden. Cavities have .001 to .043, and .098 in a box with walls of 1/400 of
/// its length; a peg through a box, a ball in a ring and a box beside another .54 to .83.
const HIDDEN: f64 = 0.2;
/// Maximum length of a piece's border with cells flipped unlike it, relative to the perimeter of a disc of its area. A
/// cell may lie on two components where they are bridged; but where windings contradict, patches have whole borders.
const BORDER: f64 = 0.2;
/// Maximum area that was flipped like cavities but is none, relative to theirs.
const ACCIDENTAL: f64 = 0.1;

/// Whether each cell is in a closed cavity (S); `None` if none is.
///
/// # Errors
/// Cancellation.
pub(super) fn closed_cavities(cells: &CellGraph, run: &Run) -> Result<Option<Vec<bool>>> {
    let flipped = &cells.flipped;
    if !(flipped.contains(&true) && flipped.contains(&false)) {
        return Ok(None);
    }
    let (piece, count) = connected_pieces(&cells.pairs, &flipped.iter().map(|&x| u32::from(x)).collect::<Vec<u32>>());
    let mut border = vec![0.; count];
    for (&[i, j], length) in cells.pairs.iter().zip(&cells.length) {
        if flipped[i as usize] != flipped[j as usize] {
            [i, j].iter().for_each(|&cell| border[piece[cell as usize] as usize] += length);
        }
    }
    let areas = class_sums(&piece, &cells.area, count);
    let is_closed = |k: usize| border[k] <= BORDER * (4. * PI * areas[k]).sqrt();
    // The outside is mostly the larger surface, but a cavity may be full of folds.
    let area = |of: &[bool]| -> f64 { of.iter().zip(&cells.area).filter(|(is, _)| **is).map(|(_, area)| area).sum() };
    let rarer = area(flipped) < 0.5 * cells.total_area();
    for inner in [rarer, !rarer] {
        let among: Vec<bool> = flipped.iter().map(|&flipped| flipped == inner).collect();
        let exposure = exposure_behind_others(cells, &among, run)?;
        let dark = dark_pieces(cells, &exposure, &piece, count, HIDDEN);
        let is_cavity = |k: usize| dark[k] && is_closed(k);
        let all: Vec<bool> = among.iter().zip(&piece).map(|(&among, &k)| among && is_cavity(k as usize)).collect();
        let cavities = area(&all);
        if cavities > 0. && area(&among) <= (1. + ACCIDENTAL) * cavities {
            return Ok(Some(all));
        }
    }
    Ok(None)
}

/// `cells` with the normals of those in `cavities` (S) turned, out of the solid.
pub(super) fn turned(cells: &CellGraph, cavities: &[bool]) -> CellGraph {
    let mut turned = cells.clone();
    let normals = turned.normal.iter_mut().zip(cavities).filter(|(_, is_cavity)| **is_cavity);
    normals.for_each(|(normal, _)| *normal = normal.map(|x| 0. - x));
    turned
}

#[cfg(test)]
mod tests {
    use super::super::exposure::tests::balls;
    use super::*;

    fn of(all: &[(f64, usize, bool)], flipped: &[bool]) -> Option<Vec<bool>> {
        let mut cells = balls(all);
        cells.flipped = all.iter().zip(flipped).flat_map(|(&(_, n, _), &flipped)| vec![flipped; n]).collect();
        closed_cavities(&cells, &Run::new(&())).unwrap()
    }

    #[test]
    fn a_cavity_is_wound_against_the_surface_around_it() {
        // The second wall is a third of a cell thick.
        for within in [0.8, 0.98] {
            let all = [(1., 1000, false), (within, 900, false)];
            let inner = Some([vec![false; 1000], vec![true; 900]].concat());
            assert_eq!(of(&all, &[false, true]), inner);
            assert_eq!(of(&all, &[true, false]), inner);
            assert_eq!(of(&all, &[false, false]), None);
            assert_eq!(of(&all, &[true, true]), None);
        }
    }

    /// Closed parts that are not hidden show that windings were not meant.
    #[test]
    fn accidental_windings_tell_nothing() {
        let mut cells = balls(&[(1., 900, false), (0.5, 400, false), (1., 900, false)]);
        cells.centre[1300..].iter_mut().for_each(|x| x[0] += 1.);
        for (third, expected) in [(false, true), (true, false)] {
            cells.flipped = [vec![false; 900], vec![true; 400], vec![third; 900]].concat();
            assert_eq!(closed_cavities(&cells, &Run::new(&())).unwrap().is_some(), expected);
        }
    }

    #[test]
    fn what_is_not_hidden_or_has_a_border_is_no_cavity() {
        let mut cells = balls(&[(1., 600, false), (1., 600, false)]);
        cells.flipped = [vec![false; 600], vec![true; 600]].concat();
        let run = Run::new(&());
        for (apart, expected) in [(2., false), (1., false), (0., true)] {
            let mut two = cells.clone();
            two.centre[600..].iter_mut().for_each(|x| *x = [0.5 * x[0] + apart * 0.3, 0.5 * x[1], 0.5 * x[2]]);
            two.area[600..].iter_mut().for_each(|area| *area *= 0.25);
            assert_eq!(closed_cavities(&two, &run).unwrap().is_some(), expected, "{apart}");
            // A patch of one surface whose winding contradicts the rest.
            (two.pairs, two.length) = ((1..1200).map(|i| [i - 1, i]).collect(), vec![2.; 1199]);
            assert_eq!(closed_cavities(&two, &run).unwrap(), None);
        }
    }
}
