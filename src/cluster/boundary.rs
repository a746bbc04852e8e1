//! Boundaries of parts, moved from the edges of cells onto creases.
//!
//! Faces deeper in a part than [`BAND`] (at least the deepest 40 % of it) keep their label; one front under the
//! edge weights, from the rim of these cores into the bands between them, labels the rest: it is held up where the
//! surface turns, so it meets there. Boundaries come out a fifth shorter, without islands. The other way labels each face
//! of the bands by its own place in the embedding ([`super::extrapolate`]) and dissolves islands ([`super::islands`]).
//! Either way boundaries are then straightened ([`smooth`]). Only the bands are visited. Memory: two mapped arrays of 4 bytes
//! a face.

use crate::base::Result;
use crate::base::parallel::{fill_each, map_ranges};
use crate::distance::front::mean_weight;
use crate::distance::{DistanceRows, voronoi};
use crate::graph::DualGraph;
use crate::graph::dual::Csr;
use crate::store::{Context, MappedSlice, Run};

use super::area_shares::AreaShares;
use super::extrapolate::Places;
use super::islands;
use super::normals::lengths;
use super::smooth;

/// Half the width of the band around a boundary that is labelled anew, in units of √(area).
pub const BAND: f32 = 0.04;
/// Share of a part's faces that at least keeps its label.
const CORE: f64 = 0.4;
/// Bins of the depths' histogram.
const BINS: usize = 1024;
const CHUNK: usize = 1 << 15;

/// How the faces of the bands get their labels.
#[derive(Clone, Copy, Debug)]
pub enum BoundaryMethod<'a> {
    /// By one front from the cores.
    Front,
    /// By the places of the parts in the embedding, and each face's column of the rows.
    Embedding(&'a Places, &'a DistanceRows),
}

/// Labels every face from the labels of cells: `cell` (n) and `label_of_cell` (S). Writes `labels.npy`.
/// `steps` is the graph under the weights that fronts use.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub fn refine(
    graph: &DualGraph,
    steps: Csr<'_>,
    shares: &AreaShares,
    cell: &[u32],
    label_of_cell: &[u32],
    way: BoundaryMethod<'_>,
    context: Context<'_>,
) -> Result<MappedSlice<u32>> {
    let n = cell.len();
    let parts = label_of_cell.iter().max().map_or(0, |top| *top as usize + 1);
    let mut labels = context.work.array::<u32>("labels.npy", &[n])?;
    fill_each(context.run.threads, &context.run.cancel, labels.data(), CHUNK, |i, _| label_of_cell[cell[i] as usize])?;
    let rim = rim(steps, labels.data(), context.run)?;
    if rim.is_empty() {
        return labels.finish(false);
    }
    let band = BAND / shares.unit;
    let mut field = context.work.array::<f32>("depth.tmp", &[n])?;
    let lengths = lengths(graph);
    field.data().fill(f32::INFINITY);
    voronoi::within(lengths, &rim, band, field.data(), context.run)?;
    let limits = core_limits(labels.data(), field.data(), parts, band, context.run)?;
    // Cores are where the second front starts, at distance 0; the bands are open.
    let owners: &[u32] = labels.data();
    let core = |i: usize, depth: f32| if depth >= limits[owners[i] as usize] { 0. } else { f32::INFINITY };
    fill_each(context.run.threads, &context.run.cancel, field.data(), CHUNK, core)?;
    let edge_of_core = core_rim(steps, field.data(), context.run)?;
    match way {
        BoundaryMethod::Front => {
            voronoi::spread_owners(steps, &edge_of_core, field.data(), labels.data(), context.run)?
        }
        BoundaryMethod::Embedding(places, rows) => {
            let field = field.data();
            places.relabel(rows, cell, |i| field[i] != 0., labels.data(), context.run)?;
            islands::dissolve(steps, &edge_of_core, field, labels.data(), context.run)?;
        }
    }
    straighten(graph, steps, shares, field.data(), labels.data(), context.run)?;
    drop(field);
    context.work.remove("depth.tmp.partial");
    labels.finish(false)
}

/// Smooths the new boundaries; `field` (n) is 0 in the cores and is used up.
fn straighten(
    graph: &DualGraph,
    steps: Csr<'_>,
    shares: &AreaShares,
    field: &mut [f32],
    labels: &mut [u32],
    run: &Run,
) -> Result<()> {
    let lengths = lengths(graph);
    let mean = mean_weight(lengths);
    let open = collect(steps, run, |i| field[i] > 0., |i, j| labels[i] != labels[j])?;
    // Cores cannot be lowered below 0, so they stay outside the band.
    fill_each(run.threads, &run.cancel, field, CHUNK, |_, d| if d == 0. { -1. } else { f32::INFINITY })?;
    let reach = (smooth::REACH / shares.unit).min(smooth::FACES * mean);
    voronoi::within(lengths, &open, reach, field, run)?;
    let field = &*field;
    let band = map_ranges(run.threads, &run.cancel, field.len(), CHUNK, |range| {
        let inside = |i: &usize| field[*i] >= 0. && field[*i] < f32::INFINITY;
        Ok(range.filter(inside).map(|i| i as u32).collect::<Vec<u32>>())
    })?
    .concat();
    let sizes = (&graph.rows.centroid_distance[..], &graph.rows.edge[..]);
    smooth::smooth(steps, sizes, (shares.unit, mean * shares.unit), &band, labels, run)
}

/// Nodes with a neighbour of another label, ascending.
fn rim(graph: Csr<'_>, labels: &[u32], run: &Run) -> Result<Vec<u32>> {
    collect(graph, run, |_| true, |i, j| labels[i] != labels[j])
}

/// Nodes at distance 0 with a neighbour that is not, ascending.
fn core_rim(graph: Csr<'_>, field: &[f32], run: &Run) -> Result<Vec<u32>> {
    collect(graph, run, |i| field[i] == 0., |_, j| field[j] != 0.)
}

/// Nodes i, ascending, with `own(i)` and a neighbour j for which `beside(i, j)`.
fn collect(
    graph: Csr<'_>,
    run: &Run,
    own: impl Fn(usize) -> bool + Sync,
    beside: impl Fn(usize, usize) -> bool + Sync,
) -> Result<Vec<u32>> {
    let n = graph.len();
    let parts = map_ranges(run.threads, &run.cancel, n, CHUNK, |range| {
        Ok(range
            .filter(|&i| {
                let span = || graph.indptr[i] as usize..graph.indptr[i + 1] as usize;
                own(i) && graph.indices[span()].iter().any(|&j| beside(i, j as usize))
            })
            .map(|i| i as u32)
            .collect::<Vec<u32>>())
    })?;
    Ok(parts.concat())
}

/// The depth from which on each part's faces keep their label: the band's half width, or less where more
/// than 60 % of the part lies in it. From histograms; depths beyond the band are infinite.
fn core_limits(labels: &[u32], depth: &[f32], parts: usize, band: f32, run: &Run) -> Result<Vec<f32>> {
    let n = labels.len();
    let block = n.div_ceil(8).max(1);
    let blocks = map_ranges(run.threads, &run.cancel, n, block, |range| {
        let mut counts = vec![0u64; parts * (BINS + 1)];
        for i in range {
            let bin = if depth[i] < band { (depth[i] / band * BINS as f32) as usize } else { BINS };
            counts[labels[i] as usize * (BINS + 1) + bin.min(BINS)] += 1;
        }
        Ok(counts)
    })?;
    let mut counts = vec![0u64; parts * (BINS + 1)];
    for block in blocks {
        counts.iter_mut().zip(block).for_each(|(a, b)| *a += b);
    }
    Ok(counts
        .chunks_exact(BINS + 1)
        .map(|bins| {
            let core = (CORE * bins.iter().sum::<u64>() as f64).ceil() as u64;
            let mut kept = bins[BINS];
            let mut bin = BINS;
            while kept < core && bin > 0 {
                bin -= 1;
                kept += bins[bin];
            }
            band * bin as f32 / BINS as f32
        })
        .collect())
}
