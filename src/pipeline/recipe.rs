//! The recipe of `segment`: from a mesh, or from the kept stages of a work directory, to one label per face.
//!
//! The first stages write a record of the mesh and of the options ([`super::input::Record`]), so that a later command
//! needs only what is to change. Another number of parts then costs checking and mapping the stages, a cut of the kept
//! hierarchy, and the narrow bands at the parts' boundaries.

use super::components;
use super::decision;
use super::edits::Corrections;
use super::input;
use super::labels::{self, SegmentedMesh, label};
use super::means::{self, Means};
use super::on_proxy;
use super::params::{Cluster, SegmentParams, dimensions};
use super::parts::PartRequests;
use super::sample::rows;
use crate::base::{Error, Result};
use crate::cluster::parts::{PartTree, PartsParams};
use crate::distance::DistanceRows;
use crate::graph::{DualGraph, NodeOrder};
use crate::mesh::Mesh;
use crate::mesh::geometry::one_per_face;
use crate::spectral::EmbeddingParams;
use crate::store::manifest::MANIFEST;
use crate::store::{Context, WorkDir};

/// Cuts the mesh `opened` into parts. `identity` identifies the input (see [`input::identity`]).
///
/// # Errors
/// [`Error::Parameter`] for K-means without a number of parts or with options out of range, [`Error::Unusable`] for
/// more parts than faces, [`Error::Io`], [`Error::Memory`], [`Error::Cancelled`].
pub fn segment(
    opened: &Mesh,
    identity: &serde_json::Value,
    params: &SegmentParams,
    context: Context<'_>,
) -> Result<SegmentedMesh> {
    segment_corrected(opened, identity, params, Corrections::default(), context)
}

/// [`segment`] with corrections of the parts.
///
/// # Errors
/// As [`segment`], and [`Error::Malformed`] naming the edit that cannot be applied.
pub fn segment_corrected(
    opened: &Mesh,
    identity: &serde_json::Value,
    params: &SegmentParams,
    corrections: Corrections<'_>,
    context: Context<'_>,
) -> Result<SegmentedMesh> {
    params.check_for(opened.path(), opened.faces.len() as u64)?;
    params.check_memory(opened.faces.len() as u64, context.run)?;
    check_corrections(params, corrections, opened.faces.len())?;
    let (ordered, mut graph) = input::graph(opened, identity, params, context)?;
    let order = ordered.into_nodes(context.work)?;
    let clustered = match means::fit(params, opened.faces.len()) {
        _ if params.cluster == Cluster::Components => components::components(&graph, params, context)?,
        Some(fit) if params.contracts(graph.nodes.len()) => means::contracted(&graph, fit, params, context)?,
        Some(fit) => {
            let weighted = graph.weighted(params.metric, context)?;
            graph.release_lengths(context.work)?;
            let rows = rows(&graph, &weighted, params.landmarks_of(graph.nodes.len()), params, context)?;
            weighted.release(context.work)?;
            let embedding = params.embedding_or_default();
            let clustered = means::over_faces(&graph, &rows, Means { embedding, fit }, context)?;
            rows.release(context.work)?;
            clustered
        }
        None => on_proxy::parts(&graph, &order, params, PartRequests { tree: None, corrections }, context)?,
    };
    label(&graph, order, clustered, params, context)
}

/// Rejects corrections that do not suit the method or the number of `faces`.
fn check_corrections(params: &SegmentParams, corrections: Corrections<'_>, faces: usize) -> Result<()> {
    if params.cluster != Cluster::Parts && !corrections.is_empty() {
        let given = if corrections.painted.is_some() { "hints" } else { "edits" };
        return Err(Error::parameter(given, format!("{given} need the hierarchy of parts"), "use `cluster` parts"));
    }
    one_per_face("hints", corrections.painted.map_or(faces, <[u32]>::len), faces)
}

/// Eigenvalues kept by a work directory.
#[derive(Clone, Debug, PartialEq)]
pub struct Eigenvalues {
    /// All of them, descending.
    pub values: Vec<f64>,
    /// How many, from the end, are dropped as negative or too small.
    pub dropped: usize,
}

/// The eigenvalues in `work`: of the decision on parts (on the contracted mesh, unless it is small or rows were
/// `exact`), else of the embedding, for which only negative ones count as dropped.
///
/// # Errors
/// [`Error::WorkDir`] if there are none.
pub fn eigenvalues(work: &WorkDir, exact: bool) -> Result<Eigenvalues> {
    let decided = decision::kept_numbers(work, exact)?;
    let kept = decided.map(|numbers| Eigenvalues { values: numbers.eigenvalues, dropped: numbers.dropped_eigenpairs });
    let embedded = || {
        let values = work.recorded_facts::<super::embed::EmbeddingStage<'_>>()?.eigenvalues;
        Some(Eigenvalues { dropped: values.iter().filter(|value| **value <= 0.).count(), values })
    };
    let remedy = "compute them: stage `embedding`";
    let found = kept.or_else(embedded).ok_or_else(|| Error::work_dir(work.path(), "has no eigenvalues", remedy))?;
    if found.values.first().is_none_or(|first| *first > 0.) {
        return Ok(found);
    }
    Err(work.damaged(MANIFEST, "has no positive eigenvalue"))
}

/// The number of parts requested for the labels in `work`, if they are a cut of a hierarchy.
pub fn requested_parts(work: &WorkDir) -> Option<PartsParams> {
    labels::method(work).filter(|params| params.cluster == Cluster::Parts).map(|params| params.parts)
}

/// Clusters the faces of the mesh in `work` (again) under `params`; missing stages between its graph and the labels are
/// computed. Uses the hierarchy `tree`, if given, and applies corrections. If the mesh is not contracted, K-means and
/// 2-means use the existing rows over all faces, whatever their metric, and the embedding options of the stage
/// `embedding` if `params` has none.
///
/// # Errors
/// As [`segment`], and [`Error::WorkDir`] if the graph is missing.
pub fn cluster(
    params: &SegmentParams,
    tree: Option<&PartTree>,
    corrections: Corrections<'_>,
    context: Context<'_>,
) -> Result<SegmentedMesh> {
    let (graph, input) = DualGraph::kept(context.work)?;
    let mesh = input::recorded_mesh(context.work);
    params.check_for(mesh.as_deref().unwrap_or(context.work.path()), graph.nodes.len() as u64)?;
    params.check_memory(graph.nodes.len() as u64, context.run)?;
    check_corrections(params, corrections, graph.nodes.len())?;
    let order = NodeOrder::kept(&input, graph.nodes.len(), context.work)?;
    let clustered = match means::fit(params, graph.nodes.len()) {
        _ if params.cluster == Cluster::Components => components::components(&graph, params, context)?,
        Some(fit) => match rows_over_faces(&graph, params, context)? {
            None => means::contracted(&graph, fit, params, context)?,
            Some(rows) => {
                context.run.progress.note_of_work(&format!("rows: {} of them", rows.len()));
                let kept = || super::embed::params_over(&rows.key, context.work);
                let embedding = params.embedding.or_else(kept).unwrap_or_else(|| params.embedding_or_default());
                let embedding = EmbeddingParams { dimensions: dimensions(params), ..embedding };
                means::over_faces(&graph, &rows, Means { embedding, fit }, context)?
            }
        },
        None => on_proxy::parts(&graph, &order, params, PartRequests { tree, corrections }, context)?,
    };
    label(&graph, order, clustered, params, context)
}

/// The existing rows over all faces, whatever their metric, or new ones; `None` if `params` contract the mesh, even if
/// another command left rows over all faces.
fn rows_over_faces(graph: &DualGraph, params: &SegmentParams, context: Context<'_>) -> Result<Option<DistanceRows>> {
    let n = graph.nodes.len();
    if params.contracts(n) {
        return Ok(None);
    }
    match DistanceRows::kept(&graph.key, n, context.work) {
        Ok(rows) => Ok(Some(rows)),
        Err(Error::WorkDir { .. }) => {
            let weighted = graph.weighted(params.metric, context)?;
            rows(graph, &weighted, params.landmarks_of(n), params, context).map(Some)
        }
        Err(error) => Err(error),
    }
}

/// `params` with the options of `record`, except for those of clustering: with these, [`cluster`] rebuilds nothing that
/// `record` made.
pub fn continued(record: &input::Record, params: &SegmentParams) -> SegmentParams {
    let own = &record.params;
    SegmentParams {
        landmarks: own.landmarks,
        sampling: own.sampling,
        metric: own.metric,
        order: own.order,
        exact: own.exact,
        ..params.clone()
    }
}
