//! The recipe of `segment`: from a mesh to one label per face, or from the stages that a work directory keeps.
//!
//! The first stages leave a record of the mesh and of the options ([`super::input::Record`]), so that a later command
//! needs to be told only what is to change. Another number of parts then costs what it costs to check and map the
//! stages, a cut of the kept hierarchy, and the narrow bands at the parts' boundaries.

use super::decision;
use super::edits::Corrections;
use super::input;
use super::labels::{self, SegmentedMesh, label};
use super::means::{self, Means};
use super::params::{Cluster, SegmentParams, dimensions};
use super::parts::{self, PartRequests};
use super::sample::rows;
use crate::base::{Error, Result};
use crate::cluster::parts::{PartTree, PartsParams};
use crate::distance::DistanceRows;
use crate::graph::{DualGraph, NodeOrder};
use crate::mesh::Mesh;
use crate::spectral::EmbeddingParams;
use crate::store::manifest::MANIFEST;
use crate::store::{Context, WorkDir};

/// Cuts the mesh of `opened` into parts. `identity` says which input it is (see [`input::identity`]).
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

/// [`segment`], and corrects the parts.
///
/// # Errors
/// As [`segment`], and [`Error::Malformed`] naming the edit that cannot be followed.
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
        Some(fit) if params.contracts(graph.nodes.len()) => means::contracted(&graph, fit, params, context)?,
        Some(fit) => {
            let weighted = graph.weighted(params.metric, context)?;
            graph.release_lengths(context.work)?;
            let rows = rows(&graph, &weighted, params.landmarks_of(graph.nodes.len()), params, context)?;
            weighted.release(context.work)?;
            let embedding = params.embedding.unwrap_or(EmbeddingParams::for_parts(dimensions(params)));
            let clustered = means::over_faces(&graph, &rows, Means { embedding, fit }, context)?;
            rows.release(context.work)?;
            clustered
        }
        None => parts::parts(&graph, &order, params, PartRequests { tree: None, corrections }, context)?,
    };
    label(&graph, order, clustered, params, context)
}

/// Refuses corrections that do not fit the method or the `faces` faces.
fn check_corrections(params: &SegmentParams, corrections: Corrections<'_>, faces: usize) -> Result<()> {
    if params.cluster != Cluster::Parts && !corrections.is_empty() {
        let given = if corrections.painted.is_some() { "hints" } else { "edits" };
        return Err(Error::parameter(given, format!("{given} need the hierarchy of parts"), "use `cluster` parts"));
    }
    match corrections.painted {
        Some(painted) if painted.len() != faces => {
            let problem = format!("{} values for {faces} faces", painted.len());
            Err(Error::parameter("hints", problem, "give one for every face of the mesh"))
        }
        _ => Ok(()),
    }
}

/// Eigenvalues that a work directory keeps.
#[derive(Clone, Debug, PartialEq)]
pub struct Eigenvalues {
    /// All of them, descending.
    pub values: Vec<f64>,
    /// How many, from the end, are dropped as negative or too small.
    pub dropped: usize,
}

/// The eigenvalues in `work`: of the decision about parts (on the contracted mesh, unless it is small or rows were
/// `exact`), else of the embedding, which only tells the negative ones apart.
///
/// # Errors
/// [`Error::WorkDir`] where there are none.
pub fn eigenvalues(work: &WorkDir, exact: bool) -> Result<Eigenvalues> {
    let decided = decision::kept_numbers(work, exact)?;
    let kept = decided.map(|numbers| Eigenvalues { values: numbers.eigenvalues, dropped: numbers.dropped_eigenpairs });
    let embedded = || {
        let values = work.told::<super::embed::EmbeddingStage<'_>>()?.eigenvalues;
        Some(Eigenvalues { dropped: values.iter().filter(|value| **value <= 0.).count(), values })
    };
    let remedy = "make them: stage `embedding`";
    let found = kept.or_else(embedded).ok_or_else(|| Error::work_dir(work.path(), "keeps no eigenvalues", remedy))?;
    if found.values.first().is_none_or(|first| *first > 0.) {
        return Ok(found);
    }
    Err(work.damaged(MANIFEST, "tells of eigenvalues of which none is positive"))
}

/// The number of parts that the labels in `work` were asked for, where they are a cut of a hierarchy.
pub fn requested_parts(work: &WorkDir) -> Option<PartsParams> {
    labels::method(work).filter(|params| params.cluster == Cluster::Parts).map(|params| params.parts)
}

/// Clusters the faces of the mesh in `work` (again) under `params`; what is missing between its graph and the labels is
/// made. By the hierarchy `tree`, where one is given, and corrected. Where the mesh is not contracted, K-means and
/// two-means take the rows over all faces that are there, of whatever metric, and the embedding's options of the stage
/// `embedding` where `params` has none.
///
/// # Errors
/// As [`segment`], and [`Error::WorkDir`] where the graph is missing.
pub fn cluster(
    params: &SegmentParams,
    tree: Option<&PartTree>,
    corrections: Corrections<'_>,
    context: Context<'_>,
) -> Result<SegmentedMesh> {
    let (graph, input) = DualGraph::kept(context.work)?;
    params.check_for(context.work.path(), graph.nodes.len() as u64)?;
    check_corrections(params, corrections, graph.nodes.len())?;
    let order = NodeOrder::kept(&input, graph.nodes.len(), context.work)?;
    let clustered = match means::fit(params, graph.nodes.len()) {
        Some(fit) => match rows_over_faces(&graph, params, context)? {
            None => means::contracted(&graph, fit, params, context)?,
            Some(rows) => {
                context.run.progress.note_of_work(&format!("rows: {} of them", rows.len()));
                let kept = || super::embed::params_over(&rows.key, context.work);
                let embedding =
                    params.embedding.or_else(kept).unwrap_or(EmbeddingParams::for_parts(dimensions(params)));
                let embedding = EmbeddingParams { dimensions: dimensions(params), ..embedding };
                means::over_faces(&graph, &rows, Means { embedding, fit }, context)?
            }
        },
        None => parts::parts(&graph, &order, params, PartRequests { tree, corrections }, context)?,
    };
    label(&graph, order, clustered, params, context)
}

/// The rows over all faces that are there, of whatever metric, or new ones; `None` where `params` have the mesh
/// contracted, also if another command left rows over all faces.
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

/// What `params` would have to be for [`cluster`] to make nothing anew that `record` made: its options but for those
/// of clustering.
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
