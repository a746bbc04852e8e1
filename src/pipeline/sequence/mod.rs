//! The recipe of `sequence`: from an opened mesh to the position of each face and the number of each vertex.
//!
//! ```text
//! mesh ─▶ dual graph ─▶ rows [A B] ─▶ coordinates of vertices (─▶ sweeps) ─┐
//! mesh ─▶ vertex graph ─▶ searches ────────────────────────────────────────┼▶ ranks ─▶ places of faces ─▶ first uses
//! mesh ─▶ positions ───────────────────────────────────────────────────────┘
//! ```
//! The graph is that of `segment`, and so are the rows, but for geodesic distances only: with rows that include
//! turning, mean fronts were 1.68 times as wide as those of the exact order, instead of 1.15 (12 models,
//! `docs/dev/decisions.md`). Existing stages are reused; the others are computed and not kept. Everything up to the
//! positions works on the mesh as ordered by [`Ordered`], so that a scattered file is sorted once.

mod coordinates;

use crate::apps::sequence::{self, SequenceOrder, StreamMeasures, VertexUse};
use crate::base::printable::counted;
use crate::base::{Error, Result};
use crate::distance::DistanceRows;
use crate::distance::rows::RowParams;
use crate::graph::dual::WeightsStage;
use crate::graph::{DualGraph, Metric, Order, OrderParams, Ordered, VertexAdjacency};
use crate::landmarks::Sampling;
use crate::mesh::Mesh;
use crate::pipeline::input::Record;
use crate::pipeline::params::{Cluster, LANDMARKS_AT_MOST, SegmentParams};
use crate::pipeline::proxy::ProxyStage;
use crate::store::stage::Stage;
use crate::store::{Context, MappedSlice, WorkDir};
use coordinates::{Coordinates, Task};
use serde::Serialize;
use serde_json::json;
use std::cell::OnceCell;

/// Number of landmarks if rows have to be computed: more gain nothing without sweeps.
pub const LANDMARKS: usize = 10;

/// Parameters of `sequence`.
#[derive(Clone, Copy, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct SequenceParams {
    /// The criterion of the order.
    pub order: SequenceOrder,
    /// Number of Jacobi sweeps over spectral coordinates.
    pub sweeps: usize,
    /// Number of landmarks; by default that of the existing rows, or [`LANDMARKS`].
    pub landmarks: Option<usize>,
}

crate::base::setters::setters!(SequenceParams { order: SequenceOrder, sweeps: usize, landmarks: Option<usize> });

/// An order, by face and vertex numbers of the file.
#[derive(Clone, Debug)]
pub struct Sequence {
    /// The position of each face (n).
    pub places: MappedSlice<u32>,
    /// First and last uses of the vertices and their new numbers.
    pub uses: VertexUse,
}

/// A mesh to be sequenced by one or several methods; shared data are computed once.
pub struct Sequencer<'a> {
    opened: &'a Mesh,
    identity: &'a serde_json::Value,
    ordered: Ordered,
    vertices: OnceCell<VertexAdjacency>,
    context: Context<'a>,
}

/// The folder for rows in a work directory that has those of another metric.
const FOLDER: &str = "sequence";
/// Temporary arrays.
const RANKS: &str = "vertex_rank.tmp";
const EXACT: &str = "exact_rank.tmp";
const NODE_PLACES: &str = "places.tmp";

impl<'a> Sequencer<'a> {
    /// Prepares the mesh, whose `identity` identifies it (see [`super::input::identity`]).
    ///
    /// # Errors
    /// [`crate::base::Error::Io`], [`crate::base::Error::Memory`], [`crate::base::Error::Cancelled`].
    pub fn new(opened: &'a Mesh, identity: &'a serde_json::Value, context: Context<'a>) -> Result<Self> {
        // A work directory made by `segment` keeps the order on which its rows are based.
        let order = match Record::read(context.work) {
            Ok(record) if record.identity == *identity => record.params.ordering(opened.faces.len()),
            _ => OrderParams { order: Order::Auto, has_rows: true },
        };
        let ordered = Ordered::build(opened, order, identity, context)?;
        Ok(Self { opened, identity, ordered, vertices: OnceCell::new(), context })
    }

    /// The mesh on which all orders except the file's are computed.
    fn mesh(&self) -> &Mesh {
        &self.ordered.mesh
    }

    /// The adjacency of vertices, built at first use.
    fn vertices(&self) -> Result<&VertexAdjacency> {
        if let Some(graph) = self.vertices.get() {
            return Ok(graph);
        }
        let faces = self.mesh().faces.len() as u64;
        let make = || VertexAdjacency::build(self.mesh(), self.context);
        let (graph, _) = self.context.run.stage("vertex graph", "faces", faces, make)?;
        Ok(self.vertices.get_or_init(|| graph))
    }

    /// The dual graph and rows of geodesic distances over it: the existing ones, if no number of landmarks is given.
    /// Beside rows of another metric they are stored in a folder of their own.
    fn rows(&self, landmarks: Option<usize>) -> Result<(DualGraph, DistanceRows)> {
        let Context { work, run } = self.context;
        let graph = DualGraph::build(&self.ordered.mesh, self.opened.path(), &self.ordered.identity, self.context)?;
        // For a later `cluster`, which has no mesh.
        if !work.is_temporary() {
            self.context.stage(ProxyStage { mesh: &self.ordered.mesh, graph: &graph })?;
        }
        let other = |record: Record| record.identity != *self.identity;
        if Record::read(work).map_or(true, other) {
            Record::of(self.opened, self.identity, &SegmentParams::default(), work).write(self.context)?;
        }
        // Rows that include turning, as `segment` computes them, give jagged fronts; they are not used.
        let geodesic = json!(Metric::Geodesic);
        let other =
            work.manifest().stages.get(WeightsStage::NAME).is_some_and(|stage| stage.inputs["metric"] != geodesic);
        let own = other.then(|| WorkDir::open(&work.file(FOLDER))).transpose()?;
        let work = own.as_ref().unwrap_or(work);
        let context = Context::new(work, run);
        if landmarks.is_none()
            && let Ok(rows) = DistanceRows::kept(&graph.key, graph.nodes.len(), work)
        {
            run.progress.note_of_work(&format!("rows: {} of them reused", rows.len()));
            return Ok((graph, rows));
        }
        let weighted = graph.weighted(Metric::Geodesic, context)?;
        let params = RowParams { l: landmarks.unwrap_or(LANDMARKS), sampling: Sampling::default() };
        let rows = DistanceRows::build(&weighted, graph.nodes.view(), params, context)?;
        Ok((graph, rows))
    }

    fn spectral(&self, sweeps: usize, landmarks: Option<usize>) -> Result<MappedSlice<u32>> {
        let run = self.context.run;
        // With fewer, there is no second vector for the order.
        if landmarks.is_some_and(|l| !(3..=LANDMARKS_AT_MOST).contains(&l)) {
            let problem = counted(landmarks.unwrap_or(0), "landmark");
            return Err(Error::parameter("landmarks", problem, format!("choose from 3 to {LANDMARKS_AT_MOST}")));
        }
        let (graph, rows) = self.rows(landmarks)?;
        let n = self.mesh().positions.len();
        let _grant = Cluster::KMeans.grant(rows.len(), graph.nodes.len(), run)?;
        let make = || {
            let embedding = coordinates::fit(&rows, &graph, run)?;
            let task =
                Task { mesh: self.mesh(), graph: &graph, rows: &rows, embedding: &embedding, context: self.context };
            task.coordinates()
        };
        let (Coordinates { mut first, sums, component }, _) =
            run.stage("coordinates", "faces", graph.nodes.len() as u64, make)?;
        if sweeps > 0 {
            let vertices = self.vertices()?;
            let all = (sweeps as u64).saturating_mul(n as u64);
            first = run.stage("sweeps", "vertices", all, || sequence::sweep(vertices, first, sweeps, self.context))?.0;
        }
        let along = &first.data()[..];
        let center = |v: usize| {
            let own = component.as_ref().map_or(0, |component| component[v]);
            (own, along[v], sums[v][1] / sums[v][2])
        };
        let ranks = sequence::ranks_along(RANKS, n, center, self.context)?;
        coordinates::remove(self.context.work);
        Ok(ranks)
    }

    /// Ranks of the vertices of [`Self::mesh`].
    fn ranks(&self, params: &SequenceParams) -> Result<MappedSlice<u32>> {
        let (context, mesh) = (self.context, self.mesh());
        match params.order {
            SequenceOrder::Spectral => self.spectral(params.sweeps, params.landmarks),
            SequenceOrder::Pca => sequence::pca_ranks(RANKS, mesh, context),
            SequenceOrder::Bfs => sequence::bfs_ranks(RANKS, self.vertices()?, context),
            SequenceOrder::Rcm => sequence::rcm_ranks(RANKS, self.vertices()?, context),
            SequenceOrder::Hilbert => sequence::hilbert_ranks(RANKS, mesh, context),
            SequenceOrder::Random | SequenceOrder::Keep => sequence::random_ranks(RANKS, mesh.positions.len(), context),
        }
    }

    /// Orders the mesh.
    ///
    /// # Errors
    /// As [`Sequencer::new`]; [`crate::base::Error::Parameter`] for no landmarks.
    pub fn sequence(&self, params: &SequenceParams) -> Result<Sequence> {
        if params.order == SequenceOrder::Keep {
            let mut array = self.context.work.array::<u32>(NODE_PLACES, &[self.opened.faces.len()])?;
            array.data().iter_mut().zip(0..).for_each(|(place, face)| *place = face);
            return self.used(array.finish(false)?);
        }
        let ranks = self.ranks(params)?;
        let sequence = self.placed(&ranks);
        drop(ranks);
        self.context.work.remove(RANKS);
        sequence
    }

    /// The exact Fiedler order, if the mesh is small enough for the budget.
    ///
    /// # Errors
    /// As [`Sequencer::sequence`].
    pub fn exact(&self, params: &SequenceParams) -> Result<Option<Sequence>> {
        let good = self.ranks(&SequenceParams { order: SequenceOrder::Spectral, sweeps: 0, ..*params })?;
        let vertices = self.vertices()?;
        let make = || sequence::fiedler::fiedler_ranks(EXACT, vertices, &good, self.context);
        let (ranks, _) = self.context.run.stage("exact order", "vertices", 0, make)?;
        let sequence = ranks.map(|ranks| self.placed(&ranks)).transpose();
        drop(good);
        [RANKS, EXACT].iter().for_each(|name| self.context.work.remove(name));
        sequence
    }

    fn placed(&self, ranks: &[u32]) -> Result<Sequence> {
        let context = self.context;
        let faces = self.mesh().faces.len() as u64;
        let places = || sequence::places(NODE_PLACES, self.mesh(), ranks, context);
        let (places, _) = context.run.stage("sequence", "faces", faces, places)?;
        self.used(self.ordered.nodes().restore(NODE_PLACES, places, context)?)
    }

    fn used(&self, places: MappedSlice<u32>) -> Result<Sequence> {
        let (mesh, run) = (&self.opened, self.context.run);
        let vertices = mesh.positions.len() as u64;
        let uses = || VertexUse::of(mesh, &places, self.context);
        let (uses, _) = run.stage("vertices", "vertices", vertices, uses)?;
        Ok(Sequence { places, uses })
    }

    /// How well `sequence` streams.
    ///
    /// # Errors
    /// As [`Sequencer::new`].
    pub fn measures(&self, sequence: &Sequence) -> Result<StreamMeasures> {
        StreamMeasures::of(self.opened, &sequence.uses, self.context)
    }
}

impl Drop for Sequencer<'_> {
    fn drop(&mut self) {
        VertexAdjacency::remove(self.context.work);
        VertexUse::remove(self.context.work);
        self.context.work.remove(NODE_PLACES);
    }
}
