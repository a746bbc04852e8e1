//! Area vectors, sums of area times normal: how closed a surface is, and how wide the mouth of a part.
//!
//! The area vector of a closed surface is zero. So that of a part of one is, turned around, the area vector of whatever
//! closes the part. Cost: a pass over the cells.

use super::cell_graph::CellGraph;
use crate::base::vector::add_scaled;
use crate::graph::orientation_sums::is_closed;

/// Sums over the cells of a class.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct AreaVector {
    /// Of area times normal.
    pub vector: [f64; 3],
    /// Of area.
    pub area: f64,
}

impl AreaVector {
    /// Whether a component with these sums is closed but for small holes.
    pub fn is_closed(&self) -> bool {
        is_closed(self.vector, self.area)
    }
}

/// The sums of each of `count` classes, given the class of each superface (R) and the superface of each cell (S).
pub(super) fn area_vectors(cells: &CellGraph, of_cell: &[u32], class: &[u32], count: usize) -> Vec<AreaVector> {
    let mut sums = vec![AreaVector::default(); count];
    for ((&x, &area), &normal) in of_cell.iter().zip(&cells.area).zip(&cells.normal) {
        let sum = &mut sums[class[x as usize] as usize];
        sum.vector = add_scaled(sum.vector, area, normal);
        sum.area += area;
    }
    sums
}
