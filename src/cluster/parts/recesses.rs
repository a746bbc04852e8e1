//! Recesses: the floor of a recess is not a part by itself.
//!
//! A concave crease runs around the floor of a blind hole, a pocket or a mug, just as it runs around a limb. But what
//! would close the floor lies outside of the material, so the crease cuts no piece off the body. Therefore a part that
//! rises hardly above its mouth, or lies below it, is joined to its largest neighbour. The rise is the volume between
//! the part and its mouth over the area of the mouth. Thin fins and shells have little volume too, but narrow mouths.
//!
//! A single neighbour may have any size. Of several neighbours the largest must be at least three times as large as the
//! recess: a court among walls and a keep belongs to none of them.
//! Parts behind a convex edge stay, such as the inside of a cup, and so do those with narrow mouths, such as the inside
//! of a vase with its neck. Open surfaces are left out, since a valley is no recess, and surfaces that enclose others
//! (`interior`). On the benchmark one model of 190 has such parts. Pieces of four birds, which some people have, rise
//! as little, but have flat boundaries (docs/dev/segmentation-experiments.md).
//!
//! Cost: two passes over cells and pairs, and two more for each recess.

use super::area_vectors::{AreaVector, area_vectors};
use super::cell_graph::CellGraph;
use super::cell_labels::{compact, connected_pieces};
use super::ensemble::Superfaces;
use crate::base::vector::{add_scaled, dot, length};
use std::collections::BTreeSet;

/// Maximum rise of a recess above its mouth, in units of √(its area).
const RISE: f64 = 0.01;
/// Minimum area of the mouth of a recess, as a share of its own area.
const MOUTH: f64 = 0.3;
/// Minimum mean concave angle along the boundary of a recess.
const CONCAVE: f64 = 0.12;
/// Minimum area of the largest of several neighbours, relative to the recess.
const LARGER: f64 = 3.0;

/// A connected piece of a part.
#[derive(Clone, Default)]
struct Piece {
    sum: AreaVector,
    /// Sum of area times the product of normal and centre: three times the volume of the cone to the origin.
    flux: f64,
    /// Neighbouring pieces.
    beside: BTreeSet<u32>,
    /// Length of the boundary.
    boundary: f64,
    /// Sums along the boundary, of length times the concave angle,
    concave: f64,
    /// times the centre of the cell within,
    within: [f64; 3],
    /// and times the point between the cells on both sides.
    between: [f64; 3],
}

impl Piece {
    /// Whether it is the floor of a recess, if its component is closed.
    ///
    /// The mouth is taken for a cone to the mean point of the boundary. That between cells is half a cell above the
    /// floor at the foot of a wall, and that of the cells within is above the foot of a knob of few cells; so both must
    /// say that it does not rise.
    fn is_recess(&self) -> bool {
        let mouth = length(self.sum.vector);
        let is_wide = mouth > 0. && mouth >= MOUTH * self.sum.area;
        let is_concave = self.boundary > 0. && self.concave >= CONCAVE * self.boundary;
        let is_low = |points: [f64; 3]| {
            let apex = points.map(|x| x / self.boundary);
            let volume = (self.flux - dot(self.sum.vector, apex)) / 3.;
            volume <= RISE * mouth * self.sum.area.sqrt()
        };
        is_wide && is_concave && is_low(self.within) && is_low(self.between)
    }
}

/// Joins each part that is only the floor of a recess to its largest neighbour. Takes labels of the superfaces of
/// `cells` (R) and returns them numbered by first appearance.
pub(super) fn without_recesses(cells: &CellGraph, superfaces: &Superfaces, label: &[u32]) -> Vec<u32> {
    let pairs: Vec<[u32; 2]> = superfaces.shared_boundaries(cells).iter().map(|&(a, b, _)| [a, b]).collect();
    let (component, count) = connected_pieces(&pairs, &vec![0; label.len()]);
    let components = area_vectors(cells, &superfaces.of_cell, &component, count);
    let mut label = label.to_vec();
    // One at a time, those beside the largest pieces first: the walls of a pocket before its floor.
    loop {
        let (piece, count) = connected_pieces(&pairs, &label);
        let pieces = pieces(cells, superfaces, &piece, count);
        let mut is_closed = vec![false; count];
        piece.iter().zip(&component).for_each(|(&x, &of)| is_closed[x as usize] = components[of as usize].is_closed());
        let area = |x: u32| pieces[x as usize].sum.area;
        let larger = |x: &u32, y: &u32| area(*x).total_cmp(&area(*y)).then(y.cmp(x));
        let recesses = (0..count as u32).filter(|&x| is_closed[x as usize] && pieces[x as usize].is_recess());
        let into = |x: u32| {
            let beside = &pieces[x as usize].beside;
            let largest = beside.iter().copied().max_by(larger)?;
            (beside.len() == 1 || area(largest) >= LARGER * area(x)).then_some((x, largest))
        };
        let joins = recesses.filter_map(into);
        let Some((recess, into)) = joins.max_by(|(x, a), (y, b)| larger(a, b).then(y.cmp(x))) else {
            return compact(&label).0;
        };
        let to = piece.iter().zip(&label).find(|(piece, _)| **piece == into).map_or(0, |(_, &label)| label);
        label.iter_mut().zip(&piece).filter(|(_, piece)| **piece == recess).for_each(|(label, _)| *label = to);
    }
}

/// The `count` pieces, given the piece of each superface (R).
fn pieces(cells: &CellGraph, superfaces: &Superfaces, piece: &[u32], count: usize) -> Vec<Piece> {
    let of_cell = &superfaces.of_cell;
    let sums = area_vectors(cells, of_cell, piece, count);
    let mut pieces: Vec<Piece> = sums.into_iter().map(|sum| Piece { sum, ..Piece::default() }).collect();
    for (cell, &x) in of_cell.iter().enumerate() {
        pieces[piece[x as usize] as usize].flux += cells.area[cell] * dot(cells.normal[cell], cells.centre[cell]);
    }
    for (k, &[i, j]) in cells.pairs.iter().enumerate() {
        let [a, b] = [i, j].map(|cell| piece[of_cell[cell as usize] as usize]);
        if a == b {
            continue;
        }
        let [x, y] = [i, j].map(|cell| cells.centre[cell as usize]);
        let length = cells.length[k];
        for (piece, other, within, without) in [(a, b, x, y), (b, a, y, x)] {
            let piece = &mut pieces[piece as usize];
            piece.beside.insert(other);
            piece.boundary += length;
            piece.concave += length * cells.concave[k];
            piece.within = add_scaled(piece.within, length, within);
            piece.between = add_scaled(add_scaled(piece.between, 0.5 * length, within), 0.5 * length, without);
        }
    }
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A cell of area 1 with the given centre and normal.
    type Cell = ([f64; 3], [f64; 3]);
    const UP: [f64; 3] = [0., 0., 1.];
    const DOWN: [f64; 3] = [0., 0., -1.];

    /// Parts of cells that are superfaces of one cell each, and neighbours `pairs` with a boundary of length 1 and the
    /// given concave angle, negative for a convex one.
    fn parts(cells: &[Cell], label: &[u32], pairs: &[([u32; 2], f64)]) -> Vec<u32> {
        let n = cells.len();
        let graph = CellGraph {
            area: vec![1.; n],
            centre: cells.iter().map(|cell| cell.0).collect(),
            normal: cells.iter().map(|cell| cell.1).collect(),
            pairs: pairs.iter().map(|pair| pair.0).collect(),
            length: vec![1.; pairs.len()],
            concave: pairs.iter().map(|pair| pair.1.max(0.)).collect(),
            convex: pairs.iter().map(|pair| (-pair.1).max(0.)).collect(),
            ..CellGraph::default()
        };
        let superfaces = Superfaces::kept((0..n as u32).collect(), vec![1.; n]).unwrap();
        without_recesses(&graph, &superfaces, label)
    }

    /// A block with a top at height 0 (cell 0), a bottom (1), and a cell above or below the top (2), joined to it by
    /// walls (3 and 4) with opposite normals.
    fn block(height: f64, bend: f64) -> Vec<u32> {
        let wall = |x: f64| ([x, 0., height / 2.], [if height < 0. { -x } else { x }.signum(), 0., 0.]);
        let cells = [([2., 0., 0.], UP), ([0., 0., -3.], DOWN), ([0., 0., height], UP), wall(-0.5), wall(0.5)];
        let below = ([0., 0., -3.], DOWN);
        let cells: Vec<Cell> = cells.into_iter().chain([below]).collect();
        let pairs = [([0, 1], -1.), ([0, 3], -1.), ([0, 4], -1.), ([1, 5], 0.), ([2, 3], bend), ([2, 4], bend)];
        parts(&cells, &[0, 0, 1, 0, 0, 0], &pairs)
    }

    #[test]
    fn the_floor_of_a_recess_is_joined_and_a_knob_stays() {
        assert_eq!(block(-1., 1.), [0; 6]);
        // The inside of a cup, behind a convex edge.
        assert_eq!(block(-1., -1.), [0, 0, 1, 0, 0, 0]);
        // A knob with its walls, on a concave edge.
        let knob = [([0., 0., 1.], UP), ([-0.5, 0., 0.5], [-1., 0., 0.]), ([0.5, 0., 0.5], [1., 0., 0.])];
        let body = [([-2., 0., 0.], UP), ([2., 0., 0.], UP), ([0., 0., -3.], DOWN), ([0., 0., -3.], DOWN)];
        let cells: Vec<Cell> = knob.into_iter().chain(body).chain([([1., 0., -3.], DOWN)]).collect();
        let pairs = [([0, 1], -1.), ([0, 2], -1.), ([1, 3], 1.), ([2, 4], 1.)];
        let round = [([3, 5], -1.), ([4, 6], -1.), ([5, 6], 0.), ([6, 7], 0.)];
        let pairs: Vec<([u32; 2], f64)> = pairs.into_iter().chain(round).collect();
        assert_eq!(parts(&cells, &[0, 0, 0, 1, 1, 1, 1, 1], &pairs), [0, 0, 0, 1, 1, 1, 1, 1]);
    }

    #[test]
    fn a_step_follows_the_floor_below_it() {
        // From above: the top, a step with its wall, and a floor with its wall; then the bottom.
        let wall = |z: f64| [([-0.5, 0., z], [1., 0., 0.]), ([0.5, 0., z], [-1., 0., 0.])];
        let level = |z: f64| ([0., 0., z], UP);
        let (step, floor) = (level(-1.), level(-2.));
        let body = [level(0.), ([0., 0., -4.], DOWN), ([0., 0., -4.], DOWN), ([0., 0., -4.], DOWN)];
        let cells: Vec<Cell> =
            body.into_iter().chain(wall(-0.5)).chain([step]).chain(wall(-1.5)).chain([floor]).collect();
        let bottom = [([0, 1], -1.), ([1, 2], 0.), ([2, 3], 0.), ([0, 4], -1.), ([0, 5], -1.)];
        let inside = [([4, 6], 1.), ([5, 6], 1.), ([6, 7], -1.), ([6, 8], -1.), ([7, 9], 1.), ([8, 9], 1.)];
        let pairs: Vec<([u32; 2], f64)> = bottom.into_iter().chain(inside).collect();
        assert_eq!(parts(&cells, &[0, 0, 0, 0, 0, 0, 1, 1, 1, 2], &pairs), [0; 10]);
    }

    /// Each wall of a pocket lies beside a convex edge too.
    #[test]
    fn so_are_the_walls_of_a_pocket() {
        let wall = |x: f64| ([x, 0., -0.5], [-x.signum(), 0., 0.]);
        let top = [([-0.9, 0., 0.], UP), ([0.9, 0., 0.], UP)];
        let pocket = [wall(-0.5), wall(0.5), ([0., 0., -1.], UP)];
        let cells: Vec<Cell> = top.into_iter().chain(pocket).chain([([0., 0., -3.], DOWN); 3]).collect();
        let below = [([0, 5], -1.), ([1, 6], -1.), ([5, 7], 0.), ([6, 7], 0.)];
        let inside = [([0, 2], -1.), ([1, 3], -1.), ([2, 4], 1.), ([3, 4], 1.)];
        let pairs: Vec<([u32; 2], f64)> = below.into_iter().chain(inside).collect();
        assert_eq!(parts(&cells, &[0, 0, 1, 2, 3, 0, 0, 0], &pairs), [0; 8]);
    }

    /// Regression: the court of a castle was joined to its keep.
    #[test]
    fn what_lies_among_parts_that_are_hardly_larger_stays() {
        // A court (0) between two walls (2 and 3) of two cells each, on a body that is not beside it.
        let side = |x: f64| [([x, 0., 0.], UP), ([x, 0., 1.], UP)];
        let cells: Vec<Cell> = [([0.; 3], UP)].into_iter().chain(side(-1.)).chain(side(1.)).collect();
        let cells: Vec<Cell> = cells.into_iter().chain([([0., 0., -3.], DOWN); 5]).collect();
        let pairs = [([0, 1], 1.), ([0, 3], 1.), ([1, 2], 0.), ([3, 4], 0.), ([2, 5], -1.), ([4, 6], -1.)];
        let below = (5..9).map(|i| ([i, i + 1], 0.));
        let pairs: Vec<([u32; 2], f64)> = pairs.into_iter().chain(below).collect();
        let label = [0, 1, 1, 2, 2, 3, 3, 3, 3, 3];
        assert_eq!(parts(&cells, &label, &pairs), label);
        // With the walls in one part with the body, it is a recess.
        assert_eq!(parts(&cells, &[0, 1, 1, 1, 1, 1, 1, 1, 1, 1], &pairs), [0; 10]);
    }

    #[test]
    fn valleys_of_open_surfaces_stay() {
        let cells = [([0., 0., -1.], UP), ([-1., 0., 0.], UP), ([1., 0., 0.], UP)];
        assert_eq!(parts(&cells, &[0, 1, 1], &[([0, 1], 1.), ([0, 2], 1.)]), [0, 1, 1]);
    }

    #[test]
    fn what_is_one_part_or_in_pieces_stays() {
        assert_eq!(parts(&[([0.; 3], UP)], &[7], &[]), [0]);
        assert_eq!(parts(&[([0.; 3], UP), ([1., 0., 0.], DOWN)], &[3, 3], &[]), [0, 0]);
    }
}
