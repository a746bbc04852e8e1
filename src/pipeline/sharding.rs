//! Work divided among several processes over one work directory: who prepares it, and how the others find it.
//!
//! The first process locks the directory exclusively, makes all stages up to the divided one, records a stage that
//! refers to them, and unlocks. Shares are then computed under a shared lock, each into its own files. A process that
//! finds the stage recorded needs neither the mesh nor an exclusive lock. A scheduler can run the first step separately
//! with [`prepare_shared`], since it waits more efficiently than a process; shards then never wait.
//!
//! Rows over all faces are divided by landmark. For a large mesh that is contracted, the fronts from many sources are
//! divided by ranges of nodes: those of the normals, then that of the contraction; after its rows, those of the
//! boundaries ([`super::shared_boundaries`]). The stages that need these use the shares ([`SharedFront`],
//! [`shard::merge`]).
//!
//! Cost, beside the stages themselves: each process reads the files of the stages that it builds on once, for their
//! checksums. The record of a divided stage takes some hundred bytes.

use super::decision::{CONTRACTED, manifest_of_contraction};
use super::input::Record;
use super::params::{Cluster, SegmentParams};
use super::shared_boundaries::BoundaryFacts;
use super::surface::{Kind, SurfaceStage, WeightedSurface};
use super::{contracted, input};
use crate::base::{Error, Result};
use crate::cluster::area_shares::AreaShares;
use crate::cluster::contract::{self, Contraction};
use crate::cluster::normals;
use crate::distance::rows::RowParams;
use crate::distance::{DistanceRows, SharedFront, shard};
use crate::graph::dual::{GraphStage, WeightsStage};
use crate::graph::row_starts::StartsForm;
use crate::graph::{DualGraph, Node, WeightedGraph, nodes};
use crate::landmarks::Sampling;
use crate::mesh::Mesh;
use crate::store::stage::{Stage, StageKey};
use crate::store::{Context, MappedSlice, Run, WorkDir};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::path::Path;
use std::time::Duration;

/// Version of the stages' content.
const VERSION: u32 = 2;

/// A step of a run that is divided into shares.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ShareStep {
    /// The rows over all faces, by landmark.
    Rows,
    /// The fronts for averaging the normals of a large mesh, by ranges of faces.
    Normals,
    /// The front that contracts a large mesh, likewise; after the normals.
    Contraction,
    /// The rows over the contraction, by landmark; after the contraction.
    ContractedRows,
    /// The front that measures the depth of faces in their parts, by ranges of faces; after these rows.
    Depths,
    /// The front that labels the narrow bands around boundaries, likewise; last.
    Bands,
}

impl ShareStep {
    /// Whether a share consists of rows; otherwise it is a range of faces.
    pub fn is_by_landmark(self) -> bool {
        matches!(self, Self::Rows | Self::ContractedRows)
    }
}

/// What is recorded for rows.
#[derive(Debug, Serialize, Deserialize)]
struct RowShardFacts {
    /// Key of the weights, or of the contraction that provides them.
    weights: String,
    /// Number of landmarks; 0 if the mesh is too small to be contracted.
    l: usize,
    sampling: Sampling,
}

/// What is recorded for fronts.
#[derive(Debug, Serialize, Deserialize)]
struct FrontFacts {
    /// The fronts and their numbers of sources; empty if the mesh is too small to be contracted.
    fronts: Vec<(String, usize)>,
    /// Key of the graph.
    graph: String,
    /// Number of its nodes.
    nodes: usize,
    /// Key of the weights, for fronts under them.
    weights: Option<String>,
    /// Key of the stage that uses them.
    used_by: String,
}

/// The file of a front's sources.
fn sources_file(front: &str) -> String {
    format!("{front}_sources.npy")
}

/// The divided work on a given mesh with given options.
#[derive(Clone, Copy, Debug)]
pub struct SharedWork<'a> {
    /// Which of its steps.
    pub step: ShareStep,
    /// Identity of the mesh ([`input::identity`]).
    pub identity: &'a Value,
    /// The options.
    pub params: &'a SegmentParams,
}

impl SharedWork<'_> {
    /// What identifies the shares.
    fn key(&self, run: &Run) -> StageKey {
        let Self { step, identity, params } = self;
        let name = match step {
            ShareStep::Rows => "sharding",
            ShareStep::Normals => "shared normals",
            ShareStep::Contraction => "shared contraction",
            ShareStep::ContractedRows => "shared rows",
            ShareStep::Depths => "shared depths",
            ShareStep::Bands => "shared bands",
        };
        // All options: even whether a mesh is contracted depends on the number of parts.
        StageKey::new(name, VERSION, json!({"input": identity, "params": params, "seed": run.seed}))
    }

    /// The record of the stage in `work`, if the weights that it refers to still exist: a run with other options may
    /// have replaced them.
    fn rows(&self, work: &WorkDir, run: &Run) -> Option<RowShardFacts> {
        let key = self.key(run);
        let facts: RowShardFacts = work.reuse(key.name, key.version, &key.key).ok()?;
        let there = match self.step {
            ShareStep::ContractedRows if facts.l == 0 => true,
            ShareStep::ContractedRows => work.inner(CONTRACTED).ok()?.has_stage(Contraction::NAME, &facts.weights),
            // An altered manifest might claim that there are no rows.
            _ => facts.l > 0 && work.has_stage(WeightsStage::NAME, &facts.weights),
        };
        there.then_some(facts)
    }

    /// The same for fronts.
    fn fronts(&self, work: &WorkDir, run: &Run) -> Option<FrontFacts> {
        let key = self.key(run);
        let facts: FrontFacts = work.reuse(key.name, key.version, &key.key).ok()?;
        let there = match &facts.weights {
            Some(weights) => work.has_stage(WeightsStage::NAME, weights),
            None => work.manifest().stages.get(GraphStage::NAME).is_some_and(|graph| graph.key == facts.graph),
        };
        there.then_some(facts)
    }

    /// The same for boundaries.
    fn boundaries(&self, work: &WorkDir, run: &Run) -> Option<BoundaryFacts> {
        let key = self.key(run);
        work.reuse(key.name, key.version, &key.key).ok().filter(|facts: &BoundaryFacts| facts.is_current(work, run))
    }

    /// Whether everything that the shares need exists.
    fn is_prepared(&self, work: &WorkDir, run: &Run) -> bool {
        match self.step {
            ShareStep::Rows | ShareStep::ContractedRows => self.rows(work, run).is_some(),
            ShareStep::Normals | ShareStep::Contraction => self.fronts(work, run).is_some(),
            ShareStep::Depths | ShareStep::Bands => self.boundaries(work, run).is_some(),
        }
    }

    /// Makes everything that the shares need in `work`.
    fn prepare(&self, opened: &Mesh, context: Context<'_>) -> Result<()> {
        match self.step {
            ShareStep::Rows => self.prepare_rows(opened, context).map(drop),
            ShareStep::Normals | ShareStep::Contraction => self.prepare_fronts(opened, context),
            ShareStep::ContractedRows => self.prepare_contracted_rows(opened, context),
            ShareStep::Depths | ShareStep::Bands => {
                let bands = self.step == ShareStep::Bands;
                let (facts, files) = BoundaryFacts::make(bands, opened, self.identity, self.params, context)?;
                context.work.record_stage(self.key(context.run), &files, &facts, 0.)
            }
        }
    }

    fn prepare_rows(&self, opened: &Mesh, context: Context<'_>) -> Result<WeightedGraph> {
        let Self { identity, params, .. } = self;
        let l = landmarks_over_faces(params, opened.faces.len())?;
        let graph = input::graph(opened, identity, params, context)?.1;
        let weighted = if params.cluster.embeds() {
            graph.weighted(params.metric, context)?
        } else {
            contracted::weighted(&graph, params, context)?.1
        };
        let facts = RowShardFacts { weights: weighted.key.clone(), l, sampling: params.sampling.unwrap_or_default() };
        context.work.record_stage(self.key(context.run), &[], &facts, 0.)?;
        Ok(weighted)
    }

    fn prepare_contracted_rows(&self, opened: &Mesh, context: Context<'_>) -> Result<()> {
        let Self { identity, params, .. } = self;
        let graph = input::graph(opened, identity, params, context)?.1;
        let (mut weights, mut l, n) = (String::new(), 0, graph.nodes.len());
        if params.contracts(n) {
            let (surface, weighted) = contracted::weighted(&graph, params, context)?;
            let whole = WeightedSurface { graph: &graph, weighted: &weighted, surface: &surface };
            weights = contracted::contraction(whole, context)?.1.weighted.key;
            l = landmarks(params, n)?;
        }
        let facts = RowShardFacts { weights, l, sampling: params.sampling_of(n) };
        context.work.record_stage(self.key(context.run), &[], &facts, 0.)
    }

    fn prepare_fronts(&self, opened: &Mesh, context: Context<'_>) -> Result<()> {
        let Context { work, run } = context;
        let graph = input::graph(opened, self.identity, self.params, context)?.1;
        let nodes = graph.nodes.len();
        let mut facts =
            FrontFacts { fronts: Vec::new(), graph: graph.key.clone(), nodes, weights: None, used_by: String::new() };
        let mut files = Vec::new();
        let mut add = |front: SharedFront<'_>| {
            files.push(sources_file(front.name));
            work.write(&sources_file(front.name), front.sources, 1)?;
            facts.fronts.push((front.name.to_string(), front.sources.len()));
            Ok(())
        };
        let contracts = self.params.contracts(nodes);
        if contracts && self.step == ShareStep::Normals {
            let stage = SurfaceStage { graph: &graph, kind: Kind::Faces, cells: false };
            let shares = AreaShares::of(&graph, context)?;
            for (radius, file) in stage.likely_normals(&shares, context)? {
                add(normals::cell_front(&graph, &normals::seeds(&shares, radius, file, run)?, file))?;
            }
            facts.used_by = StageKey::of::<SurfaceStage<'_>>(stage.inputs(context)).key;
        } else if contracts {
            let (surface, weighted) = contracted::weighted(&graph, self.params, context)?;
            add(contract::front(&weighted, &contract::seeds(&surface.shares, run)?))?;
            facts.used_by = contract::key(&weighted.key, run.seed);
            facts.weights = Some(weighted.key);
        }
        let files: Vec<&str> = files.iter().map(String::as_str).collect();
        work.record_stage(self.key(run), &files, &facts, 0.)
    }

    /// Computes a share in `work`; returns its number of rows or faces. `None` if what it needs does not exist.
    fn share(&self, shard: (usize, usize), work: &WorkDir, run: &Run) -> Result<Option<usize>> {
        match self.step {
            ShareStep::Rows | ShareStep::ContractedRows => {
                self.rows(work, run).map(|facts| self.share_rows(facts, shard, work, run)).transpose()
            }
            ShareStep::Normals | ShareStep::Contraction => {
                self.fronts(work, run).map(|facts| self.share_fronts(&facts, shard, work, run)).transpose()
            }
            ShareStep::Depths | ShareStep::Bands => match self.boundaries(work, run) {
                None => Ok(None),
                Some(facts) if facts.is_done(work) => Ok(Some(nothing_to_do(run))),
                Some(facts) if self.step == ShareStep::Depths => facts.share_depths(shard, work, run).map(Some),
                Some(facts) => facts.share_bands(shard, work, run),
            },
        }
    }

    fn share_rows(&self, facts: RowShardFacts, shard: (usize, usize), work: &WorkDir, run: &Run) -> Result<usize> {
        let inner;
        let (work, form) = match self.step {
            ShareStep::ContractedRows if facts.l == 0 => return Ok(nothing_to_do(run)),
            ShareStep::ContractedRows => {
                inner = work.inner(CONTRACTED)?;
                (&*inner, StartsForm::Plain)
            }
            _ => (work, StartsForm::Packed),
        };
        let nodes: MappedSlice<Node> = work.open_array(nodes::FILE)?;
        let weighted = WeightedGraph::open(facts.weights, nodes.len(), form, work)?;
        let rows = RowParams { l: facts.l, sampling: facts.sampling };
        shard::compute(&weighted, nodes[..].into(), rows, shard, Context::new(work, run))
    }

    fn share_fronts(&self, facts: &FrontFacts, shard: (usize, usize), work: &WorkDir, run: &Run) -> Result<usize> {
        let used = match self.step {
            ShareStep::Contraction => manifest_of_contraction(work),
            _ => Some(work.manifest()),
        };
        let stages = used.map(|manifest| manifest.stages).unwrap_or_default();
        if facts.fronts.is_empty() || stages.values().any(|stage| stage.key == facts.used_by) {
            return Ok(nothing_to_do(run));
        }
        let mut faces = 0;
        let mut share = |front: SharedFront<'_>| {
            faces = front.share(shard, &|_| None, Context::new(work, run))?;
            Ok(())
        };
        let sources = |(name, count): &(String, usize)| work.indices(&sources_file(name), *count, facts.nodes);
        if let Some(weights) = &facts.weights {
            let weighted = WeightedGraph::open(weights.clone(), facts.nodes, StartsForm::Packed, work)?;
            facts.fronts.iter().try_for_each(|front| share(contract::front(&weighted, &sources(front)?)))?;
        } else {
            let graph = DualGraph::prepared(facts.graph.clone(), facts.nodes, work)?;
            facts.fronts.iter().try_for_each(|front| share(normals::cell_front(&graph, &sources(front)?, &front.0)))?;
        }
        Ok(faces)
    }
}

/// Notes that a share is empty, since the mesh is small or later stages exist. Returns 0, the number of its faces or
/// rows.
fn nothing_to_do(run: &Run) -> usize {
    run.progress.note_of_work("nothing to do: small meshes are not divided, and existing results are reused");
    0
}

/// Number of landmarks of `params` on a mesh of `faces` faces.
///
/// # Errors
/// [`Error::Parameter`] for K-means without a number of parts and of landmarks.
fn landmarks(params: &SegmentParams, faces: usize) -> Result<usize> {
    if params.landmarks.is_none() && params.cluster.embeds() && params.centres().is_none() {
        return Err(Error::parameter("landmarks", "the number of landmarks is missing", "give it, or `parts`"));
    }
    Ok(params.landmarks_of(faces))
}

/// The same for rows over all faces, even if the method would contract the mesh.
fn landmarks_over_faces(params: &SegmentParams, faces: usize) -> Result<usize> {
    landmarks(&params.clone().exact(true), faces)
}

/// Makes everything that shards need, or finds it; `open` reads the mesh if necessary.
///
/// # Errors
/// As [`super::segment()`], and [`Error::WorkDir`] where another process uses the directory.
pub fn prepare_shared(shared: SharedWork<'_>, open: impl FnOnce() -> Result<Mesh>, context: Context<'_>) -> Result<()> {
    if shared.is_prepared(context.work, context.run) {
        context.run.progress.note_of_work("everything before the shares is already done");
        return Ok(());
    }
    shared.prepare(&open()?, context)
}

/// Computes all rows, as `segment` would.
///
/// # Errors
/// As [`super::segment()`].
pub fn compute_all_rows(
    opened: &Mesh,
    identity: &Value,
    params: &SegmentParams,
    context: Context<'_>,
) -> Result<DistanceRows> {
    let weighted = SharedWork { step: ShareStep::Rows, identity, params }.prepare_rows(opened, context)?;
    let l = landmarks_over_faces(params, opened.faces.len())?;
    let rows = RowParams { l, sampling: params.sampling.unwrap_or_default() };
    let nodes: MappedSlice<Node> = context.work.open_array(nodes::FILE)?;
    DistanceRows::build(&weighted, nodes[..].into(), rows, context)
}

/// Computes one share in the work directory `path`, making what it needs if no other process did. `open` reads the
/// mesh, with decoded arrays going to the work directory; it is called only if necessary. Returns the number of rows or
/// faces of the share.
///
/// # Errors
/// As [`super::segment()`], and [`Error::Parameter`] for a shard that does not exist, or connected components.
pub fn compute_shard(
    path: &Path,
    shared: SharedWork<'_>,
    shard: (usize, usize),
    open: impl Fn(&WorkDir) -> Result<Mesh>,
    run: &Run,
) -> Result<usize> {
    if shared.params.cluster == Cluster::Components {
        let problem = "connected components have no steps that several processes could share";
        return Err(Error::parameter("cluster", problem, "find them in one process: stage `labels`"));
    }
    waiting(path, run, || {
        if let Some(work) = WorkDir::try_open(path, true)?
            && let Some(count) = shared.share(shard, &work, run)?
        {
            return Ok(Ok(count));
        }
        let Some(work) = WorkDir::try_open(path, false)? else { return Ok(Err(true)) };
        shared.prepare(&open(&work)?, Context::new(&work, run))?;
        Ok(Err(false))
    })
}

/// The record in the work directory at `path`, which other processes may be preparing; `None` if there is none.
///
/// # Errors
/// [`crate::base::Error::WorkDir`] for a folder that is something else; [`crate::base::Error::Io`],
/// [`crate::base::Error::Cancelled`].
pub fn record(path: &Path, run: &Run) -> Result<Option<Record>> {
    if !path.is_dir() {
        return Ok(None);
    }
    waiting(path, run, || Ok(WorkDir::try_open(path, true)?.map(|work| Record::read(&work).ok()).ok_or(true)))
}

/// Repeats `attempt` until it finds something; waits in between if it reports (`true`) that another process uses the
/// work directory at `path`.
fn waiting<R>(path: &Path, run: &Run, mut attempt: impl FnMut() -> Result<Result<R, bool>>) -> Result<R> {
    let mut noted = false;
    loop {
        run.cancel.check()?;
        match attempt()? {
            Ok(found) => return Ok(found),
            Err(false) => {}
            Err(true) => {
                if !noted {
                    run.progress.note_of_work(&format!("waiting for another process that uses {}", path.display()));
                    noted = true;
                }
                std::thread::sleep(Duration::from_millis(200));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cluster::parts::{PartCount, PartsParams};

    /// Regression: the number of parts, which affects whether a mesh is contracted, was missing in the keys of normals
    /// and contraction. "Nothing to do" for a thousand parts was then taken as the answer for ten.
    #[test]
    fn every_kind_of_share_is_of_one_number_of_parts() {
        use ShareStep::{Bands, ContractedRows, Contraction, Depths, Normals, Rows};
        let (identity, run) = (json!("mesh"), Run::new(&()));
        for step in [Rows, Normals, Contraction, ContractedRows, Depths, Bands] {
            let [few, many] = [10, 1_001].map(|parts| {
                let parts = PartsParams { count: PartCount::Exactly(parts), ..PartsParams::default() };
                let params = SegmentParams::default().cluster(Cluster::KMeans).parts(parts);
                SharedWork { step, identity: &identity, params: &params }.key(&run).key
            });
            assert_ne!(few, many, "{step:?}");
        }
    }
}
