//! The embedding of all faces as an array, for other programs: `embedding.npy` (faces × d), in file order.
//!
//! `segment` never needs it as a whole: it extrapolates chunk by chunk. Cost: one pass over `[A B]`; 4 d bytes of disk
//! per face.

use super::contracted;
use super::params::{Cluster, SegmentParams, default_landmarks_for_parts};
use super::sample::rows;
use crate::base::Result;
use crate::distance::DistanceRows;
use crate::graph::{DualGraph, NodeOrder, Ordered};
use crate::mesh::Mesh;
use crate::spectral::{Embedding, EmbeddingParams, SampledColumns};
use crate::store::needs::{BudgetEstimate, Extent, Needs};
use crate::store::stage::{BuiltStage, Stage};
use crate::store::{Context, WorkDir};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// The array of all faces.
pub const FILE: &str = "embedding.npy";

/// Parameters and results of an embedding.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct EmbeddingFacts {
    /// Its options.
    pub params: EmbeddingParams,
    /// Coordinates d: as many as requested, or fewer if there are not as many.
    pub dimensions: usize,
    /// The kernel's width in distance units.
    pub sigma: f64,
    /// Eigenvalues, descending.
    pub eigenvalues: Vec<f64>,
    /// Key of the rows it was computed from.
    rows: String,
}

/// The facts of the embedding in `work`, if there is one that is complete and based on the current rows.
pub fn kept(work: &WorkDir) -> Option<EmbeddingFacts> {
    let facts = work.finished_stage::<EmbeddingStage<'_>>("").ok()?.facts;
    DistanceRows::kept_key(work).is_some_and(|rows| rows == facts.rows).then_some(facts)
}

/// Options of the embedding in `work`, whatever its rows.
pub fn kept_params(work: &WorkDir) -> Option<EmbeddingParams> {
    valid_facts(work).map(|facts| facts.params)
}

/// The same if it is based on the rows `rows`.
pub(super) fn params_over(rows: &str, work: &WorkDir) -> Option<EmbeddingParams> {
    valid_facts(work).filter(|facts| facts.rows == rows).map(|facts| facts.params)
}

/// The facts recorded in the manifest, if they are valid.
fn valid_facts(work: &WorkDir) -> Option<EmbeddingFacts> {
    work.recorded_facts::<EmbeddingStage<'_>>().filter(|facts| facts.params.check().is_ok())
}

/// The stage that writes the embedding of all faces.
pub(super) struct EmbeddingStage<'a> {
    graph: &'a DualGraph,
    order: &'a NodeOrder,
    rows: &'a DistanceRows,
    params: EmbeddingParams,
}

impl Stage for EmbeddingStage<'_> {
    const NAME: &'static str = "embedding";
    const VERSION: u32 = 2;
    type Facts = EmbeddingFacts;
    type Output = EmbeddingFacts;

    fn inputs(&self, context: Context<'_>) -> Value {
        json!({"rows": self.rows.key, "params": self.params, "seed": context.run.seed})
    }

    fn progress(&self) -> Option<(&'static str, u64)> {
        Some(("faces", self.rows.nodes as u64))
    }

    fn make(self, _: &str, context: Context<'_>) -> Result<BuiltStage<Self>> {
        let columns = SampledColumns::sample(self.rows, |node| self.graph.nodes.at(node).area, context.run)?;
        let embedding = Embedding::fit(self.rows, &columns, self.params)?;
        write(self.rows, &embedding, self.order, context)?;
        let facts = EmbeddingFacts {
            params: self.params,
            dimensions: embedding.dimensions,
            sigma: embedding.sigma,
            eigenvalues: embedding.eigenvalues,
            rows: self.rows.key.clone(),
        };
        Ok(BuiltStage { output: facts.clone(), facts, files: vec![FILE] })
    }

    fn open(self, facts: EmbeddingFacts, _: &str, _: Context<'_>) -> Result<EmbeddingFacts> {
        Ok(facts)
    }

    fn needs(extent: &Extent, _: &mut BudgetEstimate) -> Needs {
        Needs { keeps: 4 * extent.dimensions * extent.faces, ..Needs::default() }
    }
}

/// Embeds all faces of the mesh in `work` with the existing rows, or with those that `method` requires if there are
/// none.
///
/// # Errors
/// [`crate::base::Error::WorkDir`] if the graph is missing, [`crate::base::Error::Parameter`],
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub fn embed(params: EmbeddingParams, method: &SegmentParams, context: Context<'_>) -> Result<EmbeddingFacts> {
    // Otherwise they would be refused when the existing embedding is gone.
    params.check()?;
    let (graph, input) = DualGraph::kept(context.work)?;
    let order = NodeOrder::kept(&input, graph.nodes.len(), context.work)?;
    let rows = kept_or_new_rows(&graph, params.dimensions, method, context)?;
    context.stage(EmbeddingStage { graph: &graph, order: &order, rows: &rows, params })
}

/// The same for the mesh `opened`. A temporary directory may have deleted its graph, which is then rebuilt.
///
/// # Errors
/// As [`embed`], and those of [`DualGraph::build`].
pub fn embed_again(
    opened: &Mesh,
    params: EmbeddingParams,
    method: &SegmentParams,
    context: Context<'_>,
) -> Result<EmbeddingFacts> {
    if context.work.is_temporary() && DualGraph::kept(context.work).is_err() {
        let ordered = Ordered::build(opened, method.ordering(opened.faces.len()), &Value::Null, context)?;
        DualGraph::build(&ordered.mesh, opened.path(), &ordered.identity, context)?;
        ordered.into_nodes(context.work)?;
    }
    embed(params, method, context)
}

/// The existing rows, or new ones: if the method is K-means over all faces, those that it uses.
fn kept_or_new_rows(
    graph: &DualGraph,
    parts: usize,
    method: &SegmentParams,
    context: Context<'_>,
) -> Result<DistanceRows> {
    let n = graph.nodes.len();
    if let Ok(rows) = DistanceRows::kept(&graph.key, n, context.work) {
        context.run.progress.note_of_work("rows: reused");
        return Ok(rows);
    }
    if method.cluster == Cluster::Parts {
        let weighted = contracted::weighted(graph, method, context)?.1;
        return rows(graph, &weighted, method.landmarks_over(n), method, context);
    }
    let weighted = graph.weighted(method.metric, context)?;
    let over_faces = method.centres().is_some() && !method.contracts(n);
    let l = if over_faces { Some(method.landmarks_of(n)) } else { method.landmarks };
    rows(graph, &weighted, l.unwrap_or(default_landmarks_for_parts(parts)), method, context)
}

/// Extrapolates all faces, chunk by chunk.
fn write(rows: &DistanceRows, embedding: &Embedding, order: &NodeOrder, context: Context<'_>) -> Result<()> {
    let d = embedding.dimensions;
    let mut array = context.work.array::<f32>(FILE, &[rows.nodes, d])?;
    let out = array.data();
    embedding.for_each_chunk(rows, EmbeddingStage::NAME, context.run, |range, coordinates| {
        for (i, node) in range.clone().enumerate() {
            let face = order.face(node as u32) as usize;
            for e in 0..d {
                out[face * d + e] = coordinates[e * range.len() + i];
            }
        }
        Ok(())
    })?;
    array.finish(context.work.durable()).map(drop)
}
