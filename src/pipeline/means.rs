//! The paper's methods: centres by K-means or iterative 2-means on sampled columns of the embedding, then one pass over
//! all of them.
//!
//! Cost: fitting is constant in the size of the mesh (16,384 columns); the pass reads 4 l bytes per face.

use super::edits::PartMarks;
use super::labels::{Clustered, SegmentStats};
use super::params::{Cluster, SegmentParams, default_landmarks};
use super::sample::rows;
use crate::base::Result;
use crate::cluster::kmeans::{Assignment, KMeans, KMeansParams, WeightedPoints, assign, exactly};
use crate::cluster::parts::PartCount;
use crate::cluster::two_means::{self, TwoMeansParams};
use crate::distance::DistanceRows;
use crate::graph::DualGraph;
use crate::graph::WeightedGraph;
use crate::spectral::measures::Gamma;
use crate::spectral::{Embedding, EmbeddingParams, SampledColumns};
use crate::store::Context;
use crate::store::mapped::Access;
use serde::Serialize;

/// How centres are found.
#[derive(Clone, Copy, Debug, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Fit {
    /// K of them by K-means.
    KMeans(usize),
    /// By halving parts.
    TwoMeans(TwoMeansParams),
}

/// Embeds, fits centres and labels every face.
pub(super) fn k_means(
    graph: &DualGraph,
    rows: &DistanceRows,
    params: EmbeddingParams,
    fit: Fit,
    context: Context<'_>,
) -> Result<Clustered> {
    let n = rows.nodes;
    let nodes = graph.nodes.view();
    if !rows.is_empty() && context.run.is_paged(rows.row(0)) {
        // What is needed is asked for. Around a page that is missed, megabytes would be read.
        rows.distances.advise(Access::Random);
    }
    let mut quality = context.work.array::<f32>("quality.npy", &[n])?;
    let quality_data = quality.data();
    // Areas until confidences are known: geometry is looked at once.
    nodes.areas(quality_data, context.run)?;
    let areas = &quality_data[..];
    let columns = SampledColumns::sample(rows, |node| areas[node], context.run);
    let embedding = Embedding::fit(rows, &columns, params)?;
    let coordinates = embedding.columns(&columns);
    let points = WeightedPoints { coordinates: &coordinates, weights: &columns.shares };
    let centres = match fit {
        Fit::KMeans(parts) => KMeans::fit(points, embedding.dimensions, KMeansParams::new(parts), context.run)?,
        Fit::TwoMeans(params) => two_means::fit(points, embedding.dimensions, params, context.run)?,
    };
    let gamma = Gamma::new(rows, params.kernel, embedding.sigma);

    let mut labels = context.work.array::<u32>("labels.npy", &[n])?;
    let label_data = labels.data();
    let assignment = Assignment { rows, embedding: &embedding, centres: &centres, gamma: Some(&gamma) };
    let mut totals = assign(assignment, label_data, quality_data, context.run)?;
    exactly(&mut totals, nodes, label_data, quality_data);
    let (labels, quality) = (labels.finish(false)?, quality.finish(false)?);
    let gamma = gamma.of_sum(totals.gamma);
    Ok(Clustered {
        labels,
        boundary_nodes: None,
        quality,
        marks: PartMarks::default(),
        cell_labels: Vec::new(),
        numbers: SegmentStats {
            landmarks: rows.landmarks.clone(),
            sigma: embedding.sigma,
            eigenvalues: embedding.eigenvalues,
            dropped_eigenpairs: embedding.dropped,
            negative_mass: embedding.negative_mass,
            gamma,
            faces: totals.faces,
            area: totals.area,
            ..SegmentStats::default()
        },
    })
}

/// How centres in the embedding are found, and how many parts to provide landmarks for; nothing where parts are
/// decided on cells.
pub(super) fn fit(params: &SegmentParams, faces: usize) -> Option<(Fit, usize)> {
    let bounds = |least, most: usize| Fit::TwoMeans(TwoMeansParams::between(least, most.min(faces)));
    match (params.cluster, params.parts.count) {
        (Cluster::KMeans, PartCount::Exactly(k)) => Some((Fit::KMeans(k), k)),
        (Cluster::TwoMeans, PartCount::Exactly(k)) => Some((bounds(k, k), k)),
        (Cluster::TwoMeans, PartCount::Found) => Some((bounds(1, two_means::MOST), two_means::MOST)),
        (Cluster::TwoMeans, PartCount::Between(least, most)) => Some((bounds(least, most), most)),
        _ => None,
    }
}

/// The rows for the paper's methods.
pub(super) fn rows_for_means(
    graph: &DualGraph,
    weighted: &WeightedGraph,
    parts: usize,
    params: &SegmentParams,
    context: Context<'_>,
) -> Result<DistanceRows> {
    let l = params.landmarks.unwrap_or(default_landmarks(parts));
    rows(graph, weighted, l, params, context)
}
