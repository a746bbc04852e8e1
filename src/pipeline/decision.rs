//! The decision about parts as a stage: all answers at once, kept, so that another number of parts needs neither rows nor
//! members.
//!
//! Files, constant in the mesh size: `tree.json`, the merge hierarchy of cells; `superfaces.npy` and `atom_areas.npy`, the
//! cells' intersections of members; `co_association.npy` (atoms × atoms), how far any two belong together, which
//! confidences come from.

use super::report::SegmentStats;
use super::sample::{Sample, SamplingContext};
use super::surface::Surface;
use super::{SegmentParams, landmarks_for_parts};
use crate::base::{Error, Result};
use crate::cluster::parts::matrix::Square;
use crate::cluster::parts::{self, PartDecision, PartTree, Superfaces};
use crate::distance::DistanceRows;
use crate::distance::rows::RowParams;
use crate::graph::DualGraph;
use crate::graph::WeightedGraph;
use crate::spectral::eigen;
use crate::spectral::kernel::Kernel;
use crate::store::stage::options_key;
use crate::store::{Context, WorkDir};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::path::Path;

const TREE: &str = "tree.json";
const SUPERFACES: &str = "superfaces.npy";
const AREAS: &str = "superface_areas.npy";
const CO_ASSOCIATION: &str = "co_association.npy";

/// What is kept besides the files.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Facts {
    /// Landmarks l.
    pub l: usize,
    /// Seconds that deciding took.
    pub seconds: f64,
    /// The spectral numbers of the report.
    pub numbers: SegmentStats,
}

/// The decision on `surface`, made from the rows (which are made where needed), or reused.
///
/// # Errors
/// [`Error::Io`], [`Error::Parameter`], [`Error::Cancelled`].
pub(super) fn decide(
    graph: &DualGraph,
    weighted: &WeightedGraph,
    surface: &Surface,
    params: &SegmentParams,
    context: Context<'_>,
) -> Result<(PartDecision, Facts)> {
    let n = graph.nodes.len();
    let l = params.landmarks.unwrap_or(landmarks_for_parts(n));
    let row_params = RowParams { l, sampling: params.sampling };
    let options = json!({
        "stage": "decision",
        "rows": DistanceRows::key(weighted, n, row_params, context.run),
        "surface": surface.key,
        "decision": params.parts.decision,
        "ensemble_size": params.parts.ensemble_size,
        "small_part": params.parts.small_part,
        "hierarchy": 3,
        "seed": context.run.seed,
    });
    let key = options_key(&options);
    match context.work.reuse::<Facts>("decision", 1, &key) {
        Ok(facts) => {
            context.run.progress.note("decision: reused");
            return Ok((open(surface.cells.len(), context.work)?, facts));
        }
        Err(reason) => context.run.note_remake("decision", &reason),
    }
    let sample = SamplingContext { graph, weighted, surface, context }.representative(l, params)?;
    let (decided, seconds) = parts::decide(&surface.cells.graph, &sample.b, sample.len(), &params.parts, context.run)?;
    write_tree(&decided.tree, &context.work.file(TREE))?;
    context.work.write(SUPERFACES, &decided.superfaces.of_cell, 1)?;
    context.work.write(AREAS, &decided.superfaces.area, 1)?;
    context.work.write(CO_ASSOCIATION, decided.co_association.values(), decided.co_association.len())?;
    let facts = Facts { l: sample.len(), seconds, numbers: numbers(&sample) };
    context.work.stamp_as("decision", &key, &options, &[TREE, SUPERFACES, AREAS, CO_ASSOCIATION], &facts, seconds)?;
    Ok((decided, facts))
}

/// Reads a kept decision on `cells` cells.
fn open(cells: usize, work: &WorkDir) -> Result<PartDecision> {
    let tree = read_tree(&work.file(TREE))?;
    let area = work.open_array::<f64>(AREAS)?.to_vec();
    let co_association = work.open_array::<f64>(CO_ASSOCIATION)?;
    let n = area.len();
    let superfaces = Superfaces::kept(work.open_array::<u32>(SUPERFACES)?.to_vec(), area);
    match superfaces.filter(|superfaces| {
        superfaces.of_cell.len() == cells && tree.cells() == cells && co_association.len() == n * n
    }) {
        Some(superfaces) => {
            Ok(PartDecision { superfaces, co_association: Square::from_values(n, co_association.to_vec()), tree })
        }
        None => Err(Error::work_dir(work.path(), "the decision's arrays contradict each other", "delete tree.json")),
    }
}

/// The spectral numbers of the decision in `work`, where there is one.
pub(super) fn kept_numbers(work: &WorkDir) -> Option<SegmentStats> {
    let facts = work.manifest().stages.remove("decision")?.facts;
    serde_json::from_value::<Facts>(facts).ok().map(|facts| facts.numbers)
}

/// The hierarchy of parts in `work`; of a preview, `coarse`, that of the contracted mesh.
///
/// # Errors
/// [`Error::WorkDir`] where there is none; [`Error::Io`], [`Error::Malformed`].
pub fn tree_of(work: &WorkDir, coarse: bool) -> Result<PartTree> {
    let (whole, contracted) = (work.file(TREE), work.file("coarse").join(TREE));
    let places = if coarse { [contracted, whole] } else { [whole, contracted] };
    match places.iter().find(|path| path.exists()) {
        Some(path) => read_tree(path),
        None => {
            let remedy = "make one: nystrom-stream cluster --work-dir …";
            Err(Error::work_dir(work.path(), "holds no hierarchy of parts", remedy))
        }
    }
}

/// Reads a hierarchy of parts as [`write_tree`] writes it.
///
/// # Errors
/// [`Error::Io`], [`Error::Malformed`].
pub fn read_tree(path: &Path) -> Result<PartTree> {
    let text = std::fs::read(path).map_err(Error::io(path, "read"))?;
    let wrong = |problem: String| Error::malformed(path, "tree", problem, "make it again with `cluster` or `export`");
    let tree: PartTree = serde_json::from_slice(&text).map_err(|error| wrong(error.to_string()))?;
    tree.check().map_err(|error| wrong(error.to_string()))?;
    Ok(tree)
}

/// Writes a hierarchy of parts as JSON.
///
/// # Errors
/// [`Error::Io`].
pub fn write_tree(tree: &PartTree, path: &Path) -> Result<()> {
    let text = serde_json::to_vec(tree).unwrap_or_default();
    std::fs::write(path, text).map_err(Error::io(path, "write"))
}

/// The spectral numbers of the report, which deciding parts does not need itself: eigenvalues of the landmarks' affinities
/// under the members' middle width.
fn numbers(sample: &Sample) -> SegmentStats {
    let sigma = 0.25 * sample.landmarks.mean();
    let kernel = Kernel::Gaussian;
    let l = sample.len();
    let distance = |i: usize, j: usize| if i == j { 0. } else { f64::from(sample.between[i.max(j)][i.min(j)]) };
    let affinities = DMatrix::from_fn(l, l, |i, j| kernel.of(sigma, distance(i, j)));
    let (eigenvalues, _) = eigen::symmetric(affinities);
    let cut = kernel.tolerance(l) * eigenvalues.first().copied().unwrap_or(0.);
    let negative: f64 = eigenvalues.iter().filter(|v| **v < 0.).map(|v| -v).sum();
    let mass: f64 = eigenvalues.iter().map(|v| v.abs()).sum();
    SegmentStats {
        landmarks: sample.landmarks.nodes.clone(),
        sampling: Some(sample.sampling),
        sigma,
        dropped_eigenpairs: eigenvalues.iter().filter(|v| **v <= cut.max(0.)).count(),
        negative_mass: if mass > 0. { negative / mass } else { 0. },
        eigenvalues,
        ..SegmentStats::default()
    }
}
