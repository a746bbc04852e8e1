//! Rows by several processes over one work directory: who makes the graph, and how the others find it.
//!
//! The first process takes the directory for itself and makes all stages up to the weights; it stamps a stage
//! `sharding` that names them, and lets go. Rows are then computed under a shared lock, each shard into files of
//! its own. A process that finds the stage stamped needs neither mesh nor lock of its own. A scheduler, which waits
//! better than a process does, has the first step done by [`first`] alone; shards then never wait.

use super::means::fit;
use super::params::{Cluster, SegmentParams, default_landmarks, landmarks_for_parts};
use super::{input, parts};
use crate::base::{Error, Result};
use crate::distance::rows::RowParams;
use crate::distance::{DistanceRows, shard};
use crate::graph::WeightedGraph;
use crate::graph::row_starts::StartsForm;
use crate::graph::{Node, nodes};
use crate::landmarks::Sampling;
use crate::mesh::Mesh;
use crate::store::stage::StageKey;
use crate::store::{Context, MappedSlice, Run, WorkDir};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::path::Path;
use std::time::Duration;

/// Version of what the stage tells.
const VERSION: u32 = 1;

/// What the stage keeps.
#[derive(Debug, Serialize, Deserialize)]
struct Facts {
    /// Key of the weights.
    weights: String,
    /// Number of landmarks.
    l: usize,
    sampling: Sampling,
}

/// What identifies the rows that are shared out.
fn shared_rows(identity: &Value, params: &SegmentParams, run: &Run) -> StageKey {
    let rows = json!({
        "landmarks": params.landmarks, "sampling": params.sampling, "metric": params.metric, "order": params.order,
        "cluster": params.cluster, "count": params.parts.count,
    });
    StageKey::new("sharding", VERSION, json!({"input": identity, "rows": rows, "seed": run.seed}))
}

/// What the stage `shared` in `work` says, where the weights that it names are still there: a run with other options may
/// have made others since.
fn made(shared: &StageKey, work: &WorkDir) -> Option<Facts> {
    let facts: Facts = work.reuse(shared.name, shared.version, &shared.key).ok()?;
    let weights = work.manifest().stages.remove("weights")?;
    work.reuse::<Value>("weights", weights.version, &facts.weights).ok()?;
    Some(facts)
}

/// Landmarks that `params` asks for on a mesh of `faces` faces.
///
/// # Errors
/// [`Error::Parameter`] for K-means without a number of parts and of landmarks.
fn landmarks(params: &SegmentParams, faces: usize) -> Result<usize> {
    match (params.landmarks, fit(params, faces)) {
        (Some(l), _) => Ok(l),
        (None, Some((_, parts))) => Ok(default_landmarks(parts)),
        (None, None) if params.cluster == Cluster::Parts => Ok(landmarks_for_parts(faces)),
        (None, None) => Err(Error::parameter("-l", "the number of landmarks is missing", "give it, or -k")),
    }
}

/// Makes everything up to the weights in `work`.
fn prepare(opened: &Mesh, identity: &Value, params: &SegmentParams, context: Context<'_>) -> Result<WeightedGraph> {
    let l = landmarks(params, opened.faces.len())?;
    let graph = input::graph(opened, identity, params, context)?.1;
    let weighted = match params.cluster {
        Cluster::KMeans | Cluster::TwoMeans => graph.weighted(params.metric, context)?,
        Cluster::Parts => parts::weighted(&graph, params, context)?.1,
    };
    let facts = Facts { weights: weighted.key.clone(), l, sampling: params.sampling };
    context.work.stamp(shared_rows(identity, params, context.run), &[], &facts, 0.)?;
    Ok(weighted)
}

/// Makes everything that shards share, or finds it made; `open` reads the mesh where that is needed.
///
/// # Errors
/// As [`super::segment()`], and [`Error::WorkDir`] where another process uses the directory.
pub fn first(
    identity: &Value,
    params: &SegmentParams,
    open: impl FnOnce() -> Result<Mesh>,
    context: Context<'_>,
) -> Result<()> {
    if made(&shared_rows(identity, params, context.run), context.work).is_some() {
        context.run.progress.note("rows: everything before them is there already");
        return Ok(());
    }
    prepare(&open()?, identity, params, context).map(drop)
}

/// Computes all rows, as `segment` would.
///
/// # Errors
/// As [`super::segment()`].
pub fn all(opened: &Mesh, identity: &Value, params: &SegmentParams, context: Context<'_>) -> Result<DistanceRows> {
    let weighted = prepare(opened, identity, params, context)?;
    let rows = RowParams { l: landmarks(params, opened.faces.len())?, sampling: params.sampling };
    let nodes: MappedSlice<Node> = context.work.open_array(nodes::FILE)?;
    DistanceRows::build(&weighted, &nodes, rows, context)
}

/// Computes one shard of the rows in the work directory `path`, making what comes before where no other process did.
/// `open` reads the mesh, with decoded arrays going to the work directory; it is called only where needed. How many rows
/// the shard has is returned.
///
/// # Errors
/// As [`super::segment()`], and [`Error::Parameter`] for a shard that does not exist.
pub fn one(
    path: &Path,
    identity: &Value,
    params: &SegmentParams,
    shard: (usize, usize),
    open: impl Fn(&WorkDir) -> Result<Mesh>,
    run: &Run,
) -> Result<usize> {
    let shared = shared_rows(identity, params, run);
    let mut told = false;
    loop {
        run.cancel.check()?;
        if let Some(work) = WorkDir::try_open(path, true)?
            && let Some(facts) = made(&shared, &work)
        {
            let nodes: MappedSlice<Node> = work.open_array(nodes::FILE)?;
            let weighted = WeightedGraph::open(facts.weights, nodes.len(), StartsForm::Packed, &work)?;
            let rows = RowParams { l: facts.l, sampling: facts.sampling };
            return shard::compute(&weighted, &nodes, rows, shard, Context::new(&work, run));
        }
        if let Some(work) = WorkDir::try_open(path, false)? {
            prepare(&open(&work)?, identity, params, Context::new(&work, run))?;
            continue;
        }
        if !told {
            run.progress.note(&format!("waiting for another process that uses {}", path.display()));
            told = true;
        }
        std::thread::sleep(Duration::from_millis(200));
    }
}
