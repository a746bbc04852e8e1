//! How exposed each cell is to the outside: the complement of ambient occlusion, from the cells alone.
//!
//! The cells are drawn as discs from 98 directions, or from 26, and a cell is visible if no disc lies more than its own
//! radius in front of its centre. Cells that no direction sees lie inside the surface. Small holes do not let light in,
//! since discs are slightly larger than cells. Directions have small integer components, so no trigonometric function
//! has to give the same result on every processor.
//!
//! Cost: 13 points of each disc along each of 13 or 49 axes, 1.6 or 6 ms of processor time for 2,000 cells; a picture
//! of two depths per thread.

use crate::base::Result;
use crate::base::vector::{MapEach, dot, unit};
use crate::cluster::parts::cell_graph::CellGraph;
use crate::cluster::parts::cell_labels::class_sums;
use crate::cluster::parts::thickness::tangents;
use crate::store::run::Run;

/// Directions have integer components up to these, without a common divisor: 26 of them, or 98.
#[derive(Clone, Copy, Debug)]
pub(super) enum Directions {
    Few = 1,
    Many = 2,
}

/// Side of a pixel, relative to the radius of a cell of mean area.
const PIXEL: f64 = 0.8;
/// Maximum number of pixels of a picture, 4 MB: some seven times the square root of the area across. A longer surface
/// hides next to nothing of itself.
const PIXELS: usize = 1 << 19;
/// Radius of a disc, relative to that of the cell.
const COVER: f64 = 1.1;
/// Points of a disc besides its centre, relative to the radius of the cell: two rings of six. Discs are larger than
/// cells, so that no light falls between them.
const POINTS: [[f64; 2]; 12] = {
    const NEAR: f64 = 0.63;
    const FAR: f64 = COVER;
    // Half the root of 3.
    const R: f64 = 0.866_025_403_784_438_6;
    [
        [NEAR, 0.],
        [0.5 * NEAR, R * NEAR],
        [-0.5 * NEAR, R * NEAR],
        [-NEAR, 0.],
        [-0.5 * NEAR, -R * NEAR],
        [0.5 * NEAR, -R * NEAR],
        [R * FAR, 0.5 * FAR],
        [0., FAR],
        [-R * FAR, 0.5 * FAR],
        [-R * FAR, -0.5 * FAR],
        [0., -FAR],
        [R * FAR, -0.5 * FAR],
    ]
};

/// The share of directions in front of each cell, weighted by the cosine of their angle, from which it is visible (S):
/// 1 on a convex body, 0 inside. All 1 if the surface is too long for a picture.
///
/// # Errors
/// Cancellation.
pub(super) fn exposure(cells: &CellGraph, directions: Directions, run: &Run) -> Result<Vec<f64>> {
    shares_seen(cells, directions, |_| true, 1., run)
}

/// The same if only cells that are not `among` (S) hide others. These lie on other surfaces, so any of their discs
/// hides what is behind it, however near.
///
/// # Errors
/// Cancellation.
pub(super) fn exposure_behind_others(cells: &CellGraph, among: &[bool], run: &Run) -> Result<Vec<f64>> {
    shares_seen(cells, Directions::Few, |i| !among[i], 0., run)
}

/// Whether the mean `exposure` of each of the `count` pieces of surface, by area, is below `than`; `piece` is the one
/// of each cell (S).
pub(super) fn dark_pieces(cells: &CellGraph, exposure: &[f64], piece: &[u32], count: usize, than: f64) -> Vec<bool> {
    let light: Vec<f64> = exposure.iter().zip(&cells.area).map(|(x, area)| x * area).collect();
    let [light, area] = [&light, &cells.area].map(|values| class_sums(piece, values, count));
    light.iter().zip(area).map(|(light, area)| *light < than * area).collect()
}

/// The exposure of cells behind those that `hides`; a disc hides what is more than `slack` radii behind it.
fn shares_seen(
    cells: &CellGraph,
    directions: Directions,
    hides: impl Fn(usize) -> bool + Sync,
    slack: f64,
    run: &Run,
) -> Result<Vec<f64>> {
    let discs: Vec<Disc> =
        cells.radii().into_iter().enumerate().map(|(i, radius)| Disc::of(cells, i, radius)).collect();
    let axes = axes(directions);
    let picture = |k: usize, depths: &mut Vec<[f32; 2]>| Ok(seen_along(&discs, axes[k], &hides, slack, depths));
    let pictures = run.map_chunks(axes.len(), Vec::new, picture)?;
    let mut seen = vec![0.; cells.len()];
    let mut facing = vec![0.; cells.len()];
    for (picture, axis) in pictures.iter().zip(&axes) {
        for (i, &is_seen) in picture.iter().enumerate() {
            let cosine = dot(cells.normal[i], *axis).abs();
            facing[i] += cosine;
            seen[i] += if is_seen { cosine } else { 0. };
        }
    }
    Ok(seen.iter().zip(&facing).map(|(seen, facing)| if *facing > 0. { seen / facing } else { 1. }).collect())
}

/// A cell as a disc: its centre, and sample points.
struct Disc {
    points: [[f64; 3]; 1 + POINTS.len()],
    normal: [f64; 3],
    radius: f64,
}

impl Disc {
    fn of(cells: &CellGraph, i: usize, radius: f64) -> Self {
        let (x, normal) = (cells.centre[i], cells.normal[i]);
        let [u, v] = tangents(normal);
        let point = |[p, q]: [f64; 2]| std::array::from_fn(|c| x[c] + radius * (p * u[c] + q * v[c]));
        let mut points = [x; 1 + POINTS.len()];
        points[1..].iter_mut().zip(POINTS).for_each(|(slot, at)| *slot = point(at));
        Self { points, normal, radius }
    }

    fn centre(&self) -> [f64; 3] {
        self.points[0]
    }
}

/// One direction of each opposite pair.
fn axes(directions: Directions) -> Vec<[f64; 3]> {
    let most = directions as i32;
    let numbers = || -most..=most;
    let all = numbers().flat_map(|a| numbers().flat_map(move |b| (-most..=most).map(move |c| [a, b, c])));
    let even = |v: &[i32; 3]| v.iter().all(|x| x % 2 == 0);
    let first = |v: &[i32; 3]| v.iter().find(|x| **x != 0).is_some_and(|x| *x > 0);
    all.filter(|v| first(v) && !even(v)).map(|v| unit(v.map(f64::from))).collect()
}

/// Whether each of `discs` is visible along `axis`, from the end that it faces, behind those that `hides`. `depths` is
/// a buffer for a picture.
fn seen_along(
    discs: &[Disc],
    axis: [f64; 3],
    hides: &impl Fn(usize) -> bool,
    slack: f64,
    depths: &mut Vec<[f32; 2]>,
) -> Vec<bool> {
    let square = discs.iter().map(|disc| disc.radius * disc.radius).sum::<f64>() / discs.len().max(1) as f64;
    let per_pixel = 1. / (PIXEL * square.sqrt());
    let [right, up] = tangents(axis).map_each(|t| t.map_each(|x| x * per_pixel));
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for disc in discs {
        for (c, t) in [right, up].into_iter().enumerate() {
            let p = dot(disc.centre(), t);
            low[c] = low[c].min(p - COVER * disc.radius * per_pixel);
            high[c] = high[c].max(p + COVER * disc.radius * per_pixel);
        }
    }
    let [width, height] = [0, 1].map(|c| high[c] - low[c] + 2.);
    let fits = width * height < PIXELS as f64;
    if !fits {
        return vec![true; discs.len()];
    }
    let width = width as usize;
    let last = width * (height as usize) - 1;
    // Meaningless if coordinates are so large that positions cannot be distinguished, but within bounds.
    let at = |x: [f64; 3]| ((dot(x, up) - low[1]) as usize * width + (dot(x, right) - low[0]) as usize).min(last);
    depths.clear();
    depths.resize(last + 1, [f32::INFINITY, f32::NEG_INFINITY]);
    for (_, disc) in discs.iter().enumerate().filter(|(i, _)| hides(*i)) {
        for &x in &disc.points {
            let [nearest, farthest] = &mut depths[at(x)];
            let depth = dot(x, axis) as f32;
            (*nearest, *farthest) = (nearest.min(depth), farthest.max(depth));
        }
    }
    let seen = |disc: &Disc| {
        let ([nearest, farthest], depth) = (depths[at(disc.centre())], dot(disc.centre(), axis));
        if dot(disc.normal, axis) > 0. {
            depth >= f64::from(farthest) - slack * disc.radius
        } else {
            depth <= f64::from(nearest) + slack * disc.radius
        }
    };
    discs.iter().map(seen).collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use std::f64::consts::PI;

    /// Cells of equal area on balls around the origin: radius, number of cells, whether normals point inwards. Areas
    /// sum to 1. Cells of one ball are adjacent along a spiral, by short borders.
    pub(in crate::cluster::parts) fn balls(all: &[(f64, usize, bool)]) -> CellGraph {
        let mut cells = CellGraph::default();
        for &(radius, n, inwards) in all {
            let first = cells.len() as u32;
            cells.pairs.extend((first + 1..first + n as u32).map(|i| [i - 1, i]));
            for k in 0..n {
                let (z, turn) = (1. - (2 * k + 1) as f64 / n as f64, 2.399_963_23 * k as f64);
                let r = (1. - z * z).sqrt();
                let out = [r * turn.cos(), r * turn.sin(), z];
                cells.centre.push(out.map(|x| radius * x));
                cells.normal.push(if inwards { out.map(|x| -x) } else { out });
                cells.area.push(4. * PI * radius * radius / n as f64);
            }
        }
        let total = cells.total_area();
        let unit = total.sqrt();
        cells.area.iter_mut().for_each(|a| *a /= total);
        cells.centre.iter_mut().flatten().for_each(|x| *x /= unit);
        cells.length = vec![0.01; cells.pairs.len()];
        let flat = vec![0.; cells.pairs.len()];
        (cells.concave, cells.convex, cells.convex04) = (flat.clone(), flat.clone(), flat);
        cells
    }

    #[test]
    fn a_ball_is_seen_and_what_is_within_is_not() {
        let cells = balls(&[(1., 900, false), (0.9, 700, true), (0.5, 300, false)]);
        let seen = exposure(&cells, Directions::Many, &Run::new(&())).unwrap();
        let of =
            |range: std::ops::Range<usize>| seen[range].iter().fold([1f64, 0.], |[a, b], x| [a.min(*x), b.max(*x)]);
        let ([least, _], [_, wall], [_, within]) = (of(0..900), of(900..1600), of(1600..1900));
        assert!(least > 0.6 && wall < 0.05 && within < 0.05, "{least} {wall} {within}");
    }

    #[test]
    fn directions_are_spread_evenly() {
        for (directions, count) in [(Directions::Few, 13), (Directions::Many, 49)] {
            let axes = axes(directions);
            assert_eq!(axes.len(), count);
            let second = |c: usize| axes.iter().map(|a| a[c] * a[c]).sum::<f64>() / count as f64;
            assert!((0..3).all(|c| (second(c) - 1. / 3.).abs() < 1e-12));
        }
    }

    #[test]
    fn threads_change_nothing_and_no_extent_is_no_error() {
        let cells = balls(&[(1., 300, false), (0.8, 200, true)]);
        let with = |threads| exposure(&cells, Directions::Many, &Run { threads, ..Run::new(&()) }).unwrap();
        assert_eq!(with(1), with(3));
        assert!(exposure(&CellGraph::default(), Directions::Few, &Run::new(&())).unwrap().is_empty());
        // One cell is very far away, and one has no normal.
        let mut far = cells;
        (far.centre[7], far.normal[9]) = ([1e100; 3], [0.; 3]);
        assert_eq!(exposure(&far, Directions::Many, &Run::new(&())).unwrap(), vec![1.; 500]);
    }
}
