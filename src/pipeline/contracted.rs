//! What all methods do with a large mesh before they decide on parts: weights of its surface, its contraction, and the
//! transfer of labels from contracted nodes to the faces.
//!
//! Cost: that of the stages ([`SurfaceStage`], [`Contraction`]).

use super::decision::CONTRACTED;
use super::params::SegmentParams;
use super::surface::{Kind, PreparedSurface, SurfaceStage, WeightedSurface};
use super::units::Units;
use crate::base::{Error, Result};
use crate::cluster::contract::{ContractedSurface, Contraction};
use crate::distance::shard;
use crate::graph::dual::TurningNormals;
use crate::graph::{DualGraph, WeightedGraph};
use crate::store::stage::Stage;
use crate::store::{Context, WorkDir};
use std::sync::Arc;

/// The surface of `graph`, and the graph weighted with the surface's normals and unit of length.
pub(super) fn weighted(
    graph: &DualGraph,
    params: &SegmentParams,
    context: Context<'_>,
) -> Result<(PreparedSurface, WeightedGraph)> {
    let mut surface =
        context.stage(SurfaceStage { graph, kind: Kind::Faces, cells: !params.contracts(graph.nodes.len()) })?;
    let area = 1. / f64::from(surface.shares.unit).powi(2);
    let (radius, version) = (surface.radius, SurfaceStage::VERSION);
    let normals = surface.normals.as_ref().map(|normals| TurningNormals { normals, radius, version });
    let weighted = graph.weighted_with(params.metric, normals, area, context)?;
    surface.release_normals(context.work)?;
    Ok((surface, weighted))
}

/// The contraction of `whole`, and its work directory.
pub(super) fn contraction(
    whole: WeightedSurface<'_>,
    context: Context<'_>,
) -> Result<(Arc<WorkDir>, ContractedSurface)> {
    let inner = context.work.inner(CONTRACTED)?;
    let WeightedSurface { graph, weighted, surface } = whole;
    let stage = Contraction { graph, weighted, shares: &surface.shares, whole: context.work };
    let small = Context::new(&inner, context.run).stage(stage)?;
    Ok((inner, small))
}

/// The same; rows over it that were computed in shards are merged.
pub(super) fn contraction_and_shares(
    whole: WeightedSurface<'_>,
    context: Context<'_>,
) -> Result<(Arc<WorkDir>, ContractedSurface)> {
    let (inner, small) = contraction(whole, context)?;
    if !inner.is_temporary() && shard::any(&inner)? {
        match shard::merge(Context::new(&inner, context.run)) {
            Err(Error::WorkDir { path, problem, .. }) => {
                let text = format!("{}: {problem}: rows are computed without the shards", path.display());
                context.run.progress.note_of_work(&text)
            }
            merged => drop(merged?),
        }
    }
    Ok((inner, small))
}

/// The contracted nodes as units, with their labels and confidences (u), and the parts of labels beyond the parts.
pub(super) fn units_of(small: ContractedSurface, label: Vec<u32>, further: Vec<u32>, confidence: Vec<f64>) -> Units {
    let steps = small.graph.edges.by_distance();
    let touches = |node: u32| steps.neighbours(node).any(|(next, _)| label[next as usize] != label[node as usize]);
    let at_boundary = Some((0..label.len() as u32).map(touches).collect());
    Units { of_node: small.of_node, label, further, at_boundary, areas: Some(small.areas), confidence }
}

/// The faces from which the contracted nodes `landmarks` grew.
pub(super) fn faces_of(landmarks: &[u32], small: &ContractedSurface) -> Vec<u32> {
    landmarks.iter().filter_map(|&node| small.seeds.get(node as usize).copied()).collect()
}
