//! Parts as people would cut them, decided on some two thousand cells: constant in the mesh size.
//!
//! The input is the cell graph and the landmark distances averaged over cells.
//! - What is `enclosed` by the surface is set apart first: walls of cavities follow the outside, bodies within are
//!   decided on alone (`layered`).
//! - [`ensemble`] over-segments the cells twelve times (embedding of [`crate::spectral::anchor`], [`cell_kmeans`]),
//!   each time from a random subset of the landmarks.
//! - [`merges`] merges each over-segmentation down to one part and tells at each merge how probably people keep the two
//!   sides together ([`merge_odds`]), from sums over [`regions`], [`convexity`] and [`thickness`], in units of the
//!   shape without its [`folding`].
//! - The mean over the ensemble is the co-association: a probability for any two [`Superfaces`].
//! - Where the surface is its own mirror image, [`twins`] make both sides alike; where a posed body is so along its
//!   surface, those of its [`reflection`] do.
//! - [`labelling`] finds the labels of the greatest expected Rand index, without `ambiguous` patches, and a whole
//!   [`hierarchy`] around them.
//! - [`hints`] changes a labelling as people ask; `split` divides a part further along the hierarchy.
//! - [`consensus`] has the plainer decisions; [`agreement`] tells how sure a part is and how many people would have it.
//!
//! Everything is a function of the input and the seed: not of threads, not of timing. Cost: .05 s on two
//! threads for 60 landmarks, some megabytes, whatever the size of the mesh; up to .08 s of processor time more
//! where no plane is found.

pub mod agreement;
mod ambiguous;
mod anchored;
mod anchors;
pub mod cell_graph;
pub mod cell_kmeans;
mod cell_map;
pub mod cell_paths;
pub mod consensus;
pub mod convexity;
mod enclosed;
pub mod ensemble;
mod exposure;
pub mod folding;
mod functions;
pub mod hierarchy;
pub mod hints;
pub mod labelling;
mod layered;
pub mod matrix;
pub mod merge_features;
pub mod merge_odds;
pub mod merges;
#[cfg(test)]
mod posed_body;
pub mod reflection;
pub mod regions;
mod signs;
mod split;
pub mod thickness;
pub mod tips;
pub mod twins;

pub use cell_graph::CellGraph;
pub use consensus::PartDecision;
pub use enclosed::Enclosed;
pub use ensemble::Superfaces;
pub use hierarchy::{PartTree, TreeCut, detail_threshold};

use crate::base::{Error, Result};
use crate::spectral::anchor::LandmarkDistances;
use crate::store::run::Run;
use enclosed::Layers;
use matrix::Square;
use serde::{Deserialize, Serialize};

/// How the parts are decided.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Decision {
    /// An ensemble merged down to one part each, probabilities at the merges, the labelling of the
    /// greatest expected Rand index: no stop constant.
    #[default]
    SoftTrees,
    /// An ensemble stopped by a constant, average linkage, a last merge.
    Consensus,
    /// One over-segmentation, merged until a constant.
    Single,
}

/// How many parts are wanted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PartCount {
    /// As many as there are.
    #[default]
    Found,
    /// Exactly this many.
    Exactly(usize),
    /// As many as there are, within these bounds, both included.
    Between(usize, usize),
}

/// Options of [`parts`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PartsParams {
    /// How the parts are decided.
    pub decision: Decision,
    /// How many are wanted.
    pub count: PartCount,
    /// −1 (one part) to 1 (as fine as can be told), 0 being the parts found; moves the threshold
    /// ([`detail_threshold`]). No effect where the number is given.
    pub detail: f64,
    /// Over-segmentations in the ensemble of [`Decision::SoftTrees`], at least 1.
    #[serde(alias = "members")]
    pub ensemble_size: usize,
    /// Connected pieces below this share of the area join a neighbour.
    pub small_part: f64,
}

impl Default for PartsParams {
    fn default() -> Self {
        PartsParams {
            decision: Decision::default(),
            count: PartCount::default(),
            detail: 0.0,
            ensemble_size: 12,
            small_part: cell_graph::SMALL_PART,
        }
    }
}

/// The parts, and what is worth telling or keeping of them.
#[derive(Clone, Debug)]
pub struct PartsResult {
    /// Part of each cell (S), numbered by first appearance.
    pub label: Vec<u32>,
    /// Number of parts.
    pub parts: usize,
    /// All other answers.
    pub tree: PartTree,
    /// How sure the part of each cell is, in \[0, 1\] (S).
    pub confidence: Vec<f64>,
    /// Figures for the report.
    pub report: PartsReport,
}

/// Figures for the report.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PartsReport {
    /// Cells S.
    pub cells: usize,
    /// Landmarks l.
    #[serde(alias = "rows")]
    pub landmarks: usize,
    /// Superfaces: intersections of all regions of the ensemble.
    #[serde(alias = "atoms")]
    pub superfaces: usize,
    /// Number of parts found when none is given.
    pub parts_found: usize,
    /// Share of pairs of points, by area, on which a person is expected to differ ([`agreement::disagreement`]).
    pub expected_disagreement: f64,
    /// Mean confidence by area.
    pub mean_confidence: f64,
    /// Area share of each part.
    pub area: Vec<f64>,
    /// Share of people who are expected to have each part ([`agreement`]); empty where the parts are
    /// not the decision's alone.
    #[serde(default)]
    pub expected_agreement: Vec<f64>,
    /// What the surface encloses.
    #[serde(default)]
    pub enclosed: Enclosed,
    /// Seconds the decision took.
    pub seconds: f64,
}

impl PartsReport {
    /// Mean of [`PartsReport::expected_agreement`] by area; none where that is empty.
    pub fn mean_agreement(&self) -> Option<f64> {
        let all = self.expected_agreement.iter().zip(&self.area);
        (!self.expected_agreement.is_empty()).then(|| all.map(|(share, area)| share * area).sum())
    }

    /// Whether the surface falls into parts that people would agree on; none where that is not known. A
    /// surface of one part does not.
    pub fn has_clear_parts(&self) -> Option<bool> {
        self.mean_agreement().map(|mean| mean >= agreement::UNCLEAR && self.expected_agreement.len() > 1)
    }
}

impl PartCount {
    /// The least number that is asked for.
    pub fn least(self) -> usize {
        match self {
            Self::Found => 1,
            Self::Exactly(k) | Self::Between(k, _) => k,
        }
    }

    /// The same, but for no more than `most` parts.
    pub fn at_most(self, most: usize) -> Self {
        match self {
            Self::Found => Self::Found,
            Self::Exactly(k) => Self::Exactly(k.min(most)),
            Self::Between(a, b) => Self::Between(a.min(most), b.min(most)),
        }
    }
}

impl PartTree {
    /// The cut that some options ask for.
    ///
    /// # Errors
    /// A number of parts that cannot be had.
    pub fn cut_for(&self, count: PartCount, detail: f64) -> Result<TreeCut> {
        match count {
            PartCount::Found => Ok(self.cut_detail(detail)),
            PartCount::Exactly(k) => self.cut_k(k),
            PartCount::Between(a, b) => self.cut_range(a, b, detail),
        }
    }
}

/// Decides the parts of a surface of S cells from the mean distances of its cells from `l`
/// landmarks: `rows`, row-major l × S, infinite where not reached.
///
/// ```
/// use nystrom_stream::cluster::parts::{CellGraph, PartsParams, parts};
/// use nystrom_stream::store::Run;
///
/// # fn main() -> nystrom_stream::base::Result<()> {
/// // A strip of 24 cells with a crease in the middle, and how far they are from every fourth.
/// let step = |i: u32| if i == 12 { 2. } else { 0.2 };
/// let cells = CellGraph {
///     seed: (0..24).collect(),
///     area: vec![1. / 24.; 24],
///     centre: (0..24).map(|i| [0.2 * f64::from(i), 0., 0.]).collect(),
///     normal: vec![[0., 0., 1.]; 24],
///     pairs: (1..24).map(|i| [i - 1, i]).collect(),
///     length: vec![0.2; 23],
///     concave: (1..24).map(|i| step(i) - 0.2).collect(),
///     convex: vec![0.; 23],
///     convex04: vec![0.; 23],
/// };
/// let distance = |a: u32, b: u32| (a.min(b) + 1..=a.max(b)).map(step).sum::<f64>();
/// let rows: Vec<f64> = (0..6).flat_map(|k| (0..24).map(move |i| distance(4 * k, i))).collect();
/// let found = parts(&cells, &rows, 6, &PartsParams::default(), &Run::new(&()))?;
/// // The hierarchy has all answers: this is the one of two parts.
/// let two = found.tree.cut_k(2)?;
/// assert_eq!(two.label, [vec![0; 12], vec![1; 12]].concat());
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// Sizes that disagree, no cell, no row, options out of range, more parts than cells, or
/// cancellation.
pub fn parts(cells: &CellGraph, rows: &[f64], l: usize, params: &PartsParams, run: &Run) -> Result<PartsResult> {
    let (decided, seconds) = decide(cells, rows, l, params, run)?;
    cut(&decided, l, seconds, params)
}

/// All answers at once, and the seconds that took: of `params` the number of parts and the detail do not matter.
///
/// # Errors
/// As [`parts`], but for the number of parts.
pub fn decide(
    cells: &CellGraph,
    rows: &[f64],
    l: usize,
    params: &PartsParams,
    run: &Run,
) -> Result<(PartDecision, f64)> {
    let (cells, rows) = checked(cells, rows, l, params)?;
    let work = || -> Result<PartDecision> {
        match params.decision {
            Decision::SoftTrees => {
                let Some(layers) = Layers::of(&cells, run)? else {
                    let (superfaces, c) = layered::co_association(&cells, &rows, params.ensemble_size, run)?;
                    return alike(&cells, superfaces, c, params.small_part, run);
                };
                let (superfaces, c) = layered::of_layers(&cells, &rows, &layers, params.ensemble_size, run)?;
                let decided = alike(&cells, superfaces, c, params.small_part, run)?;
                let (enclosed, is_wall) = (layers.enclosed(&cells.area_shares()), layers.walls());
                Ok(PartDecision { enclosed, is_wall, ..decided })
            }
            Decision::Consensus => consensus::consensus(&cells, &rows, params.small_part, run),
            Decision::Single => consensus::single_run(&cells, &rows, params.small_part, run),
        }
    };
    run.stage("parts", "segmentations", params.ensemble_size as u64, work)
}

/// The decision on superfaces with the co-association `c`, the same on both sides where there are two.
fn alike(cells: &CellGraph, superfaces: Superfaces, mut c: Square, small_part: f64, run: &Run) -> Result<PartDecision> {
    let decided = |superfaces: Superfaces, co_association: Square| -> Result<PartDecision> {
        let tree = labelling::soft_hierarchy(cells, &superfaces, &co_association, small_part, run)?;
        Ok(PartDecision { superfaces, co_association, tree, enclosed: Enclosed::default(), is_wall: Vec::new() })
    };
    let shares = cells.area_shares();
    let planes = twins::twins(cells, &shares);
    // The best plane last: what it makes alike stays so.
    for twins in planes.iter().rev() {
        c = twins::made_alike(&c, &superfaces.of_cell, &shares, twins);
    }
    if planes.first().is_some_and(|best| best.likeness(&shares) >= twins::LIKE) {
        return decided(superfaces, c);
    }
    let Some(twins) = reflection::reflection(cells, &shares, &superfaces.log_thickness, run)? else {
        return decided(superfaces, c);
    };
    // Where one side is cut, superfaces of the other need not end: the parts tell where they must.
    let once = twins::made_alike(&c, &superfaces.of_cell, &shares, &twins);
    let uncut = decided(superfaces, once)?;
    let parts = uncut.tree.cut_detail(0.0);
    let of_cell = &uncut.superfaces.of_cell;
    let (of_piece, count) = twins.cut_at_images(cells, &shares, of_cell, &parts.label);
    if count == uncut.superfaces.len() {
        return Ok(uncut);
    }
    let area = cell_graph::class_sums(&of_piece, &cells.area, count);
    let finer = Superfaces::kept(of_piece, area).ok_or_else(|| Error::internal("a superface without cells"))?;
    let whole = finer.labels(of_cell);
    let row = |&x: &u32| whole.iter().map(|&y| c[(x as usize, y as usize)]).collect::<Vec<f64>>();
    let c = Square::from_values(count, whole.iter().flat_map(row).collect());
    let c = twins::made_alike(&c, &finer.of_cell, &shares, &twins);
    // A twin that was missing is one part more; slivers between images that are off are several.
    let cut = decided(finer, c)?;
    Ok(if cut.tree.cut_detail(0.0).parts > parts.parts + 1 { uncut } else { cut })
}

/// The answer of `decided`, from `l` rows in `seconds`, that `params` asks for. Milliseconds.
///
/// # Errors
/// More parts than cells, or an empty range.
pub fn cut(decided: &PartDecision, l: usize, seconds: f64, params: &PartsParams) -> Result<PartsResult> {
    Ok(describe(decided, decided.tree.cut_for(params.count, params.detail)?, l, seconds))
}

/// The answer of `decided`, from `l` rows in `seconds`, whose parts are those of `cut`: a cut of its hierarchy,
/// or one that was corrected.
pub fn describe(decided: &PartDecision, cut: TreeCut, l: usize, seconds: f64) -> PartsResult {
    let PartDecision { superfaces, co_association, tree, enclosed, .. } = decided;
    // Kept in single precision, they sum to nearly 1.
    let total: f64 = tree.area.iter().map(|&share| f64::from(share)).sum();
    let shares: Vec<f64> = tree.area.iter().map(|&share| f64::from(share) / total).collect();
    // A cut may divide superfaces, or move a loose piece of one: a superface's label is its first cell's.
    let label = superfaces.labels(&cut.label);
    let sure = agreement::confidence(superfaces, co_association, &label, cut.parts);
    let confidence: Vec<f64> = superfaces.of_cell.iter().map(|&a| sure[a as usize]).collect();
    let report = PartsReport {
        cells: tree.cells(),
        landmarks: l,
        superfaces: superfaces.len(),
        parts_found: tree.cut_detail(0.0).parts,
        expected_disagreement: agreement::disagreement(labelling::expected_disagreement(
            superfaces,
            co_association,
            &label,
        )),
        mean_confidence: confidence.iter().zip(&shares).map(|(c, a)| c * a).sum(),
        area: cell_graph::class_sums(&cut.label, &shares, cut.parts),
        expected_agreement: agreement::of_parts(tree, &cut.label, cut.parts, &confidence, &shares),
        enclosed: *enclosed,
        seconds,
    };
    PartsResult { label: cut.label, parts: cut.parts, tree: tree.clone(), confidence, report }
}

/// Input that is safe to compute with.
fn checked(cells: &CellGraph, rows: &[f64], l: usize, params: &PartsParams) -> Result<(CellGraph, LandmarkDistances)> {
    let cells = cells.cleaned()?;
    let n = cells.len();
    if n == 0 || l == 0 || l.checked_mul(n) != Some(rows.len()) {
        let problem = format!("{} distances are not {l} rows of {n} cells", rows.len());
        return Err(Error::parameter("rows", problem, "pass at least one row and one cell, all rows whole"));
    }
    if !(-1.0..=1.0).contains(&params.detail) {
        let problem = format!("{} is not within −1 to 1", params.detail);
        return Err(Error::parameter("detail", problem, "0 is the default, above it finer, below it coarser"));
    }
    if params.ensemble_size == 0 || !(0.0..1.0).contains(&params.small_part) {
        let problem = format!("an ensemble of {}, small parts below {}", params.ensemble_size, params.small_part);
        return Err(Error::parameter("ensemble size", problem, "use at least one segmentation, and a share below 1"));
    }
    let rows = LandmarkDistances::new(rows, l, n);
    Ok((cells, rows))
}
