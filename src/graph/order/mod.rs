//! The order of faces: the file's, or along Hilbert's curve where the file's scatters neighbours.
//!
//! Out of core, order is everything: a front over scattered faces touches a page a face. So the locality of the file is
//! measured ([`Locality`]), and where it is poor and the mesh large, vertices and faces are sorted along the curve by
//! external sorts ([`vertex_sort`], [`face_sort`]) into a mesh of their own, which all stages work on as if it had been
//! the file; `face_order` leads back, and [`NodeOrder::restore`] puts results in the file's order. Which order is
//! chosen is a pure function of mesh and options. Cost of a reordering: about 0.3 µs per face and thread in memory; 22
//! B per face kept on disk.

mod face_sort;
pub mod hilbert;
mod vertex_sort;

use super::nodes::Frame;
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::{Error, Result};
use crate::mesh::Mesh;
use crate::store::needs::{Extent, Needs, Room, ShuffleNeeds};
use crate::store::npy::Item;
use crate::store::shuffle::{BudgetedShuffle, Producer, RangeBuckets};
use crate::store::stage::{Made, Stage};
use crate::store::{Context, MappedSlice, WorkDir};
use face_sort::ORDER;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use vertex_sort::VERTICES;

/// Values per chunk of the way back.
const RESTORED: usize = 1 << 16;
/// Faces above which [`Order::Auto`] may reorder: below, all pages are at hand in any order.
pub const LARGE: usize = 2_000_000;
/// Share of far steps above which [`Order::Auto`] reorders.
pub const POOR: f64 = 0.25;
/// Faces above which [`Order::Auto`] reorders stretched orders too, for fronts over all faces. At 372 M faces in 2 GiB
/// a row takes 44 s along the curve and 60 s in rows of a grid, and sorting takes 100 s; at 100 M ten rows gain less
/// than sorting takes, free and in 1 GiB.
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
    /// Along the curve where the mesh has more than [`LARGE`] faces and more than [`POOR`] of the file's steps are far,
    /// or, for rows over all faces, more than [`HUGE`] faces and an order stretched by more than [`STRETCHED`].
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

/// What was found and done.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OrderFacts {
    /// Share of far steps in the file's order, 0 to 1; 0 where it was not looked at.
    pub far_steps: f64,
    /// How stretched runs of faces are in the file's order; 1 is a round patch.
    pub stretch: f64,
    /// Whether faces were sorted along the curve.
    pub reordered: bool,
}

/// Which face of the file each node is.
#[derive(Clone, Debug)]
pub struct NodeOrder {
    /// The face of the file that each node is (n); `None` where the file's order was kept.
    pub order: Option<MappedSlice<u32>>,
    /// What was found and done.
    pub facts: OrderFacts,
}

impl NodeOrder {
    /// The order of the `nodes` nodes that the graph in `work` was built in, `input` being the identity that it was
    /// built from: the order's stage where faces were sorted, the file's otherwise.
    ///
    /// # Errors
    /// [`Error::WorkDir`] where the files of the stage are gone or damaged.
    pub fn kept(input: &Value, nodes: usize, work: &WorkDir) -> Result<Self> {
        if input["stage"] != OrderStage::NAME {
            let facts = OrderFacts { far_steps: 0., stretch: 0., reordered: false };
            return Ok(Self { order: None, facts });
        }
        if work.is_temporary() {
            // [`Ordered::into_nodes`] gave up all of the stage except the order.
            let facts = OrderFacts { far_steps: 0., stretch: 0., reordered: true };
            return Ok(Self { order: Some(work.array_of(ORDER, nodes)?), facts });
        }
        let remedy = "make it again: stage `graph`";
        let kept = work.kept::<OrderStage<'_>>(remedy)?;
        if input["key"] != kept.key {
            return Err(Error::work_dir(work.path(), "order: it is not the graph's", remedy));
        }
        Ok(Self { order: Some(work.indices(ORDER, nodes, nodes)?), facts: kept.facts })
    }

    /// The face of the file that `node` is.
    pub fn face(&self, node: u32) -> u32 {
        self.order.as_ref().map_or(node, |order| order[node as usize])
    }

    /// Puts `values` (n, one a node, 4 bytes each), which are the array `name` of `work`, in the order of the file's
    /// faces, under the same name; where the file's order was kept they stay as they are. Values are scattered into the
    /// mapped output where that fits memory, else shuffled by face, a bucket at a time: one pass over the nodes, and 8
    /// B per value on disk where memory does not hold them.
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
                &context.work.file("restore.tmp"),
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
        // By rename: `values` stay mapped until they are dropped.
        array.finish(false)
    }
}

/// A mesh in the order of its nodes.
#[derive(Clone, Debug)]
pub struct Ordered {
    /// The mesh: the file's own, or its faces and vertices along the curve.
    pub mesh: Mesh,
    /// The face of the file that each node is (n); `None` where the file's order was kept.
    pub order: Option<MappedSlice<u32>>,
    /// What was found and done.
    pub facts: OrderFacts,
    /// What later stages build on: the input's identity, and the order where it is not the file's.
    pub identity: Value,
}

impl Ordered {
    /// Puts `mesh`, whose identity is `input`, in order, or opens what an earlier run left in `work`. Stray vertices
    /// are moved to their neighbours first ([`Mesh::without_strays`]), and a note says so.
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
        let found = Locality::of(mesh, frame.scale);
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

    /// The face of the file that `node` is.
    pub fn face(&self, node: u32) -> u32 {
        self.order.as_ref().map_or(node, |order| order[node as usize])
    }

    /// The way back to the file's order.
    pub fn nodes(&self) -> NodeOrder {
        NodeOrder { order: self.order.clone(), facts: self.facts }
    }

    /// The same where the mesh itself is not needed any more: a temporary `work` gives up what was sorted, 18 B a face.
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

/// The stage of faces and vertices along the curve.
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

    fn make(self, key: &str, context: Context<'_>) -> Result<Made<Self>> {
        let Self { mesh, frame, found: Locality { far_steps, stretch }, .. } = self;
        sort(mesh, &frame, context)?;
        let facts = OrderFacts { far_steps, stretch, reordered: true };
        let files = [&[ORDER, VERTICES], face_sort::files(&mesh.faces)].concat();
        Ok(Made { output: Ordered::open(mesh, facts, key, context.work)?, facts, files })
    }

    fn open(self, facts: OrderFacts, key: &str, context: Context<'_>) -> Result<Ordered> {
        Ordered::open(self.mesh, facts, key, context.work)
    }

    fn progress(&self) -> Option<(&'static str, u64)> {
        Some(("faces", self.mesh.faces.len() as u64))
    }

    /// Ranks of the vertices, and the greater of two sorts.
    fn needs(extent: &Extent, room: &mut Room) -> Needs {
        let Extent { faces: n, vertices, corners, threads: t, reordered, .. } = *extent;
        if !reordered {
            return Needs::default();
        }
        let budget = room.total();
        let ranks = room.take(4 * vertices);
        let joined = budget < 8 * vertices;
        let left = if joined { budget } else { budget - 4 * vertices };
        let held = |records, size, part| ShuffleNeeds::new(records, size, 6 * t, part, left, t).held;
        let memory = if joined { budget } else { held(vertices, 24, 2).max(held(n, 20, 3)) };
        let passing = 4 * vertices + (24 * vertices).max(20 * n + if joined { 16 * corners } else { 0 });
        room.give_back(ranks);
        Needs {
            memory: memory + ranks,
            keeps: 12 * vertices + 4 * corners + 4 * n,
            passing: passing.saturating_sub(memory + ranks),
            ..Needs::default()
        }
        .moving(105 * n, 104 * n)
    }
}

/// Sorts vertices, then faces.
fn sort(mesh: &Mesh, frame: &Frame, context: Context<'_>) -> Result<()> {
    let bytes = 4 * mesh.positions.len() as u64;
    // The ranks stay mapped, but random access wants them resident: they count as if allocated.
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
/// Vertices that a step may pass over at the least.
const NEAR: u64 = 1 << 16;

/// How well an order keeps neighbours together.
///
/// Sampled: [`RUNS`] runs of [`RUN`] consecutive faces, evenly spread. A step to the next face is *far* when one of
/// its corners lies far from the one before in vertex numbers (a file whose vertices are scattered) or in space (a
/// soup in random order, whose numbers always ascend). The *stretch* of a run is its extent over the width of a
/// round patch of as many faces: 1–2 along Hilbert's curve, √([`RUN`]) and more in rows of a grid. A front that
/// crosses such rows touches one page per face too, however near its neighbours are. A pure function of the mesh,
/// never of budget or threads.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Locality {
    /// Share of far steps, 0 to 1: near 0 in scan order, near 1 at random.
    far_steps: f64,
    /// Mean extent of a run over that of a round patch of as many faces.
    stretch: f64,
}

impl Locality {
    /// Measures the order of `mesh`, whose box has diagonal `diagonal`. Cost: 65,536 faces read.
    fn of(mesh: &Mesh, diagonal: f64) -> Self {
        let n = mesh.faces.len();
        let near = NEAR.max(mesh.positions.len() as u64 / 64);
        let runs = RUNS.min(n.div_ceil(RUN));
        let (mut far, mut steps, mut stretch, mut measured) = (0u64, 0u64, 0f64, 0u64);
        for k in 0..runs {
            let start = (k as u128 * n as u128 / runs as u128) as usize;
            let mut last: Option<(u32, [f64; 3])> = None;
            let (mut low, mut high, mut edges) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3], (0f64, 0u64));
            mesh.faces.for_each(start..n.min(start + RUN), |_, corners| {
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
            // A triangle of edge e has area .43 e²; a disc of as much area as the run is this wide.
            let round = (edges.0 / edges.1.max(1) as f64) * (0.55 * edges.1 as f64).sqrt();
            if extent.is_finite() && round > 0. {
                stretch += extent / round;
                measured += 1;
            }
        }
        Self { far_steps: far as f64 / steps.max(1) as f64, stretch: stretch / measured.max(1) as f64 }
    }
}
