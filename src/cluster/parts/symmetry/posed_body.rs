//! A body of blocks with limbs in different poses, for tests.

use super::cell_map::Surface;
use crate::base::vector::{dot, minus};
use crate::cluster::parts::cell_graph::CellGraph;
use crate::cluster::parts::thickness::log_thickness;
use crate::store::run::Run;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

type Voxels = BTreeSet<[i32; 3]>;

fn fill(voxels: &mut Voxels, [x, y, z]: [Range<i32>; 3]) {
    for x in x {
        voxels.extend(y.clone().flat_map(|y| z.clone().map(move |z| [x, y, z])));
    }
}

/// Runs `test` on the surface of the whole body.
pub fn on_surface(test: impl FnOnce(&CellGraph, &Surface<'_>)) {
    let cells = posed(true, true);
    let shares = cells.area_shares();
    let thickness = log_thickness(&cells, &Run::new(&())).unwrap();
    test(&cells, &Surface::new(&cells, &shares, &thickness).unwrap());
}

/// A body whose left side stands with its arm stretched out, while the right arm is raised and the right leg walks; arm
/// and leg may be missing.
pub fn posed(arm: bool, leg: bool) -> CellGraph {
    let mut body = Voxels::new();
    let mut add = |there: bool, blocks: &[[Range<i32>; 3]]| {
        for block in blocks.iter().filter(|_| there) {
            // At twice the resolution.
            fill(&mut body, block.clone().map(|range| 2 * range.start..2 * range.end));
        }
    };
    add(true, &[[-3..3, 0..4, 0..12], [-2..2, 0..3, 12..17], [-1..1, -2..0, 13..15]]);
    add(true, &[[3..15, 1..2, 9..10], [1..2, 1..2, -16..0], [1..2, -2..1, -16..-15]]);
    add(arm, &[[-15..-3, 1..2, 9..10]]);
    add(leg, &[[-2..-1, 1..2, -16..0], [-2..-1, -2..1, -16..-15]]);
    let mut cells = surface(&body);
    let unit = 0.5 * (cells.len() as f64).sqrt();
    for (centre, normal) in cells.centre.iter_mut().zip(&mut cells.normal) {
        let at = centre.map(|x| x * unit);
        if at[0] < -5.0 {
            turn(centre, normal, [0, 2], [-5.0 / unit, 9.5 / unit]);
        } else if at[0] < 0.0 && at[2] < -2.0 {
            turn(centre, normal, [1, 2], [1.5 / unit, -2.0 / unit]);
        }
    }
    cells
}

/// Rotates a position and a direction by .6 about a hinge, in the plane of two axes.
fn turn(place: &mut [f64; 3], direction: &mut [f64; 3], [a, b]: [usize; 2], hinge: [f64; 2]) {
    let (sin, cos) = libm::sincos(0.6);
    for (v, [p, q]) in [(place, hinge), (direction, [0.0; 2])] {
        let (x, y) = (v[a] - p, v[b] - q);
        (v[a], v[b]) = (p + cos * x + sin * y, q + cos * y - sin * x);
    }
}

/// A cell for each square on the boundary of the voxels.
fn surface(body: &Voxels) -> CellGraph {
    let mut cells = CellGraph::default();
    let mut edges: BTreeMap<[i32; 3], Vec<u32>> = BTreeMap::new();
    for &voxel in body {
        for (axis, sign) in [(0, -1), (0, 1), (1, -1), (1, 1), (2, -1), (2, 1)] {
            let mut beside = voxel;
            beside[axis] += sign;
            if body.contains(&beside) {
                continue;
            }
            // Doubled positions are integers.
            let mut centre = voxel.map(|x| 2 * x);
            centre[axis] += sign;
            for other in (0..3).filter(|&other| other != axis) {
                for step in [-1, 1] {
                    let mut edge = centre;
                    edge[other] += step;
                    edges.entry(edge).or_default().push(cells.area.len() as u32);
                }
            }
            let mut normal = [0.0; 3];
            normal[axis] = f64::from(sign);
            cells.normal.push(normal);
            cells.centre.push(centre.map(|x| 0.5 * f64::from(x)));
            cells.area.push(1.0);
        }
    }
    let unit = 2.0 * (0.25 * cells.area.len() as f64).sqrt();
    cells.centre.iter_mut().for_each(|centre| *centre = centre.map(|x| x / unit));
    cells.area.iter_mut().for_each(|area| *area /= unit * unit);
    cells.pairs = edges.into_values().map(|both| [both[0], both[1]]).collect();
    // How far each pair turns towards each other, in right angles: positive if concave.
    let turning = |&[i, j]: &[u32; 2]| {
        dot(minus(cells.centre[j as usize], cells.centre[i as usize]), cells.normal[i as usize]).signum()
            * (1.0 - dot(cells.normal[i as usize], cells.normal[j as usize]))
    };
    let turning: Vec<f64> = cells.pairs.iter().map(turning).collect();
    cells.concave = turning.iter().map(|turn| turn.max(0.0)).collect();
    cells.convex = turning.iter().map(|turn| (-turn).max(0.0)).collect();
    cells.length = vec![1.0 / unit; cells.pairs.len()];
    cells
}

/// Whether a position, in units of the blocks, is on each limb.
pub const LEFT_ARM: fn([f64; 3]) -> bool = |x| x[0] > 4.0;
pub const RIGHT_ARM: fn([f64; 3]) -> bool = |x| x[0] < -3.0 && x[2] > 5.0;
pub const LEFT_LEG: fn([f64; 3]) -> bool = |x| x[0] > 0.0 && x[2] < -1.0;
pub const RIGHT_LEG: fn([f64; 3]) -> bool = |x| x[0] < 0.0 && x[2] < 0.0;

/// The numbers of the cells there.
pub fn cells_of(cells: &CellGraph, part: fn([f64; 3]) -> bool) -> Vec<usize> {
    let unit = 0.5 * (cells.len() as f64).sqrt();
    (0..cells.len()).filter(|&i| part(cells.centre[i].map(|x| x * unit))).collect()
}
