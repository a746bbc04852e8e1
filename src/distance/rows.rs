//! The rows of `[A B]`: one front per landmark, written to a mapped file, or passed to a visitor that needs each only
//! once ([`DistanceRows::stream_rows`]).
//!
//! [`super::row_job`] computes them, [`super::shard`] with several processes.
//!
//! *Distances* are stored, not affinities: σ, kernel and K can change without a new front. A row is a slice of the
//! mapped array, so the kernel may write it back and reclaim it at any time: only the fronts' queues are allocated.
//! Cost: a row takes 14–20 ns per face and thread on scans, 4 bytes per face on disk.

use super::journal::{JobSpec, JournalEntry, RowFacts};
use super::row_job::RowJob;
use super::row_sink::RowVisitor;
use super::sampler::Sampler;
use crate::base::{Error, Result};
use crate::graph::NodeView;
use crate::graph::WeightedGraph;
use crate::graph::csr::WEIGHTS;
use crate::graph::dual::{GraphStage, WeightsStage};
use crate::store::needs::{BudgetEstimate, Extent, Needs};
use crate::store::rows_file::{RowsFile, are_held};
use crate::store::stage::{BuiltStage, Stage, StageKey};
use crate::store::{Context, MappedSlice, Run, WorkDir};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// The sampled rows of the distance matrix, l × n, and their landmarks.
#[derive(Clone, Debug)]
pub struct DistanceRows {
    /// Landmark nodes (l).
    pub landmarks: Vec<u32>,
    /// Distances, row k at `k * n` (l × n).
    pub distances: MappedSlice<f32>,
    /// Sums of each row (l).
    pub facts: Vec<RowFacts>,
    /// Number of nodes n.
    pub nodes: usize,
    /// Key of the stage.
    pub key: String,
}

/// Landmarks, and the sums of their rows.
#[derive(Clone, Debug, Default)]
pub struct Landmarks {
    /// The landmark nodes (l).
    pub nodes: Vec<u32>,
    /// Sums of each row (l).
    pub facts: Vec<RowFacts>,
}

impl Landmarks {
    /// Mean of all finite distances: the paper's σ.
    pub fn mean(&self) -> f64 {
        mean(&self.facts)
    }
}

fn mean(facts: &[RowFacts]) -> f64 {
    let (sum, count) = facts.iter().fold((0., 0), |(s, c), row| (s + row.sum, c + row.reached));
    sum / (count.max(1)) as f64
}

/// What the manifest records of the stage.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Facts {
    rows: Vec<RowFacts>,
}

/// How many landmarks to sample, and how.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct RowParams<S> {
    /// Number of landmarks wanted; capped at the number of nodes.
    pub l: usize,
    /// How they are chosen; its serialised form is part of the key.
    pub sampling: S,
}

impl<S> RowParams<S> {
    /// `l` landmarks, chosen by `sampling`.
    pub fn new(l: usize, sampling: S) -> Self {
        Self { l, sampling }
    }
}

/// The journal of rows in progress.
const JOURNAL: &str = "rows.journal";
/// The file of the rows.
pub(crate) const ROWS: &str = "distances.npy";
/// The file of the landmarks.
pub(super) const LANDMARKS: &str = "landmarks.npy";
const FILES: [&str; 2] = [LANDMARKS, ROWS];

/// The description of the rows of `params` over `nodes` nodes with weights of the key `weights`: a single shard.
pub(super) fn job_spec(weights: &str, nodes: usize, params: &RowParams<impl Serialize>, run: &Run) -> JobSpec {
    let options = json!({"weights": weights, "params": params, "seed": run.seed});
    let StageKey { key, inputs: options, .. } = StageKey::of::<RowsStage<'_>>(options);
    JobSpec { key, options, rows: params.l.min(nodes), nodes, shard: 0, of: 1 }
}

/// The stage of rows that are kept.
pub(crate) struct RowsStage<'a>(RowJob<'a>);

impl Stage for RowsStage<'_> {
    const NAME: &'static str = "rows";
    const VERSION: u32 = 1;
    type Facts = Facts;
    type Output = DistanceRows;

    fn inputs(&self, _: Context<'_>) -> Value {
        self.0.spec.options.clone()
    }

    fn make(self, _: &str, context: Context<'_>) -> Result<BuiltStage<Self>> {
        let (file, entries) = self.0.compute(ROWS, JOURNAL, context)?;
        let entries: Vec<JournalEntry> = entries.into_values().collect();
        let output = DistanceRows::finish(file, &entries, self.0.spec, context.work)?;
        Ok(BuiltStage { facts: Facts { rows: output.facts.clone() }, output, files: FILES.to_vec() })
    }

    fn open(self, facts: Facts, key: &str, context: Context<'_>) -> Result<DistanceRows> {
        DistanceRows::open(facts.rows, self.0.spec.nodes, key.to_string(), context.work)
    }

    fn progress(&self) -> Option<(&'static str, u64)> {
        Some(("rows", self.0.spec.rows as u64))
    }

    /// The field of the search, the triangle adjacency for fronts, and a row per thread. If rows are not kept, a thread
    /// without memory for one uses a file. If rows are kept in a temporary directory, a field without memory uses the
    /// place of the last row.
    fn needs(extent: &Extent, estimate: &mut BudgetEstimate) -> Needs {
        let (n, l, t) = (extent.faces, extent.landmarks, extent.threads);
        // Kept rows are reserved first, and computed in place if they are in memory.
        let rows = if extent.keeps_rows && are_held(4 * l * n, estimate.total()) {
            estimate.reserve_named(ROWS, 4 * l * n)
        } else {
            0
        };
        let field = estimate.reserve_array(4 * n);
        let triangles = estimate.reserve(24 * n);
        let own: u64 = if rows > 0 { estimate.reserve(4 * n) } else { (0..t).map(|_| estimate.reserve(4 * n)).sum() };
        // Fronts over a graph larger than memory cache blocks of it: at most three quarters of what is left.
        let blocks = if extent.paged { (estimate.left() / 4 * 3).min(t * (28 * n + 4096)) } else { 0 };
        let memory = estimate.used() + blocks;
        estimate.release(field + triangles + own);
        let (keeps, scratch) = if extent.keeps_rows { (4 * l * n - rows, 0) } else { (0, 4 * n * t - own) };
        let field = if extent.keeps_rows && rows == 0 && !extent.lasting && l > 1 { 4 * n } else { field };
        // Weights are deleted once rows are computed from them.
        let frees = if extent.releases { 4 * extent.corners - estimate.release_named(WEIGHTS) } else { 0 };
        Needs { memory, keeps, temporary: 4 * n - field + scratch, frees, ..Needs::default() }
            .moving(35 * l * n, 11 * l * n)
    }
}

impl DistanceRows {
    /// Row `k` (n).
    pub fn row(&self, k: usize) -> &[f32] {
        &self.distances[k * self.nodes..(k + 1) * self.nodes]
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.landmarks.len()
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.landmarks.is_empty()
    }

    /// Mean of all finite distances: the paper's σ.
    pub fn mean(&self) -> f64 {
        mean(&self.facts)
    }

    /// The key of rows of `params` over a graph of `nodes` nodes.
    pub fn key(graph: &WeightedGraph, nodes: usize, params: RowParams<impl Serialize>, run: &Run) -> String {
        job_spec(&graph.key, nodes, &params, run).key
    }

    /// Opens the finished rows of `work`, whatever their options, if they are over the graph stage `graph` of `nodes`
    /// nodes.
    ///
    /// # Errors
    /// [`Error::WorkDir`] if there are none, or if they are those of another graph.
    pub fn kept(graph: &str, nodes: usize, work: &WorkDir) -> Result<Self> {
        let remedy = "compute them first: stage `rows`";
        let none = || Error::work_dir(work.path(), "holds no rows", remedy);
        let kept = work.finished_stage::<RowsStage<'_>>(remedy)?;
        let manifest = work.manifest();
        let weights = manifest.stages.get(WeightsStage::NAME).ok_or_else(none)?;
        if kept.inputs["weights"] != weights.key || weights.inputs["graph"] != graph {
            return Err(none());
        }
        Self::open(kept.facts.rows, nodes, kept.key, work)
    }

    /// Opens finished rows over `nodes` nodes, given the stage's `facts` and `key`.
    pub(super) fn open(facts: Vec<RowFacts>, nodes: usize, key: String, work: &WorkDir) -> Result<Self> {
        let landmarks = work.indices(LANDMARKS, facts.len(), nodes)?.to_vec();
        let distances = work.array_of(ROWS, landmarks.len() * nodes)?;
        if !facts.iter().all(|row| row.is_sound(nodes)) {
            return Err(work.damaged("manifest.json", "has sums that no rows can have"));
        }
        Ok(Self { landmarks, distances, facts, nodes, key })
    }

    /// The key of the rows over the graph in `work`, complete or not; `None` if they belong to another graph, or to
    /// other weights.
    pub fn kept_key(work: &WorkDir) -> Option<String> {
        let stages = work.manifest().stages;
        let [graph, weights, rows] =
            [GraphStage::NAME, WeightsStage::NAME, RowsStage::<'_>::NAME].map(|name| stages.get(name));
        let (graph, weights) = (graph?, weights?);
        let of_these = weights.inputs["graph"] == graph.key.as_str();
        rows.filter(|rows| of_these && rows.inputs["weights"] == weights.key.as_str()).map(|rows| rows.key.clone())
    }

    fn spec(graph: &WeightedGraph, nodes: usize, params: &RowParams<impl Serialize>, run: &Run) -> Result<JobSpec> {
        if params.l == 0 {
            return Err(Error::parameter("landmarks", "0 landmarks", "choose at least 1"));
        }
        Ok(job_spec(&graph.key, nodes, params, run))
    }

    /// Whether all rows, of which `spec` describes a share, are finished in `work`.
    pub(super) fn is_done(spec: &JobSpec, work: &WorkDir) -> bool {
        let (name, version) = (RowsStage::<'_>::NAME, RowsStage::<'_>::VERSION);
        work.reuse::<Facts>(name, version, &spec.key).is_ok()
    }

    /// The finished rows of `work`, if there are any, whatever their options.
    pub(super) fn finished(work: &WorkDir) -> Option<Self> {
        let kept = work.finished_stage::<RowsStage<'_>>("").ok()?;
        let distances: MappedSlice<f32> = work.open_array(ROWS).ok()?;
        let nodes = distances.len().checked_div(kept.facts.rows.len())?;
        Self::open(kept.facts.rows, nodes, kept.key, work).ok()
    }

    /// Computes the rows in `work`, or opens them if they were computed before.
    ///
    /// # Errors
    /// [`Error::Parameter`] for l = 0, [`Error::Io`], [`Error::Cancelled`].
    ///
    /// ```
    /// use nystrom_stream::distance::{DistanceRows, RowParams};
    /// use nystrom_stream::graph::{DualGraph, Metric};
    /// use nystrom_stream::landmarks::Sampling;
    /// use nystrom_stream::mesh::Mesh;
    /// use nystrom_stream::store::{Context, Run, WorkDir};
    ///
    /// # fn main() -> nystrom_stream::base::Result<()> {
    /// let run = Run::new(&());
    /// let work = WorkDir::temporary(&std::env::temp_dir())?;
    /// let points = [[0f32, 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]];
    /// let mesh = Mesh::from_slices(&points, &[[0u32, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])?;
    /// let context = Context::new(&work, &run);
    /// let graph = DualGraph::build(&mesh, "tetrahedron".as_ref(), &"tetrahedron".into(), context)?;
    /// let weighted = graph.weighted(Metric::Geodesic, context)?;
    /// let rows = DistanceRows::build(&weighted, graph.nodes.view(), RowParams::new(2, Sampling::Farthest), context)?;
    /// assert_eq!(rows.len(), 2);
    /// assert_eq!(rows.row(0)[rows.landmarks[0] as usize], 0.);
    /// # Ok(())
    /// # }
    /// ```
    pub fn build(
        graph: &WeightedGraph,
        nodes: NodeView<'_>,
        params: RowParams<impl Sampler + Serialize>,
        context: Context<'_>,
    ) -> Result<Self> {
        let n = nodes.len();
        let spec = Self::spec(graph, n, &params, context.run)?;
        let job = RowJob { weighted: graph, graph: graph.csr(), nodes, sampler: &params.sampling, spec: &spec };
        let rows = context.stage(RowsStage(job))?;
        // Left by this run, or by one that was killed right after recording the stage.
        context.work.remove(JOURNAL);
        Ok(rows)
    }

    /// Computes rows without keeping them: `visitor` sees each once, on any thread and in any order. Landmarks and sums
    /// are those of [`DistanceRows::build`]. Progress is reported as stage `rows`; nothing is recorded in the manifest.
    /// # Errors
    /// As [`DistanceRows::build`], and those of `visitor`.
    pub fn stream_rows(
        graph: &WeightedGraph,
        nodes: NodeView<'_>,
        params: RowParams<impl Sampler + Serialize>,
        visitor: RowVisitor<'_>,
        context: Context<'_>,
    ) -> Result<Landmarks> {
        let spec = Self::spec(graph, nodes.len(), &params, context.run)?;
        let job = RowJob { weighted: graph, graph: graph.csr(), nodes, sampler: &params.sampling, spec: &spec };
        let (entries, _) = context.run.stage("rows", "rows", spec.rows as u64, || job.stream_rows(visitor, context))?;
        let (nodes, facts) = entries.into_values().map(|entry| (entry.landmark, entry.facts)).unzip();
        Ok(Landmarks { nodes, facts })
    }

    /// Gives finished rows their final names.
    pub(super) fn finish(
        file: RowsFile<f32>,
        entries: &[JournalEntry],
        spec: &JobSpec,
        work: &WorkDir,
    ) -> Result<Self> {
        let landmarks: Vec<u32> = entries.iter().map(|entry| entry.landmark).collect();
        let facts = entries.iter().map(|entry| entry.facts).collect();
        work.write(LANDMARKS, &landmarks, 1)?;
        let distances = file.finish(work.durable())?;
        Ok(Self { landmarks, distances, facts, nodes: spec.nodes, key: spec.key.clone() })
    }

    /// Deletes the rows in a temporary `work`, once nothing will read them again: 4 l bytes of disk per node.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn release(self, work: &WorkDir) -> Result<()> {
        drop(self);
        work.release(RowsStage::NAME, &FILES)
    }

    /// Records the stage as finished.
    pub(super) fn record_stage(&self, spec: &JobSpec, seconds: f64, work: &WorkDir) -> Result<()> {
        let facts = Facts { rows: self.facts.clone() };
        work.record_stage(StageKey::of::<RowsStage<'_>>(spec.options.clone()), &FILES, &facts, seconds)?;
        work.remove(JOURNAL);
        Ok(())
    }
}
