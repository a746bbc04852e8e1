//! Left and right of a posed body: the map of the surface onto itself that preserves distances along it and reverses
//! orientation.
//!
//! A body that walks or sits has no mirror plane, but its legs still have the same length. Maps that start from tips of
//! limbs ([`anchored`]) are tried first. If none of these is a reflection beyond doubt, smooth functions give further
//! starts ([`signs`]). Everything is a function of the cells. Cost: .04 to .08 s of processor time and some megabytes
//! for 2,000 cells, whatever the size of the mesh, and .05 to .12 s for the second search.

use super::cell_map::{CellMap, Surface};
use super::mirror_images::CellImages;
use super::{anchored, signs};
use crate::base::Result;
use crate::spectral::exp::exp64;
use crate::store::run::Run;

/// Difference between the distances of a cell and of its image, in cell radii, at which the weight has fallen to e⁻¹.
const REACH: f64 = 3.0;

/// The reflection of a posed body; `None` if there is none beyond doubt.
///
/// # Errors
/// Cancellation.
pub fn reflection(surface: &Surface<'_>, run: &Run) -> Result<Option<CellImages>> {
    let maps = anchored::maps(surface, run)?;
    let dissimilarity = |map: &CellMap| surface.mean_dissimilarity(map);
    let reflections = maps.iter().filter(|map| surface.is_reflection(map));
    let map = match reflections.min_by(|a, b| dissimilarity(a).total_cmp(&dissimilarity(b))) {
        Some(best) => Some(best.clone()),
        None => signs::reflection(surface, &maps, run)?,
    };
    Ok(map.map(|map| {
        let doubt = map.dissimilarity.iter().zip(&map.back).map(|(cost, back)| cost.max(back / 2.0) / REACH);
        CellImages { weight: doubt.map(|doubt| exp64(-doubt.powi(4))).collect(), image: map.image }
    }))
}

#[cfg(test)]
mod tests {
    use super::super::posed_body::{LEFT_ARM, LEFT_LEG, RIGHT_ARM, RIGHT_LEG, cells_of, posed};
    use super::*;
    use crate::cluster::parts::cell_graph::CellGraph;
    use crate::cluster::parts::thickness::log_thickness;

    fn found(cells: &CellGraph) -> Option<CellImages> {
        let run = Run::new(&());
        let (shares, thickness) = (cells.area_shares(), log_thickness(cells, &run).unwrap());
        Surface::new(cells, &shares, &thickness).and_then(|surface| reflection(&surface, &run).unwrap())
    }

    #[test]
    fn a_posed_body_has_a_left_and_a_right() {
        let cells = posed(true, true);
        let CellImages { image, weight } = found(&cells).unwrap();
        for (from, to) in [(LEFT_ARM, RIGHT_ARM), (LEFT_LEG, RIGHT_LEG)] {
            let (from, to) = (cells_of(&cells, from), cells_of(&cells, to));
            let share = from.iter().filter(|&&i| to.contains(&(image[i] as usize))).count() as f64 / from.len() as f64;
            assert!(share > 0.95, "{share}");
        }
        assert!(weight.iter().sum::<f64>() > 0.9 * weight.len() as f64);
    }

    #[test]
    fn what_is_on_one_side_only_has_no_image() {
        let cells = posed(false, true);
        let CellImages { weight, .. } = found(&cells).unwrap();
        let mean = |part: Vec<usize>| part.iter().map(|&i| weight[i]).sum::<f64>() / part.len() as f64;
        let (arm, leg) = (mean(cells_of(&cells, |x| x[0] > 8.0)), mean(cells_of(&cells, LEFT_LEG)));
        assert!(arm < 0.1 && leg > 0.9, "{arm} {leg}");
    }

    #[test]
    fn a_body_that_lacks_an_arm_and_a_leg_is_mirrored_without_them() {
        let cells = posed(false, false);
        let CellImages { image, weight } = found(&cells).unwrap();
        let across = |i: usize| 0.5 * (cells.len() as f64).sqrt() * cells.centre[i][0];
        let trunk = cells_of(&cells, |x| x[0].abs() < 3.5 && x[2] > 1.0 && x[2] < 9.0);
        let mirrored = trunk.iter().filter(|&&i| (across(i) + across(image[i] as usize)).abs() < 2.0).count();
        assert!(mirrored > trunk.len() * 19 / 20, "{mirrored} of {}", trunk.len());
        let arm = cells_of(&cells, |x| x[0] > 4.0 && x[0] < 12.0);
        assert!(arm.iter().map(|&i| weight[i]).sum::<f64>() < 0.2 * arm.len() as f64);
    }

    #[test]
    fn what_has_no_two_sides_or_no_shape_has_no_reflection() {
        // One side is convex where the other is concave.
        let mut cells = posed(true, true);
        for (k, pair) in cells.pairs.iter().enumerate() {
            if cells.centre[pair[0] as usize][0] < 0.0 {
                std::mem::swap(&mut cells.convex[k], &mut cells.concave[k]);
            }
        }
        assert!(found(&cells).is_none());
        // Two pieces, no pieces, a few cells.
        let centre = cells.centre.clone();
        cells.pairs.retain(|pair| pair.iter().all(|&i| centre[i as usize][2] > 0.0));
        assert!(found(&cells).is_none());
        cells.pairs.clear();
        assert!(found(&cells).is_none());
        let few = CellGraph {
            area: vec![1.0; 3],
            centre: vec![[0.0; 3]; 3],
            normal: vec![[0.0; 3]; 3],
            ..CellGraph::default()
        };
        assert!(found(&few).is_none());
    }
}
