//! The result of cutting: one label per face in file order, confidences, colours, and the numbers for the report.
//!
//! Labels are brought from node order into file order, adjacent parts get different colours, and both are kept in the
//! work directory for `export`. Cost: two passes over the labels, one over the graph.

use super::edits::PartMarks;
use super::params::SegmentParams;
use super::proxy::{ProxyMesh, ProxyStage};
use super::surface::SurfaceStage;
use crate::apps::colours;
use crate::apps::edits::Edits;
use crate::base::Result;
use crate::cluster::contract::Contraction;
use crate::cluster::parts::PartsReport;
use crate::cluster::parts::agreement::UNSURE;
use crate::distance::rows::RowsStage;
use crate::graph::dual::{GraphStage, WeightsStage};
use crate::graph::order::OrderFacts;
use crate::graph::{DualGraph, GraphFacts, NodeOrder};
use crate::landmarks::Sampling;
use crate::mesh::Labelling;
use crate::mesh::ply::labelled::GREY;
use crate::mesh::split_faces::FineLabels;
use crate::store::manifest::{MANIFEST, StageRecord};
use crate::store::stage::{Stage, StageKey};
use crate::store::{Context, MappedSlice, Run, WorkDir};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::json;
use std::collections::BTreeMap;

const CHUNK: usize = 1 << 15;
/// The labels.
pub const LABELS: &str = "labels.npy";
/// The confidences.
pub(super) const QUALITY: &str = "quality.npy";
/// The face and the label of each of a proxy's triangles, if parts were decided on finer ones.
const PROXY_LABELS: &str = "proxy_labels.npy";
/// The stage that writes them.
pub(super) const STAGE: &str = "labels";
/// Version of the algorithm that decides on parts, given the cells.
pub(super) const DECISION_VERSION: u32 = 38;
/// Version of the algorithms behind labels: the sum of that of boundaries and colours, the first number, and those of
/// all earlier stages. Labels of an older program are rejected when read.
pub const LABELS_VERSION: u32 = 9
    + DECISION_VERSION
    + GraphStage::VERSION
    + WeightsStage::VERSION
    + ProxyStage::VERSION
    + SurfaceStage::VERSION
    + RowsStage::VERSION
    + Contraction::VERSION;
/// A note, if tiny components should form a part of their own.
pub(super) const NO_TINY_COMPONENTS: &str = "there are no tiny components, so no label stands for them";

/// Numbers from the stages for the report.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SegmentStats {
    /// Landmark faces (l).
    pub landmarks: Vec<u32>,
    /// How they were chosen, if that was decided during the run.
    #[serde(default)]
    pub sampling: Option<Sampling>,
    /// The kernel's width.
    pub sigma: f64,
    /// Eigenvalues of the l × l problem, descending.
    pub eigenvalues: Vec<f64>,
    /// Eigenpairs of A dropped as negative or too small.
    pub dropped_eigenpairs: usize,
    /// Share of A's negative eigenvalues in the sum of all absolute ones.
    pub negative_mass: f64,
    /// Γ, eq. 6.
    pub gamma: f64,
    /// Γ divided by the number of nodes that it is summed over: faces, or nodes of the contraction.
    #[serde(default)]
    pub gamma_per_node: f64,
    /// Faces of each part.
    pub faces: Vec<u64>,
    /// Area of each part, in the frame.
    pub area: Vec<f64>,
    /// Figures of the decision on parts.
    pub decision: Option<PartsReport>,
    /// Radius of the normals used for measuring turning; 0: the faces' own.
    pub radius: f32,
    /// Faces of components too small to be parts.
    pub tiny_faces: u64,
    /// The common label of tiny components, if they do not join parts.
    pub tiny_components_label: Option<u32>,
    /// The common label of walls of cavities, if they do not follow the outside.
    #[serde(default)]
    pub walls_label: Option<u32>,
}

impl SegmentStats {
    /// Share of people expected to have each part; empty if unknown.
    pub fn expected_agreement(&self) -> &[f64] {
        self.decision.as_ref().map_or(&[], |decision| &decision.expected_agreement)
    }
}

/// Labels and the numbers computed with them.
pub(super) struct Clustered {
    pub labels: MappedSlice<u32>,
    /// Nodes with a neighbour of another label, ascending, if known.
    pub boundary_nodes: Option<Vec<u32>>,
    pub quality: MappedSlice<f32>,
    pub numbers: SegmentStats,
    pub marks: PartMarks,
    /// Part of each cell (S), if parts are decided on cells.
    pub cell_labels: Vec<u32>,
    /// The parts on the mesh's proxy, if they were decided there on finer triangles.
    pub on_proxy: Option<OnProxy>,
}

/// Parts on the proxy of a mesh.
pub(super) struct OnProxy {
    pub proxy: ProxyMesh,
    /// The label of each triangle (t).
    pub labels: Vec<u32>,
    /// Parts that touch each other there, as [`touching`] has them.
    pub pairs: Vec<(u32, u32, f64)>,
}

impl OnProxy {
    /// Its labels as they are kept, and as writers take them, where the faces of the file have `labels`.
    fn keep(&self, order: &NodeOrder, labels: &[u32], work: &WorkDir) -> Result<FineLabels> {
        let own = (0..).zip(&self.labels).map(|(k, &label)| [order.face(self.proxy.node(k)), label]);
        let of_face = work.write(PROXY_LABELS, own.collect::<Vec<_>>().as_flattened(), 2)?;
        Ok(self.proxy.fine_labels(of_face, labels))
    }
}

impl Clustered {
    /// Labels that were not decided on cells.
    pub fn of_faces(
        labels: MappedSlice<u32>,
        boundary_nodes: Option<Vec<u32>>,
        quality: MappedSlice<f32>,
        numbers: SegmentStats,
    ) -> Self {
        let (marks, cell_labels) = (PartMarks::default(), Vec::new());
        Self { labels, boundary_nodes, quality, numbers, marks, cell_labels, on_proxy: None }
    }
}

/// Reads a number that JSON cannot hold.
fn infinite_if_null<'de, D: Deserializer<'de>>(from: D) -> std::result::Result<f64, D::Error> {
    Option::deserialize(from).map(|area| area.unwrap_or(f64::INFINITY))
}

/// A part.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Part {
    /// Its label.
    pub label: u32,
    /// Its faces.
    pub faces: u64,
    /// Its area, in the squared unit of the file; infinite beyond the range of doubles, which JSON writes as `null`.
    #[serde(deserialize_with = "infinite_if_null")]
    pub area: f64,
    /// Its colour.
    pub colour: [u8; 3],
    /// Share of people expected to have such a part, 0 to 1; absent if the parts are not those of the decision.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expected_agreement: Option<f64>,
    /// Whether that is less than half: a band, a sliver, a crumb, or a boundary without a basis in the surface.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unsure: Option<bool>,
    /// Its name, if it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
}

/// A segmented mesh.
#[derive(Clone, Debug)]
pub struct SegmentedMesh {
    /// One part per face, in file order (n).
    pub labels: MappedSlice<u32>,
    /// The confidence of each label, 0 to 1 (n).
    pub quality: MappedSlice<f32>,
    /// The labels on the mesh's proxy, and its key, if parts were decided there on finer triangles.
    pub fine: Option<(FineLabels, String)>,
    /// One colour per part; adjacent parts differ.
    pub colours: Vec<[u8; 3]>,
    /// Name of each part, empty if it has none; the list is empty if no part has one.
    pub names: Vec<String>,
    /// Part of each cell (S), before refinement of boundaries; empty if parts are not decided on cells.
    pub cell_labels: Vec<u32>,
    /// How good the file's order was, and whether it was kept.
    pub order: OrderFacts,
    /// Facts about the mesh from building the graph.
    pub graph: GraphFacts,
    /// The numbers behind the report.
    pub numbers: SegmentStats,
}

impl SegmentedMesh {
    /// Labels, colours, confidences and names in the form that writers take.
    pub fn labelling(&self) -> Labelling<'_> {
        let fine = self.fine.as_ref().map(|(fine, _)| fine);
        Labelling {
            labels: &self.labels,
            colours: &self.colours,
            quality: Some(&self.quality),
            names: &self.names,
            fine,
        }
    }

    /// The parts, by label.
    pub fn parts(&self) -> Vec<Part> {
        let (numbers, unit) = (&self.numbers, self.graph.frame.scale.powi(2));
        let part = |(label, ((&faces, &area), &colour)): (usize, ((&u64, &f64), &[u8; 3]))| {
            let agreement = numbers.expected_agreement().get(label).copied();
            Part {
                label: label as u32,
                faces,
                // A part without area has none in any unit.
                area: if area > 0. { area * unit } else { 0. },
                colour,
                expected_agreement: agreement,
                unsure: agreement.map(|share| share < UNSURE),
                name: self.names.get(label).filter(|name| !name.is_empty()).cloned(),
            }
        };
        numbers.faces.iter().zip(&numbers.area).zip(&self.colours).enumerate().map(part).collect()
    }
}

/// The key of the labels of `graph`.
pub(super) fn stage_key(graph: &DualGraph, params: &SegmentParams, seed: u64) -> StageKey {
    StageKey::new(STAGE, LABELS_VERSION, json!({"graph": graph.key, "params": params, "seed": seed}))
}

/// Removes the labels from the manifest, since their files are about to be written: if the run is killed meanwhile,
/// they count as missing rather than damaged. Returns their record.
///
/// # Errors
/// [`crate::base::Error::Io`].
pub(super) fn begin(work: &WorkDir) -> Result<Option<StageRecord>> {
    let before = work.remove_record(STAGE)?;
    work.remove(PROXY_LABELS);
    Ok(before)
}

/// Brings labels into file order, colours the parts and records the result. The caller calls [`begin`] before it writes
/// labels.
pub(super) fn label(
    graph: &DualGraph,
    order: NodeOrder,
    clustered: Clustered,
    params: &SegmentParams,
    context: Context<'_>,
) -> Result<SegmentedMesh> {
    let mut pairs = touching(graph, &clustered.labels, clustered.boundary_nodes.as_deref(), context.run)?;
    if let Some(decided) = &clustered.on_proxy {
        // Where faces are split, other parts touch.
        pairs.extend_from_slice(&decided.pairs);
        pairs.sort_by_key(|&(a, b, _)| (a, b));
        pairs.dedup_by_key(|pair| (pair.0, pair.1));
    }
    let mut numbers = clustered.numbers;
    numbers.landmarks.iter_mut().for_each(|node| *node = order.face(*node));
    let labels = order.restore(LABELS, clustered.labels, context)?;
    let quality = order.restore(QUALITY, clustered.quality, context)?;
    let fine = clustered.on_proxy.map(|decided| {
        let fine = decided.keep(&order, &labels, context.work)?;
        Ok((fine, decided.proxy.key().to_owned()))
    });
    let mut colours = colours::assign(numbers.faces.len(), &pairs);
    if let Some(tiny_components) = numbers.tiny_components_label {
        colours[tiny_components as usize] = GREY;
    }
    let PartMarks { mut names, colours: own, edits, corrected, decision } = clustered.marks;
    for (&part, &colour) in &own {
        if let Some(slot) = colours.get_mut(part as usize) {
            *slot = colour;
        }
    }
    if !names.is_empty() {
        names.resize(colours.len(), String::new());
    }
    let result = SegmentedMesh {
        colours,
        names,
        cell_labels: clustered.cell_labels,
        labels,
        quality,
        fine: fine.transpose()?,
        order: order.facts,
        graph: graph.facts.clone(),
        numbers,
    };
    let facts = LabelFacts { edits, corrected, decision, ..LabelFacts::of(&result) };
    let stage = stage_key(graph, params, context.run.seed);
    context.work.record_stage(stage, files(&result), &facts, 0.)?;
    Ok(result)
}

/// Records `result` again after names or colours have been changed.
///
/// # Errors
/// [`crate::base::Error::Io`].
pub fn keep(result: &SegmentedMesh, context: Context<'_>) -> Result<()> {
    keep_as(context.work.manifest().stages.remove(STAGE), result, context.work)
}

/// Records `result`, whose labels are in the work directory as [`LABELS`], in place of the record `stage` returned by
/// [`begin`].
pub(super) fn keep_as(stage: Option<StageRecord>, result: &SegmentedMesh, work: &WorkDir) -> Result<()> {
    let Some(stage) = stage else { return Ok(()) };
    let before = serde_json::from_value::<LabelFacts>(stage.facts).unwrap_or_default();
    let key = StageKey { name: STAGE, version: LABELS_VERSION, key: stage.key, inputs: stage.inputs };
    let LabelFacts { edits, corrected, decision, .. } = before;
    let facts = LabelFacts { edits, corrected, decision, ..LabelFacts::of(result) };
    work.record_stage(key, files(result), &facts, 0.)
}

/// The files of `result`.
fn files(result: &SegmentedMesh) -> &'static [&'static str] {
    let all = &[LABELS, QUALITY, PROXY_LABELS];
    if result.fine.is_some() { all } else { &all[..2] }
}

/// Gives the parts of the `fine` labels other numbers, the new one of each in `number`, as in the `labels` of faces.
///
/// # Errors
/// [`crate::base::Error::Io`].
#[cfg(feature = "correspondence")]
pub(super) fn renumber_fine(fine: FineLabels, number: &[u32], labels: &[u32], work: &WorkDir) -> Result<FineLabels> {
    let new = |two: &[u32]| [two[0], number.get(two[1] as usize).copied().unwrap_or(two[1])];
    let all: Vec<[u32; 2]> = fine.triangles.chunks_exact(2).map(new).collect();
    let triangles = work.write(PROXY_LABELS, all.as_flattened(), 2)?;
    Ok(FineLabels { triangles, belongs_to: FineLabels::hash(labels), ..fine })
}

/// The options used for the labels in `work`; `cluster` may have been run with others than those in the record.
pub fn method(work: &WorkDir) -> Option<SegmentParams> {
    let stage = work.manifest().stages.remove(STAGE)?;
    serde_json::from_value(stage.inputs.get("params")?.clone()).ok()
}

/// Labels of a work directory, as written by `cluster`.
#[derive(Clone, Debug)]
pub struct Labels {
    /// One part per face, in file order (n).
    pub labels: MappedSlice<u32>,
    /// The confidence of each label, 0 to 1 (n).
    pub quality: MappedSlice<f32>,
    /// The labels on the mesh's proxy, if parts were decided there on finer triangles.
    pub fine: Option<FineLabels>,
    /// The parts, by label.
    pub parts: Vec<Part>,
    /// The edits that produced them.
    pub edits: Option<Edits>,
    /// Whether they differ from the cut that the options give on the kept hierarchy: they are corrected, or cut from
    /// another hierarchy.
    pub corrected: bool,
    /// The common label of tiny components, if they do not join parts.
    pub tiny_components_label: Option<u32>,
    /// The common label of walls of cavities, if they do not follow the outside.
    pub walls_label: Option<u32>,
}

/// What the manifest records of labels.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct LabelFacts {
    /// The parts, by label.
    pub parts: Vec<Part>,
    /// The file of edits that produced the labels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub edits: Option<String>,
    /// [`PartMarks::corrected`].
    #[serde(default)]
    pub corrected: bool,
    /// [`PartMarks::decision`].
    #[serde(default)]
    pub decision: Option<String>,
    /// [`SegmentStats::tiny_components_label`].
    pub tiny_components_label: Option<u32>,
    /// [`SegmentStats::walls_label`].
    pub walls_label: Option<u32>,
    /// The key of the proxy on whose finer triangles the parts were decided.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub proxy: Option<String>,
}

impl LabelFacts {
    /// Of labels that nobody has corrected.
    fn of(result: &SegmentedMesh) -> Self {
        let SegmentStats { tiny_components_label, walls_label, .. } = result.numbers;
        let proxy = result.fine.as_ref().map(|(_, key)| key.clone());
        Self { parts: result.parts(), tiny_components_label, walls_label, proxy, ..Self::default() }
    }
}

/// The key of the decision from which the labels in `work` were cut, if recorded.
pub(super) fn decision_of(work: &WorkDir) -> Option<String> {
    let stage = work.manifest().stages.remove(STAGE)?;
    Some(stage.facts.get("decision")?.as_str()?.to_string())
}

impl Labels {
    /// The labels in `work`.
    ///
    /// # Errors
    /// [`crate::base::Error::WorkDir`] if there are none.
    pub fn read(work: &WorkDir) -> Result<Self> {
        let remedy = "compute them first: stage `labels`";
        let facts = work.finished_stage_named::<LabelFacts>(STAGE, LABELS_VERSION, remedy)?.facts;
        let labels = work.open_array::<u32>(LABELS)?;
        let labels = work.indices(LABELS, labels.len(), facts.parts.len())?;
        let quality = work.array_of(QUALITY, labels.len())?;
        let edits =
            facts.edits.as_ref().map(|text| Edits::of_text(text.as_bytes(), &work.place(MANIFEST))).transpose()?;
        let LabelFacts { parts, corrected, tiny_components_label, walls_label, proxy, .. } = facts;
        let fine = proxy.map(|key| fine_labels(&key, &labels, parts.len(), work)).transpose()?.flatten();
        Ok(Self { labels, quality, fine, parts, edits, corrected, tiny_components_label, walls_label })
    }

    /// One colour per part.
    pub fn colours(&self) -> Vec<[u8; 3]> {
        self.parts.iter().map(|part| part.colour).collect()
    }

    /// One name per part, empty if it has none; an empty list if no part has one.
    pub fn names(&self) -> Vec<String> {
        let some = self.parts.iter().any(|part| part.name.is_some());
        self.parts.iter().filter(|_| some).map(|part| part.name.clone().unwrap_or_default()).collect()
    }
}

/// The labels on the proxy `key` in `work`, below `parts`, where faces have `labels`; `None` if the mesh has
/// another proxy by now.
fn fine_labels(key: &str, labels: &[u32], parts: usize, work: &WorkDir) -> Result<Option<FineLabels>> {
    let Some(proxy) = ProxyMesh::with_key(key, labels.len(), work)? else { return Ok(None) };
    let of_face = work.array_of::<u32>(PROXY_LABELS, 2 * proxy.len())?;
    if of_face.chunks_exact(2).any(|two| two[0] as usize >= labels.len() || two[1] as usize >= parts) {
        return Err(work.damaged(PROXY_LABELS, "has a face or a label that does not exist"));
    }
    Ok(Some(proxy.fine_labels(of_face, labels)))
}

/// Pairs of adjacent parts, ascending, with the length of their common boundary in the frame (at least 1e-9).
/// `boundary_nodes` are those with a neighbour of another label, ascending; without them all nodes are examined.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn touching(
    graph: &DualGraph,
    labels: &[u32],
    boundary_nodes: Option<&[u32]>,
    run: &Run,
) -> Result<Vec<(u32, u32, f64)>> {
    let n = labels.len();
    let shared = graph.edges.shared();
    let chunks = run.map_ranges(n, CHUNK, |range| {
        let mut pairs: BTreeMap<(u32, u32), f64> = BTreeMap::new();
        let place = |node: usize, nodes: &[u32]| nodes.partition_point(|&other| (other as usize) < node);
        let few = boundary_nodes.map(|nodes| &nodes[place(range.start, nodes)..place(range.end, nodes)]);
        if few.is_none() {
            shared.will_need(range.clone(), run);
            run.will_need(labels, range.clone());
        }
        let all = if few.is_none() { range } else { 0..0 };
        for i in few.unwrap_or_default().iter().map(|&node| node as usize).chain(all) {
            for (e, j) in shared.entries(i as u32) {
                let j = j as usize;
                if j > i && labels[i] != labels[j] {
                    let pair = (labels[i].min(labels[j]), labels[i].max(labels[j]));
                    *pairs.entry(pair).or_default() += f64::from(shared.length(i as u32, e).abs());
                }
            }
        }
        Ok(pairs)
    })?;
    let mut all: BTreeMap<(u32, u32), f64> = BTreeMap::new();
    for (pair, length) in chunks.into_iter().flatten() {
        *all.entry(pair).or_default() += length;
    }
    Ok(all.into_iter().map(|((a, b), length)| (a, b, length.max(1e-9))).collect())
}
