//! The order of faces: the file's, or along Hilbert's curve where the file's scatters neighbours.
//!
//! Out of core, order is everything: a front over scattered faces touches a page a face. So the locality of the
//! file is measured ([`locality`]), and where it is poor and the mesh large, vertices and faces are sorted
//! along the curve by external sorts ([`vertices`], [`faces`]) into a mesh of their own, which all stages work on
//! as if it had been the file; `face_order` leads back, and [`NodeOrder::restore`] puts results in the
//! file's order. Which order is chosen is a pure function of mesh and options. Cost of a reordering: about
//! 0.3 µs a face and thread in memory; 22 B a face kept on disk.

mod faces;
pub mod hilbert;
mod locality;
mod restore;
mod vertices;

use super::Frame;
use crate::base::{Error, Result};
use crate::mesh::Mesh;
use crate::store::stage::options_key;
use crate::store::{Context, MappedSlice, WorkDir};
use locality::Locality;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// The stage of the sorted mesh; its order, which outlives it in a temporary directory, is the stage `order`.
const CURVE: &str = "curve";
const ORDER: &str = "face_order.npy";
const VERTICES: &str = "curve_vertices.npy";
/// Faces above which [`Order::Auto`] may reorder: below, all pages are at hand in any order.
pub const LARGE: usize = 2_000_000;
/// Share of far steps above which [`Order::Auto`] reorders.
pub const POOR: f64 = 0.25;
/// Faces above which [`Order::Auto`] reorders stretched orders too: the pages under a front across the rows of a grid
/// (six arrays, 4 KiB a face of the front) come to half a gigabyte at 100 M faces, those along the curve to 30 MB:
/// an estimate, not yet measured.
pub const HUGE: usize = 40_000_000;
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
    /// or more than [`HUGE`] faces and an order stretched by more than [`STRETCHED`].
    #[default]
    Auto,
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
    /// The order of nodes that the graph in `work` was built in, `input` being the identity that it was built from: the
    /// order's stage where faces were sorted, the file's otherwise.
    ///
    /// # Errors
    /// [`Error::WorkDir`] where the files of the stage are gone or damaged.
    pub fn kept(input: &Value, work: &WorkDir) -> Result<Self> {
        if input["stage"] != "order" {
            let facts = OrderFacts { far_steps: 0., stretch: 0., reordered: false };
            return Ok(Self { order: None, facts });
        }
        let facts = work.reuse::<OrderFacts>("order", 1, &options_key(input)).map_err(|problem| {
            Error::work_dir(work.path(), format!("order: {problem}"), "make it again: nystrom-stream graph MESH …")
        })?;
        Ok(Self { order: Some(work.open_array(ORDER)?), facts })
    }

    /// The face of the file that `node` is.
    pub fn face(&self, node: u32) -> u32 {
        self.order.as_ref().map_or(node, |order| order[node as usize])
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
    /// Puts `mesh`, whose identity is `input`, in `order`, or opens what an earlier run left in `work`.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`], [`crate::base::Error::Memory`], [`crate::base::Error::Cancelled`].
    pub fn build(mesh: &Mesh, order: Order, input: &Value, context: Context<'_>) -> Result<Self> {
        let n = mesh.faces.len();
        let kept = |Locality { far_steps, stretch }| Self {
            mesh: mesh.clone(),
            order: None,
            facts: OrderFacts { far_steps, stretch, reordered: false },
            identity: input.clone(),
        };
        if order == Order::Keep || (order == Order::Auto && n <= LARGE) {
            return Ok(kept(Locality::default()));
        }
        let options = json!({"stage": "order", "input": input, "order": "hilbert"});
        let key = options_key(&options);
        let whole = |facts| context.work.reuse::<()>(CURVE, 1, &key).map(|()| facts);
        let facts = match context.work.reuse::<OrderFacts>("order", 1, &key).and_then(whole) {
            Ok(facts) => {
                context.run.progress.note("order: reused");
                facts
            }
            Err(reason) => {
                let frame = Frame::of(&mesh.positions, context.run)?;
                let found = locality::measure(mesh, frame.scale);
                let poor = found.far_steps > POOR || (n > HUGE && found.stretch > STRETCHED);
                if order == Order::Auto && !poor {
                    return Ok(kept(found));
                }
                context.run.note_remake("order", &reason);
                let ((), seconds) = context.run.stage("order", "faces", n as u64, || sort(mesh, &frame, context))?;
                let facts = OrderFacts { far_steps: found.far_steps, stretch: found.stretch, reordered: true };
                let sorted = [&[VERTICES], faces::files(&mesh.faces)].concat();
                context.work.stamp_as(CURVE, &key, &options, &sorted, &(), 0.)?;
                context.work.stamp_as("order", &key, &options, &[ORDER], &facts, seconds)?;
                facts
            }
        };
        let positions = vertices::open(context.work, mesh.positions.is_double(), mesh.positions.len())?;
        Ok(Self {
            mesh: Mesh::new(positions, faces::open(&mesh.faces, context.work)?),
            order: Some(context.work.open_array(ORDER)?),
            facts,
            identity: options,
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
            let files = [&[VERTICES], faces::files(&self.mesh.faces)].concat();
            drop(self);
            work.release(CURVE, &files)?;
        }
        Ok(nodes)
    }
}

/// Sorts vertices, then faces.
fn sort(mesh: &Mesh, frame: &Frame, context: Context<'_>) -> Result<()> {
    let bytes = 4 * mesh.positions.len() as u64;
    // The ranks stay mapped, but random access wants them resident: they count as if allocated.
    let resident = context.run.budget.take("ranks of vertices", 0, bytes)?;
    let in_memory = resident.bytes() >= bytes && context.run.budget.left() >= context.run.budget.total() / 2;
    let resident = in_memory.then_some(resident);
    let rank = vertices::sort(&mesh.positions, frame, in_memory, context)?;
    faces::sort(&mesh.faces, &rank, in_memory, context)?;
    drop((resident, rank));
    context.work.remove("vertex_rank.tmp");
    Ok(())
}
