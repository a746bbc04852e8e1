//! The order of faces: that of the file, or along Hilbert's curve if the file scatters neighbours.
//!
//! Out of core, order is decisive: a front over scattered faces touches one page per face. So the locality of the file
//! is measured ([`Locality`]). If it is poor and the mesh large, vertices and faces are sorted along the curve by
//! external sorts ([`vertex_sort`], [`face_sort`]) into a new mesh, which all stages treat as if it were the file;
//! `face_order` leads back, and [`NodeOrder::restore`] puts results in the file's order. Which order is chosen is a
//! pure function of mesh and options. Cost of reordering: about 0.3 µs per face and thread in memory; 22 B per face
//! kept on disk.

mod face_sort;
pub mod hilbert;
mod vertex_sort;

use super::frame::Frame;
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::{Error, Result};
use crate::mesh::Mesh;
use crate::store::needs::{BudgetEstimate, Extent, Needs, ShuffleNeeds};
use crate::store::npy::Item;
use crate::store::shuffle::{BudgetedShuffle, Producer, RangeBuckets};
use crate::store::stage::{BuiltStage, Stage};
use crate::store::{Context, MappedSlice, Run, WorkDir};
use face_sort::ORDER;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::ops::Range;
use vertex_sort::VERTICES;

/// Values per chunk when restoring the file's order.
const RESTORED: usize = 1 << 16;
/// Number of faces above which [`Order::Auto`] may reorder: below, all pages are in memory in any order.
pub const LARGE: usize = 2_000_000;
/// Share of far steps above which [`Order::Auto`] reorders.
pub const POOR: f64 = 0.25;
/// Number of faces above which [`Order::Auto`] also reorders stretched orders, for fronts over all faces. At 372 M
/// faces in 2 GiB a row takes 44 s along the curve and 60 s in rows of a grid, and sorting takes 100 s; at 100 M, ten
/// rows gain less than sorting costs, with all the memory or in 1 GiB.
pub const HUGE: usize = 200_000_000;
/// Stretch above which an order counts as stretched.
pub const STRETCHED: f64 = 4.;

/// In which order faces become nodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Order {
    /// As in the file.
    Keep,
    /// Along Hilbert's curve.
    Hilbert,
    /// Along the curve if the mesh has more than [`LARGE`] faces and more than [`POOR`] of the file's steps are far,
    /// or, for rows over all faces, if it has more than [`HUGE`] faces and a stretch above [`STRETCHED`].
    #[default]
    Auto,
}

/// How to order faces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OrderParams {
    /// The order.
    pub order: Order,
    /// Whether rows over all faces will be computed: fronts that cross the whole mesh, one after the other.
    pub has_rows: bool,
}

/// What was measured and done.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OrderFacts {
    /// Share of far steps in the file's order, 0 to 1; 0 if it was not measured.
    pub far_steps: f64,
    /// How stretched runs of faces are in the file's order; 1 is a round patch.
    pub stretch: f64,
    /// Whether faces were sorted along the curve.
    pub reordered: bool,
}

/// Maps nodes to faces of the file.
#[derive(Clone, Debug)]
pub struct NodeOrder {
    /// The face of the file for each node (n); `None` if the file's order was kept.
    pub order: Option<MappedSlice<u32>>,
    /// What was measured and done.
    pub facts: OrderFacts,
}

impl NodeOrder {
    /// The order in which the graph of `nodes` nodes in `work` was built, where `input` is the recorded identity of its
    /// input: the order's stage if faces were sorted, else the file's order.
    ///
    /// # Errors
    /// [`Error::WorkDir`] if the files of the stage are missing or damaged.
    pub fn kept(input: &Value, nodes: usize, work: &WorkDir) -> Result<Self> {
        if input["stage"] != OrderStage::NAME {
            let facts = OrderFacts { far_steps: 0., stretch: 0., reordered: false };
            return Ok(Self { order: None, facts });
        }
        if work.is_temporary() {
            // [`Ordered::into_nodes`] deleted everything of the stage except the order.
            let facts = OrderFacts { far_steps: 0., stretch: 0., reordered: true };
            return Ok(Self { order: Some(work.array_of(ORDER, nodes)?), facts });
        }
        let remedy = "rebuild it: stage `graph`";
        let kept = work.finished_stage::<OrderStage<'_>>(remedy)?;
        if input["key"] != kept.key {
            return Err(Error::work_dir(work.path(), "order: it does not belong to the graph", remedy));
        }
        Ok(Self { order: Some(work.indices(ORDER, nodes, nodes)?), facts: kept.facts })
    }

    /// The face of the file for `node`.
    pub fn face(&self, node: u32) -> u32 {
        self.order.as_ref().map_or(node, |order| order[node as usize])
    }

    /// Puts `values` (n, one per node, 4 bytes each), the array `name` of `work`, in the order of the file's faces,
    /// under the same name; if the file's order was kept they are unchanged. Values are scattered into the mapped
    /// output if that fits memory, else shuffled by face and written bucket by bucket: one pass over the nodes, and 8 B
    /// per value on disk where memory does not hold them.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`], [`crate::base::Error::Memory`], [`crate::base::Error::Cancelled`].
    pub fn restore<T: Item>(&self, name: &str, values: MappedSlice<T>, context: Context<'_>) -> Result<MappedSlice<T>> {
        let Some(order) = &self.order else { return Ok(values) };
        let n = values.len();
        let words: &[u32] = bytemuck::cast_slice(&values);
        let mut array = context.work.array::<T>(name, &[n])?;
        let out: &mut [u32] = bytemuck::cast_slice_mut(&mut array.data()[..]);
        let bytes = 4 * n as u64;
        let resident = context.run.budget.take("ordering results", 0, bytes)?;
        if resident.bytes() >= bytes {
            for (k, (&face, &word)) in order.iter().zip(words).enumerate() {
                if k % RESTORED == 0 {
                    context.run.cancel.check()?;
                }
                out[face as usize] = word;
            }
        } else {
            drop(resident);
            let pairs = BudgetedShuffle::<[u32; 2]>::new(
                context.work.spill("restore.tmp"),
                "ordering results",
                n as u64,
                1,
                1,
                context.run,
            )?;
            let buckets = pairs.shuffle.buckets();
            let by_face = RangeBuckets::new(n, buckets);
            context.run.each_chunk(
                chunk_count(n, RESTORED),
                || pairs.shuffle.producer(),
                |k, producer| {
                    chunk_range(n, RESTORED, k).try_for_each(|i| {
                        let face = order[i];
                        producer.push(by_face.bucket_of(face), [face, words[i]])
                    })
                },
                Producer::finish,
            )?;
            for bucket in 0..buckets {
                context.run.cancel.check()?;
                pairs.shuffle.take(bucket)?.into_iter().for_each(|[face, word]| out[face as usize] = word);
            }
        }
        // Replaced by rename: `values` stay mapped until they are dropped.
        array.finish(false)
    }
}

/// A mesh in node order.
#[derive(Clone, Debug)]
pub struct Ordered {
    /// The mesh: that of the file, or its faces and vertices along the curve.
    pub mesh: Mesh,
    /// The face of the file for each node (n); `None` if the file's order was kept.
    pub order: Option<MappedSlice<u32>>,
    /// What was measured and done.
    pub facts: OrderFacts,
    /// The identity for later stages: that of the input, plus the order if it is not the file's.
    pub identity: Value,
}

impl Ordered {
    /// Orders `mesh`, whose identity is `input`, or opens the result of an earlier run in `work`. Stray vertices are
    /// first moved to their neighbours ([`Mesh::without_strays`]), with a note.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`], [`crate::base::Error::Memory`], [`crate::base::Error::Cancelled`].
    pub fn build(mesh: &Mesh, params: OrderParams, input: &Value, context: Context<'_>) -> Result<Self> {
        let OrderParams { order, has_rows } = params;
        let n = mesh.faces.len();
        let mesh = &mesh.without_strays(context.run)?;
        if mesh.strays() > 0 {
            context.run.progress.note(&mesh.strays_note());
        }
        let kept = |Locality { far_steps, stretch }| Self {
            mesh: mesh.clone(),
            order: None,
            facts: OrderFacts { far_steps, stretch, reordered: false },
            identity: input.clone(),
        };
        if order == Order::Keep || (order == Order::Auto && n <= LARGE) {
            return Ok(kept(Locality::default()));
        }
        let frame = Frame::of(mesh, context.run)?;
        let found = Locality::of(mesh, frame.scale, context.run);
        let poor = found.far_steps > POOR || (has_rows && n > HUGE && found.stretch > STRETCHED);
        if order == Order::Auto && !poor {
            return Ok(kept(found));
        }
        context.stage(OrderStage { mesh, input, frame, found })
    }

    fn open(mesh: &Mesh, facts: OrderFacts, key: &str, work: &WorkDir) -> Result<Self> {
        let (vertices, faces) = (mesh.positions.len(), mesh.faces.len());
        let positions = vertex_sort::open(work, mesh.positions.is_double(), vertices)?;
        Ok(Self {
            mesh: mesh.with_arrays(positions, face_sort::open(&mesh.faces, vertices, work)?),
            order: Some(work.indices(ORDER, faces, faces)?),
            facts,
            identity: json!({"stage": OrderStage::NAME, "key": key}),
        })
    }

    /// The face of the file for `node`.
    pub fn face(&self, node: u32) -> u32 {
        self.order.as_ref().map_or(node, |order| order[node as usize])
    }

    /// The mapping back to the file's order.
    pub fn nodes(&self) -> NodeOrder {
        NodeOrder { order: self.order.clone(), facts: self.facts }
    }

    /// The same if the mesh itself is no longer needed: a temporary `work` deletes the sorted mesh, 18 B per face.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn into_nodes(self, work: &WorkDir) -> Result<NodeOrder> {
        let nodes = self.nodes();
        if nodes.order.is_some() {
            let files = [&[VERTICES], face_sort::files(&self.mesh.faces)].concat();
            drop(self);
            work.release(OrderStage::NAME, &files)?;
        }
        Ok(nodes)
    }
}

/// The stage that sorts faces and vertices along the curve.
pub(crate) struct OrderStage<'a> {
    mesh: &'a Mesh,
    input: &'a Value,
    frame: Frame,
    found: Locality,
}

impl Stage for OrderStage<'_> {
    const NAME: &'static str = "order";
    const VERSION: u32 = 3;
    type Facts = OrderFacts;
    type Output = Ordered;

    fn inputs(&self, _: Context<'_>) -> Value {
        json!({"input": self.input, "order": "hilbert"})
    }

    fn make(self, key: &str, context: Context<'_>) -> Result<BuiltStage<Self>> {
        let Self { mesh, frame, found: Locality { far_steps, stretch }, .. } = self;
        sort(mesh, &frame, context)?;
        let facts = OrderFacts { far_steps, stretch, reordered: true };
        let files = [&[ORDER, VERTICES], face_sort::files(&mesh.faces)].concat();
        Ok(BuiltStage { output: Ordered::open(mesh, facts, key, context.work)?, facts, files })
    }

    fn open(self, facts: OrderFacts, key: &str, context: Context<'_>) -> Result<Ordered> {
        Ordered::open(self.mesh, facts, key, context.work)
    }

    fn progress(&self) -> Option<(&'static str, u64)> {
        Some(("faces", self.mesh.faces.len() as u64))
    }

    /// Ranks of the vertices, plus the larger of the two sorts.
    fn needs(extent: &Extent, estimate: &mut BudgetEstimate) -> Needs {
        let Extent { faces: n, vertices, corners, threads: t, reordered, .. } = *extent;
        if !reordered {
            return Needs::default();
        }
        let budget = estimate.total();
        let ranks = estimate.reserve_array(4 * vertices);
        let joined = budget < 8 * vertices;
        let left = if joined { budget } else { budget - 4 * vertices };
        let held = |records, size, part| ShuffleNeeds::new(records, size, 6 * t, part, left, t).held;
        let memory = if joined { budget } else { held(vertices, 24, 2).max(held(n, 20, 3)) };
        let temporary = 4 * vertices + (24 * vertices).max(20 * n + if joined { 16 * corners } else { 0 });
        estimate.release(ranks);
        Needs {
            memory: memory + ranks,
            keeps: 12 * vertices + 4 * corners + 4 * n,
            temporary: temporary.saturating_sub(memory + ranks),
            ..Needs::default()
        }
        .moving(105 * n, 104 * n)
    }
}

/// Sorts vertices, then faces.
fn sort(mesh: &Mesh, frame: &Frame, context: Context<'_>) -> Result<()> {
    let bytes = 4 * mesh.positions.len() as u64;
    // The ranks stay mapped, but random access needs them resident, so they count as allocated.
    let resident = context.run.budget.take("ranks of vertices", 0, bytes)?;
    let in_memory = resident.bytes() >= bytes && context.run.budget.left() >= context.run.budget.total() / 2;
    let resident = in_memory.then_some(resident);
    let rank = vertex_sort::sort(&mesh.positions, frame, in_memory, context)?;
    face_sort::sort(&mesh.faces, &rank, in_memory, context)?;
    drop((resident, rank));
    context.work.remove("vertex_rank.tmp");
    Ok(())
}

const RUNS: usize = 256;
const RUN: usize = 256;
/// Minimum number of vertices that a step may skip before it counts as far.
const NEAR: u64 = 1 << 16;

/// How well an order keeps neighbours together.
///
/// Sampled: [`RUNS`] runs of [`RUN`] consecutive faces, evenly spread. A step to the next face is *far* if one of its
/// corners is far from the previous one in vertex numbers (a file whose vertices are scattered) or in space (a soup in
/// random order, whose numbers always ascend). The *stretch* of a run is its extent divided by the width of a round
/// patch of as many faces: 1–2 along Hilbert's curve, √([`RUN`]) and more in rows of a grid. A front that crosses such
/// rows also touches one page per face, however close its neighbours are. A pure function of the mesh, never of budget
/// or threads.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Locality {
    /// Share of far steps, 0 to 1: near 0 in scan order, near 1 in random order.
    far_steps: f64,
    /// Mean extent of a run, relative to a round patch of as many faces.
    stretch: f64,
}

impl Locality {
    /// Measures the order of `mesh`, whose box has diagonal `diagonal`. Cost: 65,536 faces read.
    fn of(mesh: &Mesh, diagonal: f64, run: &Run) -> Self {
        let n = mesh.faces.len();
        let runs = RUNS.min(n.div_ceil(RUN));
        let start = |k: usize| (k as u128 * n as u128 / runs as u128) as usize;
        let ranges = (0..runs).map(|k| start(k)..n.min(start(k) + RUN));
        mesh.sampled(run, |request| {
            if request {
                ranges.clone().for_each(|range| mesh.faces.will_need(range));
            }
            Self::of_runs(mesh, diagonal, ranges)
        })
    }

    /// The same over the faces of `runs`.
    fn of_runs(mesh: &Mesh, diagonal: f64, runs: impl Iterator<Item = Range<usize>>) -> Self {
        let near = NEAR.max(mesh.positions.len() as u64 / 64);
        let (mut far, mut steps, mut stretch, mut measured) = (0u64, 0u64, 0f64, 0u64);
        for run in runs {
            let mut last: Option<(u32, [f64; 3])> = None;
            let (mut low, mut high, mut edges) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3], (0f64, 0u64));
            mesh.faces.for_each(run, |_, corners| {
                let (Some(&first), Some(&other)) = (corners.first(), corners.get(1)) else { return };
                let (at, end) = (mesh.positions.get(first), mesh.positions.get(other));
                let square = |a: [f64; 3], b: [f64; 3]| (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>();
                if let Some((vertex, place)) = last {
                    let jump = corners.iter().any(|&v| u64::from(v.abs_diff(vertex)) > near);
                    steps += 1;
                    far += u64::from(jump || square(at, place) > (diagonal / 16.).powi(2));
                }
                for axis in 0..3 {
                    low[axis] = low[axis].min(at[axis]);
                    high[axis] = high[axis].max(at[axis]);
                }
                edges = (edges.0 + square(at, end).sqrt(), edges.1 + 1);
                last = Some((first, at));
            });
            let extent = (0..3).map(|axis| (high[axis] - low[axis]).powi(2)).sum::<f64>().sqrt();
            // A triangle of edge e has area .43 e²; this is the diameter of a disc with the run's area.
            let round = (edges.0 / edges.1.max(1) as f64) * (0.55 * edges.1 as f64).sqrt();
            if extent.is_finite() && round > 0. {
                stretch += extent / round;
                measured += 1;
            }
        }
        Self { far_steps: far as f64 / steps.max(1) as f64, stretch: stretch / measured.max(1) as f64 }
    }
}
