//! The paper's methods: centres by K-means or iterative 2-means on sampled columns of the embedding, then one pass over
//! all columns.
//!
//! A large mesh is processed on its contraction, as for the default method's decision: rows are cheap there, so there
//! are more of them. Faces get the label of their contracted node, and those near boundaries are relabelled.
//!
//! Cost: fitting is constant in the size of the mesh (16,384 columns). With rows over all faces, the pass reads 4 l
//! bytes per face; with a contraction it takes one front over all faces, and one in the narrow bands.

use super::contracted::{contraction_and_shares, faces_of, units_of, weighted};
use super::labels::{self, Clustered, LABELS, QUALITY, SegmentStats};
use super::params::{Cluster, SegmentParams};
use super::sample::rows;
use super::surface::WeightedSurface;
use super::units::Units;
use crate::base::Result;
use crate::cluster::boundary::{self, BoundaryMethod, RefinedLabels};
use crate::cluster::kmeans::{Assignment, KMeans, KMeansParams, WeightedPoints, assign, fill_empty_parts};
use crate::cluster::part_totals::PartTotals;
use crate::cluster::two_means::{self, TwoMeansParams};
use crate::distance::DistanceRows;
use crate::graph::{DualGraph, NodeView};
use crate::spectral::measures::Gamma;
use crate::spectral::{Embedding, EmbeddingParams, SampledColumns};
use crate::store::mapped::Access;
use crate::store::{Context, Run};
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

/// The embedding of faces, and how centres are found in it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Means {
    /// The embedding.
    pub embedding: EmbeddingParams,
    /// The centres.
    pub fit: Fit,
}

/// Embeds, fits centres and labels every node: fills `labels` and `quality` (n).
fn k_means(
    nodes: NodeView<'_>,
    rows: &DistanceRows,
    means: Means,
    labels: &mut [u32],
    quality: &mut [f32],
    run: &Run,
) -> Result<SegmentStats> {
    if !rows.is_empty() && run.is_paged(rows.row(0)) {
        // Exactly what is needed is requested explicitly; default read-ahead would read megabytes around each missed
        // page.
        rows.distances.advise(Access::Random);
    }
    let _grant = Cluster::KMeans.grant(rows.len(), rows.nodes, run)?;
    // `quality` holds areas until confidences are known, so that geometry is read only once.
    nodes.areas(quality, run)?;
    let areas = &quality[..];
    let columns = SampledColumns::sample(rows, |node| areas[node], run)?;
    let embedding = Embedding::fit(rows, &columns, means.embedding)?;
    let coordinates = embedding.columns(&columns);
    let points = WeightedPoints { coordinates: &coordinates, weights: &columns.shares };
    let centres = match means.fit {
        Fit::KMeans(parts) => KMeans::fit(points, embedding.dimensions, KMeansParams::new(parts), run)?,
        Fit::TwoMeans(params) => two_means::fit(points, embedding.dimensions, params, run)?,
    };
    let gamma = Gamma::new(rows, means.embedding.kernel, embedding.sigma);

    let assignment = Assignment { rows, embedding: &embedding, centres: &centres, gamma: Some(&gamma) };
    let (mut totals, gamma_sum) = assign(assignment, labels, quality, run)?;
    fill_empty_parts(&mut totals, nodes, labels, quality, &run.cancel)?;
    let gamma = gamma.of_sum(gamma_sum);
    Ok(SegmentStats {
        landmarks: rows.landmarks.clone(),
        sigma: embedding.sigma,
        eigenvalues: embedding.eigenvalues,
        dropped_eigenpairs: embedding.dropped,
        negative_mass: embedding.negative_mass,
        gamma,
        gamma_per_node: gamma / rows.nodes.max(1) as f64,
        faces: totals.faces,
        area: totals.area,
        ..SegmentStats::default()
    })
}

/// How centres in the embedding of `faces` faces are found; `None` if parts are decided on cells.
pub(super) fn fit(params: &SegmentParams, faces: usize) -> Option<Fit> {
    let most = params.centres()?;
    Some(match params.cluster {
        Cluster::KMeans => Fit::KMeans(most),
        _ => Fit::TwoMeans(TwoMeansParams::between(params.parts.count.least(), most.min(faces))),
    })
}

/// Labels every face of `graph`, with rows over all of them.
pub(super) fn over_faces(
    graph: &DualGraph,
    rows: &DistanceRows,
    means: Means,
    context: Context<'_>,
) -> Result<Clustered> {
    let Context { work, run } = context;
    let n = rows.nodes;
    let (mut labels, mut quality) = (work.array::<u32>(LABELS, &[n])?, work.array::<f32>(QUALITY, &[n])?);
    let (to_labels, to_quality) = (labels.data(), quality.data());
    let assign = || k_means(graph.nodes.view(), rows, means, to_labels, to_quality, run);
    let (numbers, _) = run.stage("assign", "faces", n as u64, assign)?;
    labels::begin(work)?;
    let (labels, quality) = (labels.finish(false)?, quality.finish(false)?);
    Ok(Clustered::of_faces(labels, None, quality, numbers))
}

/// The contracted nodes of `whole` and their labels, with rows over the contraction.
pub(super) fn on_contraction(
    whole: WeightedSurface<'_>,
    fit: Fit,
    params: &SegmentParams,
    context: Context<'_>,
) -> Result<(Units, SegmentStats)> {
    let run = context.run;
    let (inner, small) = contraction_and_shares(whole, context)?;
    let l = params.landmarks_of(whole.graph.nodes.len());
    let rows = rows(&small.graph, &small.weighted, l, params, Context::new(&inner, run))?;
    let n = rows.nodes;
    let (mut labels, mut quality) = (vec![0; n], vec![0.; n]);
    let means = Means { embedding: params.embedding_or_default(), fit };
    let assign = || k_means(small.graph.nodes.view(), &rows, means, &mut labels, &mut quality, run);
    let (numbers, _) = run.stage("assign", "nodes", n as u64, assign)?;
    rows.release(&inner)?;
    let landmarks = faces_of(&numbers.landmarks, &small);
    let confidence = quality.into_iter().map(f64::from).collect();
    Ok((units_of(small, labels, Vec::new(), confidence), SegmentStats { landmarks, ..numbers }))
}

/// Labels every face of `graph` via its contraction.
pub(super) fn contracted(
    graph: &DualGraph,
    fit: Fit,
    params: &SegmentParams,
    context: Context<'_>,
) -> Result<Clustered> {
    let (surface, weighted) = weighted(graph, params, context)?;
    let whole = WeightedSurface { graph, weighted: &weighted, surface: &surface };
    let (units, numbers) = on_contraction(whole, fit, params, context)?;
    let parts = numbers.faces.len();
    labels::begin(context.work)?;
    let (refined, _) = context.run.stage("boundaries", "faces", graph.nodes.len() as u64, || {
        boundary::refine(whole.boundaries(params.metric), units.cells(), BoundaryMethod::Front, LABELS, context)
    })?;
    let RefinedLabels { labels, boundary_nodes } = refined;
    weighted.release(context.work)?;
    let quality = units.confidences(context)?;
    let PartTotals { faces, area } = units.totals(graph, &labels, parts, true, context.run)?;
    let tiny_faces = surface.shares.tiny_nodes;
    let numbers = SegmentStats { faces, area, radius: surface.radius, tiny_faces, ..numbers };
    Ok(Clustered::of_faces(labels, Some(boundary_nodes), quality, numbers))
}
