//! The decision on parts as a stage: it keeps all answers at once, so that another number of parts needs neither rows
//! nor the ensemble.
//!
//! Files, constant in the size of the mesh: `tree.json`, the merge hierarchy of cells; `superfaces.npy` and
//! `superface_areas.npy`, the sets of cells that no clustering of the ensemble separates; `co_association.npy`
//! (superfaces × superfaces), the probability that any two belong together, from which confidences are computed;
//! `walls.npy`, 1 for each cell that is the wall of a cavity, empty if nothing is enclosed.

use super::labels::{self, SegmentStats};
use super::params::{Cluster, SegmentParams};
use super::proxy;
use super::sample::Sample;
use super::surface::{self, SurfaceStage, WeightedSurface};
use crate::base::{Error, Result};
use crate::cluster::contract;
use crate::cluster::parts::hints::Affinities;
use crate::cluster::parts::matrix::Square;
use crate::cluster::parts::{self, CellGraph, Enclosed, PartDecision, PartTree, Superfaces};
use crate::distance::DistanceRows;
use crate::distance::rows::RowParams;
use crate::graph::dual::{GraphStage, WeightsStage};
use crate::spectral::affinity::KeptEigenpairs;
use crate::spectral::kernel::Kernel;
use crate::store::manifest::{MANIFEST, Manifest};
use crate::store::needs::{BudgetEstimate, Extent, Needs};
use crate::store::stage::{BuiltStage, Stage};
use crate::store::{Context, WorkDir, json};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::borrow::Cow;
use std::path::Path;
use std::sync::Arc;

/// The folder of the contracted mesh.
pub(super) const CONTRACTED: &str = "contracted";
const TREE: &str = "tree.json";
const SUPERFACES: &str = "superfaces.npy";
const AREAS: &str = "superface_areas.npy";
const CO_ASSOCIATION: &str = "co_association.npy";
const WALLS: &str = "walls.npy";

/// What is recorded besides the files.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct DecisionFacts {
    /// Landmarks l.
    pub l: usize,
    /// Seconds that the decision took.
    pub seconds: f64,
    /// The spectral numbers of the report.
    pub numbers: SegmentStats,
    /// What the surface encloses.
    pub enclosed: Enclosed,
}

/// The stage that decides on parts.
pub(super) struct DecisionStage<'a> {
    /// The surface to cut.
    pub surface: WeightedSurface<'a>,
    /// The options.
    pub params: &'a SegmentParams,
}

impl DecisionStage<'_> {
    /// Number of landmarks.
    fn landmarks(&self) -> usize {
        self.params.landmarks_over(self.surface.graph.nodes.len())
    }
}

impl Stage for DecisionStage<'_> {
    const NAME: &'static str = "decision";
    const VERSION: u32 = labels::DECISION_VERSION;
    type Facts = DecisionFacts;
    type Output = (PartDecision, DecisionFacts);

    fn inputs(&self, context: Context<'_>) -> Value {
        let WeightedSurface { graph, weighted, surface } = self.surface;
        let rows = RowParams { l: self.landmarks(), sampling: self.params.sampling.unwrap_or_default() };
        let parts = &self.params.parts;
        json!({
            "rows": DistanceRows::key(weighted, graph.nodes.len(), rows, context.run),
            "surface": surface.key,
            "decision": parts.decision,
            "ensemble_size": parts.ensemble_size,
            "small_part": parts.small_part,
            "seed": context.run.seed,
        })
    }

    /// Also computes the rows, if needed.
    fn make(self, _: &str, context: Context<'_>) -> Result<BuiltStage<Self>> {
        let sample = self.surface.representative(self.landmarks(), self.params, context)?;
        let cells = &self.surface.surface.cells()?.graph;
        let _grant = Cluster::Parts.grant(sample.len(), self.surface.graph.nodes.len(), context.run)?;
        let (decided, seconds) = parts::decide(cells, &sample.b, sample.len(), &self.params.parts, context.run)?;
        let work = context.work;
        work.write_json(TREE, &decided.tree)?;
        work.write(SUPERFACES, &decided.superfaces.of_cell, 1)?;
        work.write(AREAS, &decided.superfaces.area, 1)?;
        work.write(CO_ASSOCIATION, decided.co_association.values(), decided.co_association.len())?;
        let walls: Vec<u32> = decided.is_wall.iter().map(|&wall| u32::from(wall)).collect();
        work.write(WALLS, &walls, 1)?;
        let facts = DecisionFacts { l: sample.len(), seconds, numbers: numbers(&sample), enclosed: decided.enclosed };
        let files = vec![TREE, SUPERFACES, AREAS, CO_ASSOCIATION, WALLS];
        Ok(BuiltStage { output: (decided, facts.clone()), facts, files })
    }

    fn open(self, facts: DecisionFacts, _: &str, context: Context<'_>) -> Result<Self::Output> {
        let (nodes, landmarks) = (self.surface.graph.nodes.len(), &facts.numbers.landmarks);
        if landmarks.iter().any(|&node| node as usize >= nodes) {
            return Err(context.work.damaged(MANIFEST, "refers to landmarks that do not exist"));
        }
        let cells = self.surface.surface.cells()?.len();
        let decided = open(cells, context.work)?;
        let is_wall: Vec<bool> = context.work.open_array::<u32>(WALLS)?.iter().map(|&wall| wall > 0).collect();
        if !is_wall.is_empty() && is_wall.len() != cells {
            return Err(context.work.damaged(WALLS, "has another number of cells"));
        }
        Ok((PartDecision { enclosed: facts.enclosed, is_wall, ..decided }, facts))
    }

    /// Constant in the size of the mesh.
    fn needs(_: &Extent, _: &mut BudgetEstimate) -> Needs {
        Needs::default()
    }
}

/// Reads a kept decision on `cells` cells.
fn open(cells: usize, work: &WorkDir) -> Result<PartDecision> {
    let tree = checked(&work.json_text(TREE)?, &work.file(TREE))?;
    let area = work.open_array::<f64>(AREAS)?.to_vec();
    let co_association = work.open_array::<f64>(CO_ASSOCIATION)?;
    let of_cell = work.open_array::<u32>(SUPERFACES)?.to_vec();
    assembled(cells, of_cell, area, co_association.to_vec(), tree)
        .ok_or_else(|| work.damaged(TREE, format!("contradicts {SUPERFACES}, {AREAS} or {CO_ASSOCIATION}")))
}

/// The decision on `cells` cells assembled from these parts; `None` if they are inconsistent.
fn assembled(
    cells: usize,
    of_cell: Vec<u32>,
    area: Vec<f64>,
    co_association: Vec<f64>,
    tree: PartTree,
) -> Option<PartDecision> {
    let n = area.len();
    let superfaces = Superfaces::kept(of_cell, area)?;
    let whole = superfaces.of_cell.len() == cells && tree.cells() == cells && co_association.len() == n * n;
    // Only after this check is it certain that there is room for n².
    whole.then(|| {
        let co_association = Square::from_values(n, co_association);
        PartDecision::of(superfaces, co_association, tree)
    })
}

/// The spectral numbers of the decision on the mesh in `work`, or on its contraction, unless it is small or rows were
/// `exact`; `None` if there is no decision on the current graph.
///
/// # Errors
/// As [`WorkDir::inner`].
pub(super) fn kept_numbers(work: &WorkDir, exact: bool) -> Result<Option<SegmentStats>> {
    let proxy = proxy::in_use(work, exact)?;
    let work = proxy.as_deref().unwrap_or(work);
    let inner = contraction_in_use(work, exact)?;
    if inner.is_none() && !is_current(work, false) {
        return Ok(None);
    }
    let kept = inner.as_deref().unwrap_or(work).manifest().stages.remove(DecisionStage::NAME);
    let facts = kept.and_then(|kept| serde_json::from_value::<DecisionFacts>(kept.facts).ok());
    Ok(facts.map(|facts| facts.numbers))
}

/// The hierarchy of parts of the mesh in `work`: that of its contraction, unless it is small or rows were `exact`.
///
/// # Errors
/// [`Error::WorkDir`] if there is none; [`Error::Io`], [`Error::Malformed`].
pub fn tree_of(work: &WorkDir, exact: bool) -> Result<PartTree> {
    let proxy = proxy::in_use(work, exact)?;
    let mesh = proxy.as_deref().unwrap_or(work);
    for contracted in [!exact, exact] {
        if !is_current(mesh, contracted) {
            continue;
        }
        let inner = if contracted { Some(mesh.inner(CONTRACTED)?) } else { None };
        let decided = inner.as_deref().unwrap_or(mesh);
        if decided.holds(TREE) {
            check_labels(work, decided)?;
            return checked(&decided.json_text(TREE)?, &decided.place(TREE));
        }
    }
    let remedy = "compute one: stage `labels`";
    Err(Error::work_dir(work.path(), "holds no hierarchy of parts of its mesh", remedy))
}

/// Removes the decision in `work`, on which no parts are based.
///
/// # Errors
/// [`Error::Io`].
pub(super) fn discard(work: &WorkDir) -> Result<()> {
    work.remove_record(DecisionStage::NAME)?;
    work.remove(TREE);
    Ok(())
}

/// The key of the decision in `work`, if there is one.
pub(super) fn decision_key(work: &WorkDir) -> Option<String> {
    work.manifest().stages.remove(DecisionStage::NAME).map(|stage| stage.key)
}

/// Rejects a decision in `decided` other than the one from which the labels in `work` were cut: a refused or
/// interrupted run may have left it.
fn check_labels(work: &WorkDir, decided: &WorkDir) -> Result<()> {
    let decision = decided.manifest().stages.remove(DecisionStage::NAME);
    if decision.as_ref().is_some_and(|decision| decision.version != DecisionStage::VERSION) {
        let problem = "its hierarchy of parts was made by another version of the program";
        return Err(Error::work_dir(work.path(), problem, "cut it again: stage `labels`"));
    }
    match labels::decision_of(work) {
        Some(cut_from) if decision.is_some_and(|decision| decision.key != cut_from) => {
            let problem = "its hierarchy of parts is not the one that its labels were cut from";
            Err(Error::work_dir(work.path(), problem, "cut it again: stage `labels`"))
        }
        _ => Ok(()),
    }
}

/// The kept decision of a work directory, and its cells: the data for computing corrections.
#[derive(Clone, Debug)]
pub struct KeptDecision {
    /// The cells, safe to compute with ([`CellGraph::cleaned`]).
    pub cells: CellGraph,
    /// The decision.
    pub decision: PartDecision,
}

/// A [`KeptDecision`] as JSON, with one half of the co-association.
#[derive(Serialize, Deserialize)]
struct KeptText<'a> {
    cells: Cow<'a, CellGraph>,
    of_cell: Cow<'a, [u32]>,
    area: Cow<'a, [f64]>,
    co_association: Cow<'a, [f64]>,
    tree: Cow<'a, PartTree>,
}

/// The rows of a symmetric `matrix` up to the diagonal; all values of another.
fn lower_half(matrix: &Square) -> Cow<'_, [f64]> {
    let n = matrix.len();
    if (0..n).any(|i| (0..i).any(|j| matrix[(i, j)] != matrix[(j, i)])) {
        return Cow::Borrowed(matrix.values());
    }
    (0..n).flat_map(|i| &matrix.row(i)[..=i]).copied().collect()
}

/// All values of the matrix with `n` rows of which `values` are what [`lower_half`] returns.
fn both_halves(n: usize, values: Cow<'_, [f64]>) -> Vec<f64> {
    if values.len() != n * (n + 1) / 2 {
        return values.into_owned();
    }
    let (mut all, mut values) = (vec![0.; n * n], values.iter());
    for i in 0..n {
        for (j, &value) in (0..=i).zip(values.by_ref()) {
            (all[n * i + j], all[n * j + i]) = (value, value);
        }
    }
    all
}

impl KeptDecision {
    /// The one for the mesh in `work`: on its contraction, unless it is small or rows were `exact`.
    ///
    /// # Errors
    /// As [`tree_of`].
    pub fn read(work: &WorkDir, exact: bool) -> Result<Self> {
        let of = |work: &WorkDir| {
            let cells = work.read_json::<CellGraph>(surface::CELL_GRAPH)?.cleaned()?;
            Ok(Self { decision: open(cells.len(), work)?, cells })
        };
        let proxy = proxy::in_use(work, exact)?;
        let mesh = proxy.as_deref().unwrap_or(work);
        let inner = contraction_in_use(mesh, exact)?;
        let decided = inner.as_deref().unwrap_or(mesh);
        check_labels(work, decided)?;
        of(decided)
    }

    /// All of it as JSON: one megabyte to twelve.
    ///
    /// # Errors
    /// [`Error::Internal`] for values that JSON cannot represent.
    pub fn text(&self) -> Result<String> {
        let PartDecision { superfaces, co_association, tree, .. } = &self.decision;
        let values = KeptText {
            cells: Cow::Borrowed(&self.cells),
            of_cell: Cow::Borrowed(&superfaces.of_cell),
            area: Cow::Borrowed(&superfaces.area),
            co_association: lower_half(co_association),
            tree: Cow::Borrowed(tree),
        };
        Ok(json::value("the decision", &values)?.to_string())
    }

    /// Parses the output of [`KeptDecision::text`].
    ///
    /// # Errors
    /// [`Error::Parameter`] for any other text.
    pub fn of_text(text: &str) -> Result<Self> {
        let wrong = |problem: String| Error::parameter("decision", problem, "cut the mesh again");
        let parsed: KeptText<'_> = serde_json::from_slice(text.as_bytes()).map_err(|error| wrong(error.to_string()))?;
        parsed.tree.check()?;
        let cells = parsed.cells.cleaned()?;
        let (of_cell, area) = (parsed.of_cell.into_owned(), parsed.area.into_owned());
        let (co_association, tree) = (both_halves(area.len(), parsed.co_association), parsed.tree.into_owned());
        let decision = assembled(cells.len(), of_cell, area, co_association, tree)
            .ok_or_else(|| wrong("its cells, superfaces and tree contradict each other".into()))?;
        Ok(Self { cells, decision })
    }

    /// How strongly cells belong together.
    pub fn affinities(&self) -> Affinities<'_> {
        self.decision.affinities(&self.cells)
    }
}

/// The manifest of the contraction in `work`, if there is one.
pub(super) fn manifest_of_contraction(work: &WorkDir) -> Option<Manifest> {
    work.read_json::<Manifest>(&format!("{CONTRACTED}/{MANIFEST}")).ok()
}

/// Whether the decision in `work`, or that on its contracted mesh, belongs to the current graph: after K-means on
/// another mesh, an older decision may be left.
fn is_current(work: &WorkDir, contracted: bool) -> bool {
    if work.is_temporary() {
        // The folder of a contraction exists if it was used for any mesh.
        let holds = || work.place(CONTRACTED).exists() && work.inner(CONTRACTED).is_ok_and(|inner| inner.holds(TREE));
        return !contracted || holds();
    }
    let manifest = work.manifest();
    let Some(graph) = manifest.stages.get(GraphStage::NAME).map(|stage| stage.key.as_str()) else { return false };
    let decided = |manifest: &Manifest, graph: &str| {
        let (Some(surface), Some(decision)) =
            (manifest.stages.get(SurfaceStage::NAME), manifest.stages.get(DecisionStage::NAME))
        else {
            return false;
        };
        surface.inputs["graph"] == graph && decision.inputs["surface"] == surface.key
    };
    if !contracted {
        return decided(&manifest, graph);
    }
    let Some(inner) = manifest_of_contraction(work) else { return false };
    manifest.stages.get(WeightsStage::NAME).is_some_and(|weights| {
        let seed = weights.inputs["seed"].as_u64().unwrap_or_default();
        weights.inputs["graph"] == graph && decided(&inner, &contract::key(&weights.key, seed))
    })
}

/// The work directory of the contraction on which the mesh in `work` was decided; `None` if the decision was on the
/// mesh itself, since it is small or with `exact` rows over all faces.
///
/// # Errors
/// As [`WorkDir::inner`].
pub(super) fn contraction_in_use(work: &WorkDir, exact: bool) -> Result<Option<Arc<WorkDir>>> {
    (!exact && is_current(work, true)).then(|| work.inner(CONTRACTED)).transpose()
}

/// Reads a hierarchy of parts as written by [`write_tree`].
///
/// # Errors
/// [`Error::Io`], [`Error::Malformed`].
pub fn read_tree(path: &Path) -> Result<PartTree> {
    checked(&json::read_small(path)?, path)
}

/// Parses and checks the hierarchy in `text`, the content of `path`.
fn checked(text: &[u8], path: &Path) -> Result<PartTree> {
    let wrong = |problem: String| Error::malformed(path, "tree", problem, "write it again: stage `tree`");
    let read = |error: serde_json::Error| wrong(format!("is no hierarchy of parts: {error}"));
    let tree: PartTree = serde_json::from_slice(text).map_err(read)?;
    match tree.check() {
        Err(Error::Parameter { problem, .. }) => Err(wrong(problem)),
        checked => checked.map(|()| tree),
    }
}

/// Writes a hierarchy of parts as JSON, by rename.
///
/// # Errors
/// [`Error::Io`].
pub fn write_tree(tree: &PartTree, path: &Path) -> Result<()> {
    json::write(path, tree)
}

/// The spectral numbers for the report, which the decision itself does not need: eigenvalues of the landmarks'
/// affinities under the ensemble's middle width.
fn numbers(sample: &Sample) -> SegmentStats {
    let sigma = 0.25 * sample.landmarks.mean();
    let kernel = Kernel::Gaussian;
    let l = sample.len();
    let distance = |i: usize, j: usize| if i == j { 0. } else { f64::from(sample.between[i.max(j)][i.min(j)]) };
    let affinities = DMatrix::from_fn(l, l, |i, j| kernel.of(sigma, distance(i, j)));
    let kept = KeptEigenpairs::of(affinities, kernel.tolerance(l));
    SegmentStats {
        landmarks: sample.landmarks.nodes.clone(),
        sampling: Some(sample.sampling),
        sigma,
        dropped_eigenpairs: kept.dropped(),
        negative_mass: kept.negative_mass(),
        eigenvalues: kept.all,
        ..SegmentStats::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_half_of_a_symmetric_matrix_is_kept() {
        for n in 0..4 {
            let symmetric: Vec<f64> = (0..n * n).map(|k| ((k / n) * (k % n)) as f64 / 3.).collect();
            let distinct: Vec<f64> = (0..n * n).map(|k| k as f64).collect();
            for values in [symmetric, distinct] {
                let matrix = Square::from_values(n, values);
                assert_eq!(both_halves(n, lower_half(&matrix)), matrix.values());
            }
        }
        assert_eq!(lower_half(&Square::zeros(9)).len(), 45);
    }

    /// Regression: a wrong file was told to be no `struct PartTree`.
    #[test]
    fn what_a_hierarchy_holds_is_told() {
        let told = checked(b"3", "tree.json".as_ref()).unwrap_err().to_string();
        assert!(told.contains("expected an object with version, unions, level") && !told.contains("struct"), "{told}");
    }

    #[test]
    fn a_matrix_that_is_not_there_is_not_made_room_for() {
        // Regression: n² numbers were allocated before their absence was noticed.
        let n = 1 << 20;
        assert!(assembled(n, (0..n as u32).collect(), vec![1.; n], Vec::new(), PartTree::default()).is_none());
    }
}
