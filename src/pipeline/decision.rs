//! The decision about parts as a stage: all answers at once, kept, so that another number of parts needs neither rows nor
//! members.
//!
//! Files, constant in the mesh size: `tree.json`, the merge hierarchy of cells; `atoms.npy` and `atom_areas.npy`, the
//! cells' intersections of members; `together.npy` (atoms × atoms), how far any two belong together, which
//! confidences come from.

use super::report::Numbers;
use super::surface::Surface;
use super::{SegmentParams, landmarks_for_parts, rows};
use crate::base::{Error, Result};
use crate::cluster::cell_rows::{self, greatest_share};

use crate::cluster::parts::matrix::Square;
use crate::cluster::parts::{self, Atoms, Decided, PartTree};
use crate::distance::DistanceRows;
use crate::distance::landmarks::Sampling;
use crate::distance::rows::RowParams;
use crate::graph::DualGraph;
use crate::graph::dual::Weighted;
use crate::spectral::kernel::Kernel;
use crate::spectral::{eigen, embedding};
use crate::store::workdir::key_of;
use crate::store::{Run, WorkDir};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::path::Path;

const TREE: &str = "tree.json";
const ATOMS: &str = "atoms.npy";
const AREAS: &str = "atom_areas.npy";
const TOGETHER: &str = "together.npy";

/// Greatest share of the surface that may be nearest to a single landmark.
const OUTLIERS: f64 = 0.8;
/// So few landmarks tell nothing about outliers.
const FEW: usize = 10;

/// What is kept besides the files.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Facts {
    /// Landmarks l.
    pub l: usize,
    /// Seconds that deciding took.
    pub seconds: f64,
    /// The spectral numbers of the report.
    pub numbers: Numbers,
}

/// The decision on `surface`, made from the rows (which are made where needed), or reused.
///
/// # Errors
/// [`Error::Io`], [`Error::Parameter`], [`Error::Cancelled`].
pub(super) fn decide(
    graph: &DualGraph,
    weighted: &Weighted,
    surface: &Surface,
    params: &SegmentParams,
    work: &WorkDir,
    run: &Run,
) -> Result<(Decided, Facts)> {
    let n = graph.nodes.len();
    let l = params.landmarks.unwrap_or(landmarks_for_parts(n));
    let row_params = RowParams { l, sampling: params.sampling };
    let options = json!({
        "stage": "decision",
        "rows": DistanceRows::key(weighted, n, row_params, run),
        "surface": surface.key,
        "decision": params.parts.decision,
        "members": params.parts.members,
        "small_part": params.parts.small_part,
        "hierarchy": 3,
        "seed": run.seed,
    });
    let key = key_of(&options);
    match work.reuse::<Facts>("decision", &key) {
        Ok(facts) => {
            run.progress.note("decision: reused");
            return Ok((open(surface.cells.len(), work)?, facts));
        }
        Err(reason) => run.note_remake("decision", &reason),
    }
    let (rows, b, sampling) = representative_rows(graph, weighted, surface, l, params, work, run)?;
    let (decided, seconds) = parts::decide(&surface.cells.graph, &b, rows.len(), &params.parts, run)?;
    write_tree(&decided.tree, &work.file(TREE))?;
    work.write(ATOMS, &decided.atoms.of_cell, 1)?;
    work.write(AREAS, &decided.atoms.area, 1)?;
    work.write(TOGETHER, decided.together.values(), decided.together.len())?;
    let facts = Facts { l: rows.len(), seconds, numbers: numbers(&rows, sampling) };
    work.stamp("decision", &key, &options, &[TREE, ATOMS, AREAS, TOGETHER], &facts, seconds)?;
    Ok((decided, facts))
}

/// The rows that `params` asks for and their means over cells; where they are of farthest points that turned out to be
/// outliers, those of landmarks drawn by area instead.
///
/// Farthest points are corners that few paths lead out of: mostly tips of limbs, which is what parts are told apart by. A
/// surface full of pockets, like an isosurface of a scanned body, has pockets for all of them. Then all the rest is
/// equally far from every landmark, one cluster of the embedding, and one part.
fn representative_rows(
    graph: &DualGraph,
    weighted: &Weighted,
    surface: &Surface,
    l: usize,
    params: &SegmentParams,
    work: &WorkDir,
    run: &Run,
) -> Result<(DistanceRows, Vec<f64>, Sampling)> {
    let first = rows(graph, weighted, l, params, work, run)?;
    let b = cell_rows(&first, surface, work, run)?;
    let share = greatest_share(&b, &surface.cells.graph.area);
    if params.sampling != Sampling::Farthest || l < FEW || share <= OUTLIERS {
        return Ok((first, b, params.sampling));
    }
    run.progress.note(&format!(
        "landmarks: {:.0} % of the surface is nearest to one of {l}, the others are outliers; drawn by area instead",
        100. * share
    ));
    drop(first);
    work.remove("distances.npy");
    let params = SegmentParams { sampling: Sampling::Random, ..params.clone() };
    let rows = rows(graph, weighted, l, &params, work, run)?;
    let b = cell_rows(&rows, surface, work, run)?;
    Ok((rows, b, params.sampling))
}

/// The rows behind a decision that left `numbers`, and their means over cells: as a rule they are still there.
pub(super) fn rows_used(
    graph: &DualGraph,
    weighted: &Weighted,
    surface: &Surface,
    numbers: &Numbers,
    params: &SegmentParams,
    work: &WorkDir,
    run: &Run,
) -> Result<(DistanceRows, Vec<f64>)> {
    let params = SegmentParams { sampling: numbers.sampling.unwrap_or(params.sampling), ..params.clone() };
    let l = params.landmarks.unwrap_or(landmarks_for_parts(graph.nodes.len()));
    let rows = rows(graph, weighted, l, &params, work, run)?;
    let b = cell_rows(&rows, surface, work, run)?;
    Ok((rows, b))
}

/// Reads a kept decision on `cells` cells.
fn open(cells: usize, work: &WorkDir) -> Result<Decided> {
    let tree = read_tree(&work.file(TREE))?;
    let area = work.open_array::<f64>(AREAS)?.to_vec();
    let together = work.open_array::<f64>(TOGETHER)?;
    let n = area.len();
    let atoms = Atoms::kept(work.open_array::<u32>(ATOMS)?.to_vec(), area);
    match atoms.filter(|atoms| atoms.of_cell.len() == cells && tree.cells() == cells && together.len() == n * n) {
        Some(atoms) => Ok(Decided { atoms, together: Square::from_values(n, together.to_vec()), tree }),
        None => Err(Error::work_dir(work.path(), "the decision's arrays contradict each other", "delete tree.json")),
    }
}

/// The spectral numbers of the decision in `work`, where there is one.
pub(super) fn kept_numbers(work: &WorkDir) -> Option<Numbers> {
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

/// The rows averaged over cells: made, or reused.
fn cell_rows(rows: &DistanceRows, surface: &Surface, work: &WorkDir, run: &Run) -> Result<Vec<f64>> {
    const FILE: &str = "cell_rows.npy";
    let options = json!({"stage": "cell rows", "rows": rows.key, "surface": surface.key});
    let key = key_of(&options);
    if work.reuse::<()>("cell rows", &key).is_ok() {
        return Ok(work.open_array::<f64>(FILE)?.to_vec());
    }
    let average = || cell_rows::average(rows, &surface.cells, &surface.shares, run);
    let (b, seconds) = run.stage("cell rows", "rows", rows.len() as u64, average)?;
    work.write(FILE, &b, surface.cells.len())?;
    work.stamp("cell rows", &key, &options, &[FILE], &(), seconds)?;
    Ok(b)
}

/// The spectral numbers of the report, which deciding parts does not need itself: Γ's kernel and eigenvalues under the
/// members' middle width.
fn numbers(rows: &DistanceRows, sampling: Sampling) -> Numbers {
    let sigma = 0.25 * rows.mean();
    let kernel = Kernel::Gaussian;
    let (eigenvalues, _) = eigen::symmetric(embedding::landmark_affinities(rows, kernel, sigma));
    let cut = kernel.tolerance(rows.len()) * eigenvalues.first().copied().unwrap_or(0.);
    let negative: f64 = eigenvalues.iter().filter(|v| **v < 0.).map(|v| -v).sum();
    let mass: f64 = eigenvalues.iter().map(|v| v.abs()).sum();
    Numbers {
        landmarks: rows.landmarks.clone(),
        sampling: Some(sampling),
        sigma,
        dropped_eigenpairs: eigenvalues.iter().filter(|v| **v <= cut.max(0.)).count(),
        negative_mass: if mass > 0. { negative / mass } else { 0. },
        eigenvalues,
        ..Numbers::default()
    }
}
