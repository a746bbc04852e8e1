//! Ways through the body where it is thin.
//!
//! Along the surface, front and back of a thin plate are far apart: its rim turns by π, which is worth .8 √(total area)
//! under the default weights, more than an arm of it is long. So each side was a cluster of its own, and chance decided
//! whether both became one part. Here a way from a landmark may cross the body once, straight, where it is thin. The
//! idea is that of the volumetric part of Liu, Zhang, Shamir and Cohen-Or, *A part-aware surface metric for shape
//! analysis* (Computer Graphics Forum 2009), which compares what two faces see inside.
//!
//! Over-segmentations of the default decision are drawn with these distances; regions are compared, and merged, as
//! they lie on the surface. Cells of a layer that is decided alone are in units of its own area, and its rows in
//! those of the whole: there a way is longer by the root of the ratio.
//!
//! Cost: a ray per cell, a millisecond or two, and two steps per landmark and cell.

use super::cell_graph::CellGraph;
use super::thickness::straight_behind;
use crate::base::Result;
use crate::spectral::anchor::LandmarkDistances;
use crate::store::run::Run;

/// Least thickness that no way leads through, in units of √(total area). On 190 models, and 16 shapes under six seeds:
/// with .05 parts depend more on the seed, and beyond .15 they agree less with people.
const THIN: f64 = 0.12;

/// The distances `rows` of landmarks from cells where one may also go straight through thin places of the body, once.
///
/// # Errors
/// Cancellation.
pub fn through_thin_places(cells: &CellGraph, mut rows: LandmarkDistances, run: &Run) -> Result<LandmarkDistances> {
    let behind = straight_behind(cells, run)?;
    let thin = |(i, behind): (usize, &Option<(u32, f64)>)| {
        behind.filter(|(_, depth)| *depth < THIN).map(|(j, depth)| (i, j as usize, depth))
    };
    let ways: Vec<(usize, usize, f64)> = behind.iter().enumerate().filter_map(thin).collect();
    for row in rows.values.chunks_mut(cells.len().max(1)) {
        let along = row.to_vec();
        for &(i, j, depth) in &ways {
            row[i] = row[i].min(along[j] + depth);
            row[j] = row[j].min(along[i] + depth);
        }
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Front and back of a plate `thick`, ten cells each in a row, and their distances from the first cell of the
    /// front, where the way around is `around` long.
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
        let short = through_thin_places(&g, rows.clone(), &Run::new(&())).unwrap();
        assert_eq!(short.values[..10], rows.values[..10]);
        let through: Vec<f64> = rows.values[..10].iter().map(|d| d + 0.05).collect();
        assert_eq!(short.values[10..], through);
    }

    #[test]
    fn thick_bodies_and_short_ways_around_stay_as_they_are() {
        for (thick, around) in [(THIN, 0.8), (0.05, 0.04)] {
            let (g, rows) = plate(thick, around);
            assert_eq!(through_thin_places(&g, rows.clone(), &Run::new(&())).unwrap().values, rows.values);
        }
    }

    #[test]
    fn the_sides_of_an_edge_and_open_sheets_are_no_thin_places() {
        let (mut g, rows) = plate(0.05, 0.8);
        // The back leans, as beside the edge of a knife: at 70 degrees it is no back.
        g.normal[10..].fill([0.94, 0., -0.342]);
        assert_eq!(through_thin_places(&g, rows.clone(), &Run::new(&())).unwrap().values, rows.values);
        g.normal[10..].fill([0., 0., 1.]);
        assert_eq!(through_thin_places(&g, rows.clone(), &Run::new(&())).unwrap().values, rows.values);
    }
}
