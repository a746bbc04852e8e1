//! The recipe of `segment`: from an opened mesh to one label per face.
//!
//! ```text
//! mesh ─▶ dual graph ─▶ weights ─▶ landmarks ─▶ rows [A B] ─┬▶ embedding ─▶ centres ─▶ labels ─▶ colours
//!                                                            └▶ cells ─▶ parts ─▶ boundaries ─┘
//! ```
//! Every arrow is a stage in the work directory: reused where its inputs and options are the same.

pub mod calibrate;
pub mod contacts;
#[cfg(feature = "correspondence")]
pub mod correspond;
pub mod cuts;
pub mod decision;
pub mod embed;
pub mod input;
mod k_means;
pub mod kept;
mod parts;
pub mod plan;
pub mod report;
mod sample;
pub mod sequence;
pub mod sharding;
pub mod stages;
mod surface;

use crate::apps::colours;
use crate::base::{Error, Result};
use crate::cluster::parts::{PartCount, PartsParams};
use crate::cluster::two_means::{self, TwoMeansParams};
use crate::distance::DistanceRows;
use crate::distance::rows::RowParams;
use crate::graph::WeightedGraph;
use crate::graph::order::{Order, OrderFacts};
use crate::graph::{DualGraph, GraphFacts, Metric, NodeOrder};
use crate::landmarks::Sampling;
use crate::mesh::Mesh;
use crate::spectral::EmbeddingParams;
use crate::store::stage::StageKey;
use crate::store::{Context, MappedSlice};
use k_means::Fit;
use report::SegmentStats;
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::path::Path;

/// How faces become parts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Cluster {
    /// Parts as people would cut them: over-segmented, merged by concavity and convexity, refined.
    #[default]
    Parts,
    /// The paper's: K-means in the embedding.
    KMeans,
    /// The paper's other: parts halved by 2-means in the embedding, the one that gains most first.
    TwoMeans,
}

/// What becomes of components too small to be parts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TinyComponents {
    /// Each joins the part that it floats beside.
    #[default]
    Join,
    /// All of them together are a part of their own, besides those that are found or asked for.
    Own,
}

/// How faces near the boundaries of [`Cluster::Parts`] get their labels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Boundaries {
    /// By one front between the parts' cores, which is held up on creases.
    #[default]
    Front,
    /// By Nyström's extrapolation: each face goes to the part nearest to it in the embedding.
    Embedding,
}

/// What `segment` is asked to do.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[non_exhaustive]
pub struct SegmentParams {
    /// Number of landmarks l; by default [`default_landmarks`] or [`landmarks_for_parts`].
    pub landmarks: Option<usize>,
    /// How landmarks are chosen.
    pub sampling: Sampling,
    /// Form of the edge weights.
    pub metric: Metric,
    /// In which order faces become nodes.
    pub order: Order,
    /// How faces become parts.
    pub cluster: Cluster,
    /// How many parts, and how [`Cluster::Parts`] decides on them.
    pub parts: PartsParams,
    /// Whether [`Cluster::Parts`] may contract the mesh first: a preview.
    pub coarse: bool,
    /// What becomes of components too small to be parts, with [`Cluster::Parts`].
    #[serde(default)]
    pub tiny_components: TinyComponents,
    /// How faces near boundaries get their labels, with [`Cluster::Parts`].
    #[serde(default)]
    pub boundaries: Boundaries,
    /// How rows become coordinates, for [`Cluster::KMeans`] and [`Cluster::TwoMeans`];
    /// by default [`EmbeddingParams::for_parts`].
    pub embedding: Option<EmbeddingParams>,
}

crate::base::setters::setters!(SegmentParams {
    landmarks: Option<usize>,
    sampling: Sampling,
    metric: Metric,
    order: Order,
    cluster: Cluster,
    parts: PartsParams,
    coarse: bool,
    tiny_components: TinyComponents,
    boundaries: Boundaries,
    embedding: Option<EmbeddingParams>
});

impl SegmentParams {
    /// Whether rows of distances are kept, in a work directory that is `lasting` or temporary: in one that lasts always, else
    /// where their columns are read again, by K-means, 2-means, and boundaries by the embedding.
    pub fn keeps_rows(&self, lasting: bool) -> bool {
        lasting || self.cluster != Cluster::Parts || self.boundaries == Boundaries::Embedding
    }
}

/// Landmarks for K-means into `parts` parts: twice as many, so that every part can hold two, at least 10 and at most
/// 60, but more than parts up to 512: beyond, eigenvectors would cost more than they tell apart.
pub fn default_landmarks(parts: usize) -> usize {
    (2 * parts).clamp(10, 60).max((parts + 1).min(512))
}

/// Landmarks for deciding parts on a mesh of `faces` faces: 60 where fronts are cheap, fewer where each costs. On the 190
/// models of the benchmark 1 − Rand was .094, .093, .089, .087, .087, .086 with 20, 30, 40, 60, 80, 120.
pub fn landmarks_for_parts(faces: usize) -> usize {
    match faces {
        0..=300_000 => 60,
        300_001..=2_000_000 => 40,
        2_000_001..=20_000_000 => 30,
        _ => 20,
    }
}

/// Version of how labels come of parts.
const LABELS_VERSION: u32 = 1;
/// The colour of tiny components that are a part of their own.
const TINY_COMPONENTS_COLOUR: [u8; 3] = [128; 3];

/// A segmented mesh.
#[derive(Clone, Debug)]
pub struct Segmentation {
    /// One part per face, in the order of the file (n).
    pub labels: MappedSlice<u32>,
    /// How sure each label is, 0 to 1 (n).
    pub quality: MappedSlice<f32>,
    /// One colour per part; neighbours differ.
    pub colours: Vec<[u8; 3]>,
    /// How good the file's order was, and whether it was kept.
    pub order: OrderFacts,
    /// What the graph learned of the mesh.
    pub graph: GraphFacts,
    /// The numbers behind the report.
    pub numbers: SegmentStats,
}

/// Cuts the mesh of `opened` into parts. `identity` says which input it is (see [`input::identity`]).
///
/// # Errors
/// [`Error::Parameter`] for K-means without a number of parts or with options out of range, [`Error::Unusable`] for more
/// parts than faces, [`Error::Io`], [`Error::Memory`], [`Error::Cancelled`].
pub fn segment(
    opened: &Mesh,
    identity: &serde_json::Value,
    params: &SegmentParams,
    context: Context<'_>,
) -> Result<Segmentation> {
    check(params, opened.path(), opened.faces.len())?;
    let (ordered, mut graph) = stages::graph(opened, identity, params, context)?;
    let order = ordered.into_nodes(context.work)?;
    let clustered = match fit(params, opened.faces.len()) {
        Some((fit, parts)) => {
            let weighted = graph.weighted(params.metric, context)?;
            graph.release_lengths(context.work)?;
            let rows = rows_for_means(&graph, &weighted, parts, params, context)?;
            weighted.release(context.work)?;
            let embedding = params.embedding.unwrap_or(EmbeddingParams::for_parts(dimensions(params)));
            let assign = || k_means::k_means(&graph, &rows, embedding, fit, context);
            context.run.stage("assign", "faces", rows.nodes as u64, assign)?.0
        }
        None => parts::parts(&graph, params, None, context)?,
    };
    label(&graph, order, clustered, params, context)
}

/// Brings labels into the order of the file, colours the parts and stamps the result.
fn label(
    graph: &DualGraph,
    order: NodeOrder,
    clustered: Clustered,
    params: &SegmentParams,
    context: Context<'_>,
) -> Result<Segmentation> {
    let touching = contacts::between(graph, &clustered.labels, context.run)?;
    let mut numbers = clustered.numbers;
    numbers.landmarks.iter_mut().for_each(|node| *node = order.face(*node));
    let labels = order.restore("labels.npy", clustered.labels, context)?;
    let quality = order.restore("quality.npy", clustered.quality, context)?;
    let mut colours = colours::assign(numbers.faces.len(), &touching);
    if let Some(tiny_components) = numbers.tiny_components_label {
        colours[tiny_components as usize] = TINY_COMPONENTS_COLOUR;
    }
    let inputs = json!({"graph": graph.key, "params": params, "seed": context.run.seed});
    let facts = kept::LabelFacts { faces: numbers.faces.clone(), colours: colours.clone() };
    let stage = StageKey::new("labels", LABELS_VERSION, inputs);
    context.work.stamp(stage, &["labels.npy", "quality.npy"], &facts, 0.)?;
    Ok(Segmentation { colours, labels, quality, order: order.facts, graph: graph.facts.clone(), numbers })
}

/// Coordinates wanted for the paper's ways.
fn dimensions(params: &SegmentParams) -> usize {
    if let PartCount::Exactly(k) = params.parts.count { k } else { two_means::DIMENSIONS }
}

/// The rows for the paper's ways.
fn rows_for_means(
    graph: &DualGraph,
    weighted: &WeightedGraph,
    parts: usize,
    params: &SegmentParams,
    context: Context<'_>,
) -> Result<DistanceRows> {
    let l = params.landmarks.unwrap_or(default_landmarks(parts));
    rows(graph, weighted, l, params, context)
}

/// How centres in the embedding are found, and how many parts to provide landmarks for; nothing where parts are
/// decided on cells.
fn fit(params: &SegmentParams, faces: usize) -> Option<(Fit, usize)> {
    let bounds = |least, most: usize| Fit::TwoMeans(TwoMeansParams::between(least, most.min(faces)));
    match (params.cluster, params.parts.count) {
        (Cluster::KMeans, PartCount::Exactly(k)) => Some((Fit::KMeans(k), k)),
        (Cluster::TwoMeans, PartCount::Exactly(k)) => Some((bounds(k, k), k)),
        (Cluster::TwoMeans, PartCount::Found) => Some((bounds(1, two_means::MOST), two_means::MOST)),
        (Cluster::TwoMeans, PartCount::Between(least, most)) => Some((bounds(least, most), most)),
        _ => None,
    }
}

/// The rows `[A B]` that `params` asks for.
fn rows(
    graph: &DualGraph,
    weighted: &WeightedGraph,
    l: usize,
    params: &SegmentParams,
    context: Context<'_>,
) -> Result<DistanceRows> {
    DistanceRows::build(weighted, &graph.nodes, RowParams { l, sampling: params.sampling }, context)
}

/// Refuses numbers of parts that make no sense for this mesh, and ways that exclude each other.
fn check(params: &SegmentParams, path: &Path, faces: usize) -> Result<()> {
    let preview = params.cluster == Cluster::Parts && params.coarse;
    if preview && params.boundaries == Boundaries::Embedding {
        let remedy = "leave out --coarse, or use --boundaries front";
        return Err(Error::parameter("--boundaries", "a preview has no rows over all faces", remedy));
    }
    let wanted = match params.parts.count {
        PartCount::Found if params.cluster == Cluster::KMeans => {
            let remedy = "give it, as in -k 6, or leave out --cluster kmeans";
            return Err(Error::parameter("-k", "K-means needs the number of parts", remedy));
        }
        PartCount::Between(..) if params.cluster == Cluster::KMeans => {
            return Err(Error::parameter("--parts-range", "K-means needs an exact number of parts", "give -k"));
        }
        PartCount::Found => 1,
        PartCount::Exactly(parts) => parts,
        PartCount::Between(least, most) if least > most => {
            return Err(Error::parameter(
                "--parts-range",
                format!("{least}..{most} is empty"),
                "put the smaller first",
            ));
        }
        PartCount::Between(least, _) => least,
    };
    if wanted == 0 {
        return Err(Error::parameter("-k", "0 parts", "choose at least 1"));
    }
    if wanted > faces {
        return Err(Error::unusable(
            path,
            format!("has {faces} faces, fewer than the {wanted} parts asked for"),
            "choose a smaller -k",
        ));
    }
    Ok(())
}

/// Labels and the numbers learned on the way to them.
struct Clustered {
    labels: MappedSlice<u32>,
    quality: MappedSlice<f32>,
    numbers: SegmentStats,
}
