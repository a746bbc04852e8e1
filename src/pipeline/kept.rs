//! A work directory opened by itself, without its mesh: what `cluster`, `embed` and `export` start from.
//!
//! The first stages leave a record of the mesh and of the options, so that a later command needs to be told only what
//! is to change. Another number of parts then costs what it costs to check and map the stages, a cut of the
//! kept hierarchy, and the bands at the parts' boundaries.

use super::{Cluster, SegmentParams, Segmentation, k_means, label, parts};
use crate::base::{Error, Result};
use crate::cluster::parts::{PartTree, PartsParams};
use crate::distance::DistanceRows;
use crate::graph::{DualGraph, NodeOrder};
use crate::mesh::Mesh;
use crate::spectral::EmbeddingParams;
use crate::store::stage::StageKey;
use crate::store::{Context, MappedSlice, WorkDir};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::path::PathBuf;

/// Version of what the record tells.
const VERSION: u32 = 1;

/// Which mesh a work directory is of, and under which options it was made.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Record {
    /// Where the mesh lies.
    pub mesh: PathBuf,
    /// Which input it is ([`super::input::identity`]).
    pub identity: Value,
    /// The options.
    pub params: SegmentParams,
    /// The seed.
    pub seed: u64,
}

impl Record {
    /// The record of a run; the seed is filled in by [`Record::stamp`].
    pub(super) fn of(opened: &Mesh, identity: &Value, params: &SegmentParams, work: &WorkDir) -> Self {
        let path = opened.path();
        // Standard input lies in the work directory, where it was spooled to.
        let path = if identity.get("stdin").is_some() { work.file("input") } else { path.to_path_buf() };
        let mesh = std::path::absolute(&path).unwrap_or(path);
        Self { mesh, identity: identity.clone(), params: params.clone(), seed: 0 }
    }

    /// Leaves the record in `work`.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub(super) fn stamp(mut self, context: Context<'_>) -> Result<()> {
        if context.work.is_temporary() {
            return Ok(());
        }
        self.seed = context.run.seed;
        let inputs = json!({"input": self.identity, "params": self.params, "seed": self.seed});
        context.work.stamp(StageKey::new("record", VERSION, inputs), &[], &self, 0.)
    }

    /// The record in `work`.
    ///
    /// # Errors
    /// [`Error::WorkDir`] where there is none.
    pub fn read(work: &WorkDir) -> Result<Self> {
        let remedy = "start it: nystrom-stream graph MESH --work-dir …";
        let stage = work.manifest().stages.remove("record");
        let stage = stage.ok_or_else(|| Error::work_dir(work.path(), "does not say which mesh it is of", remedy))?;
        serde_json::from_value(stage.facts)
            .map_err(|error| Error::work_dir(work.path(), format!("its record cannot be read: {error}"), remedy))
    }
}

/// Labels of a work directory, as `cluster` left them.
#[derive(Clone, Debug)]
pub struct Labels {
    /// One part per face, in the order of the file (n).
    pub labels: MappedSlice<u32>,
    /// How sure each label is, 0 to 1 (n).
    pub quality: MappedSlice<f32>,
    /// One colour per part.
    pub colours: Vec<[u8; 3]>,
}

/// What the manifest keeps of labels.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct LabelFacts {
    /// Faces of each part.
    pub faces: Vec<u64>,
    /// One colour per part.
    pub colours: Vec<[u8; 3]>,
}

impl Labels {
    /// The labels in `work`.
    ///
    /// # Errors
    /// [`Error::WorkDir`] where there are none.
    pub fn read(work: &WorkDir) -> Result<Self> {
        let remedy = "make them first: nystrom-stream cluster --work-dir …";
        let stage = work.manifest().stages.remove("labels");
        let stage = stage.ok_or_else(|| Error::work_dir(work.path(), "holds no labels", remedy))?;
        let facts = work
            .reuse::<LabelFacts>("labels", 1, &stage.key)
            .map_err(|problem| Error::work_dir(work.path(), format!("labels: {problem}"), remedy))?;
        let (labels, quality) = (work.open_array("labels.npy")?, work.open_array("quality.npy")?);
        Ok(Self { labels, quality, colours: facts.colours })
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

/// The eigenvalues in `work`: of the decision about parts (of a preview, `coarse`, on the contracted mesh), else of the
/// embedding, which only tells the negative ones apart.
///
/// # Errors
/// [`Error::WorkDir`] where there are none.
pub fn eigenvalues(work: &WorkDir, coarse: bool) -> Result<Eigenvalues> {
    let inner = if coarse { Some(WorkDir::open_existing(&work.file("coarse"))?) } else { None };
    let decided = super::decision::kept_numbers(inner.as_ref().unwrap_or(work));
    let kept = decided.map(|numbers| Eigenvalues { values: numbers.eigenvalues, dropped: numbers.dropped_eigenpairs });
    let embedded = || {
        let values = work.told::<super::embed::EmbeddingStage<'_>>()?.eigenvalues;
        Some(Eigenvalues { dropped: values.iter().filter(|value| **value <= 0.).count(), values })
    };
    let remedy = "make them: nystrom-stream embed --work-dir …, or plot the report of `segment --json`";
    kept.or_else(embedded).ok_or_else(|| Error::work_dir(work.path(), "keeps no eigenvalues", remedy))
}

/// The number of parts that the labels in `work` were asked for, where they are a cut of a hierarchy.
pub fn cut(work: &WorkDir) -> Option<PartsParams> {
    let stage = work.manifest().stages.remove("labels")?;
    let params: SegmentParams = serde_json::from_value(stage.inputs.get("params")?.clone()).ok()?;
    (params.cluster == Cluster::Parts).then_some(params.parts)
}

/// Clusters the faces of the mesh in `work` (again) under `params`; what is missing between its graph and the labels is
/// made. By the hierarchy `tree`, where one is given. K-means and two-means take the rows that are there, of whatever
/// metric, and the embedding's options of the stage `embedding` where `params` has none.
///
/// # Errors
/// As [`super::segment`], and [`Error::WorkDir`] where the graph is missing.
pub fn cluster(params: &SegmentParams, tree: Option<&PartTree>, context: Context<'_>) -> Result<Segmentation> {
    let (graph, input) = DualGraph::kept(context.work)?;
    super::check(params, context.work.path(), graph.nodes.len())?;
    let order = NodeOrder::kept(&input, context.work)?;
    let clustered = match super::fit(params, graph.nodes.len()) {
        Some((fit, parts)) => {
            let rows = match DistanceRows::kept(&graph.key, graph.nodes.len(), context.work) {
                Ok(rows) => rows,
                Err(Error::WorkDir { .. }) => {
                    let weighted = graph.weighted(params.metric, context)?;
                    super::rows_for_means(&graph, &weighted, parts, params, context)?
                }
                Err(error) => return Err(error),
            };
            context.run.progress.note(&format!("rows: {} of them", rows.len()));
            let kept = || super::embed::kept_params(&rows.key, context.work);
            let embedding = params.embedding.or_else(kept).unwrap_or(EmbeddingParams::for_parts(parts));
            let embedding = EmbeddingParams { dimensions: super::dimensions(params), ..embedding };
            let assign = || k_means::k_means(&graph, &rows, embedding, fit, context);
            context.run.stage("assign", "faces", rows.nodes as u64, assign)?.0
        }
        None => parts::parts(&graph, params, tree, context)?,
    };
    label(&graph, order, clustered, params, context)
}

/// What `params` would have to be for [`cluster`] to make nothing anew that `record` made: its options but for those
/// of clustering.
pub fn continued(record: &Record, params: &SegmentParams) -> SegmentParams {
    let own = &record.params;
    SegmentParams {
        landmarks: own.landmarks,
        sampling: own.sampling,
        metric: own.metric,
        order: own.order,
        coarse: own.coarse && params.cluster == Cluster::Parts,
        ..params.clone()
    }
}
