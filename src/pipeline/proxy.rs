//! The proxy of a small mesh that is unlike those which the decision is fitted to: parts are decided on the proxy.
//!
//! The decision is fitted to smooth meshes of some ten thousand similar faces. There are two kinds of proxies:
//!
//! - *Refined*: if triangles are longer than the features of the shape, as exported by CAD or made of few triangles,
//!   the same surface in short ones. Of 37 solids as exported by CAD, 14 were cut unlike the same solid in short
//!   triangles when their own faces were used, and 5 with a refinement. On models of the benchmark decimated to 250 and
//!   800 faces, 1 − Rand was .0986 and .0915, and is .0929 and .0842; on models of 1,600, whose triangles are shorter
//!   than [`LONG`] as a rule, it would hardly change.
//! - *Denoised*: if the surface is rough or consists of stairs, the same triangles with noise and stairs smoothed away
//!   ([`denoised`]). With noise of 15 % of an edge, 38 models score .0786 instead of .0874.
//!
//! Above [`LARGE`] triangles, where meshes are contracted and normals smoothed over many faces, neither gains anything.
//!
//! Cost: a few passes over the triangles of a mesh below that size. If they are long, at most [`MOST`] triangles are
//! made, in memory. A proxy is kept with 32 bytes per triangle on disk; parts are then decided on its triangles.

use crate::base::vector::{add_scaled, area, distance};
use crate::base::{Error, Result};
use crate::cluster::contract::LARGE;
use crate::cluster::denoise::denoised;
use crate::graph::dual::GraphStage;
use crate::graph::frame::NO_AREA;
use crate::graph::{DualGraph, NodeOrder};
use crate::mesh::Mesh;
use crate::mesh::long_edges::{FineTriangles, area_and_length};
use crate::mesh::split_faces::FineLabels;
use crate::store::manifest::MANIFEST;
use crate::store::needs::{BudgetEstimate, Extent, Needs};
use crate::store::stage::{BuiltStage, Stage};
use crate::store::{Context, MappedSlice, WorkDir};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::ops::Range;
use std::sync::Arc;

/// The work directory, within that of the mesh, of the proxy.
const PROXY: &str = "proxy";
const POSITIONS: &str = "proxy_positions.npy";
const CORNERS: &str = "proxy_corners.npy";
const NODES: &str = "proxy_nodes.npy";
/// Of vertices of the mesh, a node and a corner of it; of the others, the two between which they are midpoints.
const PARENTS: &str = "proxy_parents.npy";
/// What to do if it is missing.
const REMEDY: &str = "recreate it with the original options: stage `record`";
/// The face of the file for each triangle, if faces were sorted.
const ORDER: &str = "proxy_order.npy";
/// Mean length of triangles, in units of √area, from which a mesh is refined. The benchmark has up to .095;
/// on the ten with the longest, a refinement changes 1 − Rand by −.012 to .014.
const LONG: f64 = 0.08;
/// The greatest mean length of refined triangles: cells are .02 wide.
const SHORT: f64 = 0.04;
/// Solids of fewer triangles have no concave edges.
const LEAST: u64 = 20;
/// Maximum number of triangles of a refined mesh.
const MOST: usize = 4 * LARGE;

/// The proxy of a mesh: triangles, and the node of the mesh that each stands for.
#[derive(Clone, Debug)]
pub(super) struct ProxyMesh {
    /// Positions of vertices (v × 3), in the mesh's frame.
    positions: MappedSlice<f64>,
    /// Corners of each triangle (t × 3).
    corners: MappedSlice<u32>,
    /// The node of each triangle (t), ascending.
    nodes: MappedSlice<u32>,
    /// A node and a corner of it for each vertex of the mesh, then the ends of the edge for each midpoint (v × 2).
    parents: MappedSlice<u32>,
    /// How many vertices are vertices of the mesh.
    originals: usize,
    key: String,
}

/// The stage that makes a proxy, if triangles are long or rough.
pub(super) struct ProxyStage<'a> {
    /// The mesh in node order.
    pub mesh: &'a Mesh,
    /// Its graph.
    pub graph: &'a DualGraph,
}

/// Facts about a proxy.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct ProxyFacts {
    /// Mean length of the mesh's triangles, in units of √area; 0 if the mesh is large.
    length: f64,
    /// Steps of denoising.
    steps: usize,
    /// Number of its triangles; 0 if the mesh has no proxy.
    triangles: usize,
    /// How many of their vertices are vertices of the mesh.
    originals: usize,
}

impl Stage for ProxyStage<'_> {
    const NAME: &'static str = "proxy";
    const VERSION: u32 = 3;
    type Facts = ProxyFacts;
    type Output = Option<ProxyMesh>;

    fn inputs(&self, _: Context<'_>) -> Value {
        json!({"graph": self.graph.key})
    }

    fn make(self, key: &str, context: Context<'_>) -> Result<BuiltStage<Self>> {
        let Made { length, steps, triangles: fine } = self.triangles();
        let Some(fine) = fine else {
            let facts = ProxyFacts { length, steps, triangles: 0, originals: 0 };
            return Ok(BuiltStage { output: None, facts, files: Vec::new() });
        };
        let work = context.work;
        let positions = work.write(POSITIONS, fine.positions.as_flattened(), 3)?;
        let corners = work.write(CORNERS, fine.corners.as_flattened(), 3)?;
        let nodes = work.write(NODES, &fine.face, 1)?;
        let originals = fine.originals.len();
        let parents = work.write(PARENTS, [fine.originals, fine.midpoints].concat().as_flattened(), 2)?;
        let facts = ProxyFacts { length, steps, triangles: nodes.len(), originals };
        let output = ProxyMesh { positions, corners, nodes, parents, originals, key: key.to_string() };
        Ok(BuiltStage { output: Some(output), facts, files: vec![POSITIONS, CORNERS, NODES, PARENTS] })
    }

    fn open(self, facts: ProxyFacts, key: &str, context: Context<'_>) -> Result<Option<ProxyMesh>> {
        ProxyMesh::open(facts, key.to_string(), self.graph.nodes.len(), context.work)
    }

    /// Small, and only for few meshes: nothing in proportion to one that does not fit memory anyway.
    fn needs(_: &Extent, _: &mut BudgetEstimate) -> Needs {
        Needs::default()
    }
}

/// The triangles of a proxy, if it is needed, and what was found out about the mesh.
#[derive(Default)]
struct Made {
    length: f64,
    steps: usize,
    triangles: Option<FineTriangles>,
}

impl ProxyStage<'_> {
    fn triangles(&self) -> Made {
        let triangles = self.mesh.faces.triangle_count();
        if triangles > LARGE as u64 || self.mesh.faces.len() > LARGE {
            return Made::default();
        }
        let facts = &self.graph.facts;
        let frame = facts.frame;
        let (area, length) = area_and_length(self.mesh, |p| frame.place(p));
        let unit = area.sqrt();
        // Without area there is no unit.
        if area < NO_AREA {
            return Made::default();
        }
        let none = Made { length: length / unit, ..Made::default() };
        if triangles < LEAST {
            return none;
        }
        let is_long = length >= LONG * unit;
        // Loose triangles cannot be denoised.
        if !is_long && facts.edges <= facts.bridges {
            return none;
        }
        let mut fine = FineTriangles::of(self.mesh, |p| frame.place(p));
        if !is_long {
            let (positions, steps) = denoised(&fine.positions, &fine.corners);
            fine.positions = positions;
            return Made { steps, triangles: (steps > 0).then_some(fine), ..none };
        }
        let mut limit = unit;
        while fine.corners.len() < LARGE || fine.area_and_length().1 > SHORT * unit {
            limit *= std::f64::consts::FRAC_1_SQRT_2;
            if !fine.split_longer(limit, MOST) {
                break;
            }
        }
        Made { triangles: Some(fine), ..none }
    }
}

impl ProxyMesh {
    /// The proxy of the mesh of `graph`, as left by the command that built that; `None` if it has none.
    ///
    /// # Errors
    /// [`Error::WorkDir`] if it is missing or damaged.
    pub fn kept(graph: &DualGraph, work: &WorkDir) -> Result<Option<Self>> {
        let kept = work.finished_stage::<ProxyStage<'_>>(REMEDY)?;
        if kept.inputs["graph"] != graph.key {
            return Err(Error::work_dir(work.path(), "proxy: it does not belong to the graph", REMEDY));
        }
        Self::open(kept.facts, kept.key, graph.nodes.len(), work)
    }

    fn open(facts: ProxyFacts, key: String, nodes: usize, work: &WorkDir) -> Result<Option<Self>> {
        if facts.triangles == 0 {
            return Ok(None);
        }
        let positions = work.open_array::<f64>(POSITIONS)?;
        let corners = work.indices(CORNERS, 3 * facts.triangles, positions.len() / 3)?;
        let of_node = work.indices(NODES, facts.triangles, nodes)?;
        let all = of_node.first() == Some(&0) && of_node.last().is_some_and(|last| *last as usize + 1 == nodes);
        if !all || !of_node.windows(2).all(|two| two[0] == two[1] || two[0] + 1 == two[1]) {
            return Err(work.damaged(NODES, "does not name every face in order"));
        }
        let parents = work.array_of(PARENTS, positions.len() / 3 * 2)?;
        Ok(Some(Self { positions, corners, nodes: of_node, parents, originals: facts.originals, key }))
    }

    /// The work directory of the proxy within `work`.
    pub fn work(work: &WorkDir) -> Result<Arc<WorkDir>> {
        work.inner(PROXY)
    }

    /// The graph of the proxy, in its work directory.
    pub fn graph(&self, context: Context<'_>) -> Result<DualGraph> {
        let triples = |k: usize| [0, 1, 2].map(|d| self.corners[3 * k + d]);
        let positions: Vec<[f64; 3]> = self.positions.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
        let mesh = Mesh::from_vecs(positions, (0..self.nodes.len()).map(triples).collect())?;
        DualGraph::build_silently(&mesh, &of_proxy(&self.key), context)
    }

    /// The order of its triangles, in its work directory: it maps them to faces of the file, as
    /// `order` does the nodes of the mesh.
    pub fn order(&self, order: &NodeOrder, work: &WorkDir) -> Result<NodeOrder> {
        let of_file = match &order.order {
            None => self.nodes.clone(),
            Some(faces) => {
                let all: Vec<u32> = self.nodes.iter().map(|&node| faces[node as usize]).collect();
                work.write(ORDER, &all, 1)?
            }
        };
        Ok(NodeOrder { order: Some(of_file), facts: order.facts })
    }

    /// The labels of its triangles as those of the mesh are kept, `of_face` (t × 2) with the face of the file and the
    /// label of each, where the file's faces have `labels`.
    pub fn fine_labels(&self, of_face: MappedSlice<u32>, labels: &[u32]) -> FineLabels {
        FineLabels {
            triangles: of_face,
            corners: self.corners.clone(),
            parents: self.parents.clone(),
            originals: self.originals,
            belongs_to: FineLabels::hash(labels),
        }
    }

    /// The proxy with the `key` in `work`, of a mesh of `nodes` faces; `None` if it is another one by now.
    ///
    /// # Errors
    /// [`Error::WorkDir`] if it is damaged.
    pub fn with_key(key: &str, nodes: usize, work: &WorkDir) -> Result<Option<Self>> {
        if work.manifest().stages.get(ProxyStage::NAME).is_none_or(|kept| kept.key != key) {
            return Ok(None);
        }
        let kept = work.finished_stage::<ProxyStage<'_>>(REMEDY)?;
        Self::open(kept.facts, kept.key, nodes, work)
    }

    /// Whether its triangles are finer than the faces: it is refined, not denoised.
    pub fn is_finer(&self) -> bool {
        self.positions.len() / 3 > self.originals
    }

    /// Its key.
    pub fn key(&self) -> &str {
        &self.key
    }

    /// Number of triangles.
    pub fn len(&self) -> usize {
        self.nodes.len()
    }

    /// The node that `triangle` lies on.
    pub fn node(&self, triangle: u32) -> u32 {
        self.nodes[triangle as usize]
    }

    /// The triangles of `node`.
    pub fn of_node(&self, node: u32) -> Range<usize> {
        self.nodes.partition_point(|&other| other < node)..self.nodes.partition_point(|&other| other <= node)
    }

    /// The triangles of each node, in order.
    pub fn of_nodes(&self) -> impl Iterator<Item = Range<usize>> {
        let mut start = 0;
        self.nodes.chunk_by(|a, b| a == b).map(move |own| {
            let range = start..start + own.len();
            start = range.end;
            range
        })
    }

    /// The triangle in the middle of `own`, those of one node: the one nearest to their centre of area.
    pub fn central(&self, own: Range<usize>) -> u32 {
        let centre = |k: usize| {
            let places = self.places(k);
            [0, 1, 2].map(|axis| places.iter().map(|p| p[axis]).sum::<f64>() / 3.)
        };
        let (mut sum, mut total) = ([0.; 3], 0.);
        for k in own.clone() {
            let (area, at) = (self.area(k), centre(k));
            total += area;
            sum = add_scaled(sum, area, at);
        }
        let middle = sum.map(|x| x / total);
        let off = |k: &usize| distance(centre(*k), middle);
        own.clone().min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(own.start) as u32
    }

    fn places(&self, triangle: usize) -> [[f64; 3]; 3] {
        [0, 1, 2].map(|corner| {
            let vertex = 3 * self.corners[3 * triangle + corner] as usize;
            [0, 1, 2].map(|axis| self.positions[vertex + axis])
        })
    }

    /// The area of a triangle, in the mesh's frame; 0 if it is not finite.
    pub fn area(&self, triangle: usize) -> f64 {
        let area = area(self.places(triangle));
        if area.is_finite() { area } else { 0. }
    }
}

/// The work directory of the proxy in `work` if it was used for the current mesh; `None` if that has none, or
/// that are short, or with `exact` rows over its own faces.
///
/// # Errors
/// As [`WorkDir::inner`].
pub(super) fn in_use(work: &WorkDir, exact: bool) -> Result<Option<Arc<WorkDir>>> {
    // A run that was killed may have left the folder alone; a temporary directory holds its manifest in memory.
    let begun = if work.is_temporary() { work.place(PROXY) } else { work.place(PROXY).join(MANIFEST) };
    let Some(key) = current_key(work).filter(|_| !exact && begun.exists()) else { return Ok(None) };
    let inner = work.inner(PROXY)?;
    let made_of = inner.manifest().stages.remove(GraphStage::NAME).map(|graph| graph.inputs["input"].clone());
    Ok((made_of == Some(of_proxy(&key))).then_some(inner))
}

/// The identity of the proxy `key`.
fn of_proxy(key: &str) -> Value {
    json!({"proxy": key})
}

/// The key of the proxy of the current mesh in `work`, if it has one.
fn current_key(work: &WorkDir) -> Option<String> {
    let facts = work.recorded_facts::<ProxyStage<'_>>()?;
    let mut stages = work.manifest().stages;
    let (graph, record) = (stages.remove(GraphStage::NAME)?, stages.remove(ProxyStage::NAME)?);
    (facts.triangles > 0 && record.inputs["graph"] == graph.key).then_some(record.key)
}
