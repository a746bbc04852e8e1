//! Some two thousand geodesic Voronoi cells, and the graph of cells that parts are decided on.
//!
//! One front from area-stratified seeds under length + .1 |turning| (.05 convex) cuts the surface into cells that follow
//! creases; people's segmentations projected on them lose .002 of the Rand index. One pass sums up areas, centroids,
//! normals, and for touching cells the length and mean turning of their common boundary.
//! Cost: one front, 4 + 4 bytes a face, and one pass over the graph.

use super::area_shares::AreaShares;
use super::normals::{Normals, turning};
use super::parts::CellGraph;
use super::seeds::spread;
use super::sums::{ClassSum, class_sums};
use crate::base::Result;
use crate::base::parallel::map_ranges;
use crate::distance::voronoi;
use crate::graph::dual::Csr;
use crate::graph::weights::{self, Metric};
use crate::graph::{DualGraph, Node};
use crate::store::{Context, MappedSlice, Run};
use std::collections::BTreeMap;

/// Cells of a surface.
pub const CELLS: usize = 2000;
const CHUNK: usize = 1 << 14;

/// Cells of the faces and the graph of the cells.
#[derive(Clone, Debug)]
pub struct Cells {
    /// Cell of each node (n).
    pub of_node: MappedSlice<u32>,
    /// The cells' graph, lengths in units of √(area).
    pub graph: CellGraph,
}

/// Sums over a pair of touching cells.
#[derive(Clone, Copy, Debug, Default)]
struct Border {
    length: f64,
    concave: f64,
    convex: f64,
    convex04: f64,
}

/// The normals at .01, .02 and .04 that cells need.
#[derive(Clone, Copy, Debug)]
pub struct Smooth<'a> {
    /// At .01: for the front.
    pub fine: &'a Normals,
    /// At .02: for the turning of boundaries.
    pub medium: &'a Normals,
    /// At .04: for their convexity.
    pub coarse: &'a Normals,
}

impl Cells {
    /// Cuts the surface into cells; `cells.npy`.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
    pub fn cut(graph: &DualGraph, shares: &AreaShares, smooth: Smooth<'_>, context: Context<'_>) -> Result<Self> {
        let n = graph.nodes.len();
        // A small mesh is its own cells, dust and all, so that any number of parts up to n can be had.
        let seeds: Vec<u32> =
            if n <= CELLS { (0..n as u32).collect() } else { spread(&shares.share, CELLS, context.run.seed, "cells") };
        let metric = Metric::ScaleFree { beta: 0.1, eta: 0.5 };
        let area = 1. / f64::from(shares.unit).powi(2);
        let place = (context.work, "cell_weights.npy");
        let steps = weights::build(&graph.rows, &graph.nodes, Some(smooth.fine), area, metric, place, context.run)?;
        let csr = Csr::new(&graph.rows.indptr, &graph.rows.indices, &steps);
        let mut owner = context.work.array::<u32>("cells.npy", &[n])?;
        {
            let mut field = context.work.array::<f32>("cell_field.tmp", &[n])?;
            voronoi::spread(csr, &seeds, field.data(), owner.data(), context.run)?;
        }
        context.work.remove("cell_field.tmp.partial");
        context.work.remove("cell_weights.npy");
        let of_node = owner.finish(false)?;
        let graph = cell_graph(graph, shares, smooth, &of_node, seeds.len(), context.run)?;
        Ok(Self { of_node, graph })
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.graph.area.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

fn cell_graph(
    graph: &DualGraph,
    shares: &AreaShares,
    smooth: Smooth<'_>,
    cell: &[u32],
    cells: usize,
    run: &Run,
) -> Result<CellGraph> {
    let unit = f64::from(shares.unit);
    // A cell of dust alone still needs a place: a weight too small to matter elsewhere.
    let sums = class_sums(graph, shares, cell, cells, 1e-18, run)?;
    let borders = borders(graph, shares, smooth, cell, run)?;
    let mean = |sum: f64, border: &Border| if border.length > 0. { sum / border.length } else { 0. };
    Ok(CellGraph {
        area: sums.iter().map(|sum| sum.share).collect(),
        centre: sums.iter().map(|sum| sum.centroid().map(|x| x * unit)).collect(),
        normal: sums.iter().map(ClassSum::direction).collect(),
        pairs: borders.iter().map(|(&(a, b), _)| [a, b]).collect(),
        length: borders.values().map(|b| b.length).collect(),
        concave: borders.values().map(|b| mean(b.concave, b)).collect(),
        convex: borders.values().map(|b| mean(b.convex, b)).collect(),
        convex04: borders.values().map(|b| mean(b.convex04, b)).collect(),
    })
}

/// Length and turning of the common boundary of each pair of touching cells. Bridges are no boundary.
fn borders(
    graph: &DualGraph,
    shares: &AreaShares,
    smooth: Smooth<'_>,
    cell: &[u32],
    run: &Run,
) -> Result<BTreeMap<(u32, u32), Border>> {
    let n = cell.len();
    let (indptr, indices, edge) = (&graph.rows.indptr[..], &graph.rows.indices[..], &graph.rows.edge[..]);
    let parts = map_ranges(run.threads, &run.cancel, n, CHUNK, |range| {
        let mut sums: BTreeMap<(u32, u32), Border> = BTreeMap::new();
        for i in range {
            for e in indptr[i] as usize..indptr[i + 1] as usize {
                let j = indices[e] as usize;
                if j <= i || cell[i] == cell[j] || edge[e] == 0. {
                    continue;
                }
                let length = f64::from(edge[e].abs() * shares.unit);
                let angle = |normals: &Normals| {
                    let node = |i: usize| Node { normal: normals[i], ..graph.nodes[i] };
                    f64::from(turning(&node(i), &node(j), edge[e]))
                };
                let (medium, coarse) = (angle(smooth.medium), angle(smooth.coarse));
                let border = sums.entry((cell[i].min(cell[j]), cell[i].max(cell[j]))).or_default();
                border.length += length;
                border.concave += length * medium.max(0.);
                border.convex += length * (-medium).max(0.);
                border.convex04 += length * (-coarse).max(0.);
            }
        }
        Ok(sums)
    })?;
    let mut total: BTreeMap<(u32, u32), Border> = BTreeMap::new();
    for (pair, part) in parts.into_iter().flatten() {
        let border = total.entry(pair).or_default();
        border.length += part.length;
        border.concave += part.concave;
        border.convex += part.convex;
        border.convex04 += part.convex04;
    }
    Ok(total)
}
