//! Rotations of a surface onto itself: gears, wheels, crowns, stools, and surfaces of revolution.
//!
//! A surface with n ≥ 3 such rotations about an axis has two equal second moments across it. So there are at most two
//! candidates, and most surfaces have none. The greatest n counts for which all rotations by k/n of a turn map points
//! onto points, by position and normal; a dozen stand for all of a surface of revolution.
//!
//! Cost: nothing without equal moments; otherwise some 80 searches for up to 500 points each in a grid, and one for
//! each cell and rotation: some hundredths of a second.

use super::mirror_images::CellImages;
use super::rigid_motion::turn;
use crate::base::vector::{add_scaled, minus};
use crate::cluster::mirror::{NearestPoint, PointSet, REACH, SurfacePoint, centroid, second_moments};
use std::f64::consts::TAU;

/// The greatest number of rotations considered.
const MOST_TURNS: usize = 40;
/// The number of rotations that stand for all of a surface of revolution.
const REVOLUTION: usize = 12;
/// Number of points used to test a rotation.
const SAMPLE: usize = 500;
/// Maximum mean distance of rotated points from the nearest ones, in radii, for a rotation: exact ones of points drawn
/// at random have .66 to .77, and gears turned by a tenth of a tooth .78 to .8.
const CLOSE: f64 = 0.85;
/// Maximum difference of two moments that count as equal, as a share of the greater.
const EQUAL: f64 = 0.1;

/// An axis of rotation.
#[derive(Clone, Copy, Debug)]
struct Axis {
    through: [f64; 3],
    along: [f64; 3],
}

impl Axis {
    /// The image of a point under a rotation by `angle`.
    fn turned(self, point: SurfacePoint, angle: f64) -> SurfacePoint {
        let turn = turn(self.along, angle);
        let arm = turn(minus(point.position, self.through));
        SurfacePoint { position: add_scaled(arm, 1.0, self.through), normal: turn(point.normal) }
    }

    /// The number of rotations onto itself, 1 if there are fewer than three.
    fn turns(self, nearest: &NearestPoint<'_>) -> usize {
        let PointSet { points, shares, radius } = nearest.set();
        let step = points.len().div_ceil(SAMPLE).max(1);
        let total: f64 = shares.iter().step_by(step).sum();
        let fits = |angle: f64| {
            let far =
                |point: &SurfacePoint| nearest.find(self.turned(*point, angle)).map_or(REACH, |(_, d)| d / radius);
            let mut left = CLOSE * total;
            points.iter().zip(shares).step_by(step).all(|(point, share)| {
                left -= share * far(point);
                left >= 0.0
            })
        };
        // Rotations by nearly half a turn differ most between neighbouring n.
        let all_fit = |n: &usize| (1..=n / 2).rev().all(|k| fits(TAU * k as f64 / *n as f64));
        let most = (3..=MOST_TURNS).rev().find(all_fit).unwrap_or(1);
        if most > REVOLUTION && all_fit(&(most - 1)) { REVOLUTION } else { most }
    }
}

/// The images of all cells under the rotations by 1/n, 2/n, …, (n − 1)/n of a turn; none if fewer than three rotations,
/// identity included, map the surface onto itself. Cells are searched by `nearest`.
pub fn rotations(nearest: &NearestPoint<'_>) -> Vec<CellImages> {
    let PointSet { points, shares, .. } = nearest.set();
    let through = centroid(points, shares);
    let Some((moments, axes)) = second_moments(points, shares, through) else { return Vec::new() };
    let is_equal = |a: f64, b: f64| a - b <= EQUAL * a;
    let candidates = [(2, is_equal(moments[0], moments[1])), (0, is_equal(moments[1], moments[2]))];
    let count = |&(k, equal): &(usize, bool)| {
        let axis = Axis { through, along: axes[k] };
        equal.then(|| (axis.turns(nearest), axis))
    };
    let Some((turns, axis)) = candidates.iter().filter_map(count).max_by_key(|(turns, _)| *turns) else {
        return Vec::new();
    };
    let angle = |k: usize| TAU * k as f64 / turns as f64;
    (1..turns).map(|k| CellImages::under(|point| axis.turned(point, angle(k)), nearest)).collect()
}

#[cfg(test)]
mod tests {
    use super::super::mirror_images::cell_points;
    use super::*;
    use crate::base::vector::{dot, unit as unit_vector};
    use crate::cluster::parts::cell_graph::CellGraph;

    /// Cells spread over a wall of height 1 around a vertical axis, whose distance from it is 1 + `wave` cos `teeth` θ,
    /// with a bump of height `bump` on one side.
    fn wall(teeth: usize, wave: f64, bump: f64) -> CellGraph {
        let mut cells = CellGraph::default();
        for k in 0..193 * 31 {
            // A grid, moved irregularly: multiples of powers of the plastic number spread evenly.
            let [along, up] = [0.754_877_666, 0.569_840_291].map(|step| 0.4 * (step * f64::from(k)).fract());
            let (turn, height) = (TAU * (f64::from(k % 193) + along) / 193.0, (f64::from(k / 193) + up) / 31.0);
            let (sin, cos) = libm::sincos(turn);
            let (slope, swell) = libm::sincos(teeth as f64 * turn);
            let out = 1.0 + wave * swell + if turn < 1.0 { bump } else { 0.0 };
            let steep = wave * teeth as f64 * slope / out;
            cells.centre.push([2.0 + out * cos, 3.0 + out * sin, height]);
            cells.normal.push(unit_vector([cos - steep * sin, sin + steep * cos, 0.0]));
            cells.area.push(TAU / f64::from(193 * 31));
        }
        cells
    }

    fn maps(cells: &CellGraph, shares: &[f64]) -> Vec<CellImages> {
        rotations(&NearestPoint::new(PointSet::new(&cell_points(cells), shares, cells.total_area())))
    }

    fn found(cells: &CellGraph) -> usize {
        maps(cells, &cells.area_shares()).len() + 1
    }

    #[test]
    fn as_many_rotations_are_found_as_there_are_teeth() {
        for (teeth, wave) in [(3, 0.15), (4, 0.15), (5, 0.15), (9, 0.06), (16, 0.03)] {
            assert_eq!(found(&wall(teeth, wave, 0.0)), teeth, "{teeth} teeth");
        }
        // Two are left to mirror planes; a bump on one side breaks all.
        assert_eq!(found(&wall(1, 0.0, 0.0)), REVOLUTION);
        assert_eq!([found(&wall(2, 0.3, 0.0)), found(&wall(5, 0.15, 0.5)), found(&CellGraph::default())], [1; 3]);
    }

    #[test]
    fn images_are_where_rotations_take_cells() {
        let cells = wall(5, 0.15, 0.0);
        let shares = cells.area_shares();
        let maps = maps(&cells, &shares);
        for (k, map) in (1..).zip(&maps) {
            let (sin, cos) = libm::sincos(TAU * f64::from(k) / 5.0);
            let far = |(cell, &image): (usize, &u32)| {
                let [x, y, z] = minus(cells.centre[cell], [2.0, 3.0, 0.0]);
                let turned = [2.0 + cos * x - sin * y, 3.0 + sin * x + cos * y, z];
                let d = minus(turned, cells.centre[image as usize]);
                dot(d, d).sqrt()
            };
            let mean = map.image.iter().enumerate().map(far).sum::<f64>() / cells.len() as f64;
            assert!(mean < 0.04, "{mean}");
            assert!(map.likeness(&shares) > 0.9);
        }
    }
}
