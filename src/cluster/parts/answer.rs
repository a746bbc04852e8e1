//! The result of deciding on parts, the cut for given options, and the figures reported about it.
//!
//! A decision is stored once; each number of parts and each detail is another cut of its hierarchy. Cost: milliseconds.

use super::PartCount;
use super::agreement;
use super::cell_graph::CellGraph;
use super::ensemble::Superfaces;
use super::hierarchy::{PartTree, TreeCut};
use super::hints::Affinities;
use super::interior::enclosed::Enclosed;
use super::labelling::expected_disagreement;
use super::matrix::Square;
use crate::base::Result;
use serde::{Deserialize, Serialize};

/// A decision: its superfaces, the probability that any two belong together, and the hierarchy.
#[derive(Clone, Debug)]
pub struct PartDecision {
    /// The superfaces.
    pub superfaces: Superfaces,
    /// The probability that any two superfaces belong together, in \[0, 1\] (R × R).
    pub co_association: Square,
    /// The hierarchy.
    pub tree: PartTree,
    /// What the surface encloses, if that was examined.
    pub enclosed: Enclosed,
    /// Whether each cell is the wall of a cavity (S); empty if nothing is enclosed.
    pub is_wall: Vec<bool>,
}

impl PartDecision {
    /// A decision on a surface that is not known to enclose anything.
    pub fn of(superfaces: Superfaces, co_association: Square, tree: PartTree) -> Self {
        Self { superfaces, co_association, tree, enclosed: Enclosed::default(), is_wall: Vec::new() }
    }

    /// Share of pairs of points, by area, on which a person is expected to differ from the parts `label` of the cells
    /// (S) ([`agreement::disagreement`]).
    pub fn expected_disagreement(&self, label: &[u32]) -> f64 {
        // A cut may divide superfaces, or move a loose piece of one: a superface gets the label of its first cell.
        let label = self.superfaces.labels(label);
        agreement::disagreement(expected_disagreement(&self.superfaces, &self.co_association, &label))
    }

    /// The affinities of the `cells` that it was made on. They must be finite ([`CellGraph::cleaned`]).
    pub fn affinities<'a>(&'a self, cells: &'a CellGraph) -> Affinities<'a> {
        let Self { superfaces, co_association, tree, .. } = self;
        Affinities { cells, superfaces, co_association, small_part: f64::from(tree.small_part) }
    }
}

/// The parts with their report.
#[derive(Clone, Debug)]
pub struct PartsResult {
    /// Part of each cell (S), numbered by first appearance.
    pub label: Vec<u32>,
    /// Number of parts.
    pub parts: usize,
    /// The confidence in the part of each cell, in \[0, 1\] (S).
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
    pub landmarks: usize,
    /// Superfaces: intersections of all regions of the ensemble.
    pub superfaces: usize,
    /// Number of parts found if none is requested.
    pub parts_found: usize,
    /// Share of pairs of points, by area, on which a person is expected to differ ([`agreement::disagreement`]).
    pub expected_disagreement: f64,
    /// Area-weighted mean confidence.
    pub mean_confidence: f64,
    /// Share of people expected to have each part ([`agreement`]); empty if the parts are not those of the decision.
    #[serde(default)]
    pub expected_agreement: Vec<f64>,
    /// What the surface encloses.
    #[serde(default)]
    pub enclosed: Enclosed,
    /// Seconds the decision took.
    pub seconds: f64,
}

impl PartsReport {
    /// Mean of [`PartsReport::expected_agreement`], weighted by the `area` of the parts; `None` if that is empty. Parts
    /// without an expectation, such as tiny components that are a part of their own, do not count.
    fn mean_agreement(&self, area: &[f64]) -> Option<f64> {
        let all = || self.expected_agreement.iter().zip(area);
        let total: f64 = all().map(|(_, area)| area).sum();
        let sum: f64 = all().map(|(share, area)| share * area).sum();
        (!self.expected_agreement.is_empty()).then(|| if total > 0. { sum / total } else { 0. })
    }

    /// Whether the surface has parts, of these `area`s, that people would agree on; `None` if that is unknown. A
    /// surface of one part has not.
    pub fn has_clear_parts(&self, area: &[f64]) -> Option<bool> {
        let several = self.expected_agreement.len() > 1;
        self.mean_agreement(area).map(|mean| several && agreement::is_clear(mean, self.expected_disagreement))
    }
}

impl PartTree {
    /// The cut for the given options.
    ///
    /// # Errors
    /// A number of parts that is not possible.
    pub fn cut_for(&self, count: PartCount, detail: f64) -> Result<TreeCut> {
        match count {
            PartCount::Found => Ok(self.cut_detail(detail)),
            PartCount::Exactly(k) => self.cut_k(k),
            PartCount::Between(a, b) => self.cut_range(a, b, detail),
        }
    }
}

/// The answer of `decided`, given the number `l` of rows and the `seconds` it took, with the parts of `cut`: a cut of
/// its hierarchy, or an edited one.
pub fn describe(decided: &PartDecision, cut: TreeCut, l: usize, seconds: f64) -> PartsResult {
    let PartDecision { superfaces, co_association, tree, enclosed, .. } = decided;
    // Stored in single precision, they sum only nearly to 1.
    let total: f64 = tree.area.iter().map(|&share| f64::from(share)).sum();
    let shares: Vec<f64> = tree.area.iter().map(|&share| f64::from(share) / total).collect();
    let label = superfaces.labels(&cut.label);
    let sure = agreement::confidence(superfaces, co_association, &label, cut.parts);
    let confidence: Vec<f64> = superfaces.of_cell.iter().map(|&a| sure[a as usize]).collect();
    let report = PartsReport {
        cells: tree.cells(),
        landmarks: l,
        superfaces: superfaces.len(),
        parts_found: tree.cut_detail(0.0).parts,
        expected_disagreement: decided.expected_disagreement(&cut.label),
        mean_confidence: confidence.iter().zip(&shares).map(|(c, a)| c * a).sum(),
        expected_agreement: agreement::of_parts(tree, &cut.label, cut.parts, &confidence, &shares),
        enclosed: *enclosed,
        seconds,
    };
    PartsResult { label: cut.label, parts: cut.parts, confidence, report }
}
