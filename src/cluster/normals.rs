//! Normals smoothed over a fixed radius, in O(n) whatever the radius, and the choice of that radius.
//!
//! Turning summed over the noise of a scan grows without bound as faces shrink; turning of normals averaged over a
//! fixed share of the shape's size does not. 1/r² micro-cells (one seed per quantum of area, one front by length)
//! accumulate area-weighted normals; a face's normal is the sum over its cell and the adjacent cells, weighted by
//! exp(−|c_f − x|²/(2 (.54 r)²)). Adjacency is by connectivity, so the two sheets of a thin part do not mix. The result
//! is within 2–5° of diffusion, which would cost (r/h)² sweeps. If there are too few faces for cells, neighbours are
//! averaged.
//!
//! The radius is chosen by the mesh's own turning P_r = Σ length · |θ_r|: clean meshes keep their own normals, scans
//! and noisy meshes get .01 or .02 ([`super::roughness`]). Cost: a front plus 50 ns per face and radius; 12 bytes per
//! face each. Only radius .02 is needed to tell rough from clean, so a clean mesh without cells of its own needs no
//! other.

use super::area_shares::{AreaShares, SurfaceSum, spread_seeds, surface_sums};
use super::few_nodes::fitted;
use crate::base::Result;
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::vector::{MapEach, dot};
use crate::distance::SharedFront;
use crate::graph::angle::between;
use crate::graph::{DualGraph, Node};
use crate::spectral::exp::exp;
use crate::store::{Context, MappedSlice, Run};

/// The radii in use, in units of √(area): for turning between faces, for cells, and for convexity.
pub const RADII: [f32; 3] = [0.01, 0.02, 0.04];

const CHUNK: usize = 1 << 14;

/// Normals of the nodes (n).
pub type Normals = MappedSlice<[f32; 3]>;

/// Normals at radius `r` (in units of √(area)), written to `file`. `at_a_time` is the number of such calls that run in
/// parallel and share the threads.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub fn smoothed(
    graph: &DualGraph,
    shares: &AreaShares,
    r: f32,
    file: &str,
    at_a_time: usize,
    context: Context<'_>,
) -> Result<Normals> {
    if graph.nodes.len() < 2 * (1. / (r * r)).round() as usize {
        return averaged(graph, shares, r, file, context);
    }
    let n = graph.nodes.len();
    let seeds = seeds(shares, r, file, context.run)?;
    let mut owner = context.work.array::<u32>(&format!("{file}.owner.tmp"), &[n])?;
    {
        let mut field = context.work.array::<f32>(&format!("{file}.field.tmp"), &[n])?;
        let run = context.run.with_threads((context.run.threads / at_a_time) as u64);
        cell_front(graph, &seeds, file).nearest_source(field.data(), owner.data(), Context::new(context.work, &run))?;
    }
    let owner_data: &[u32] = owner.data();
    // Brings sums of normals near 1.
    let scale = seeds.len() as f64;
    let sums = surface_sums(graph, shares, owner_data, seeds.len(), 0., context.run)?;
    let cells: Vec<SmoothingCell> = sums.iter().map(|sum| SmoothingCell::of(sum, scale)).collect();
    let near = neighbours(graph, owner_data, seeds.len(), context.run)?;
    let factor = falloff(r, shares);
    let mut array = context.work.array::<[f32; 3]>(file, &[n, 3])?;
    context.run.fill_each(array.data(), CHUNK, |i, _| {
        let node = graph.nodes.at(i);
        let near = near.of(owner_data[i]).iter().map(|&cell| &cells[cell as usize]);
        smooth_normal(&node, near, factor)
    })?;
    array.finish(false)
}

/// The seeds of the micro-cells for normals at radius `r` in `file`, about 1/r², by area.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn seeds(shares: &AreaShares, r: f32, file: &str, run: &Run) -> Result<Vec<u32>> {
    spread_seeds(shares, (1. / (r * r)).round() as usize, file, run)
}

/// The front from these `seeds`.
pub fn cell_front<'a>(graph: &'a DualGraph, seeds: &'a [u32], file: &'a str) -> SharedFront<'a> {
    let name = file.trim_end_matches(".npy");
    SharedFront {
        name,
        stage: "normals",
        graph: graph.edges.by_distance(),
        key: &graph.key,
        sources: seeds,
        labels: None,
        limit: f32::INFINITY,
    }
}

fn unit(v: [f32; 3]) -> Option<[f32; 3]> {
    let length = dot(v, v).sqrt();
    if length > 1e-20 { Some(v.map_each(|x| x / length)) } else { None }
}

/// A piece of the surface over which normals are smoothed.
#[derive(Clone, Copy, Debug)]
pub(super) struct SmoothingCell {
    centre: [f32; 3],
    /// Sum of its normals, weighted by area.
    normal: [f32; 3],
}

impl SmoothingCell {
    /// For the faces in `sum`; `scale` brings sums of normals near 1.
    pub(super) fn of(sum: &SurfaceSum, scale: f64) -> Self {
        Self { centre: sum.centroid().map(|x| x as f32), normal: sum.normal.map(|x| (x * scale) as f32) }
    }
}

/// The coefficient of squared distances in the exponent of a cell's weight, at radius `r` (in units of √(area)).
pub(super) fn falloff(r: f32, shares: &AreaShares) -> f32 {
    let spread = 0.54 * r / shares.unit;
    -0.5 / (spread * spread)
}

/// The normal at `node` smoothed over the cells `near`; the node's own if they have none.
#[inline]
pub(super) fn smooth_normal<'a>(node: &Node, near: impl Iterator<Item = &'a SmoothingCell>, falloff: f32) -> [f32; 3] {
    let mut sum = [0f32; 3];
    for SmoothingCell { centre, normal } in near {
        let mut square = 0.;
        for axis in 0..3 {
            let d = node.centroid[axis] - centre[axis];
            square += d * d;
        }
        let weight = exp(square * falloff);
        for axis in 0..3 {
            sum[axis] += weight * normal[axis];
        }
    }
    unit(sum).unwrap_or(node.normal)
}

/// Each cell, and those that share an edge with it.
struct CellNeighbours {
    start: Vec<usize>,
    list: Vec<u32>,
}

impl CellNeighbours {
    /// The cell `own` and its neighbours; nothing for no cell, `u32::MAX`.
    #[inline]
    fn of(&self, own: u32) -> &[u32] {
        match self.start.get(own as usize..) {
            Some(&[first, last, ..]) => &self.list[first..last],
            _ => &[],
        }
    }
}

fn neighbours(graph: &DualGraph, owner: &[u32], cells: usize, run: &Run) -> Result<CellNeighbours> {
    let n = owner.len();
    let shared = graph.edges.shared();
    // Both numbers in one word, which sorts in half the time.
    let parts = run.map_ranges(n, CHUNK, |range| {
        shared.will_need(range.clone(), run);
        run.will_need(owner, range.clone());
        let mut pairs = Vec::new();
        for i in range {
            for (e, j) in shared.entries(i as u32) {
                let (a, b) = (owner[i], owner[j as usize]);
                // Bridges have length 0 and do not count as adjacent here.
                if a != b && a != u32::MAX && b != u32::MAX && shared.length(i as u32, e) != 0. {
                    pairs.push(u64::from(a) << 32 | u64::from(b));
                }
            }
        }
        pairs.sort_unstable();
        pairs.dedup();
        Ok(fitted(pairs))
    })?;
    let mut pairs: Vec<u64> = parts.concat();
    // A stable sort, because it merges the sorted runs.
    pairs.sort();
    pairs.dedup();
    let pairs = thinned(&pairs);
    let (mut start, mut list) = (Vec::with_capacity(cells + 1), Vec::with_capacity(cells + pairs.len()));
    let mut pairs = pairs.into_iter().peekable();
    for cell in 0..cells as u64 {
        start.push(list.len());
        list.push(cell as u32);
        while let Some(pair) = pairs.next_if(|pair| pair >> 32 == cell) {
            list.push(pair as u32);
        }
    }
    start.push(list.len());
    Ok(CellNeighbours { start, list })
}

/// Of more than twice as many neighbours of a cell, at least this many are kept. Cells of a surface have some six; one
/// with thousands holds a whole body among pieces that are far larger, and each of its nodes would visit all of them.
const MOST_NEIGHBOURS: usize = 64;

/// The sorted `pairs` of a cell and a neighbour without some of those of cells with very many, evenly spread.
fn thinned(pairs: &[u64]) -> Vec<u64> {
    let of_cells = pairs.chunk_by(|a, b| a >> 32 == b >> 32);
    of_cells.flat_map(|pairs| pairs.iter().copied().step_by((pairs.len() / MOST_NEIGHBOURS).max(1))).collect()
}

/// Maximum number of averaging rounds. Contracted meshes take some fifty at the widest radius; faces around a single
/// vertex are so close to each other that it would be millions.
const ROUNDS: f64 = 500.;

/// Normals at radius `r` by (r/h)² rounds of area-weighted averaging over neighbours: for meshes coarse compared with
/// the radius, and for contracted ones, which consist of cells already. In memory.
///
/// # Errors
/// As [`smoothed`].
pub fn averaged(graph: &DualGraph, shares: &AreaShares, r: f32, file: &str, context: Context<'_>) -> Result<Normals> {
    let n = graph.nodes.len();
    let shared = graph.edges.shared();
    let mean = f64::from(graph.edges.mean_step() * shares.unit);
    let rounds = if mean > 0. { (f64::from(r) / mean).powi(2).round().min(ROUNDS) as usize } else { 0 };
    let mut normals: Vec<[f32; 3]> = (0..n).map(|i| graph.nodes.at(i).normal).collect();
    let mut next = normals.clone();
    for _ in 0..rounds {
        // Weighted once instead of once per neighbour.
        let weighted: Vec<[f32; 3]> = (0..n).map(|i| normals[i].map_each(|x| x * shares.at(i))).collect();
        context.run.fill_each(&mut next, CHUNK, |i, _| {
            let mut sum = weighted[i];
            // Bridges have length 0 and do not count as adjacent here.
            for (j, edge) in shared.neighbours(i as u32) {
                if edge != 0. {
                    let [x, y, z] = weighted[j as usize];
                    sum = [sum[0] + x, sum[1] + y, sum[2] + z];
                }
            }
            unit(sum).unwrap_or(normals[i])
        })?;
        std::mem::swap(&mut normals, &mut next);
    }
    let mut array = context.work.array::<[f32; 3]>(file, &[n, 3])?;
    array.data().copy_from_slice(&normals);
    array.finish(false)
}

/// The signed angle between the normals of `a` and `b`, in radians: positive if the edge is concave, or if a negative
/// `edge` marks the two as not consistently oriented.
#[inline]
pub fn dihedral_angle(a: &Node, b: &Node, edge: f32) -> f32 {
    let angle = between(a.normal, b.normal);
    if edge < 0. || crate::graph::weights::concave(a, b) { angle } else { -angle }
}

/// P_r = Σ length · |θ_r| over the edges, for the nodes' own normals and each of `smoothed`, in units of √(area).
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn total_turning(graph: &DualGraph, shares: &AreaShares, smoothed: &[&Normals], run: &Run) -> Result<Vec<f64>> {
    let n = graph.nodes.len();
    let shared = graph.edges.shared();
    let parts = run.map_chunks(chunk_count(n, CHUNK), Vec::new, |k, held| {
        let mut sums = vec![0f64; smoothed.len() + 1];
        let range = chunk_range(n, CHUNK, k);
        shared.will_need(range.clone(), run);
        let window = graph.nodes.window(range.clone(), held);
        for i in range {
            let own = window.at(i).normal;
            for (j, edge) in shared.neighbours(i as u32) {
                let j = j as usize;
                if j > i {
                    let length = f64::from(edge.abs() * shares.unit);
                    sums[0] += length * f64::from(between(own, window.at(j).normal));
                    for (sum, normals) in sums[1..].iter_mut().zip(smoothed) {
                        *sum += length * f64::from(between(normals[i], normals[j]));
                    }
                }
            }
        }
        Ok(sums)
    })?;
    let mut total = vec![0f64; smoothed.len() + 1];
    for part in parts {
        total.iter_mut().zip(part).for_each(|(a, b)| *a += b);
    }
    Ok(total)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Regression: a body in a few cells among pieces far larger than it took time that grew with the square of its
    /// faces.
    #[test]
    fn cells_with_thousands_of_neighbours_keep_some_of_them() {
        let pair = |a: u64, b: u64| a << 32 | b;
        let few: Vec<u64> = (0..2 * MOST_NEIGHBOURS as u64 - 1).map(|b| pair(3, b)).collect();
        assert_eq!(thinned(&few), few);
        let many: Vec<u64> = (0..10_000).map(|b| pair(4, b)).collect();
        let both = thinned(&[few.clone(), many.clone()].concat());
        assert_eq!(both[..few.len()], few);
        let kept = &both[few.len()..];
        assert!((MOST_NEIGHBOURS..2 * MOST_NEIGHBOURS).contains(&kept.len()), "{}", kept.len());
        assert!(
            kept[0] == many[0] && kept.iter().all(|pair| many.contains(pair)) && *kept.last().unwrap() > many[9_900]
        );
    }
}
