//! Denoising of a small mesh: noise, and the stairs of voxels, are smoothed away before parts are decided.
//!
//! Normals can be smoothed without moving anything ([`super::normals`]), but distances, areas and thickness follow the
//! vertices, and on a mesh of few faces noise changes them too. Each step moves every vertex half-way to the mean of
//! its neighbours (the umbrella operator, explicitly; a vertex of an open border only along that), and each component
//! is then scaled back to the size that it had, since smoothing shrinks.
//!
//! How many steps are needed is seen in the total turning Σ length · |θ|. Creases and curved surfaces keep theirs when
//! smoothed, as angles add up, but those of noise cancel. So steps are taken as long as [`AHEAD`] more of them would
//! leave less than [`NOISE`] of the turning. On 190 models of the benchmark the median of what is left is .91; on 19 of
//! them with noise of 5 and 15 % of an edge it is .57 and .29, and .41 on their voxels (50 along the longest side).
//! Clean meshes stay as they are.
//!
//! Stairs take more steps, and are told from noise by the second: noise loses most of its turning by the first step,
//! stairs at least as large a share by the second. So do 100 of 114 models of voxels, and none of the 190, nor with
//! noise.
//!
//! Cost: a sort of the edges; then each step and each measurement is a pass over vertices or edges, 5 for a clean mesh,
//! 15 at the most. Memory: 24 bytes per vertex for each of the steps ahead and 40 for components, 60 per edge.

use crate::base::union_find::Forest;
use crate::base::vector::{add_scaled, area, double_area, finite, length, minus, narrow, position_key, unit};
use crate::graph::angle::between;
use std::collections::HashMap;

/// By so many steps a further step is judged: stairs hardly turn less after the first.
const AHEAD: usize = 4;
/// The share of its turning that a surface must keep by them to count as clean.
const NOISE: f64 = 0.75;
/// The same if it consists of stairs. With .75, 1 − Rand is .105 instead of .093 on marching cubes of 50 voxels; with
/// .85 for noise too, one bust of the benchmark loses its neck.
const STAIRS: f64 = 0.85;
/// Maximum number of steps: with the bound of stairs, noise of 30 % of an edge would take 3 to 10.
const MOST: usize = 10;

/// The vertices of `positions` (v × 3) after denoising, and in how many steps; `corners` are those of the triangles.
/// Vertices at the same position stay together.
pub fn denoised(positions: &[[f64; 3]], corners: &[[u32; 3]]) -> (Vec<[f64; 3]>, usize) {
    let surface = Surface::of(positions, corners);
    let first: Vec<[f64; 3]> = surface.vertices.iter().map(|&v| positions[v as usize]).collect();
    let sizes = surface.sizes(&first);
    let measured = |places: Vec<[f64; 3]>| (surface.turning(&places), places);
    // Turning and places after each step; places are dropped once a further step is taken.
    let mut states = vec![measured(first)];
    let look_ahead = |states: &mut Vec<(f64, Vec<[f64; 3]>)>, steps: usize| {
        while states.len() <= steps + AHEAD {
            let next = surface.step(&states[states.len() - 1].1, &sizes);
            states.push(measured(next));
        }
    };
    look_ahead(&mut states, 0);
    let is_stairs = states[2].0 * states[0].0 <= states[1].0 * states[1].0;
    let clean = if is_stairs { STAIRS } else { NOISE };
    let mut steps = 0;
    while steps < MOST && states[steps + AHEAD].0 < clean * states[steps].0 {
        states[steps].1 = Vec::new();
        steps += 1;
        look_ahead(&mut states, steps);
    }
    let places = &states[steps].1;
    (surface.place.iter().map(|&place| places[place as usize]).collect(), steps)
}

/// Centre and mean square distance from it.
type Size = ([f64; 3], f64);

/// How the places of a surface are connected: its positions, each once.
struct Surface {
    /// The place of each vertex (v).
    place: Vec<u32>,
    /// A vertex at each place (p).
    vertices: Vec<u32>,
    /// The corners of triangles, as places (t × 3).
    corners: Vec<[u32; 3]>,
    /// Edges of two triangles: the places and the triangles.
    edges: Vec<Edge>,
    /// Where the neighbours of each place begin (p + 1).
    starts: Vec<usize>,
    neighbours: Vec<u32>,
    /// The component of each place (p): a place in it.
    component: Vec<u32>,
}

struct Edge {
    ends: [u32; 2],
    triangles: [u32; 2],
    /// Whether both triangles are wound alike.
    agrees: bool,
}

impl Surface {
    fn of(positions: &[[f64; 3]], corners: &[[u32; 3]]) -> Self {
        let (mut number, mut vertices) = (HashMap::new(), Vec::new());
        let place = |(v, position): (usize, &[f64; 3])| {
            *number.entry(position_key(*position)).or_insert_with(|| {
                vertices.push(v as u32);
                vertices.len() as u32 - 1
            })
        };
        let place: Vec<u32> = positions.iter().enumerate().map(place).collect();
        let corners: Vec<[u32; 3]> = corners.iter().map(|own| own.map(|v| place[v as usize])).collect();
        let is_finite = |place: u32| finite(positions[vertices[place as usize] as usize]);
        // Its ends, the triangle and the direction of each side.
        let mut sides: Vec<([u32; 2], u32, bool)> = Vec::with_capacity(3 * corners.len());
        for (k, &[a, b, c]) in (0..).zip(&corners) {
            for [a, b] in [[a, b], [b, c], [c, a]] {
                if a != b && is_finite(a) && is_finite(b) {
                    sides.push(([a.min(b), a.max(b)], k, a < b));
                }
            }
        }
        sides.sort_unstable();
        let mut forest = Forest::new(vertices.len());
        let mut on_border = vec![false; vertices.len()];
        let (mut edges, mut joined) = (Vec::new(), Vec::new());
        for own in sides.chunk_by(|a, b| a.0 == b.0) {
            let ends = own[0].0;
            forest.join(ends[0], ends[1]);
            joined.push((ends, own.len() == 1));
            match own {
                [_] => ends.iter().for_each(|&end| on_border[end as usize] = true),
                [(_, i, way), (_, j, other)] => {
                    edges.push(Edge { ends, triangles: [*i, *j], agrees: way != other });
                }
                _ => {}
            }
        }
        let mut pairs: Vec<[u32; 2]> = Vec::with_capacity(2 * joined.len());
        for ([a, b], is_border) in joined {
            for [a, b] in [[a, b], [b, a]] {
                if is_border || !on_border[a as usize] {
                    pairs.push([a, b]);
                }
            }
        }
        pairs.sort_unstable();
        let starts = (0..=vertices.len()).map(|p| pairs.partition_point(|pair| (pair[0] as usize) < p)).collect();
        let component = forest.labels();
        let neighbours = pairs.into_iter().map(|[_, b]| b).collect();
        Self { place, vertices, corners, edges, starts, neighbours, component }
    }

    /// Total turning, in units of √area; 0 without area.
    fn turning(&self, places: &[[f64; 3]]) -> f64 {
        let at = |place: u32| places[place as usize];
        let (mut total, mut normals) = (0., Vec::with_capacity(self.corners.len()));
        for corners in &self.corners {
            let triangle = corners.map(at);
            let own = area(triangle);
            total += if own.is_finite() { own } else { 0. };
            let normal = unit(double_area(triangle));
            normals.push(if finite(normal) { narrow(normal, 1.) } else { [0.; 3] });
        }
        let turning = |edge: &Edge| {
            let [a, b] = edge.triangles.map(|triangle| normals[triangle as usize]);
            let b = if edge.agrees { b } else { b.map(|x| 0. - x) };
            let [from, to] = edge.ends.map(at);
            length(minus(from, to)) * f64::from(between(a, b))
        };
        if total > 0. { self.edges.iter().map(turning).sum::<f64>() / total.sqrt() } else { 0. }
    }

    /// The `places` half-way to the mean of their neighbours, with each component of the size it had in `sizes`.
    fn step(&self, places: &[[f64; 3]], sizes: &[Size]) -> Vec<[f64; 3]> {
        let moved = |(place, &own): (usize, &[f64; 3])| {
            let neighbours = &self.neighbours[self.starts[place]..self.starts[place + 1]];
            let weight = 0.5 / neighbours.len() as f64;
            let start = if neighbours.is_empty() { own } else { own.map(|x| 0.5 * x) };
            neighbours.iter().fold(start, |sum, &next| add_scaled(sum, weight, places[next as usize]))
        };
        let mut moved: Vec<[f64; 3]> = places.iter().enumerate().map(moved).collect();
        let now = self.sizes(&moved);
        for (place, &component) in moved.iter_mut().zip(&self.component) {
            let ((before, size), (centre, now)) = (sizes[component as usize], now[component as usize]);
            if now > 0. && size.is_finite() {
                *place = add_scaled(before, (size / now).sqrt(), minus(*place, centre));
            }
        }
        moved
    }

    /// The size of each component, at the place that stands for it.
    fn sizes(&self, places: &[[f64; 3]]) -> Vec<Size> {
        let (mut centres, mut counts) = (vec![[0.; 3]; places.len()], vec![0.; places.len()]);
        let each = || places.iter().zip(&self.component).map(|(place, &component)| (*place, component as usize));
        for (place, component) in each() {
            centres[component] = add_scaled(centres[component], 1., place);
            counts[component] += 1.;
        }
        let mut sizes: Vec<Size> =
            centres.iter().zip(&counts).map(|(sum, count)| (sum.map(|x| x / count), 0.)).collect();
        for (place, component) in each() {
            let (centre, square) = &mut sizes[component];
            let off = length(minus(place, *centre));
            *square += off * off / counts[component];
        }
        sizes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::vector::distance;

    /// A sphere of 20 · 4^`times` triangles with radius 1, and each vertex moved outward by up to `noise` of an edge.
    fn sphere(times: usize, noise: f64) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
        let t = (1. + 5f64.sqrt()) / 2.;
        let mut positions: Vec<[f64; 3]> = (0..3)
            .flat_map(|k| [[-1., t], [1., t], [-1., -t], [1., -t]].map(|[a, b]| (k, a, b)))
            .map(|(k, a, b)| [[a, b, 0.], [0., a, b], [b, 0., a]][k])
            .collect();
        let mut corners: Vec<[u32; 3]> = Vec::new();
        // The triangles of three vertices at the least distance, wound outward.
        for a in 0..12 {
            for b in a + 1..12 {
                for c in b + 1..12 {
                    let near = |a: usize, b: usize| distance(positions[a], positions[b]) < 2.1;
                    if near(a, b) && near(b, c) && near(a, c) {
                        let triangle = [a, b, c].map(|v| positions[v]);
                        let out: f64 = (0..3).map(|x| double_area(triangle)[x] * positions[a][x]).sum();
                        corners.push(if out > 0. { [a, b, c] } else { [a, c, b] }.map(|v| v as u32));
                    }
                }
            }
        }
        for _ in 0..times {
            let mut middles = HashMap::new();
            let split = |&[a, b, c]: &[u32; 3]| {
                let mut middle = |a: u32, b: u32| {
                    *middles.entry([a.min(b), a.max(b)]).or_insert_with(|| {
                        positions.push(add_scaled(positions[a as usize], 1., positions[b as usize]));
                        positions.len() as u32 - 1
                    })
                };
                let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            };
            corners = corners.iter().flat_map(split).collect();
            positions.iter_mut().for_each(|p| *p = unit(*p));
        }
        let edge = distance(positions[corners[0][0] as usize], positions[corners[0][1] as usize]);
        for (k, p) in positions.iter_mut().enumerate() {
            // Numbers that look random, in −1 to 1.
            let random = ((k as f64 * 0.618_034).fract() * 7919.).fract() * 2. - 1.;
            *p = unit(*p).map(|x| x * (1. + noise * edge * random));
        }
        (positions, corners)
    }

    fn off_sphere(positions: &[[f64; 3]]) -> f64 {
        positions.iter().map(|&p| (length(p) - 1.).abs()).sum::<f64>() / positions.len() as f64
    }

    #[test]
    fn noise_is_removed_and_the_size_stays() {
        let (clean, corners) = sphere(3, 0.);
        let (same, steps) = denoised(&clean, &corners);
        assert_eq!((same, steps), (clean, 0));
        let mut taken = Vec::new();
        for noise in [0.1, 0.3, 0.6] {
            let (noisy, corners) = sphere(3, noise);
            let (smooth, steps) = denoised(&noisy, &corners);
            assert!(off_sphere(&smooth) < 0.6 * off_sphere(&noisy), "{} {}", off_sphere(&smooth), off_sphere(&noisy));
            taken.push(steps);
        }
        assert!(taken.is_sorted() && taken[0] >= 1 && taken[2] <= MOST, "{taken:?}");
    }

    /// A box of 20 × 10 × 10 unit squares, each in two triangles.
    fn grid_box() -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
        let size = [20, 10, 10];
        let (mut number, mut positions, mut corners) = (HashMap::new(), Vec::new(), Vec::new());
        for axis in 0..3 {
            let [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
            for side in [0, size[axis]] {
                for (i, j) in (0..size[u]).flat_map(|i| (0..size[v]).map(move |j| (i, j))) {
                    let quad = [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[a, b]| {
                        let mut p = [0i32; 3];
                        (p[axis], p[u], p[v]) = (side, i + a, j + b);
                        *number.entry(p).or_insert_with(|| {
                            positions.push(p.map(f64::from));
                            positions.len() as u32 - 1
                        })
                    });
                    let [a, b, c, d] = if side > 0 { quad } else { [quad[3], quad[2], quad[1], quad[0]] };
                    corners.extend([[a, b, c], [a, c, d]]);
                }
            }
        }
        (positions, corners)
    }

    #[test]
    fn creases_are_no_noise() {
        let (positions, corners) = grid_box();
        assert_eq!(denoised(&positions, &corners), (positions, 0));
    }

    /// As in STL files, where each triangle has vertices of its own, and wound at random.
    #[test]
    fn triangles_without_common_vertices_stay_together() {
        let (positions, corners) = sphere(2, 0.4);
        let (smooth, steps) = denoised(&positions, &corners);
        let apart: Vec<[f64; 3]> = corners.iter().flatten().map(|&v| positions[v as usize]).collect();
        let turned = |k: u32| if k % 3 == 1 { [3 * k, 3 * k + 2, 3 * k + 1] } else { [3 * k, 3 * k + 1, 3 * k + 2] };
        let own: Vec<[u32; 3]> = (0..corners.len() as u32).map(turned).collect();
        let (moved, same) = denoised(&apart, &own);
        assert_eq!(steps, same);
        for (&v, p) in corners.iter().flatten().zip(moved) {
            assert!(distance(smooth[v as usize], p) < 1e-9);
        }
    }

    /// Open borders do not shrink, loose triangles stay where they are, and nothing need be finite.
    #[test]
    fn borders_and_specks_keep_their_size() {
        let side = 30;
        let rough = |k: u32| 0.4 * ((f64::from(k) * 0.618_034).fract() * 7919.).fract();
        let mut positions: Vec<[f64; 3]> =
            (0..side * side).map(|k| [f64::from(k / side), f64::from(k % side), rough(k)]).collect();
        let cells = (0..side * (side - 1)).filter(|k| k % side < side - 1);
        let mut corners: Vec<[u32; 3]> =
            cells.flat_map(|k| [[k, k + side, k + side + 1], [k, k + side + 1, k + 1]]).collect();
        positions.extend([[50., 0., 0.], [51., 0., 0.], [50., 1., 0.], [f64::NAN, 0., 0.], [60., f64::INFINITY, 0.]]);
        let first = side * side;
        corners.extend([[first, first + 1, first + 2], [0, first, first + 3], [1, first + 4, first + 4]]);
        let (moved, steps) = denoised(&positions, &corners);
        assert!(steps > 0 && moved.len() == positions.len());
        let heights = |all: &[[f64; 3]]| all[..first as usize].iter().map(|p| (p[2] - 0.2).abs()).sum::<f64>();
        assert!(heights(&moved) < 0.5 * heights(&positions));
        let middle = (side / 2) as usize;
        assert!(moved[middle][0].abs() < 0.5 && moved[(side as usize - 1) * side as usize + middle][0] > 28.5);
        let speck = |all: &[[f64; 3]]| distance(all[first as usize], all[first as usize + 1]);
        assert!(speck(&moved) > 0.9 && moved[first as usize + 3][0].is_nan());
        assert_eq!(denoised(&[], &[]), (Vec::new(), 0));
    }
}
