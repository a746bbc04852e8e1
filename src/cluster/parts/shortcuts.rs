//! Shortcuts through the body where it is thin.
//!
//! Along the surface, front and back of a thin plate are far apart: its rim turns by π, which costs .8 √(total area)
//! under the default weights, more than the length of an arm. So each side was a cluster of its own, and it was random
//! whether both became one part. Here a path from a landmark may cross the body once, straight, where it is thin. The
//! idea comes from the volumetric part of Liu, Zhang, Shamir and Cohen-Or, *A part-aware surface metric for shape
//! analysis* (Computer Graphics Forum 2009), which compares what two faces see inside.
//!
//! Over-segmentations of the default decision are drawn with these distances; regions are compared and merged with
//! those along the surface. If a layer is decided alone, its cells are in units of its own area but its rows in those
//! of the whole: a shortcut is then longer by the square root of that ratio.
//!
//! Cost: a ray per cell, a millisecond or two, and two operations per landmark and shortcut.

use super::cell_graph::CellGraph;
use super::thickness::opposite_cells;
use crate::base::Result;
use crate::spectral::anchor::LandmarkDistances;
use crate::store::run::Run;

/// Minimum thickness without shortcuts, in units of √(total area). On 190 models, and 16 shapes under six seeds: with
/// .05 parts depend more on the seed, and beyond .15 they agree less with people.
const THIN: f64 = 0.12;

/// The distances `rows` of landmarks from cells if paths may also cross thin places of the body, once and straight.
///
/// # Errors
/// Cancellation.
pub fn with_shortcuts(cells: &CellGraph, mut rows: LandmarkDistances, run: &Run) -> Result<LandmarkDistances> {
    let opposite = opposite_cells(cells, run)?;
    let thin = |(i, opposite): (usize, &Option<(u32, f64)>)| {
        opposite.filter(|(_, depth)| *depth < THIN).map(|(j, depth)| (i, j as usize, depth))
    };
    let shortcuts: Vec<(usize, usize, f64)> = opposite.iter().enumerate().filter_map(thin).collect();
    for row in rows.values.chunks_mut(cells.len().max(1)) {
        let along = row.to_vec();
        for &(i, j, depth) in &shortcuts {
            row[i] = row[i].min(along[j] + depth);
            row[j] = row[j].min(along[i] + depth);
        }
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Front and back of a plate of thickness `thick`, ten cells each in a row, and their distances from the first cell
    /// of the front, with a path of length `around` over the rim.
    fn plate(thick: f64, around: f64) -> (CellGraph, LandmarkDistances) {
        let along = |i: usize| 0.1 * (i % 10) as f64;
        let g = CellGraph {
            centre: (0..20).map(|i| [along(i), 0., if i < 10 { thick } else { 0. }]).collect(),
            normal: (0..20).map(|i| [0., 0., if i < 10 { 1. } else { -1. }]).collect(),
            area: vec![0.01; 20],
            ..CellGraph::default()
        };
        let row: Vec<f64> = (0..20).map(|i| along(i) + if i < 10 { 0. } else { around }).collect();
        (g, LandmarkDistances::new(&row, 1, 20))
    }

    #[test]
    fn the_back_of_a_thin_plate_is_as_near_as_it_is_thick() {
        let (g, rows) = plate(0.05, 0.8);
        let short = with_shortcuts(&g, rows.clone(), &Run::new(&())).unwrap();
        assert_eq!(short.values[..10], rows.values[..10]);
        let through: Vec<f64> = rows.values[..10].iter().map(|d| d + 0.05).collect();
        assert_eq!(short.values[10..], through);
    }

    #[test]
    fn thick_bodies_and_short_ways_around_stay_as_they_are() {
        for (thick, around) in [(THIN, 0.8), (0.05, 0.04)] {
            let (g, rows) = plate(thick, around);
            assert_eq!(with_shortcuts(&g, rows.clone(), &Run::new(&())).unwrap().values, rows.values);
        }
    }

    #[test]
    fn the_sides_of_an_edge_and_open_sheets_are_no_thin_places() {
        let (mut g, rows) = plate(0.05, 0.8);
        // The back is tilted, as near the edge of a knife: at 70 degrees it does not count as opposite.
        g.normal[10..].fill([0.94, 0., -0.342]);
        assert_eq!(with_shortcuts(&g, rows.clone(), &Run::new(&())).unwrap().values, rows.values);
        g.normal[10..].fill([0., 0., 1.]);
        assert_eq!(with_shortcuts(&g, rows.clone(), &Run::new(&())).unwrap().values, rows.values);
    }
}
