//! Parts as people would cut them, decided on some two thousand cells: constant time and memory in the mesh size.
//!
//! The input is the cell graph and the landmark distances averaged over cells.
//! - The [`interior`] of the surface is separated first: walls of cavities follow the outside, bodies within are
//!   decided on alone.
//! - [`ensemble`] over-segments the cells twelve times (embedding of [`crate::spectral::anchor`], [`cell_kmeans`]),
//!   each time from a random subset of the landmarks.
//! - [`merges`] merges each over-segmentation down to one part and estimates at each merge the probability that people
//!   keep the two sides together ([`merge_odds`]), from sums over [`regions`], [`convexity`] and [`thickness`], in
//!   units of the shape without its [`folding`]. Regions of flat [`plates`] and sheets are compared after their
//!   [`inflation`].
//! - Its mean over the ensemble, by log odds, is the co-association: a probability for any two [`Superfaces`].
//! - If the surface is its own mirror image, or a posed body is symmetric along its surface, both sides are decided
//!   alike ([`symmetry`]); so is what rotations map onto itself.
//! - `slender_limbs` that no part ends at are cut off.
//! - [`labelling`] finds the labels of the greatest expected Rand index, without `ambiguous` patches,
//!   `arbitrary_cuts`, cuts at `repeated_places` and floors of `recesses`, and a whole [`hierarchy`] around them.
//! - [`hints`] changes a labelling according to people's edits; `split` divides a part further along the hierarchy.
//! - [`agreement`] estimates how certain a part is and how many people would have it.
//! - [`decide`] combines all of this; [`consensus`] has the simpler decisions.
//!
//! Everything is a function of the input and the seed, not of threads or timing. Cost, whatever the size of the mesh:
//! .05 s on two threads for 60 landmarks, up to .08 s more processor time if no mirror plane is found, and less than
//! 40 MB, except on meshes of thousands of pieces and very noisy ones.

pub mod agreement;
mod ambiguous;
mod answer;
mod arbitrary_cuts;
mod area_vectors;
pub mod cell_graph;
pub mod cell_kmeans;
pub mod cell_labels;
pub mod consensus;
pub mod convexity;
mod decide;
pub mod ensemble;
pub mod folding;
pub mod hierarchy;
pub mod hints;
pub mod inflation;
pub mod interior;
pub mod labelling;
pub mod linkage;
pub mod matrix;
pub mod merge_features;
pub mod merge_odds;
pub mod merges;
pub mod plates;
mod recesses;
pub mod region_pieces;
pub mod regions;
mod repeated_places;
pub mod shortcuts;
mod slender_limbs;
mod split;
pub mod symmetry;
pub mod thickness;

pub use answer::{PartDecision, PartsReport, PartsResult, describe};
pub use cell_graph::CellGraph;
pub use decide::decide;
pub use ensemble::Superfaces;
pub use hierarchy::{PartTree, TreeCut, detail_threshold};
pub use interior::enclosed::Enclosed;

use crate::base::printable::Significant;
use crate::base::{Error, Result};
use serde::{Deserialize, Serialize};

/// Maximum number of over-segmentations in an ensemble.
pub const MOST_SEGMENTATIONS: usize = 4096;

/// The method of deciding on parts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Decision {
    /// An ensemble merged down to one part each, probabilities at the merges, the labelling of the greatest expected
    /// Rand index: no stop constant.
    #[default]
    SoftTrees,
    /// An ensemble stopped by a constant, average linkage, a final merge.
    Consensus,
    /// One over-segmentation, merged until a constant.
    Single,
}

/// The number of parts requested.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PartCount {
    /// As many as are found.
    #[default]
    Found,
    /// Exactly this many.
    Exactly(usize),
    /// As many as are found, within these bounds, both included.
    Between(usize, usize),
}

impl PartCount {
    /// The name of the option that gives this number.
    pub fn option(self) -> &'static str {
        if matches!(self, Self::Between(..)) { "parts_between" } else { "parts" }
    }
}

/// Options of [`decide`] and [`PartTree::cut_for`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PartsParams {
    /// The method of deciding.
    pub decision: Decision,
    /// The number of parts requested.
    pub count: PartCount,
    /// −1 (one part) to 1 (as fine as possible), 0 for the parts found; moves the threshold ([`detail_threshold`]). No
    /// effect if the number is given.
    pub detail: f64,
    /// Number of over-segmentations in the ensemble of [`Decision::SoftTrees`], from 1 to [`MOST_SEGMENTATIONS`].
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
            small_part: cell_labels::SMALL_PART,
        }
    }
}

impl PartsParams {
    /// Rejects options out of range.
    ///
    /// # Errors
    /// [`Error::Parameter`] naming the option.
    pub fn check(&self) -> Result<()> {
        if !(-1.0..=1.0).contains(&self.detail) {
            let problem = format!("{} is out of range", Significant(self.detail));
            return Err(Error::parameter("detail", problem, "choose from -1 to 1"));
        }
        if !(1..=MOST_SEGMENTATIONS).contains(&self.ensemble_size) {
            let problem = format!("{} segmentations", self.ensemble_size);
            let remedy = format!("choose from 1 to {MOST_SEGMENTATIONS}");
            return Err(Error::parameter("ensemble_size", problem, remedy));
        }
        if !(0.0..1.0).contains(&self.small_part) {
            let problem = format!("{} is not a fraction of the area", Significant(self.small_part));
            return Err(Error::parameter("small_part", problem, "choose from 0 to below 1"));
        }
        Ok(())
    }
}

impl PartCount {
    /// The least number requested.
    pub fn least(self) -> usize {
        match self {
            Self::Found => 1,
            Self::Exactly(k) | Self::Between(k, _) => k,
        }
    }

    /// The same, but for at most `most` parts.
    pub fn at_most(self, most: usize) -> Self {
        match self {
            Self::Found => Self::Found,
            Self::Exactly(k) => Self::Exactly(k.min(most)),
            Self::Between(a, b) => Self::Between(a.min(most), b.min(most)),
        }
    }
}
