//! The data shared by all runs on a mesh: its graph, held-out columns, one σ, and all distances if there are few.
//!
//! σ is the same for all samplings: the mean over all pairs, or over the held-out rows. A σ from each sampling's own
//! rows would favour the farthest points, which inflate it by 1.1 to 1.9. All distances of up to
//! [`StudyParams::matrix`] nodes are in a mapped file of 4 n² bytes; one front per node, 0.2 ms each for 4,000 faces.
//!
//! Nodes are faces, as for segmentation, or vertices with distances through triangles, as for correspondence: paths
//! between centroids zigzag, and no small sample represents the resulting error.

use crate::base::Result;
use crate::base::random::{below, stream};
use crate::distance::RowFacts;
use crate::distance::front::{Front, mean_weight};
use crate::distance::march::{March, Surface};
use crate::distance::sampler::fill_lengths;
use crate::graph::{Csr, WeightedGraph};
use crate::graph::{DualGraph, Metric, NodeGeometry, VertexGraph};
use crate::mesh::Mesh;
use crate::store::{Context, MappedSlice};

/// The kind of nodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Over {
    /// Faces; distances by a metric over the dual graph.
    #[default]
    Faces,
    /// Vertices; distances by fast marching.
    Vertices,
}

/// Parameters for preparing a study.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct StudyParams {
    /// The kind of nodes.
    pub over: Over,
    /// Form of the edge weights between faces.
    pub metric: Metric,
    /// Maximum number of nodes for which all distances are computed.
    pub matrix: usize,
    /// Number of columns held out.
    pub held_out: usize,
    /// Whether a sampling needs the graph of lengths.
    pub lengths: bool,
}

impl Default for StudyParams {
    fn default() -> Self {
        Self { over: Over::Faces, metric: Metric::default(), matrix: 5000, held_out: 20, lengths: false }
    }
}

crate::base::setters::setters!(StudyParams {
    over: Over,
    metric: Metric,
    matrix: usize,
    held_out: usize,
    lengths: bool
});

#[derive(Clone, Debug)]
enum Graph {
    Faces(WeightedGraph),
    Vertices(VertexGraph),
}

impl Graph {
    fn csr(&self) -> Csr<'_> {
        match self {
            Self::Faces(graph) => graph.csr(),
            Self::Vertices(graph) => graph.csr(),
        }
    }
}

/// A mesh prepared for the study.
#[derive(Clone, Debug)]
pub struct StudyData {
    /// Geometry of the nodes (n).
    pub nodes: NodeGeometry,
    graph: Graph,
    lengths: Option<MappedSlice<f32>>,
    /// All distances, row i at `i * n` (n × n), if there are few nodes.
    pub matrix: Option<MappedSlice<f32>>,
    /// Nodes of the held-out columns, ascending.
    pub held_out: Vec<u32>,
    held_rows: MappedSlice<f32>,
    /// Mean distance between different nodes: over all pairs, or from the held-out rows.
    pub mean: f64,
}

impl StudyData {
    /// Builds everything in `work`; `identity` identifies the input.
    ///
    /// # Errors
    /// As [`DualGraph::build`].
    pub fn of(opened: &Mesh, identity: &serde_json::Value, params: StudyParams, context: Context<'_>) -> Result<Self> {
        let (path, mesh) = (opened.path(), &opened.without_strays(context.run)?);
        let (graph, nodes) = match params.over {
            Over::Faces => {
                let built = DualGraph::build(mesh, path, identity, context)?;
                (Graph::Faces(built.weighted(params.metric, context)?), built.nodes)
            }
            Over::Vertices => {
                let built = VertexGraph::build(mesh, path, context)?;
                let nodes = built.nodes.clone().into();
                (Graph::Vertices(built), nodes)
            }
        };
        let n = nodes.len();
        let lengths = if params.lengths {
            let mut array = context.work.array::<f32>("lengths.npy", &[graph.csr().weights.len()])?;
            fill_lengths(graph.csr(), nodes.view(), array.data(), context.run)?;
            Some(array.finish(false)?)
        } else {
            None
        };
        let mut draw = stream(context.run.seed, "held out");
        let mut held_out: Vec<u32> = (0..params.held_out).map(|_| below(&mut draw, n) as u32).collect();
        held_out.sort_unstable();
        held_out.dedup();
        let rows = |name: &str, of: &[u32]| rows(&graph, of, name, context);
        let held_rows = rows("held_out_rows.npy", &held_out)?;
        let matrix = if n <= params.matrix {
            let all: Vec<u32> = (0..n as u32).collect();
            Some(rows("all_distances.npy", &all)?)
        } else {
            None
        };
        let facts = RowFacts::of(matrix.as_deref().unwrap_or(&held_rows));
        // Distances of nodes from themselves do not count as pairs.
        let own = matrix.as_ref().map_or(held_out.len(), |_| n) as u64;
        let mean = facts.sum / (facts.reached - own).max(1) as f64;
        // Mapped arrays outlive their names; in a kept work directory the files would never be removed.
        ["lengths.npy", "held_out_rows.npy", "all_distances.npy"].iter().for_each(|name| context.work.remove(name));
        Ok(Self { nodes, graph, lengths, matrix, held_out, held_rows, mean })
    }

    /// Number of nodes n.
    pub fn len(&self) -> usize {
        self.nodes.len()
    }

    /// The graph.
    pub fn graph(&self) -> Csr<'_> {
        self.graph.csr()
    }

    /// The same graph weighted by length only, if requested.
    pub fn lengths(&self) -> Option<Csr<'_>> {
        self.lengths.as_ref().map(|weights| Csr { weights, triangles: &[], ..self.graph.csr() })
    }

    /// Rows of the held-out columns.
    pub fn held_rows(&self) -> Vec<&[f32]> {
        self.held_rows.chunks_exact(self.len().max(1)).collect()
    }

    /// The rows of the nodes `of` in the file `name` of `work` (count × n), one front each.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
    pub fn rows(&self, of: &[u32], name: &str, context: Context<'_>) -> Result<MappedSlice<f32>> {
        rows(&self.graph, of, name, context)
    }

    /// Shares of the area, summing to n (n).
    pub fn weights(&self) -> Vec<f64> {
        let total: f64 = (0..self.len()).map(|i| f64::from(self.nodes.at(i).area)).sum();
        let n = self.len() as f64;
        // Faces without area have almost no weight, unless all are like that.
        if total <= 0. {
            return vec![1.; self.len()];
        }
        (0..self.len()).map(|i| f64::from(self.nodes.at(i).area).max(1e-9 * total / n) * n / total).collect()
    }
}

fn rows(graph: &Graph, of: &[u32], name: &str, context: Context<'_>) -> Result<MappedSlice<f32>> {
    let csr = graph.csr();
    let mut array = context.work.array::<f32>(name, &[of.len(), csr.len()])?;
    let mean = mean_weight(csr);
    let stage = || {
        context.run.fill_chunks(
            array.data(),
            csr.len(),
            || (Front::new(mean), March::new(mean)),
            |k, row, (front, march)| {
                match graph {
                    Graph::Faces(_) => front.full(csr, of[k], row, &context.run.cancel).map(drop)?,
                    Graph::Vertices(graph) => march.full(Surface::of(graph), of[k], row, &context.run.cancel)?,
                }
                context.run.progress.advance("distances", 1);
                Ok(())
            },
        )
    };
    context.run.stage("distances", "rows", of.len() as u64, stage)?;
    array.finish(false)
}
