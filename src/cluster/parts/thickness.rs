//! How thick the body is behind each cell: the shape diameter, from the cells alone.
//!
//! Rays go from a cell into the body, one along its normal and two rings around that, and end at the nearest disc (a
//! cell, as large as its area) that faces away; the median of their lengths is the thickness (after Shapira, Shamir and
//! Cohen-Or, *The Visual Computer* 2008, who cast rays at triangles). People part what differs in thickness at a
//! boundary: a limb from a body, not a fish from its own tapering end. Cost: S² pairs of cells, a few milliseconds.

use super::cells::CellGraph;
use crate::base::Result;
use crate::base::parallel::map_ranges;
use crate::store::run::Run;
use std::f64::consts::{PI, TAU};

/// Rings of rays: how many, and the tangent of their angle with the normal.
const RINGS: [(usize, f64); 3] = [(1, 0.0), (6, 0.4), (8, 0.85)];
/// All rays of a cell.
const RAYS: usize = 15;
/// Least thickness, in units of √(total area): half a cell.
const FLOOR: f64 = 0.01;
/// Thickness where no ray of any cell hits anything.
const UNKNOWN: f64 = 0.1;
/// Rounds of medians over a cell and its neighbours.
const ROUNDS: usize = 2;
/// Cells looked at together, in single precision, before those in the cone are.
const LANES: usize = 8;
/// What that may be wrong by.
const SLACK: f32 = 1e-5;
/// Cells a chunk of the parallel pass.
const CHUNK: usize = 64;

/// Natural logarithm of the thickness behind each cell, in units of √(total area) (S). Where a cell sees nothing behind
/// it, as on an open sheet, the median of all stands in.
///
/// # Errors
/// Cancellation.
pub fn log_thickness(cells: &CellGraph, run: &Run) -> Result<Vec<f64>> {
    let rays = rays();
    let radius: Vec<f64> = cells.area.iter().map(|a| (a / PI).sqrt()).collect();
    let blocks = blocks(cells, &radius);
    let chunks = map_ranges(run.threads, &run.cancel, cells.len(), CHUNK, |range| {
        Ok(range.map(|i| behind(cells, &radius, &blocks, i, &rays)).collect::<Vec<_>>())
    })?;
    let found = chunks.concat();
    let usual = median(&mut found.iter().filter_map(|x| *x).collect::<Vec<_>>()).unwrap_or(UNKNOWN);
    let mut out: Vec<f64> = found.iter().map(|x| x.unwrap_or(usual).max(FLOOR).ln()).collect();
    let mut beside: Vec<Vec<usize>> = (0..cells.len()).map(|i| vec![i]).collect();
    for &[i, j] in &cells.pairs {
        beside[i as usize].push(j as usize);
        beside[j as usize].push(i as usize);
    }
    let mut near = Vec::new();
    for _ in 0..ROUNDS {
        let last = out.clone();
        for (x, beside) in out.iter_mut().zip(&beside) {
            near.clear();
            near.extend(beside.iter().map(|&j| last[j]));
            *x = median(&mut near).unwrap_or(*x);
        }
    }
    Ok(out)
}

/// The rays' places in the plane one unit of length behind a cell.
fn rays() -> [[f64; 2]; RAYS] {
    let mut all = RINGS.iter().flat_map(|&(count, tangent)| {
        (0..count).map(move |k| {
            let angle = k as f64 * TAU / count as f64;
            [tangent * angle.cos(), tangent * angle.sin()]
        })
    });
    std::array::from_fn(|_| all.next().unwrap_or_default())
}

/// Median length of the rays from cell `i` that hit anything; `radius`: the cells' own, as discs (S).
fn behind(cells: &CellGraph, radius: &[f64], blocks: &[Block], i: usize, rays: &[[f64; 2]; RAYS]) -> Option<f64> {
    let (x, n) = (cells.centre[i], cells.normal[i]);
    let [u, v] = tangents(n);
    let reach = RINGS[2].1;
    let mut depths = [f64::INFINITY; RAYS];
    let found = blocks.iter().enumerate().filter_map(|(b, block)| block.seen(x, n).map(|seen| (b, seen)));
    for j in found.flat_map(|(b, seen)| (0..LANES).filter(move |&k| seen[k]).map(move |k| b * LANES + k)) {
        let d = std::array::from_fn(|c| cells.centre[j][c] - x[c]);
        let depth = -dot(d, n);
        if depth <= 0.0 || dot(cells.normal[j], d) <= 0.0 {
            continue;
        }
        let across = dot(d, d) - depth * depth;
        if across > (reach * depth + radius[j]) * (reach * depth + radius[j]) {
            continue;
        }
        let (p, q) = (dot(d, u) / depth, dot(d, v) / depth);
        let radius = radius[j] / depth;
        for (low, ray) in depths.iter_mut().zip(rays) {
            if depth < *low && (p - ray[0]).powi(2) + (q - ray[1]).powi(2) < radius * radius {
                *low = depth;
            }
        }
    }
    let length = |(depth, ray): (&f64, &[f64; 2])| depth * (1.0 + ray[0] * ray[0] + ray[1] * ray[1]).sqrt();
    median(&mut depths.iter().zip(rays).map(length).filter(|x| x.is_finite()).collect::<Vec<_>>())
}

/// Cells as arithmetic over several at once wants them: x, n, radius; no number after the last cell.
struct Block {
    x: [[f32; LANES]; 3],
    n: [[f32; LANES]; 3],
    radius: [f32; LANES],
}

fn blocks(cells: &CellGraph, radius: &[f64]) -> Vec<Block> {
    let get = |values: &[[f64; 3]], i: usize, c: usize| values.get(i).map_or(f32::NAN, |x| x[c] as f32);
    let block = |i: usize| Block {
        x: std::array::from_fn(|c| std::array::from_fn(|k| get(&cells.centre, i + k, c))),
        n: std::array::from_fn(|c| std::array::from_fn(|k| get(&cells.normal, i + k, c))),
        radius: std::array::from_fn(|k| radius.get(i + k).map_or(f32::NAN, |r| *r as f32)),
    };
    (0..cells.len()).step_by(LANES).map(block).collect()
}

impl Block {
    /// Which of the cells lie in or near the cone behind `x` with normal `n` and face away, or nearly: most do not.
    #[inline]
    fn seen(&self, x: [f64; 3], n: [f64; 3]) -> Option<[bool; LANES]> {
        let (x, n, reach) = (x.map(|c| c as f32), n.map(|c| c as f32), RINGS[2].1 as f32);
        let seen: [bool; LANES] = std::array::from_fn(|k| {
            let d = [self.x[0][k] - x[0], self.x[1][k] - x[1], self.x[2][k] - x[2]];
            let square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
            let depth = -(d[0] * n[0] + d[1] * n[1] + d[2] * n[2]);
            let facing = d[0] * self.n[0][k] + d[1] * self.n[1][k] + d[2] * self.n[2][k];
            let limit = reach * depth + self.radius[k];
            let slack = SLACK * (1.0 + square);
            (depth > -slack) & (facing > -slack) & (square - depth * depth < limit * limit + slack)
        });
        seen.contains(&true).then_some(seen)
    }
}

/// Two unit vectors across `n`.
fn tangents(n: [f64; 3]) -> [[f64; 3]; 2] {
    let other = if n[0].abs() < 0.6 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
    let along = dot(other, n);
    let u: [f64; 3] = std::array::from_fn(|c| other[c] - along * n[c]);
    let norm = dot(u, u).sqrt().max(1e-12);
    let u = u.map(|c| c / norm);
    [u, [n[1] * u[2] - n[2] * u[1], n[2] * u[0] - n[0] * u[2], n[0] * u[1] - n[1] * u[0]]]
}

/// The upper median.
fn median(values: &mut [f64]) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cells on a closed tube of radius `r(z)` and length 1, with neighbours around and along.
    fn tube(around: usize, along: usize, r: impl Fn(f64) -> f64) -> CellGraph {
        let mut g = CellGraph::default();
        for k in 0..along {
            let z = (k as f64 + 0.5) / along as f64;
            for i in 0..around {
                let t = TAU * i as f64 / around as f64;
                g.centre.push([r(z) * t.cos(), r(z) * t.sin(), z]);
                g.normal.push([t.cos(), t.sin(), 0.0]);
                g.area.push(TAU * r(z) / (around * along) as f64);
                let here = (k * around + i) as u32;
                g.pairs.push([here, (k * around + (i + 1) % around) as u32]);
                if k + 1 < along {
                    g.pairs.push([here, here + around as u32]);
                }
            }
        }
        g
    }

    #[test]
    fn a_tube_is_as_thick_as_it_is_and_a_thinner_half_by_as_much() {
        let g = tube(24, 60, |z| if z < 0.5 { 0.1 } else { 0.05 });
        let t = log_thickness(&g, &Run::new(&())).unwrap();
        let at = |z: usize| t[z * 24 + 5].exp();
        assert!((at(15) - 0.2).abs() < 0.03 && (at(45) - 0.1).abs() < 0.015, "{} {}", at(15), at(45));
    }

    #[test]
    fn a_sheet_has_one_thickness_and_nothing_is_not_a_number() {
        let mut g = CellGraph::default();
        assert!(log_thickness(&g, &Run::new(&())).unwrap().is_empty());
        for i in 0..20 {
            g.centre.push([f64::from(i), 0.0, 0.0]);
            g.normal.push(if i == 7 { [0.0; 3] } else { [0.0, 0.0, 1.0] });
            g.area.push(1.0);
        }
        assert_eq!(log_thickness(&g, &Run::new(&())).unwrap(), vec![UNKNOWN.ln(); 20]);
    }

    #[test]
    fn threads_change_nothing() {
        let g = tube(20, 30, |z| 0.05 + 0.1 * z);
        let with = |threads| log_thickness(&g, &Run { threads, ..Run::new(&()) }).unwrap();
        assert_eq!(with(1), with(3));
    }
}
