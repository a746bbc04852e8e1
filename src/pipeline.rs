//! The recipe of `segment`: from an opened mesh to a label a face.
//!
//! ```text
//! mesh ─▶ dual graph ─▶ weights ─▶ landmarks ─▶ rows [A B] ─▶ embedding ─▶ clusters ─▶ labels ─▶ colours
//! ```
//! Every arrow is a stage in the work directory: reused where its inputs and options are the same.

pub mod contacts;
pub mod input;
pub mod report;

use crate::base::{Error, Result};
use crate::cluster::assign::{Totals, assign, exactly};
use crate::cluster::kmeans::{KMeans, KMeansParams, Points};
use crate::distance::DistanceRows;
use crate::distance::landmarks::Sampling;
use crate::distance::rows::RowParams;
use crate::graph::order::{Order, OrderFacts, Ordered};
use crate::graph::{DualGraph, GraphFacts, Metric};
use crate::mesh::{Opened, colours};
use crate::spectral::quality::Gamma;
use crate::spectral::{Columns, Embedding, EmbeddingParams};
use crate::store::{MappedSlice, Run, WorkDir};
use report::Numbers;
use serde::Serialize;
use serde_json::json;
use std::path::Path;

/// How faces become parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Cluster {
    /// K-means in the embedding.
    KMeans,
}

/// What `segment` is asked to do.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct SegmentParams {
    /// Number of parts K.
    pub parts: Option<usize>,
    /// Number of landmarks l; by default [`default_landmarks`].
    pub landmarks: Option<usize>,
    /// How landmarks are chosen.
    pub sampling: Sampling,
    /// Form of the edge weights.
    pub metric: Metric,
    /// In which order faces become nodes.
    pub order: Order,
    /// How faces become parts.
    pub cluster: Cluster,
    /// How rows become coordinates; by default [`EmbeddingParams::for_parts`].
    pub embedding: Option<EmbeddingParams>,
}

impl Default for SegmentParams {
    fn default() -> Self {
        Self {
            parts: None,
            landmarks: None,
            sampling: Sampling::default(),
            metric: Metric::default(),
            order: Order::default(),
            cluster: Cluster::KMeans,
            embedding: None,
        }
    }
}

/// Landmarks for `parts` parts: twice as many, so that every part can hold two, at least 10, at most 60.
pub fn default_landmarks(parts: usize) -> usize {
    (2 * parts).clamp(10, 60).max(parts + 1)
}

/// A segmented mesh.
#[derive(Clone, Debug)]
pub struct Segmentation {
    /// A part a face, in the order of the file (n).
    pub labels: MappedSlice<u32>,
    /// How sure each label is, 0 to 1 (n).
    pub quality: MappedSlice<f32>,
    /// A colour a part; neighbours differ.
    pub colours: Vec<[u8; 3]>,
    /// How good the file's order was, and whether it was kept.
    pub order: OrderFacts,
    /// What the graph learned of the mesh.
    pub graph: GraphFacts,
    /// The numbers behind the report.
    pub numbers: Numbers,
}

/// Cuts the mesh of `opened` into parts. `identity` says which input it is (see [`input::identity`]).
///
/// # Errors
/// [`Error::Parameter`] without a number of parts or with one out of range, [`Error::Unusable`] for more parts
/// than faces, [`Error::Io`], [`Error::Memory`], [`Error::Cancelled`].
pub fn segment(
    opened: &Opened,
    identity: &serde_json::Value,
    params: &SegmentParams,
    work: &WorkDir,
    run: &Run,
) -> Result<Segmentation> {
    let path = opened.document.path();
    let parts = check(params, path, opened.mesh.faces.len())?;
    let l = params.landmarks.unwrap_or(default_landmarks(parts));

    let ordered = Ordered::build(&opened.mesh, params.order, identity, work, run)?;
    let graph = DualGraph::build(&ordered.mesh, path, &ordered.identity, work, run)?;
    let weighted = graph.weighted(params.metric, work, run)?;
    let row_params = RowParams { l, sampling: params.sampling };
    let rows = DistanceRows::build(&weighted, &graph.nodes, row_params, work, run)?;
    let embedding_params = params.embedding.unwrap_or(EmbeddingParams::for_parts(parts));
    let (clustered, seconds) =
        run.stage("assign", "faces", rows.nodes as u64, || k_means(&graph, &rows, embedding_params, parts, work, run))?;

    let touching = contacts::between(&graph, &clustered.labels, run)?;
    let mut numbers = clustered.numbers;
    numbers.landmarks = rows.landmarks.iter().map(|&node| ordered.face(node)).collect();
    numbers.seconds_assign = seconds;
    let labels = ordered.restore("labels.npy", clustered.labels, work, run)?;
    let quality = ordered.restore("quality.npy", clustered.quality, work, run)?;
    let options = &clustered.options;
    let key = crate::store::workdir::key_of(options);
    work.stamp("labels", &key, options, &["labels.npy", "quality.npy"], &numbers.faces, seconds)?;
    Ok(Segmentation {
        labels,
        quality,
        colours: colours::assign(parts, &touching),
        order: ordered.facts,
        graph: graph.facts,
        numbers,
    })
}

/// The number of parts, where it makes sense for this mesh.
fn check(params: &SegmentParams, path: &Path, faces: usize) -> Result<usize> {
    let Some(parts) = params.parts else {
        return Err(Error::parameter("-k", "the number of parts is missing", "give it, as in -k 6"));
    };
    if parts == 0 {
        return Err(Error::parameter("-k", "0 parts", "choose at least 1"));
    }
    if parts > faces {
        return Err(Error::unusable(
            path,
            format!("has {faces} faces, fewer than the {parts} parts asked for"),
            "choose a smaller -k",
        ));
    }
    Ok(parts)
}

/// Labels and the numbers learned on the way to them.
struct Clustered {
    labels: MappedSlice<u32>,
    quality: MappedSlice<f32>,
    numbers: Numbers,
    /// What the labels depend on.
    options: serde_json::Value,
}

/// The paper's way: K-means on sampled columns of the embedding, then one pass over all of them.
fn k_means(
    graph: &DualGraph,
    rows: &DistanceRows,
    params: EmbeddingParams,
    parts: usize,
    work: &WorkDir,
    run: &Run,
) -> Result<Clustered> {
    let n = rows.nodes;
    let columns = Columns::sample(rows, &graph.nodes, run.seed);
    let embedding = Embedding::fit(rows, &columns, params)?;
    let coordinates = embedding.columns(&columns);
    let points = Points { coordinates: &coordinates, weights: &columns.shares };
    let centres = KMeans::fit(points, embedding.dimensions, KMeansParams::new(parts), run)?;
    let gamma = Gamma::new(rows, params.kernel, embedding.sigma);

    let mut labels = work.array::<u32>("labels.npy", &[n])?;
    let mut quality = work.array::<f32>("quality.npy", &[n])?;
    let (label_data, quality_data) = (labels.data(), quality.data());
    let mut totals: Totals =
        assign(rows, &graph.nodes, &embedding, &centres, Some(&gamma), label_data, quality_data, run)?;
    exactly(&mut totals, &graph.nodes, label_data, quality_data);
    let options = json!({"stage": "labels", "rows": rows.key, "embedding": params, "parts": parts, "seed": run.seed});
    let (labels, quality) = (labels.finish(false)?, quality.finish(false)?);
    let gamma = gamma.of_sum(totals.gamma);
    Ok(Clustered {
        labels,
        quality,
        options,
        numbers: Numbers {
            landmarks: Vec::new(),
            sigma: embedding.sigma,
            eigenvalues: embedding.eigenvalues,
            dropped_eigenpairs: embedding.dropped,
            negative_mass: embedding.negative_mass,
            gamma,
            faces: totals.faces,
            area: totals.area,
            seconds_assign: 0.,
        },
    })
}
