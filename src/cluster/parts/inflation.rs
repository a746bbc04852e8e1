//! The inflated shape of plates and flat sheets, on which their regions are compared.
//!
//! Front and back of a plate are flat, so a cut across an arm has no concave edge, all cells of a side see each other
//! as convex, and only the corners of the rim show where the arm begins. So plates are inflated first, as outlines are
//! in sketching (Igarashi, Matsuoka and Tanaka, *SIGGRAPH* 1999): the rim stays, and both sides rise to a multiple of
//! √u, where Δu = −4 on each side and u = 0 at the rim. A disc becomes an ellipsoid, a strip a tube, and a junction of
//! strips bulges. Areas, lengths and neighbours stay those of the plate.
//!
//! Cost for S cells: some hundred rounds of conjugate gradients, some milliseconds. A copy of the cells, two of those
//! of a sheet. Nothing for other shapes but their moments.

use super::cell_graph::CellGraph;
use super::matrix::Square;
use super::plates::{Plate, sheet_with_back};
use super::thickness::tangents;
use crate::base::vector::{add_scaled, axpy, distance, dot, inner_product, length, minus, unit};
use std::borrow::Cow;
use std::f64::consts::PI;

/// The height to which a side of a plate rises, in units of √u, and a sheet, whose rim is half a cell within its edge.
const RISE: f64 = 1.8;
const SHEET_RISE: f64 = 1.2;
/// Maximum number of rounds of conjugate gradients, and the share of the first residual at which they end.
const ROUNDS: usize = 500;
const RESIDUAL: f64 = 1e-6;

/// The inflated shape of a plate or a sheet.
#[derive(Clone, Debug)]
pub struct Inflated {
    /// The cells in that shape: S, or those of a sheet and then those of its back (2 S).
    pub cells: CellGraph,
    plate: Plate,
    is_sheet: bool,
}

impl Inflated {
    /// The inflated shape of a surface of `cells`, if it is a plate or a flat sheet.
    pub fn of(cells: &CellGraph) -> Option<Inflated> {
        let sheet = sheet_with_back(cells);
        let cells = sheet.as_ref().unwrap_or(cells);
        let plate = Plate::of(cells)?;
        let rise = if sheet.is_some() { SHEET_RISE } else { RISE };
        Some(Inflated { cells: inflated(&plate, cells, rise), plate, is_sheet: sheet.is_some() })
    }

    /// Values of the cells of the surface, such as labels, for the cells of this shape.
    pub fn values<'a, T: Copy>(&self, of_cell: &'a [T]) -> Cow<'a, [T]> {
        if self.is_sheet { of_cell.repeat(2).into() } else { of_cell.into() }
    }

    /// The co-association C of superfaces (R × R) with both sides as one place. `cells` are those of the surface (S),
    /// `of_cell` their superfaces.
    pub fn sides_as_one(&self, cells: &CellGraph, of_cell: &[u32], c: Square) -> Square {
        // Both sides of a sheet are in the same superfaces.
        if self.is_sheet { c } else { self.plate.sides_as_one(cells, of_cell, &c) }
    }
}

/// The `cells` of the `plate` in its inflated shape, with its angles.
fn inflated(plate: &Plate, cells: &CellGraph, rise: f64) -> CellGraph {
    let u = solved(cells, plate.is_rim());
    // No u is greater than that of a disc of the same area (Talenti 1976), unless a piece has no rim.
    let most = cells.total_area() / PI;
    let height: Vec<f64> = u.into_iter().map(|u| rise * u.max(0.0).min(most).sqrt()).collect();
    let slopes = slopes(cells, plate.axis(), &height);
    let raised = |(i, &x): (usize, &[f64; 3])| add_scaled(x, height[i], plate.outward(i));
    let centre: Vec<[f64; 3]> = cells.centre.iter().enumerate().map(raised).collect();
    let turned = |(i, &normal): (usize, &[f64; 3])| {
        if plate.is_rim()[i] { normal } else { unit(minus(plate.outward(i), slopes[i])) }
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

/// The gradient of `height` (S) along a plate across this axis at each cell, by least squares over its neighbours (S).
fn slopes(cells: &CellGraph, axis: [f64; 3], height: &[f64]) -> Vec<[f64; 3]> {
    let [first, second] = tangents(axis);
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

/// The solution u of Δu = −4 on the cells that are not of the rim (S), with u = 0 there: finite volumes, by conjugate
/// gradients.
fn solved(cells: &CellGraph, is_rim: &[bool]) -> Vec<f64> {
    let apart = |[i, j]: [u32; 2]| distance(cells.centre[j as usize], cells.centre[i as usize]);
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
    use super::super::plates::tests::{disc, sheet};
    use super::*;

    /// Δu = −4 on the unit disc has the solution 1 − r².
    #[test]
    fn a_disc_is_inflated_to_an_ellipsoid() {
        let cells = disc(0.04);
        let inflated = Inflated::of(&cells).unwrap().cells;
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

    /// Both sides of a sheet rise as those of a plate do; lengths are in units of the root of both sides' area.
    #[test]
    fn a_sheet_is_inflated_to_both_sides() {
        let cells = sheet(0.04);
        let shape = Inflated::of(&cells).unwrap();
        assert!((shape.cells.total_area() - cells.total_area()).abs() < 1e-9);
        assert_eq!(shape.values(&[1, 2]).as_ref(), [1, 2, 1, 2]);
        for (k, to) in shape.cells.centre.iter().enumerate() {
            let from = cells.centre[k % cells.len()];
            let r = from[0].hypot(from[1]);
            if r < 0.8 {
                let height = SHEET_RISE * (1.0 - r * r).sqrt() / 2f64.sqrt();
                let side = if k < cells.len() { 1.0 } else { -1.0 };
                assert!((to[2] - side * height).abs() < 0.06 * RISE, "{r}: {} instead of {height}", to[2]);
            }
        }
    }

    /// Two sheets that face away from each other, such as a plate whose rim is missing.
    #[test]
    fn sheets_on_each_other_are_finite_and_stay_apart() {
        let disc = disc(0.1);
        let kept: Vec<u32> = (0..disc.len() as u32).filter(|&i| disc.normal[i as usize][2] != 0.0).collect();
        let cells = disc.subset(&kept);
        let shape = Inflated::of(&cells).unwrap();
        let far = shape.cells.centre.iter().map(|x| x[2].abs()).fold(0.0, f64::max);
        assert!(far <= RISE * cells.total_area().sqrt(), "{far}");
        let of_cell: Vec<u32> = cells.normal.iter().map(|n| u32::from(n[2] < 0.0)).collect();
        let apart = Square::from_values(2, vec![1.0, 0.0, 0.0, 1.0]);
        assert_eq!(shape.sides_as_one(&cells, &of_cell, apart.clone()), apart);
    }
}
