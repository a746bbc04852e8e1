//! What each face counts: its share of the surface, nothing for dust.
//!
//! Components below [`TINY`] of the area are dust: scanning specks that must not become seeds, cells or parts.
//! Their faces count nothing here; being bridged to the rest, they take the label of what they float beside.
//! Lengths scale with it: in units of √(area without dust), the same shape has the same size at every resolution.
//! One pass, 4 bytes a node written.

use crate::base::Result;
use crate::base::parallel::{chunk_range, fill_chunks, map_ranges};
use crate::graph::DualGraph;
use crate::graph::half_edge_pairs::AGAINST;
use crate::store::{Context, MappedSlice, Run};
use std::collections::{HashMap, HashSet};

/// Components below this share of the area are dust; the largest never is.
pub const TINY: f64 = 0.005;
/// Least share of a face, in mean shares: no face is so small that it counts nothing.
const FLOOR: f64 = 1e-4;
const CHUNK: usize = 1 << 15;

/// Shares of the faces, and the shape's unit.
#[derive(Clone, Debug)]
pub struct AreaShares {
    /// Share of each node (n), 0 for dust; they sum to 1 but for floored ones.
    pub share: MappedSlice<f32>,
    /// From the frame's lengths to units of √(area).
    pub unit: f32,
    /// Nodes that are dust.
    pub tiny_components: u64,
}

impl AreaShares {
    /// Computes the shares; `surface_shares.npy`.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
    pub fn of(graph: &DualGraph, context: Context<'_>) -> Result<Self> {
        let n = graph.nodes.len();
        let (tiny, total, tiny_components) = tiny_roots(graph, context.run)?;
        let real = n as u64 - tiny_components;
        // All faces degenerate: each counts the same.
        let even = total <= 0.;
        let scale = if even { 0. } else { 1. / total };
        let floor = if even { 1. / real.max(1) as f64 } else { FLOOR / real.max(1) as f64 };
        let mut array = context.work.array::<f32>("surface_shares.npy", &[n])?;
        fill_chunks(
            context.run.threads,
            &context.run.cancel,
            array.data(),
            CHUNK,
            || (),
            |k, out, ()| {
                for (slot, i) in out.iter_mut().zip(chunk_range(n, CHUNK, k)) {
                    let is_dust = !tiny.is_empty()
                        && graph.components.as_ref().is_some_and(|link| tiny.contains(&(link[i] & !AGAINST)));
                    *slot = if is_dust { 0. } else { (f64::from(graph.nodes[i].area) * scale).max(floor) as f32 };
                }
                Ok(())
            },
        )?;
        let unit = if even { 1. } else { (1. / total.sqrt()) as f32 };
        Ok(Self { share: array.finish(false)?, unit, tiny_components })
    }
}

/// First nodes of the components that are dust, the area of the rest, and the number of dusty nodes.
fn tiny_roots(graph: &DualGraph, run: &Run) -> Result<(HashSet<u32>, f64, u64)> {
    let total = graph.facts.area;
    let Some(links) = &graph.components else { return Ok((HashSet::new(), total, 0)) };
    let n = links.len();
    let parts = map_ranges(run.threads, &run.cancel, n, CHUNK, |range| {
        let mut sums: HashMap<u32, (f64, u64)> = HashMap::new();
        for i in range {
            let sum = sums.entry(links[i] & !AGAINST).or_default();
            sum.0 += f64::from(graph.nodes[i].area);
            sum.1 += 1;
        }
        Ok(sums)
    })?;
    let mut sums: HashMap<u32, (f64, u64)> = HashMap::new();
    for (root, (area, count)) in parts.into_iter().flatten() {
        let sum = sums.entry(root).or_default();
        sum.0 += area;
        sum.1 += count;
    }
    let mut list: Vec<(u32, f64, u64)> = sums.into_iter().map(|(root, (area, count))| (root, area, count)).collect();
    list.sort_unstable_by(|a, b| b.1.total_cmp(&a.1).then(b.2.cmp(&a.2)).then(a.0.cmp(&b.0)));
    let (mut tiny, mut area, mut tiny_components) = (HashSet::new(), 0., 0);
    for (rank, &(root, share, count)) in list.iter().enumerate() {
        if rank > 0 && share < TINY * total {
            tiny.insert(root);
            tiny_components += count;
        } else {
            area += share;
        }
    }
    Ok((tiny, area, tiny_components))
}
