//! The dual graph as a stage: built once into the work directory, opened as mapped arrays after.

use super::components::{self, find_bridges, find_components};
use super::csr::WeightedGraph;
use super::dual_edges::{DualEdges, assemble};
use super::half_edges;
use super::nodes::{self, Frame, Node};
use super::orient::orient;
use super::weights::{Metric, Weighting};
use crate::base::{Error, Result};
use crate::mesh::Mesh;
use crate::store::mapped::csr_of_mapped;
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
    /// Its edges, without weights.
    pub edges: DualEdges,
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
        let (pairs, counts) = half_edges::matched(mesh, path, context)?;
        let edges = assemble(mesh, &frame, &nodes, &pairs, context)?;
        drop(pairs);
        let components = find_components(&edges, &nodes, context)?;
        let (mut edges, nodes, orientation) = orient(edges, nodes, &components, context)?;
        let bridges = find_bridges(&components, &nodes, context.run)?;
        if !bridges.is_empty() {
            edges = components::insert(&edges, &bridges, context)?;
        }
        let facts = GraphFacts {
            nodes: nodes.len() as u64,
            edges: edges.indices.len() as u64 / 2,
            boundary_edges: counts.boundary,
            nonmanifold_edges: counts.nonmanifold,
            welded_edges: counts.welded,
            degenerate_faces: sums.degenerate,
            turned_faces: orientation.turned,
            unoriented_edges: orientation.unsatisfied / 2,
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
        Ok(Self { edges, nodes, components, facts, key })
    }

    /// Opens the arrays of a finished graph stage.
    fn open(work: &WorkDir, facts: GraphFacts, key: String) -> Result<Self> {
        let edges = DualEdges {
            indptr: work.open_array("graph_indptr.npy")?,
            indices: work.open_array("graph_indices.npy")?,
            centroid_distance: work.open_array("graph_centroid_distances.npy")?,
            edge: work.open_array("graph_edges.npy")?,
        };
        let components = if facts.components > 1 { Some(work.open_array("components.npy")?) } else { None };
        let nodes: MappedSlice<Node> = work.open_array(nodes::FILE)?;
        if nodes.len() as u64 != facts.nodes || edges.indptr.len() != nodes.len() + 1 {
            return Err(Error::work_dir(work.path(), "the graph's arrays contradict each other", "delete it"));
        }
        Ok(Self { edges, nodes, components, facts, key })
    }

    /// Gives up the step lengths, which the weights are made of, in a temporary `work`: 12 B a triangle of disk.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn release_lengths(&mut self, work: &WorkDir) -> Result<()> {
        if work.is_temporary() {
            self.edges.centroid_distance = MappedSlice::empty();
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
                let normals = normals.map(|normals| &normals[..]);
                Weighting { edges: &self.edges, nodes: &self.nodes, normals, area, metric }
                    .build("graph_weights.npy", context)
            })?;
            context.work.stamp_as("weights", &key, &options, &["graph_weights.npy"], &(), seconds)?;
            weights
        } else {
            context.run.progress.note("weights: reused");
            context.work.open_array("graph_weights.npy")?
        };
        let matrix =
            csr_of_mapped(context.work.path(), self.edges.indptr.clone(), self.edges.indices.clone(), weights)?;
        Ok(WeightedGraph::new(matrix, self.edges.indptr.clone(), key))
    }
}
