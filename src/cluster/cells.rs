//! Some two thousand geodesic Voronoi cells, the graph of cells on which parts are decided, and rows averaged over
//! cells.
//!
//! One front from area-stratified seeds under length + .1 |turning| (.05 convex) divides the surface into cells that
//! follow creases; people's segmentations projected onto them lose .002 of the Rand index. If the surface is its own
//! mirror image, seeds come in mirrored pairs ([`super::mirror`]). One pass sums areas, centroids and normals, and for
//! adjacent cells the length and mean turning of their common boundary.
//!
//! Rows averaged over cells are B (l × S), all that deciding on parts needs of `[A B]`. Rows computed on the cell graph
//! alone are much worse (.15–.22 against .10 in 1 − Rand); averages of rows over all faces are not.
//!
//! Cost: one front, 8 bytes per face while it runs and 2 that are kept, and one pass over the graph; then one
//! sequential pass per row, which reads 10 bytes per face: cell, share and distance.

use super::area_shares::{AreaShares, SurfaceSum, narrow, spread_seeds, surface_sums};
use super::mirror::{PointSet, SurfacePoint, paired_seeds};
use super::normals::{Normals, dihedral_angle};
use super::parts::CellGraph;
use crate::base::Result;
use crate::base::vector::wide;
use crate::distance::{DistanceRows, voronoi};
use crate::graph::Csr;
use crate::graph::weights::{Metric, Weighting};
use crate::graph::{DualGraph, Node};
use crate::store::{Context, MappedSlice, Run};
use std::collections::BTreeMap;

/// Number of cells.
pub const CELLS: usize = 2000;
const CHUNK: usize = 1 << 14;
/// Cell of each face.
pub const OF_FACE: &str = "cells.npy";

/// Cells of the faces and the graph of the cells.
#[derive(Clone, Debug)]
pub struct Cells {
    /// Cell of each node (n).
    pub of_node: MappedSlice<u16>,
    /// The cells' graph, lengths in units of √(area).
    pub graph: CellGraph,
}

/// Sums over a pair of adjacent cells.
#[derive(Clone, Copy, Debug, Default)]
struct BoundarySums {
    length: f64,
    concave: f64,
    convex: f64,
    convex04: f64,
}

/// The normals smoothed at .01, .02 and .04 that cells need.
#[derive(Clone, Copy, Debug)]
pub struct SmoothedNormals<'a> {
    /// At .01: for the front.
    pub fine: &'a Normals,
    /// At .02: for the turning of boundaries.
    pub medium: &'a Normals,
    /// At .04: for their convexity.
    pub coarse: &'a Normals,
}

impl Cells {
    /// Divides the surface into cells; writes [`OF_FACE`]. `is_flipped` tells the nodes whose winding in the file is
    /// against their normals.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
    pub fn cut(
        graph: &DualGraph,
        shares: &AreaShares,
        normals: SmoothedNormals<'_>,
        is_flipped: impl Fn(u32) -> bool,
        context: Context<'_>,
    ) -> Result<Self> {
        let n = graph.nodes.len();
        // In a small mesh every face is a cell, except for those of tiny components, which belong to the cell next to
        // them.
        let seeds: Vec<u32> = if n <= CELLS {
            (0..n as u32).filter(|&node| shares.at(node as usize) > 0.).collect()
        } else {
            paired(graph, shares, normals.fine, spread_seeds(shares, CELLS, "cells", context.run)?)
        };
        let metric = Metric::ScaleFree { beta: 0.1, eta: 0.5 };
        let area = 1. / f64::from(shares.unit).powi(2);
        let (edges, nodes) = (&graph.edges, &graph.nodes);
        let steps =
            Weighting { edges, nodes, normals: Some(normals.fine), area, metric }.build("cell_weights.npy", context)?;
        let csr = Csr::new(graph.edges.starts.view(), &graph.edges.indices, &steps);
        let mut owner = context.work.array::<u32>("cells.tmp", &[n])?;
        {
            let mut field = context.work.array::<f32>("cell_field.tmp", &[n])?;
            voronoi::nearest_source(csr, &seeds, field.data(), owner.data(), context.run)?;
        }
        context.work.remove("cell_weights.npy");
        let mut cells = cell_graph(graph, shares, normals, owner.data(), seeds, context.run)?;
        if cells.seed.iter().any(|&seed| is_flipped(seed)) {
            cells.flipped = cells.seed.iter().map(|&seed| is_flipped(seed)).collect();
        }
        let mut of_node = context.work.array::<u16>(OF_FACE, &[n])?;
        context.run.fill_each(of_node.data(), CHUNK, |i, _| narrow(owner.items()[i]))?;
        Ok(Self { of_node: of_node.finish(false)?, graph: cells })
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.graph.area.len()
    }
}

/// Replaces seeds by mirrored pairs if the surface is its own mirror image.
fn paired(graph: &DualGraph, shares: &AreaShares, normals: &Normals, seeds: Vec<u32>) -> Vec<u32> {
    let unit = f64::from(shares.unit);
    let point = |node: u32| SurfacePoint {
        position: wide(graph.nodes.at(node as usize).centroid).map(|x| x * unit),
        normal: wide(normals[node as usize]),
    };
    let points: Vec<SurfacePoint> = seeds.iter().map(|&seed| point(seed)).collect();
    let alike = vec![1. / seeds.len() as f64; seeds.len()];
    let set = PointSet::new(&points, &alike, 1.);
    let edges = graph.edges.by_shared_edge();
    paired_seeds(seeds, set, point, |node| edges.neighbours(node).map(|(other, _)| other))
}

fn cell_graph(
    graph: &DualGraph,
    shares: &AreaShares,
    normals: SmoothedNormals<'_>,
    cell: &[u32],
    seeds: Vec<u32>,
    run: &Run,
) -> Result<CellGraph> {
    let unit = f64::from(shares.unit);
    // A cell within tiny components still needs a centroid: a weight too small to matter elsewhere.
    let sums = surface_sums(graph, shares, cell, seeds.len(), 1e-18, run)?;
    let borders = borders(graph, shares, normals, cell, run)?;
    let mean = |sum: f64, border: &BoundarySums| if border.length > 0. { sum / border.length } else { 0. };
    Ok(CellGraph {
        seed: seeds,
        area: sums.iter().map(|sum| sum.share).collect(),
        centre: sums.iter().map(|sum| sum.centroid().map(|x| x * unit)).collect(),
        normal: sums.iter().map(SurfaceSum::direction).collect(),
        flipped: Vec::new(),
        pairs: borders.iter().map(|(&(a, b), _)| [a, b]).collect(),
        length: borders.values().map(|b| b.length).collect(),
        concave: borders.values().map(|b| mean(b.concave, b)).collect(),
        convex: borders.values().map(|b| mean(b.convex, b)).collect(),
        convex04: borders.values().map(|b| mean(b.convex04, b)).collect(),
    })
}

/// Length and turning of the common boundary of each pair of adjacent cells. Bridges are not boundaries.
fn borders(
    graph: &DualGraph,
    shares: &AreaShares,
    normals: SmoothedNormals<'_>,
    cell: &[u32],
    run: &Run,
) -> Result<BTreeMap<(u32, u32), BoundarySums>> {
    let n = cell.len();
    let shared = graph.edges.by_shared_edge();
    let parts = run.map_ranges(n, CHUNK, |range| {
        let mut sums: BTreeMap<(u32, u32), BoundarySums> = BTreeMap::new();
        for i in range {
            for (j, edge) in shared.neighbours(i as u32) {
                let j = j as usize;
                if j <= i || cell[i] == cell[j] || edge == 0. {
                    continue;
                }
                let length = f64::from(edge.abs() * shares.unit);
                let angle = |normals: &Normals| {
                    let node = |i: usize| Node { normal: normals[i], ..graph.nodes.at(i) };
                    f64::from(dihedral_angle(&node(i), &node(j), edge))
                };
                let (medium, coarse) = (angle(normals.medium), angle(normals.coarse));
                let border = sums.entry((cell[i].min(cell[j]), cell[i].max(cell[j]))).or_default();
                border.length += length;
                border.concave += length * medium.max(0.);
                border.convex += length * (-medium).max(0.);
                border.convex04 += length * (-coarse).max(0.);
            }
        }
        Ok(sums)
    })?;
    let mut total: BTreeMap<(u32, u32), BoundarySums> = BTreeMap::new();
    for (pair, part) in parts.into_iter().flatten() {
        let border = total.entry(pair).or_default();
        border.length += part.length;
        border.concave += part.concave;
        border.convex += part.convex;
        border.convex04 += part.convex04;
    }
    Ok(total)
}

/// Averages rows over cells.
#[derive(Clone, Debug)]
pub struct CellAverages<'a> {
    cell: &'a [u16],
    shares: &'a AreaShares,
    /// Area of each cell (S).
    mass: Vec<f64>,
}

impl<'a> CellAverages<'a> {
    /// For averages over `cells`, weighted by `shares`.
    pub fn new(cells: &'a Cells, shares: &'a AreaShares) -> Self {
        let mut average = Self { cell: &cells.of_node, shares, mass: Vec::new() };
        average.mass = average.sums(cells.len(), |_| 1.);
        average
    }

    /// Area-weighted means over each cell (S) of a row of distances (n); infinite if a cell is not reached.
    pub fn of(&self, row: &[f32]) -> Vec<f64> {
        let sums = self.sums(self.mass.len(), |face| f64::from(row[face]));
        sums.iter().zip(&self.mass).map(|(sum, mass)| sum / mass).collect()
    }

    /// Sums of `value` of each face over each of `cells` cells.
    fn sums(&self, cells: usize, value: impl Fn(usize) -> f64) -> Vec<f64> {
        let mut sums = vec![0f64; cells];
        let mut faces = self.cell.iter().enumerate();
        self.shares.each(0..self.cell.len(), |share| {
            if let Some((face, &cell)) = faces.next() {
                // The same minimum weight as in the cells' own means, for cells within tiny components.
                sums[cell as usize] += f64::from(share).max(1e-18) * value(face);
            }
        });
        sums
    }
}

/// Area-weighted means of each row over each cell, row-major l × S; infinite if a cell is not reached.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn average(rows: &DistanceRows, cells: &Cells, shares: &AreaShares, run: &Run) -> Result<Vec<f64>> {
    let average = CellAverages::new(cells, shares);
    let averaged = run.map_chunks(
        rows.len(),
        || (),
        |k, ()| {
            let mean = average.of(rows.row(k));
            run.progress.advance("cell rows", 1);
            Ok(mean)
        },
    )?;
    Ok(averaged.into_iter().flatten().collect())
}

/// The largest share of the surface that is nearest to a single landmark, given rows averaged over cells (row-major l ×
/// S) and the cells' areas (S). .54 or less on 185 of 190 models of the Princeton benchmark; .89 on an isosurface where
/// all but one landmark sat in pockets.
pub fn greatest_share(b: &[f64], area: &[f64]) -> f64 {
    let mut share = vec![0f64; b.len() / area.len().max(1)];
    for (cell, a) in area.iter().enumerate() {
        let nearer =
            |best: usize, k: usize| if b[k * area.len() + cell] < b[best * area.len() + cell] { k } else { best };
        if let Some(nearest) = (0..share.len()).reduce(nearer) {
            share[nearest] += a;
        }
    }
    let total: f64 = area.iter().sum();
    if total > 0. { share.into_iter().fold(0., f64::max) / total } else { 0. }
}

#[cfg(test)]
mod tests {
    use super::greatest_share;

    #[test]
    fn the_landmark_that_most_of_the_surface_is_nearest_to() {
        let b = [0., 1., 2., 9., 5., 4., 3., 0., f64::INFINITY, f64::INFINITY, f64::INFINITY, f64::INFINITY];
        assert_eq!(greatest_share(&b, &[1., 1., 1., 1.]), 0.75);
        assert_eq!(greatest_share(&b, &[1., 1., 1., 9.]), 0.75);
        assert_eq!(greatest_share(&b, &[0., 0., 0., 0.]), 0.);
        assert_eq!(greatest_share(&[], &[1.]), 0.);
    }
}
