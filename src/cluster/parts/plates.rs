//! Flat plates: their two sides are one, and compared as if the plate were inflated.
//!
//! Arms of a flat plate, such as a laser-cut starfish, are as plain to people as those of a round one. But front and
//! back are flat, so a cut across them has no concave edge, all cells of a side see each other as convex, and only the
//! corners of the rim show where an arm begins. So regions of a plate are compared on its
//! [inflated](Plate::inflated) shape, as outlines are inflated in sketching (Igarashi, Matsuoka and Tanaka, *SIGGRAPH*
//! 1999): the rim stays, and both sides rise to a multiple of √u, where Δu = −4 on each side and u = 0 at the rim. A
//! disc becomes an ellipsoid, a strip a tube, and a junction of strips bulges. Areas, lengths and neighbours stay those
//! of the plate. A place on one side is then treated as one with the place opposite ([`Plate::sides_as_one`]).
//!
//! Cost for S cells and R superfaces: S² distances, some hundred rounds of conjugate gradients, and R² times the
//! overlaps with opposite superfaces: some ten milliseconds. One matrix of R × R. Nothing for other shapes but their
//! moments.

use super::cell_graph::CellGraph;
use super::matrix::Square;
use super::symmetry::mirror_images::{MirrorImages, superface_images};
use crate::base::moments::{principal_axes, products};
use crate::base::vector::{add_scaled, axpy, cross, dot, inner_product, length, minus, unit};

/// A plate lies within a slab of this thickness, in units of √(total area).
const SLAB: f64 = 0.12;
/// Cosine of the angle with the axis of the slab below which a cell belongs to the rim.
const RIM: f64 = 0.7;
/// Cosine of that angle from which a cell is flat, and the minimum share of the area of both sides that is: terrain in
/// relief is no plate.
const FLAT: (f64, f64) = (0.97, 0.8);
/// Minimum share of either side in the area: a single sheet is no plate.
const SIDE: f64 = 0.25;
/// The height to which a side rises, in units of √u.
const RISE: f64 = 1.8;
/// Maximum number of rounds of conjugate gradients, and the share of the first residual at which they end.
const ROUNDS: usize = 500;
const RESIDUAL: f64 = 1e-6;

/// A surface that consists of two flat sides and a rim, within a thin slab.
#[derive(Clone, Debug)]
pub struct Plate {
    /// Direction across the slab, a unit vector.
    axis: [f64; 3],
    /// For each cell, the cosine of the angle between its normal and the axis (S).
    side: Vec<f64>,
    /// Whether each cell belongs to the rim (S).
    is_rim: Vec<bool>,
}

impl Plate {
    /// The plate that `cells` form, if they do.
    pub fn of(cells: &CellGraph) -> Option<Plate> {
        let (total, mut mean, mut second) = (cells.total_area(), [0.0; 3], [0.0; 6]);
        for (&x, area) in cells.centre.iter().zip(&cells.area) {
            axpy(&mut mean, area / total, &x);
            axpy(&mut second, area / total, &products(x));
        }
        let of_mean = products(mean);
        let moments: [f64; 6] = std::array::from_fn(|k| second[k] - of_mean[k]);
        if !moments.iter().all(|x| x.is_finite()) {
            return None;
        }
        let [.., axis] = principal_axes(moments).1;
        let heights = cells.centre.iter().map(|&x| dot(x, axis));
        let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
        if high - low >= SLAB * total.sqrt() {
            return None;
        }
        let side: Vec<f64> = cells.normal.iter().map(|&normal| dot(normal, axis)).collect();
        let share = |is_part: &dyn Fn(f64) -> bool| -> f64 {
            side.iter().zip(&cells.area).filter(|(side, _)| is_part(**side)).map(|(_, area)| area / total).sum()
        };
        let (front, back) = (share(&|side| side >= RIM), share(&|side| side <= -RIM));
        if front.min(back) < SIDE || share(&|side| side.abs() >= FLAT.0) < FLAT.1 * (front + back) {
            return None;
        }
        let mut is_rim: Vec<bool> = side.iter().map(|side| side.abs() < RIM).collect();
        for &[i, j] in &cells.pairs {
            let (i, j) = (i as usize, j as usize);
            // Front and back meet: there the rim is narrower than a cell.
            if side[i].min(side[j]) <= -RIM && side[i].max(side[j]) >= RIM {
                (is_rim[i], is_rim[j]) = (true, true);
            }
        }
        Some(Plate { axis, side, is_rim })
    }

    /// The direction in which each cell rises.
    fn outward(&self, cell: usize) -> [f64; 3] {
        self.axis.map(|x| x * self.side[cell].signum())
    }

    /// The `cells` of the plate in its inflated shape, with its angles.
    pub fn inflated(&self, cells: &CellGraph) -> CellGraph {
        let u = solved(cells, &self.is_rim);
        let height: Vec<f64> = u.into_iter().map(|u| RISE * u.max(0.0).sqrt()).collect();
        let slopes = self.slopes(cells, &height);
        let raised = |(i, &x): (usize, &[f64; 3])| add_scaled(x, height[i], self.outward(i));
        let centre: Vec<[f64; 3]> = cells.centre.iter().enumerate().map(raised).collect();
        let turned = |(i, &normal): (usize, &[f64; 3])| {
            if self.is_rim[i] { normal } else { unit(minus(self.outward(i), slopes[i])) }
        };
        let normal: Vec<[f64; 3]> = cells.normal.iter().enumerate().map(turned).collect();
        // The angle between the normals of two neighbours, negative if they turn towards each other.
        let turn = |&[i, j]: &[u32; 2]| {
            let (i, j) = (i as usize, j as usize);
            let apart = minus(normal[j], normal[i]);
            let angle = 2.0 * libm::asin((0.5 * length(apart)).min(1.0));
            if dot(apart, minus(centre[j], centre[i])) < 0.0 { -angle } else { angle }
        };
        let turns: Vec<f64> = cells.pairs.iter().map(turn).collect();
        let convex: Vec<f64> = turns.iter().map(|turn| turn.max(0.0)).collect();
        let concave = turns.iter().map(|turn| (-turn).max(0.0)).collect();
        CellGraph { concave, convex04: convex.clone(), convex, centre, normal, ..cells.clone() }
    }

    /// The gradient of `height` (S) along the slab at each cell, by least squares over its neighbours (S).
    fn slopes(&self, cells: &CellGraph, height: &[f64]) -> Vec<[f64; 3]> {
        let other = if self.axis[0].abs() < 0.6 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
        let first = unit(cross(self.axis, other));
        let second = cross(self.axis, first);
        let slope = |(i, beside): (usize, &Vec<u32>)| {
            let (mut xx, mut xy, mut yy, mut xz, mut yz) = (0.0, 0.0, 0.0, 0.0, 0.0);
            for &j in beside {
                let way = minus(cells.centre[j as usize], cells.centre[i]);
                let (x, y, z) = (dot(way, first), dot(way, second), height[j as usize] - height[i]);
                (xx, xy, yy, xz, yz) = (xx + x * x, xy + x * y, yy + y * y, xz + x * z, yz + y * z);
            }
            let determinant = xx * yy - xy * xy;
            if determinant <= 1e-9 * (xx + yy) * (xx + yy) {
                return [0.0; 3];
            }
            let (along, across) = ((yy * xz - xy * yz) / determinant, (xx * yz - xy * xz) / determinant);
            add_scaled(first.map(|x| x * along), across, second)
        };
        cells.neighbours().iter().enumerate().map(slope).collect()
    }

    /// For each cell of a side, the cell of the other side nearest to its mirror image; cells of the rim have none.
    fn opposite(&self, cells: &CellGraph) -> MirrorImages {
        let inside = |i: usize| !self.is_rim[i];
        let nearest = |i: usize| {
            let along = |j: usize| {
                let way = minus(cells.centre[j], cells.centre[i]);
                let across = dot(way, self.axis);
                dot(way, way) - across * across
            };
            let others = (0..cells.len()).filter(|&j| inside(j) && self.side[i] * self.side[j] < 0.0);
            others.min_by(|&a, &b| along(a).total_cmp(&along(b)))
        };
        let found: Vec<Option<usize>> =
            (0..cells.len()).map(|i| Some(i).filter(|&i| inside(i)).and_then(nearest)).collect();
        MirrorImages {
            image: found.iter().zip(0u32..).map(|(j, i)| j.map_or(i, |j| j as u32)).collect(),
            weight: found.iter().map(|j| f64::from(u8::from(j.is_some()))).collect(),
        }
    }

    /// The co-association C of superfaces (R × R) with both sides as one place: the mean of C over either superface and
    /// what lies opposite. `of_cell` is the superface of each of the `cells` (S).
    pub fn sides_as_one(&self, cells: &CellGraph, of_cell: &[u32], c: &Square) -> Square {
        let n = c.len();
        let (images, sure) = superface_images(n, of_cell, &cells.area_shares(), &self.opposite(cells));
        // The mean over the rows of a superface and of what lies opposite; C is symmetric.
        let averaged = |c: &Square| {
            let mut out = Square::zeros(n);
            let mut row = vec![0.0; n];
            for x in 0..n {
                row.copy_from_slice(c.row(x));
                images[x].iter().for_each(|&(y, share)| axpy(&mut row, sure[x] * share, c.row(y as usize)));
                row.iter().enumerate().for_each(|(y, value)| out[(y, x)] = value / (1.0 + sure[x]));
            }
            out
        };
        let mut out = averaged(&averaged(c));
        for x in 0..n {
            for y in 0..x {
                out[(y, x)] = out[(x, y)];
            }
            out[(x, x)] = c[(x, x)];
        }
        out
    }
}

/// The solution u of Δu = −4 on the cells that are not of the rim (S), with u = 0 there: finite volumes, by conjugate
/// gradients.
fn solved(cells: &CellGraph, is_rim: &[bool]) -> Vec<f64> {
    let apart = |[i, j]: [u32; 2]| length(minus(cells.centre[j as usize], cells.centre[i as usize]));
    let weight = cells.pairs.iter().zip(&cells.length).map(|(&pair, along)| along / apart(pair).max(1e-9));
    let weight: Vec<f64> = weight.collect();
    let flow = |u: &[f64]| {
        let mut out = vec![0.0; u.len()];
        for (&[i, j], weight) in cells.pairs.iter().zip(&weight) {
            let (i, j) = (i as usize, j as usize);
            let flow = weight * (u[i] - u[j]);
            out[i] += flow;
            out[j] -= flow;
        }
        out.iter_mut().zip(is_rim).filter(|(_, is_rim)| **is_rim).for_each(|(out, _)| *out = 0.0);
        out
    };
    let source = |(area, is_rim): (&f64, &bool)| if *is_rim { 0.0 } else { 4.0 * area };
    let mut residual: Vec<f64> = cells.area.iter().zip(is_rim).map(source).collect();
    let (mut u, mut way) = (vec![0.0; residual.len()], residual.clone());
    let mut left = inner_product(&residual, &residual);
    let enough = RESIDUAL * RESIDUAL * left;
    for _ in 0..ROUNDS {
        let image = flow(&way);
        let curvature = inner_product(&way, &image);
        if left <= enough || curvature <= 0.0 {
            break;
        }
        axpy(&mut u, left / curvature, &way);
        axpy(&mut residual, -left / curvature, &image);
        let next = inner_product(&residual, &residual);
        way.iter_mut().zip(&residual).for_each(|(way, residual)| *way = residual + next / left * *way);
        left = next;
    }
    u
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{below, stream, unit as random_unit};

    /// Both sides of a disc of radius 1, as a grid of cells of this width, with the cells beyond the radius as rim.
    fn disc(width: f64) -> CellGraph {
        let half = (1.0 / width) as i32 + 1;
        let mut cells = CellGraph::default();
        let mut number = std::collections::BTreeMap::new();
        for (side, x, y) in
            [1, -1].iter().flat_map(|s| (-half..=half).flat_map(move |x| (-half..=half).map(move |y| (s, x, y))))
        {
            let at = [f64::from(x) * width, f64::from(y) * width, 0.05 * f64::from(*side)];
            let from_middle = at[0].hypot(at[1]);
            if from_middle >= 1.0 + width {
                continue;
            }
            number.insert((*side, x, y), cells.area.len() as u32);
            let is_rim = from_middle >= 1.0;
            cells.area.push(width * width);
            cells.normal.push(if is_rim {
                [at[0] / from_middle, at[1] / from_middle, 0.0]
            } else {
                [0.0, 0.0, f64::from(*side)]
            });
            cells.centre.push(at);
        }
        for (&(side, x, y), &i) in &number {
            for other in [(side, x + 1, y), (side, x, y + 1)] {
                if let Some(&j) = number.get(&other) {
                    cells.pairs.push([i, j]);
                }
            }
        }
        cells.length = vec![width; cells.pairs.len()];
        (cells.concave, cells.convex, cells.convex04) = Default::default();
        cells
    }

    /// Δu = −4 on the unit disc has the solution 1 − r².
    #[test]
    fn a_disc_is_inflated_to_an_ellipsoid() {
        let cells = disc(0.04);
        let plate = Plate::of(&cells).unwrap();
        let inflated = plate.inflated(&cells);
        for (i, (from, to)) in cells.centre.iter().zip(&inflated.centre).enumerate() {
            let r = from[0].hypot(from[1]);
            let height = RISE * (1.0 - r * r).max(0.0).sqrt();
            assert!((to[0] - from[0]).abs() < 1e-9 && (to[1] - from[1]).abs() < 1e-9);
            if r < 0.8 {
                let risen = (to[2] - from[2]) * from[2].signum();
                assert!((risen - height).abs() < 0.06 * RISE, "{i}: {risen} instead of {height}");
                // The normal of z = height(r).
                let slope = RISE * r / (1.0 - r * r).sqrt();
                let right = slope / slope.hypot(1.0);
                let leans = inflated.normal[i][0].hypot(inflated.normal[i][1]);
                assert!((leans - right).abs() < 0.05, "{i}: {leans} instead of {right}");
            }
        }
        // An ellipsoid is convex.
        let inner = |&[i, j]: &[u32; 2]| {
            [i, j].iter().all(|&k| cells.centre[k as usize][0].hypot(cells.centre[k as usize][1]) < 0.8)
        };
        let concave = inflated.pairs.iter().zip(&inflated.concave).filter(|(pair, _)| inner(pair)).map(|(_, x)| *x);
        assert!(concave.fold(0.0, f64::max) < 0.03);
    }

    #[test]
    fn other_shapes_are_no_plates() {
        let plate = disc(0.1);
        assert!(Plate::of(&plate).is_some());
        let thick = plate.centre.iter().map(|x| [x[0], x[1], 6.0 * x[2]]).collect();
        assert!(Plate::of(&CellGraph { centre: thick, ..plate.clone() }).is_none(), "a box");
        let sheet = plate.normal.iter().map(|n| [n[0], n[1], n[2].abs()]).collect();
        assert!(Plate::of(&CellGraph { normal: sheet, ..plate.clone() }).is_none(), "a single sheet");
        let relief =
            |(n, x): (&[f64; 3], &[f64; 3])| if n[2] > 0.5 { unit([0.5 * (9.0 * x[0]).sin(), 0.0, 1.0]) } else { *n };
        let relief = plate.normal.iter().zip(&plate.centre).map(relief).collect();
        assert!(Plate::of(&CellGraph { normal: relief, ..plate.clone() }).is_none(), "a relief");
        let lost = vec![[f64::NAN; 3]; plate.len()];
        assert!(Plate::of(&CellGraph { centre: lost, ..plate }).is_none());
        assert!(Plate::of(&CellGraph::default()).is_none());
    }

    #[test]
    fn both_sides_are_averaged_as_matrices_say() {
        let (mut random, cells, n) = (stream(5, "plates"), disc(0.2), 7);
        let plate = Plate::of(&cells).unwrap();
        let of_cell: Vec<u32> =
            (0..cells.len()).map(|k| if k < n { k as u32 } else { below(&mut random, n) as u32 }).collect();
        let mut c = Square::zeros(n);
        for i in 0..n {
            (0..i).for_each(|j| c.add_both(i, j, random_unit(&mut random)));
            c[(i, i)] = 1.0;
        }
        let got = plate.sides_as_one(&cells, &of_cell, &c);
        // M: from the area of a superface to itself and what lies opposite. The grid has a cell at each opposite place.
        let (mut m, mut area) = (Square::zeros(n), vec![0.0; n]);
        for (k, &x) in of_cell.iter().enumerate() {
            area[x as usize] += cells.area[k];
            if !plate.is_rim[k] {
                let opposite = (0..cells.len()).find(|&j| {
                    let [a, b] = [cells.centre[k], cells.centre[j]];
                    a[..2] == b[..2] && a[2] != b[2]
                });
                m[(x as usize, of_cell[opposite.unwrap()] as usize)] += cells.area[k];
            }
        }
        for x in 0..n {
            let sure: f64 = m.row(x).iter().sum::<f64>() / area[x];
            m.row_mut(x).iter_mut().for_each(|share| *share /= area[x]);
            m[(x, x)] += 1.0;
            m.row_mut(x).iter_mut().for_each(|share| *share /= 1.0 + sure);
        }
        for x in 0..n {
            for y in 0..x {
                let mean: f64 = (0..n * n).map(|k| m[(x, k / n)] * c[(k / n, k % n)] * m[(y, k % n)]).sum();
                assert!(
                    (got[(x, y)] - mean).abs() < 1e-12 && got[(x, y)] == got[(y, x)],
                    "{x} {y}: {} {mean}",
                    got[(x, y)]
                );
            }
        }
    }
}
