//! Coordinates for sequencing vertices: from the rows over faces, by the degree-normalised Nyström embedding.
//!
//! A vertex gets the mean of its faces' coordinates. In a mesh of one component these are the second vector and, for
//! ties, the third. With several components the leading vectors may only separate components. Each component with a
//! sufficient share of the surface then gets its own Fiedler vector within the embedding: the direction with the
//! greatest variance over its faces relative to its variation along edges (Rayleigh–Ritz; edges within chunks of faces
//! represent all). Cost: one or two passes over the rows; 12 B per vertex mapped.

use crate::base::sort::map_of;
use crate::base::{Result, eigen};
use crate::distance::DistanceRows;
use crate::graph::DualGraph;
use crate::graph::components::FLIPPED;
use crate::mesh::Mesh;
use crate::spectral::embedding::KernelWidth;
use crate::spectral::{Embedding, EmbeddingParams, Kernel, Normalisation, SampledColumns};
use crate::store::npy::ArrayMut;
use crate::store::{Context, MappedSlice, Run, WorkDir};
use nalgebra::DMatrix;
use std::collections::BTreeMap;
use std::ops::Range;

/// Minimum share of the faces for a component to get its own direction; the others use that of the mesh.
const SHARE: f64 = 1e-3;
/// Maximum number of components stored before those of at most [`SPECK`] faces are dropped.
const MOST: usize = 1 << 16;
const SPECK: u64 = 64;
/// Number of vectors for a mesh of one component, and number in which directions are sought otherwise.
const FEW: usize = 3;
const MANY: usize = 10;

/// Coordinates of vertices.
pub(super) struct Coordinates {
    /// The first coordinate, for sweeps and for sorting (v); NaN for vertices without a face.
    pub first: ArrayMut<f64>,
    /// Sums of both coordinates over faces, and the number of faces (v).
    pub sums: MappedSlice<[f32; 3]>,
    /// First node of the component of each vertex (v), if there are several.
    pub component: Option<MappedSlice<u32>>,
}

/// The directions of the embedding along which components are ordered: d weights for the first coordinate, d for the
/// second.
struct Directions {
    usual: [Vec<f32>; 2],
    own: BTreeMap<u32, [Vec<f32>; 2]>,
}

impl Directions {
    fn of(&self, root: u32) -> &[Vec<f32>; 2] {
        self.own.get(&root).unwrap_or(&self.usual)
    }
}

/// The spread of the coordinates of a component, and their changes from face to face.
struct Spread {
    d: usize,
    count: f64,
    sum: Vec<f64>,
    /// Sums of products of coordinates, and of their differences along edges (d × d).
    products: DMatrix<f64>,
    energy: DMatrix<f64>,
}

impl Spread {
    fn new(d: usize) -> Self {
        Self { d, count: 0., sum: vec![0.; d], products: DMatrix::zeros(d, d), energy: DMatrix::zeros(d, d) }
    }

    fn add(&mut self, at: &[f64]) {
        self.count += 1.;
        for e in 0..self.d {
            self.sum[e] += at[e];
            (0..self.d).for_each(|f| self.products[(e, f)] += at[e] * at[f]);
        }
    }

    fn step(&mut self, by: &[f64]) {
        for e in 0..self.d {
            (0..self.d).for_each(|f| self.energy[(e, f)] += by[e] * by[f]);
        }
    }

    /// The two directions with the greatest spread relative to their energy; `None` if there are no edges.
    fn directions(self) -> Option<[Vec<f32>; 2]> {
        let Self { d, count, sum, products, mut energy } = self;
        let spread = DMatrix::from_fn(d, d, |e, f| products[(e, f)] - sum[e] * sum[f] / count);
        // Directions along which only rounding errors vary must not appear smooth.
        let ridge = 1e-6 * energy.trace() / d as f64 + 1e-12 * spread.trace();
        (0..d).for_each(|e| energy[(e, e)] += ridge);
        let root = energy.cholesky()?.l();
        let half = root.solve_lower_triangular(&spread)?;
        let whole = root.solve_lower_triangular(&half.transpose())?;
        let axes = root.transpose().solve_upper_triangular(&eigen::symmetric(whole).1)?;
        let along = |k: usize| {
            let axis = axes.column(k.min(d - 1));
            axis.iter().map(|x| (x / axis.norm()) as f32).collect()
        };
        Some([along(0), along(1)])
    }
}

/// Shared data of the passes over the rows.
pub(super) struct Task<'a> {
    pub mesh: &'a Mesh,
    pub graph: &'a DualGraph,
    pub rows: &'a DistanceRows,
    pub embedding: &'a Embedding,
    pub context: Context<'a>,
}

impl Task<'_> {
    /// First node of the component of `node`.
    fn root(&self, node: usize) -> u32 {
        self.graph.components.as_ref().map_or(0, |roots| roots[node] & !FLIPPED)
    }

    /// Embeds chunks of faces ([`Embedding::for_each_chunk`]).
    fn embed(&self, consume: impl FnMut(Range<usize>, &[f32]) -> Result<()>) -> Result<()> {
        self.embedding.for_each_chunk(self.rows, "coordinates", self.context.run, consume)
    }

    fn directions(&self) -> Result<Directions> {
        let d = self.embedding.dimensions;
        let unit = |axis: usize| (0..d).map(|e| if e == axis.min(d - 1) { 1. } else { 0. }).collect();
        let mut directions = Directions { usual: [unit(1), unit(2)], own: BTreeMap::new() };
        let Some(roots) = &self.graph.components else { return Ok(directions) };
        let (mut sizes, mut most): (BTreeMap<u32, u64>, usize) = (BTreeMap::new(), MOST);
        for run in roots.chunk_by(|a, b| a & !FLIPPED == b & !FLIPPED) {
            *sizes.entry(run[0] & !FLIPPED).or_default() += run.len() as u64;
            // Specks may come by the million and are dropped as they come.
            if sizes.len() > most {
                self.context.run.cancel.check()?;
                sizes.retain(|_, size| *size > SPECK);
                most = MOST.max(2 * sizes.len());
            }
        }
        let least = (SHARE * roots.len() as f64).max(3.);
        sizes.retain(|_, size| *size as f64 >= least);
        let mut spreads = map_of(sizes.keys().map(|&root| (root, Spread::new(d))));
        let graph = self.graph.edges.by_shared_edge();
        let (mut here, mut step) = (vec![0.; d], vec![0.; d]);
        self.embed(|range, out| {
            let m = range.len();
            for (i, node) in range.clone().enumerate() {
                let root = self.root(node);
                let Some(spread) = spreads.get_mut(&root) else { continue };
                (0..d).for_each(|e| here[e] = f64::from(out[e * m + i]));
                spread.add(&here);
                for (near, _) in graph.neighbours(node as u32) {
                    let near = near as usize;
                    if near > node && near < range.end && self.root(near) == root {
                        (0..d).for_each(|e| step[e] = f64::from(out[e * m + near - range.start]) - here[e]);
                        spread.step(&step);
                    }
                }
            }
            Ok(())
        })?;
        directions.own = map_of(spreads.into_iter().filter_map(|(root, spread)| Some((root, spread.directions()?))));
        Ok(directions)
    }

    /// Coordinates of all vertices, in temporary files.
    pub fn coordinates(&self) -> Result<Coordinates> {
        let (n, d) = (self.mesh.positions.len(), self.embedding.dimensions);
        let directions = self.directions()?;
        let mut sums = self.context.work.array::<[f32; 3]>("vertex_sums.tmp", &[n, 3])?;
        let several = self.graph.components.is_some();
        let mut component =
            several.then(|| self.context.work.array::<u32>("vertex_component.tmp", &[n])).transpose()?;
        if let Some(component) = &mut component {
            component.data().fill(u32::MAX);
        }
        self.embed(|range, out| {
            let m = range.len();
            let start = range.start;
            self.mesh.faces.for_each(range, |node, corners| {
                let root = self.root(node);
                let [first, second] = directions.of(root);
                let along = |w: &[f32]| (0..d).map(|e| w[e] * out[e * m + node - start]).sum::<f32>();
                let (x, y) = (along(first), along(second));
                for &v in corners {
                    let sum = &mut sums.data()[v as usize];
                    *sum = [sum[0] + x, sum[1] + y, sum[2] + 1.];
                    if let Some(component) = &mut component {
                        let own = &mut component.data()[v as usize];
                        *own = root.min(*own);
                    }
                }
            });
            Ok(())
        })?;
        let mut first = self.context.work.array::<f64>("vertex_first.tmp", &[n])?;
        let sums = sums.finish(false)?;
        for (x, sum) in first.data().iter_mut().zip(sums.iter()) {
            *x = f64::from(sum[0]) / f64::from(sum[2]);
        }
        Ok(Coordinates { first, sums, component: component.map(|array| array.finish(false)).transpose()? })
    }
}

/// Removes the files behind [`Coordinates`].
pub(super) fn remove(work: &WorkDir) {
    ["vertex_sums.tmp", "vertex_component.tmp", "vertex_first.tmp", "sweep.tmp"]
        .iter()
        .for_each(|name| work.remove(name));
}

/// The fit of the embedding for coordinates.
pub(super) fn fit(rows: &DistanceRows, graph: &DualGraph, run: &Run) -> Result<Embedding> {
    let columns = SampledColumns::sample(rows, |node| graph.nodes.at(node).area, run)?;
    let dimensions = if graph.components.is_some() { MANY } else { FEW };
    Embedding::fit(rows, &columns, embedding_params(dimensions))
}

/// The parameters of the embedding for coordinates.
fn embedding_params(dimensions: usize) -> EmbeddingParams {
    EmbeddingParams {
        kernel: Kernel::Gaussian,
        width: KernelWidth::Mean(1.),
        normalisation: Normalisation::Degree,
        dimensions,
        unit_rows: false,
    }
}
