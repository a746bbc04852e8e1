//! The dual graph as a stage: built once into the work directory, opened as mapped arrays after.

use super::adjacency;
use super::assemble::{Rows, assemble};
use super::bridge;
use super::components::find_components;
use super::nodes::{self, Frame, Node};
use super::orient::orient;
use super::triangle_adjacency::TriangleNeighbours;
use super::weights::{self, Metric};
use crate::base::{Error, Result};
use crate::mesh::Mesh;
use crate::store::mapped::{MappedCsr, csr_of_mapped};
use crate::store::stage::options_key;
use crate::store::{Context, MappedSlice, WorkDir};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::path::Path;

/// What building the graph learned about the mesh.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GraphFacts {
    /// Nodes (= faces).
    pub nodes: u64,
    /// Undirected edges, bridges included.
    pub edges: u64,
    /// Mesh edges with one face, after welding.
    pub boundary_edges: u64,
    /// Mesh edges with three faces or more.
    pub nonmanifold_edges: u64,
    /// Open edges joined to others at exactly the same position.
    pub welded_edges: u64,
    /// Faces without area or with a coordinate that is no number.
    pub degenerate_faces: u64,
    /// Faces whose normals were turned, because their winding contradicts their component's or points inwards.
    pub turned_faces: u64,
    /// Edges between faces that no turning makes agree (Möbius strips, some non-manifold edges).
    pub unoriented_edges: u64,
    /// Connected components, before bridging.
    pub components: u64,
    /// Edges added to join components.
    pub bridges: u64,
    /// Sum of face areas in the frame.
    pub area: f64,
    /// The frame.
    pub frame: Frame,
}

/// A dual graph in a work directory.
#[derive(Clone, Debug)]
pub struct DualGraph {
    /// Rows without weights.
    pub rows: Rows,
    /// Geometry of the nodes.
    pub nodes: MappedSlice<Node>,
    /// First node of each node's component before bridging, with the top bit where it was wound against it;
    /// `None` where there is one component.
    pub components: Option<MappedSlice<u32>>,
    /// Counts and sums.
    pub facts: GraphFacts,
    /// Key of the stage, for stages built on it.
    pub key: String,
}

const FILES: [&str; 5] =
    [nodes::FILE, "graph_indptr.npy", "graph_indices.npy", "graph_centroid_distances.npy", "graph_edges.npy"];

impl DualGraph {
    /// Builds the graph of `mesh` (from the file `path`, whose identity is `input`) in `work`, or
    /// opens it where that was done before.
    ///
    /// # Errors
    /// [`Error::Unusable`] for more than 2³² − 1 corners, [`Error::Io`], [`Error::Memory`],
    /// [`Error::Cancelled`].
    pub fn build(mesh: &Mesh, path: &Path, input: &serde_json::Value, context: Context<'_>) -> Result<Self> {
        let options = json!({"stage": "graph", "input": input});
        let key = options_key(&options);
        match context.work.reuse::<GraphFacts>("graph", 1, &key) {
            Ok(facts) => {
                context.run.progress.note("graph: reused");
                return Self::open(context.work, facts, key);
            }
            Err(reason) => context.run.note_remake("graph", &reason),
        }
        let (graph, seconds) = context
            .run
            .stage("graph", "faces", mesh.faces.len() as u64, || Self::make(mesh, path, context, key.clone()))?;
        let mut files = FILES.to_vec();
        if graph.components.is_some() {
            files.push("components.npy");
        }
        context.work.stamp_as("graph", &key, &options, &files, &graph.facts, seconds)?;
        Ok(graph)
    }

    /// Opens the finished graph of `work`, whatever mesh it is of, and tells the identity of what it was built from.
    ///
    /// # Errors
    /// [`Error::WorkDir`] where there is none or its files are gone or damaged.
    pub fn kept(work: &WorkDir) -> Result<(Self, serde_json::Value)> {
        let remedy = "make it first: nystrom-stream graph MESH --work-dir …";
        let stage = work.manifest().stages.remove("graph");
        let stage = stage.ok_or_else(|| Error::work_dir(work.path(), "holds no graph", remedy))?;
        let facts = work
            .reuse::<GraphFacts>("graph", 1, &stage.key)
            .map_err(|problem| Error::work_dir(work.path(), format!("graph: {problem}"), remedy))?;
        Ok((Self::open(work, facts, stage.key)?, stage.inputs["input"].clone()))
    }

    fn make(mesh: &Mesh, path: &Path, context: Context<'_>, key: String) -> Result<Self> {
        let frame = Frame::of(&mesh.positions, context.run)?;
        let (nodes, sums) = nodes::build(mesh, &frame, context)?;
        let (links, counts) = adjacency::matched(mesh, path, context)?;
        let rows = assemble(mesh, &frame, &nodes, &links, context)?;
        drop(links);
        let components = find_components(&rows, &nodes, context)?;
        let (mut rows, nodes, turned) = orient(rows, nodes, &components, context)?;
        let bridges = bridge::find_bridges(&components, &nodes, context.run)?;
        if !bridges.is_empty() {
            rows = bridge::insert(&rows, &bridges, context)?;
        }
        let facts = GraphFacts {
            nodes: nodes.len() as u64,
            edges: rows.indices.len() as u64 / 2,
            boundary_edges: counts.boundary,
            nonmanifold_edges: counts.nonmanifold,
            welded_edges: counts.welded,
            degenerate_faces: sums.degenerate,
            turned_faces: turned.faces,
            unoriented_edges: turned.unsatisfied / 2,
            components: components.list.len() as u64,
            bridges: bridges.len() as u64,
            area: sums.area,
            frame,
        };
        let components = if facts.components > 1 {
            Some(components.root)
        } else {
            drop(components);
            context.work.remove("components.npy");
            None
        };
        Ok(Self { rows, nodes, components, facts, key })
    }

    /// Opens the arrays of a finished graph stage.
    fn open(work: &WorkDir, facts: GraphFacts, key: String) -> Result<Self> {
        let rows = Rows {
            indptr: work.open_array("graph_indptr.npy")?,
            indices: work.open_array("graph_indices.npy")?,
            centroid_distance: work.open_array("graph_centroid_distances.npy")?,
            edge: work.open_array("graph_edges.npy")?,
        };
        let components = if facts.components > 1 { Some(work.open_array("components.npy")?) } else { None };
        let nodes: MappedSlice<Node> = work.open_array(nodes::FILE)?;
        if nodes.len() as u64 != facts.nodes || rows.indptr.len() != nodes.len() + 1 {
            return Err(Error::work_dir(work.path(), "the graph's arrays contradict each other", "delete it"));
        }
        Ok(Self { rows, nodes, components, facts, key })
    }

    /// Gives up the step lengths, which the weights are made of, in a temporary `work`: 12 B a triangle of disk.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn release_lengths(&mut self, work: &WorkDir) -> Result<()> {
        if work.is_temporary() {
            self.rows.centroid_distance = MappedSlice::empty();
            work.release("graph", &["graph_centroid_distances.npy"])?;
        }
        Ok(())
    }

    /// The graph as a sparse matrix under `metric`: weights computed, or reused.
    ///
    /// # Errors
    /// [`Error::Parameter`], [`Error::Io`], [`Error::Cancelled`].
    pub fn weighted(&self, metric: Metric, context: Context<'_>) -> Result<WeightedGraph> {
        self.weighted_with(metric, None, 0., self.facts.area, context)
    }

    /// The same with turning taken from `normals` (n), which are those at `radius`, instead of the faces' own, and
    /// lengths in units of the root of `area` (in the frame).
    ///
    /// # Errors
    /// As [`DualGraph::weighted`].
    pub fn weighted_with(
        &self,
        metric: Metric,
        normals: Option<&MappedSlice<[f32; 3]>>,
        radius: f32,
        area: f64,
        context: Context<'_>,
    ) -> Result<WeightedGraph> {
        let options = json!({"stage": "weights", "graph": self.key, "metric": metric, "radius": radius, "area": area, "seed": context.run.seed});
        let key = options_key(&options);
        let known = context.work.reuse::<()>("weights", 1, &key);
        let weights = if let Err(reason) = known {
            context.run.note_remake("weights", &reason);
            let (weights, seconds) = context.run.stage("weights", "faces", self.facts.nodes, || {
                let place = (context.work, "graph_weights.npy");
                let normals = normals.map(|normals| &normals[..]);
                weights::build(&self.rows, &self.nodes, normals, area, metric, place, context.run)
            })?;
            context.work.stamp_as("weights", &key, &options, &["graph_weights.npy"], &(), seconds)?;
            weights
        } else {
            context.run.progress.note("weights: reused");
            context.work.open_array("graph_weights.npy")?
        };
        let matrix = csr_of_mapped(context.work.path(), self.rows.indptr.clone(), self.rows.indices.clone(), weights)?;
        Ok(WeightedGraph { matrix, indptr: self.rows.indptr.clone(), key })
    }
}

/// A weighted graph as a sparse matrix over mapped files.
#[derive(Clone, Debug)]
pub struct WeightedGraph {
    /// Row i: the neighbours of node i and the weights of the steps.
    pub matrix: MappedCsr,
    /// The matrix's row starts: its own are behind a view that cannot be borrowed for long.
    indptr: MappedSlice<u64>,
    /// Key of the stage, for stages built on it.
    pub key: String,
}

impl WeightedGraph {
    /// A matrix whose row starts are also given by themselves.
    pub fn new(matrix: MappedCsr, indptr: MappedSlice<u64>, key: String) -> Self {
        Self { matrix, indptr, key }
    }

    /// Opens the weighted graph that another process left in `work`, its weights under `key`.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Malformed`], [`Error::WorkDir`].
    pub fn open(key: String, work: &WorkDir) -> Result<Self> {
        let indptr: MappedSlice<u64> = work.open_array("graph_indptr.npy")?;
        let (indices, weights) = (work.open_array("graph_indices.npy")?, work.open_array("graph_weights.npy")?);
        let matrix = csr_of_mapped(work.path(), indptr.clone(), indices, weights)?;
        Ok(Self { matrix, indptr, key })
    }

    /// Gives up the weights, which the rows are made of, in a temporary `work`: 12 B a triangle of disk.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn release(self, work: &WorkDir) -> Result<()> {
        drop(self);
        work.release("weights", &["graph_weights.npy"])
    }

    /// The matrix as raw slices for hot loops.
    pub fn csr(&self) -> Csr<'_> {
        Csr::new(&self.indptr, self.matrix.indices(), self.matrix.data())
    }
}

/// A graph as raw slices.
#[derive(Clone, Copy, Debug)]
pub struct Csr<'a> {
    /// Row starts (n + 1).
    pub indptr: &'a [u64],
    /// Neighbours (nnz), all below n.
    pub indices: &'a [u32],
    /// Weights (nnz), positive.
    pub weights: &'a [f32],
    /// The same steps in records of three (n), for fronts; empty where they were not made.
    pub triples: &'a [TriangleNeighbours],
}

impl<'a> Csr<'a> {
    /// A graph of these arrays alone.
    pub fn new(indptr: &'a [u64], indices: &'a [u32], weights: &'a [f32]) -> Self {
        Self { indptr, indices, weights, triples: &[] }
    }

    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.indptr.len() - 1
    }

    /// Whether there are no nodes.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Bytes of the three arrays.
    pub fn bytes(&self) -> u64 {
        (size_of_val(self.indptr) + size_of_val(self.indices) + size_of_val(self.weights)) as u64
    }
}
