//! The co-association of a surface; if it encloses something, layer by layer.
//!
//! Each layer of [`super::enclosed`] has its own ensemble, in units of its own area, from the landmarks on it. A cell
//! that follows another is in the same superface. Two layers never belong together.
//!
//! Cost: an ensemble for each layer, over the cells of that layer.

use super::enclosed::Layers;
use crate::base::{Error, Result};
use crate::cluster::parts::cell_graph::CellGraph;
use crate::cluster::parts::cell_labels::{class_sums, compact};
use crate::cluster::parts::ensemble::{self, Superfaces, measured_ensemble};
use crate::cluster::parts::matrix::Square;
use crate::cluster::parts::merges::MergeModel;
use crate::spectral::anchor::LandmarkDistances;
use crate::store::run::Run;

/// A layer with fewer landmarks of its own uses all.
const FEWEST: usize = 30;

/// Superfaces and the probability that any two belong together.
pub(in crate::cluster::parts) struct CoAssociation {
    /// The superfaces.
    pub superfaces: Superfaces,
    /// Logarithm of the thickness behind each cell (S).
    pub log_thickness: Vec<f64>,
    /// C (R × R).
    pub c: Square,
    /// Whether the surface encloses something, so that it was decided layer by layer.
    pub encloses: bool,
}

/// The superfaces of `cells` and the probability that any two belong together, from an ensemble of `count`.
///
/// # Errors
/// Cancellation.
pub(in crate::cluster::parts) fn co_association(
    cells: &CellGraph,
    rows: LandmarkDistances,
    count: usize,
    run: &Run,
) -> Result<CoAssociation> {
    let (ensemble, measured) = measured_ensemble(cells, rows, count, run)?;
    let c = ensemble::co_association(cells, &measured, &ensemble, &MergeModel::default(), run)?;
    Ok(CoAssociation { superfaces: measured.superfaces, log_thickness: measured.log_thickness, c, encloses: false })
}

/// The same, decided on each of `layers` separately.
///
/// # Errors
/// Cancellation.
pub(in crate::cluster::parts) fn of_layers(
    cells: &CellGraph,
    rows: &LandmarkDistances,
    layers: &Layers,
    count: usize,
    run: &Run,
) -> Result<CoAssociation> {
    let nearest: Vec<u32> = (0..rows.count).map(|j| rows.nearest_point(j) as u32).collect();
    let (mut of_cell, mut log_thickness) = (vec![0; cells.len()], vec![0.0; cells.len()]);
    let mut all: Vec<Square> = Vec::new();
    let mut superfaces = 0;
    for layer in &layers.layers {
        let own = rows_of(rows, &nearest, layer);
        let found = co_association(&cells.subset(layer), own, count, run)?;
        for ((&cell, superface), thickness) in layer.iter().zip(&found.superfaces.of_cell).zip(&found.log_thickness) {
            of_cell[cell as usize] = superfaces + superface;
            log_thickness[cell as usize] = *thickness;
        }
        superfaces += found.superfaces.len() as u32;
        all.push(found.c);
    }
    for (cell, &to) in layers.follows.iter().enumerate() {
        of_cell[cell] = of_cell[to as usize];
        log_thickness[cell] = log_thickness[to as usize];
    }
    // Numbered by first appearance, as everywhere.
    let (number, n) = compact(&of_cell);
    let mut c = Square::zeros(n);
    let mut name = vec![0; n];
    number.iter().zip(&of_cell).for_each(|(&new, &old)| name[old as usize] = new as usize);
    let mut first = 0;
    for block in &all {
        for i in 0..block.len() {
            for (j, x) in block.row(i).iter().enumerate() {
                c[(name[first + i], name[first + j])] = *x;
            }
        }
        first += block.len();
    }
    let area = class_sums(&number, &cells.area, n);
    let superfaces = Superfaces::kept(number, area).ok_or_else(|| Error::internal("a superface without cells"))?;
    Ok(CoAssociation { superfaces, log_thickness, c, encloses: true })
}

/// The distances of the cells of `layer` from the landmarks on it; `nearest` is the cell of each landmark (l).
fn rows_of(rows: &LandmarkDistances, nearest: &[u32], layer: &[u32]) -> LandmarkDistances {
    let mut own: Vec<usize> = (0..rows.count).filter(|&j| layer.binary_search(&nearest[j]).is_ok()).collect();
    if own.len() < FEWEST {
        own = (0..rows.count).collect();
    }
    let values = own.iter().flat_map(|&j| layer.iter().map(move |&i| rows.row(j)[i as usize])).collect();
    LandmarkDistances { values, count: own.len(), points: layer.len() }
}
