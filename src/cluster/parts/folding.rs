//! How folded a surface is, and the effect on lengths.
//!
//! The cortex of a brain has three times the area of a sphere as wide as the brain. Boundaries run through its folds,
//! so they are long, and the brain is small in units of √(area). The probabilities of merges are fitted to surfaces
//! without folds. There, a long boundary between low regions indicates one part, and two hemispheres, which touch along
//! a short line, looked like that. So lengths are measured in units of the unfolded shape.
//!
//! Cost: S steps for each of 13 directions.

use super::cell_graph::CellGraph;
use crate::base::vector::dot;
use libm::log as ln;

/// Ratio of the area to that of a sphere of the same mean width above which a surface counts as folded. The 190 models
/// of the benchmark have at most 1.5, a hemisphere of a brain 2.1, whole brains 3.1 to 3.4, a head with all that is
/// inside 4.1.
const FOLDED: f64 = 2.0;
/// Maximum folding taken into account: with more, crumbs become parts (5 or 6 parts of the MRI head instead of 2 to 5).
const MOST: f64 = 3.0;
/// Directions of Lebedev's 26 points on the sphere, one of each opposite pair, with doubled weights: exact up to degree
/// 7.
const DIRECTIONS: [([f64; 3], f64); 13] = {
    const AXIS: f64 = 2.0 / 21.0;
    const EDGE: f64 = 8.0 / 105.0;
    const CORNER: f64 = 9.0 / 140.0;
    [
        ([1.0, 0.0, 0.0], AXIS),
        ([0.0, 1.0, 0.0], AXIS),
        ([0.0, 0.0, 1.0], AXIS),
        ([1.0, 1.0, 0.0], EDGE),
        ([1.0, -1.0, 0.0], EDGE),
        ([1.0, 0.0, 1.0], EDGE),
        ([1.0, 0.0, -1.0], EDGE),
        ([0.0, 1.0, 1.0], EDGE),
        ([0.0, 1.0, -1.0], EDGE),
        ([1.0, 1.0, 1.0], CORNER),
        ([1.0, 1.0, -1.0], CORNER),
        ([1.0, -1.0, 1.0], CORNER),
        ([1.0, -1.0, -1.0], CORNER),
    ]
};

/// The natural logarithm of the folding φ of a surface: 0 if it is not folded. In units of √(area), lengths of the
/// shape are too small by √φ, and boundaries along folds too long by √φ: by φ relative to the shape.
pub fn log_folding(cells: &CellGraph) -> f64 {
    let width = mean_width(&cells.centre);
    let ratio = cells.total_area() / (std::f64::consts::PI * width * width).max(1e-300);
    // Squared: on a moderately folded surface, the shape itself accounts for more of the area.
    ln((ratio / FOLDED).powi(2).clamp(1.0, MOST))
}

/// The mean distance between two parallel planes that enclose all `points`.
fn mean_width(points: &[[f64; 3]]) -> f64 {
    let width = |direction: &[f64; 3]| {
        let ends =
            |(low, high): (f64, f64), x: &[f64; 3]| (low.min(dot(*x, *direction)), high.max(dot(*x, *direction)));
        let (low, high) = points.iter().fold((f64::INFINITY, f64::NEG_INFINITY), ends);
        let length: f64 = direction.iter().map(|x| x * x).sum();
        (high - low).max(0.0) / length.sqrt()
    };
    DIRECTIONS.iter().map(|(direction, weight)| weight * width(direction)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cells of total area 1 on a sphere of area 1 / `ratio`.
    fn ball(ratio: f64) -> CellGraph {
        let radius = (0.25 / (std::f64::consts::PI * ratio)).sqrt();
        let n = 2000;
        let centre = |k: usize| {
            let (z, turn) = (1.0 - (2 * k + 1) as f64 / n as f64, 2.4 * k as f64);
            let r = (1.0 - z * z).sqrt();
            [3.0 + radius * r * turn.cos(), radius * r * turn.sin(), radius * z]
        };
        CellGraph { area: vec![1.0 / n as f64; n], centre: (0..n).map(centre).collect(), ..CellGraph::default() }
    }

    #[test]
    fn weights_are_a_mean() {
        assert!((DIRECTIONS.iter().map(|(_, weight)| weight).sum::<f64>() - 1.0).abs() < 1e-15);
    }

    #[test]
    fn a_ball_of_much_area_is_folded() {
        assert_eq!([0.5, 1.0, 1.9].map(|ratio| log_folding(&ball(ratio))), [0.0; 3]);
        let folding = log_folding(&ball(3.0)).exp();
        assert!((folding - 2.25).abs() < 0.05, "{folding}");
        assert_eq!(log_folding(&ball(10.0)), ln(MOST));
    }

    #[test]
    fn no_extent_at_all_is_no_error() {
        let point = CellGraph { area: vec![1.0], centre: vec![[1.0; 3]], ..CellGraph::default() };
        assert_eq!(log_folding(&point), ln(MOST));
        assert_eq!(log_folding(&CellGraph::default()), 0.0);
    }
}
