//! Parts as people would cut them, decided on some two thousand cells: constant in the mesh size.
//!
//! From the cell graph and the landmark distances averaged to cells, twelve members
//! over-segment the cells ([`over_segment`]: [`anchor`] embedding, [`cell_kmeans`]), each on a
//! random subset of the rows; [`tree`] merges every member down to one part and tells at each
//! merge how probably people keep the two together ([`cost`], from the sums of [`regions`] and
//! [`convexity`]); [`members`] averages that over members to a probability for any two
//! [`members::Atoms`]; [`labelling`] finds the labelling of the greatest expected Rand index, and
//! [`refinement`] a whole [`hierarchy`] around it. [`consensus`] has the plainer decisions.
//!
//! Everything is a function of the input and the seed: not of threads, not of timing.

pub mod anchor;
pub mod cell_kmeans;
pub mod cells;
pub mod consensus;
pub mod convexity;
pub mod cost;
pub mod hierarchy;
pub mod labelling;
pub mod labels;
pub mod linkage;
pub mod matrix;
pub mod members;
pub mod over_segment;
pub mod refinement;
pub mod regions;
pub mod small_parts;
pub mod thickness;
pub mod tree;

pub use cells::CellGraph;
pub use consensus::Decided;
pub use hierarchy::{Cut, PartTree, detail_threshold};
pub use members::Atoms;

use crate::base::{Error, Result};
use crate::store::run::Run;
use anchor::Rows;
use serde::{Deserialize, Serialize};

/// How the parts are decided.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Decision {
    /// Members merged down to one part each, probabilities at the merges, the labelling of the
    /// greatest expected Rand index: no stop constant.
    #[default]
    SoftTrees,
    /// Members stopped by a constant, average linkage, a last merge.
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
    /// Exactly so many.
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
    /// Members of [`Decision::SoftTrees`], at least 1.
    pub members: usize,
    /// Connected pieces below this share of the area join a neighbour.
    pub small_part: f64,
}

impl Default for PartsParams {
    fn default() -> Self {
        PartsParams {
            decision: Decision::default(),
            count: PartCount::default(),
            detail: 0.0,
            members: 12,
            small_part: small_parts::SMALL_PART,
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
    /// Numbers for the report.
    pub report: PartsReport,
}

/// Numbers for the report.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PartsReport {
    /// Cells S.
    pub cells: usize,
    /// Landmarks l.
    pub rows: usize,
    /// Atoms: intersections of the members' regions.
    pub atoms: usize,
    /// Number of parts found when none is given.
    pub parts_found: usize,
    /// Share of pairs of points, by area, on which a person is expected to differ: too small a share, since the
    /// probability is fitted to what most people decide and not to how many do.
    pub expected_disagreement: f64,
    /// Mean confidence by area.
    pub mean_confidence: f64,
    /// Area share of each part.
    pub area: Vec<f64>,
    /// Seconds the decision took.
    pub seconds: f64,
}

impl PartTree {
    /// The cut that some options ask for.
    ///
    /// # Errors
    /// A number of parts that cannot be had.
    pub fn cut_for(&self, count: PartCount, detail: f64) -> Result<Cut> {
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
/// As [`parts`].
pub fn decide(cells: &CellGraph, rows: &[f64], l: usize, params: &PartsParams, run: &Run) -> Result<(Decided, f64)> {
    let (cells, rows) = checked(cells, rows, l, params)?;
    let work = || -> Result<Decided> {
        match params.decision {
            Decision::SoftTrees => {
                let members = members::draw_members(&cells, &rows, params.members, "parts member", run)?;
                let atoms = Atoms::of(&cells, &rows, &members, run)?;
                let together = members::co_association(&cells, &atoms, &members, &cost::Model::default(), run)?;
                let tree = refinement::soft_hierarchy(&cells, &atoms, &together, params.small_part, run)?;
                Ok(Decided { atoms, together, tree })
            }
            Decision::Consensus => consensus::consensus(&cells, &rows, params.small_part, run),
            Decision::Single => consensus::single_run(&cells, &rows, params.small_part, run),
        }
    };
    run.stage("parts", "members", params.members as u64, work)
}

/// The answer of `decided`, from `l` rows in `seconds`, that `params` asks for. Milliseconds.
///
/// # Errors
/// More parts than cells, or an empty range.
pub fn cut(decided: &Decided, l: usize, seconds: f64, params: &PartsParams) -> Result<PartsResult> {
    let Decided { atoms, together, tree } = decided;
    let cut = tree.cut_for(params.count, params.detail)?;
    // Kept in single precision, they sum to nearly 1.
    let total: f64 = tree.area.iter().map(|&share| f64::from(share)).sum();
    let shares: Vec<f64> = tree.area.iter().map(|&share| f64::from(share) / total).collect();
    // A cut may divide atoms, or move a loose piece of one: an atom's label is its first cell's.
    let label = atoms.labels(&cut.label);
    let sure = consensus::confidence(atoms, together, &label, cut.parts);
    let confidence: Vec<f64> = atoms.of_cell.iter().map(|&a| sure[a as usize]).collect();
    let report = PartsReport {
        cells: tree.cells(),
        rows: l,
        atoms: atoms.len(),
        parts_found: tree.cut_detail(0.0).parts,
        expected_disagreement: consensus::expected_disagreement(atoms, together, &label),
        mean_confidence: confidence.iter().zip(&shares).map(|(c, a)| c * a).sum(),
        area: cells::class_sums(&cut.label, &shares, cut.parts),
        seconds,
    };
    Ok(PartsResult { label: cut.label, parts: cut.parts, tree: tree.clone(), confidence, report })
}

/// Input that is safe to compute with.
fn checked(cells: &CellGraph, rows: &[f64], l: usize, params: &PartsParams) -> Result<(CellGraph, Rows)> {
    let cells = cells.cleaned()?;
    let n = cells.len();
    if n == 0 || l == 0 || l.checked_mul(n) != Some(rows.len()) {
        let problem = format!("{} distances are not {l} rows of {n} cells", rows.len());
        return Err(Error::parameter("rows", problem, "pass at least one row and one cell, all rows whole"));
    }
    let most = if let PartCount::Exactly(k) | PartCount::Between(k, _) = params.count { k } else { 1 };
    if most > n || params.count == PartCount::Exactly(0) {
        let problem = format!("{most} parts cannot be made of {n} cells");
        return Err(Error::parameter("parts", problem, format!("ask for 1 to {n}")));
    }
    if !(-1.0..=1.0).contains(&params.detail) {
        let problem = format!("{} is not within −1 to 1", params.detail);
        return Err(Error::parameter("detail", problem, "0 is the default, above it finer, below it coarser"));
    }
    if params.members == 0 || !(0.0..1.0).contains(&params.small_part) {
        let problem = format!("{} members, small parts below {}", params.members, params.small_part);
        return Err(Error::parameter("members", problem, "use at least one member, and a share below 1"));
    }
    let rows = Rows::new(rows, l, n);
    Ok((cells, rows))
}
