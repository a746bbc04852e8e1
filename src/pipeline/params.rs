//! The parameters of `segment`, and their validation: a few hundred bytes, and comparisons of numbers.

use crate::base::error::LESS_WORK;
use crate::base::printable::counted;
use crate::base::{Error, Result};
use crate::cluster::cells;
use crate::cluster::contract::{self, NODES};
use crate::cluster::kmeans::FACES_PER_CHUNK;
use crate::cluster::parts::ensemble::{decision_bytes, member_bytes};
use crate::cluster::parts::{PartCount, PartsParams};
use crate::cluster::two_means;
use crate::graph::Metric;
use crate::graph::order::{Order, OrderParams};
use crate::landmarks::Sampling;
use crate::spectral::EmbeddingParams;
use crate::spectral::embedding::fit_bytes;
use crate::store::budget::Grant;
use crate::store::needs::BESIDE_BUDGET;
use crate::store::{Budget, Run};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// How faces become parts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Cluster {
    /// Parts as people would cut them: over-segmented, merged by concavity and convexity, refined.
    #[default]
    Parts,
    /// The paper's method: K-means in the embedding.
    KMeans,
    /// The paper's other method: parts halved by 2-means in the embedding, the one with the greatest gain first.
    TwoMeans,
    /// Connected components: faces that are joined through common edges, whatever their shape.
    Components,
}

/// The treatment of components too small to be parts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TinyComponents {
    /// Each joins the part next to it.
    #[default]
    Join,
    /// All of them together form a part of their own, in addition to those found or requested.
    Own,
}

/// The treatment of walls: the inside of hollow bodies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Walls {
    /// They get the labels of the outside behind them.
    #[default]
    Follow,
    /// All of them together form a part of their own, in addition to those found or requested. Not possible if more
    /// parts are requested than the surface has cells.
    Own,
}

/// How faces near the boundaries of [`Cluster::Parts`] are labelled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Boundaries {
    /// By one front between the parts' cores, which is slowed down by creases.
    #[default]
    Front,
    /// By Nyström's extrapolation: each face goes to the part nearest to it in the embedding.
    Embedding,
}

/// Parameters of `segment`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[non_exhaustive]
pub struct SegmentParams {
    /// Number of landmarks l; by default [`SegmentParams::landmarks_of`] the mesh.
    pub landmarks: Option<usize>,
    /// How landmarks are chosen; by default [`SegmentParams::sampling_of`] the mesh.
    pub sampling: Option<Sampling>,
    /// Form of the edge weights.
    pub metric: Metric,
    /// In which order faces become nodes.
    pub order: Order,
    /// How faces become parts.
    pub cluster: Cluster,
    /// How many parts, and how [`Cluster::Parts`] decides on them.
    pub parts: PartsParams,
    /// Whether rows are computed over the mesh's own faces. By default a large mesh is contracted first, and there are
    /// more rows over the contraction; with [`Cluster::Parts`], a small mesh of long triangles is refined first, and a
    /// rough one denoised.
    #[serde(default)]
    pub exact: bool,
    /// The treatment of components too small to be parts, with [`Cluster::Parts`]. With [`Cluster::Components`] they
    /// are parts themselves unless they share one.
    #[serde(default)]
    pub tiny_components: TinyComponents,
    /// The treatment of the inside of hollow bodies, with [`Cluster::Parts`].
    #[serde(default)]
    pub walls: Walls,
    /// How faces near boundaries are labelled, with [`Cluster::Parts`].
    #[serde(default)]
    pub boundaries: Boundaries,
    /// How rows are embedded, for [`Cluster::KMeans`] and [`Cluster::TwoMeans`]; by default
    /// [`EmbeddingParams::for_parts`].
    pub embedding: Option<EmbeddingParams>,
}

crate::base::setters::setters!(SegmentParams {
    landmarks: Option<usize>,
    sampling: Option<Sampling>,
    metric: Metric,
    order: Order,
    cluster: Cluster,
    parts: PartsParams,
    exact: bool,
    tiny_components: TinyComponents,
    walls: Walls,
    boundaries: Boundaries,
    embedding: Option<EmbeddingParams>
});

impl SegmentParams {
    /// The same with what follows from other options: reports and work directories state what was done, so that later
    /// runs in them continue it.
    #[must_use]
    pub fn resolved(self) -> Self {
        Self { exact: self.exact_rows(), ..self }
    }

    /// Whether parts are decided with rows over all faces whatever the size of the mesh.
    pub fn exact_rows(&self) -> bool {
        self.exact || self.boundaries == Boundaries::Embedding
    }

    /// Whether parts of a mesh of `faces` faces are decided on its contraction: if it is large, unless `exact` is set,
    /// boundaries are found in the embedding of all faces, or K-means and 2-means are asked for more parts than the
    /// contraction can resolve.
    pub fn contracts(&self, faces: usize) -> bool {
        let few = self.centres().is_none_or(|parts| parts <= NODES / NODES_A_PART);
        !self.exact_rows() && faces > contract::LARGE && few
    }

    /// The maximum number of parts that K-means or 2-means may make, if known; `None` with [`Cluster::Parts`] too.
    pub(super) fn centres(&self) -> Option<usize> {
        match (self.cluster, self.parts.count) {
            (Cluster::KMeans | Cluster::TwoMeans, PartCount::Exactly(parts)) => Some(parts),
            (Cluster::TwoMeans, PartCount::Found) => Some(two_means::MOST),
            (Cluster::TwoMeans, PartCount::Between(_, most)) => Some(most),
            _ => None,
        }
    }

    /// How rows are embedded for K-means and 2-means: as requested, else by default.
    pub(super) fn embedding_or_default(&self) -> EmbeddingParams {
        self.embedding.unwrap_or_else(|| EmbeddingParams::for_parts(dimensions(self)))
    }

    /// The number of landmarks for a mesh of `faces` faces: as requested, else a default.
    ///
    /// Rows over a contraction are cheap. There K-means has at least 60: on 38 models of the benchmark, subdivided to
    /// 150,000 to 600,000 faces, 1 − Rand was .140, .124, .117, .130 with 10, 20, 60, 120
    /// (`benches/records/2026-11-23-means-contracted.md`).
    pub fn landmarks_of(&self, faces: usize) -> usize {
        let contracts = self.contracts(faces);
        self.landmarks.unwrap_or(match self.centres() {
            Some(parts) if contracts => default_landmarks_for_parts(parts).max(MOST_LANDMARKS),
            Some(parts) => default_landmarks_for_parts(parts),
            None if contracts => landmarks_on_contraction(faces),
            None => self.landmarks_over(faces),
        })
    }

    /// The number of landmarks for deciding on parts with rows over all of `nodes` nodes: as requested, else a default.
    pub(super) fn landmarks_over(&self, nodes: usize) -> usize {
        self.landmarks.unwrap_or_else(|| default_landmarks_for_faces(nodes))
    }

    /// How landmarks of a mesh of `faces` faces are chosen: as requested, else by area and distance if
    /// [`Cluster::Parts`] has rows over a contraction, and as farthest points if rows are over all faces, or for the
    /// paper's methods.
    pub fn sampling_of(&self, faces: usize) -> Sampling {
        let weighted = self.cluster == Cluster::Parts && self.contracts(faces);
        self.sampling.unwrap_or(if weighted { Sampling::DistanceWeighted } else { Sampling::Farthest })
    }

    /// In which order the faces of a mesh of `faces` faces are processed.
    pub fn ordering(&self, faces: usize) -> OrderParams {
        OrderParams { order: self.order, has_rows: !self.contracts(faces) }
    }

    /// Whether distance rows are kept, in a work directory that is `lasting` or temporary: always in one that lasts; in
    /// a temporary one if their columns are read again, which K-means, 2-means, and boundaries by the embedding do.
    pub fn keeps_rows(&self, lasting: bool) -> bool {
        lasting || self.cluster != Cluster::Parts || self.boundaries == Boundaries::Embedding
    }
}

/// Minimum number of contraction nodes per part of K-means.
const NODES_A_PART: usize = 30;
/// Maximum number of landmarks: beyond it, matrices of l × l would take hundreds of megabytes, and their eigenvectors
/// minutes.
pub const LANDMARKS_AT_MOST: usize = 4096;
/// Maximum number of landmarks for K-means, except for very many parts.
const MOST_LANDMARKS: usize = 60;

/// Landmarks for K-means into `parts` parts with rows over all faces: twice as many, so that every part can contain
/// two, within 10 and 60, but more than the number of parts up to 512: beyond that, eigenvectors cost more than they
/// gain.
pub fn default_landmarks_for_parts(parts: usize) -> usize {
    (2 * parts).clamp(10, MOST_LANDMARKS).max((parts + 1).min(512))
}

/// Number of faces up to which a mesh has fewer landmarks on its contraction, and more over all faces.
const MEDIUM: usize = 300_000;

/// Landmarks for deciding on parts with rows over all of `faces` faces: 120 where fronts are cheap, fewer where they
/// are expensive. On the 190 models of the benchmark 1 − Rand was .094, .093, .089, .087, .087, .086 with 20, 30, 40,
/// 60, 80, 120 under seed 0. Beyond 60, agreement with people does not improve, but that between two seeds does: see
/// `docs/quality.md`.
pub fn default_landmarks_for_faces(faces: usize) -> usize {
    let landmarks = [(contract::LARGE, 120), (MEDIUM, 60), (2_000_000, 40), (20_000_000, 30)];
    landmarks.into_iter().find(|&(most, _)| faces <= most).map_or(20, |(_, landmarks)| landmarks)
}

/// Landmarks for deciding on parts with rows over the contraction of a mesh of `faces` faces: 240 if their time is
/// small compared with the rest, else 120.
pub fn landmarks_on_contraction(faces: usize) -> usize {
    if faces > MEDIUM { 240 } else { 120 }
}

/// Number of coordinates for the paper's methods.
pub(super) fn dimensions(params: &SegmentParams) -> usize {
    if let PartCount::Exactly(k) = params.parts.count { k } else { two_means::DIMENSIONS }
}

/// Minimum allocation of the decision on parts: the ensemble and its co-association over two thousand cells (measured).
const DECISION: u64 = 20 << 20;

impl Cluster {
    /// Whether parts are found in the embedding of faces.
    pub fn embeds(self) -> bool {
        matches!(self, Self::KMeans | Self::TwoMeans)
    }

    /// Whether tiny components can have a part of their own.
    pub fn separates_tiny(self) -> bool {
        matches!(self, Self::Parts | Self::Components)
    }

    /// Bytes that finding parts allocates, independent of the budget, with `landmarks` rows over `nodes` nodes: for the
    /// decision, or for the sample on which centres are found.
    pub(super) fn fixed_bytes(self, landmarks: u64, nodes: u64) -> u64 {
        match self {
            Self::Parts => decision_bytes(landmarks).max(DECISION),
            Self::KMeans | Self::TwoMeans => fit_bytes(landmarks, nodes),
            Self::Components => 0,
        }
    }

    /// The part of [`Cluster::fixed_bytes`] that must fit the budget.
    fn bytes_of_budget(self, landmarks: u64, nodes: u64) -> u64 {
        self.fixed_bytes(landmarks, nodes).saturating_sub(BESIDE_BUDGET)
    }

    /// Takes that part from the budget, for as long as parts are found with `landmarks` rows over `nodes` nodes.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub(super) fn grant(self, landmarks: usize, nodes: usize, run: &Run) -> Result<Grant> {
        let bytes = self.bytes_of_budget(landmarks as u64, nodes as u64);
        run.budget.take_or(WHAT_LANDMARKS_TAKE, bytes, LESS_WORK)
    }

    /// Bytes that each further thread allocates, if the budget has room for it.
    pub(super) fn thread_bytes(self, landmarks: u64) -> u64 {
        match self {
            Self::Parts => member_bytes(landmarks as usize, cells::CELLS),
            Self::KMeans | Self::TwoMeans => 4 * FACES_PER_CHUNK as u64 * landmarks,
            Self::Components => 0,
        }
    }
}

/// The name of this allocation in [`Error::Memory`].
const WHAT_LANDMARKS_TAKE: &str = "finding parts with so many landmarks";

/// Bytes that a part takes in reports and in the record of the work directory (measured).
pub(super) const BYTES_PER_PART: u64 = 1100;
/// The name of these in [`Error::Memory`], and what helps.
const WHAT_PARTS_TAKE: (&str, &str) = ("so many parts", "request fewer `parts`");

/// The part of the bytes of `parts` parts that must fit the budget.
fn part_bytes_of_budget(parts: usize) -> u64 {
    (BYTES_PER_PART * parts as u64).saturating_sub(BESIDE_BUDGET)
}

/// Takes that part from the budget; `remedy` is what would help besides more memory, by default fewer parts.
///
/// # Errors
/// [`Error::Memory`].
pub(super) fn grant_parts(parts: usize, remedy: Option<&'static str>, run: &Run) -> Result<Grant> {
    let (what, fewer) = WHAT_PARTS_TAKE;
    run.budget.take_or(what, part_bytes_of_budget(parts), remedy.unwrap_or(fewer))
}

impl SegmentParams {
    /// Rejects options that are out of range, contradict each other, or have no effect on the chosen method.
    ///
    /// # Errors
    /// [`Error::Parameter`] naming the option.
    pub fn check(&self) -> Result<()> {
        let refused = |name: &str, problem: String, remedy: &str| Err(Error::parameter(name, problem, remedy));
        let by_parts = self.cluster == Cluster::Parts;
        let exact = matches!(self.parts.count, PartCount::Exactly(_));
        let count = if exact { "parts" } else { "parts_between" };
        match self.parts.count {
            PartCount::Found if self.cluster == Cluster::KMeans => {
                let remedy = "give it, as in `parts` 6, or choose `cluster` parts";
                return refused("parts", "K-means needs the number of parts".into(), remedy);
            }
            PartCount::Between(..) if self.cluster == Cluster::KMeans => {
                return refused("parts_between", "K-means needs an exact number of parts".into(), "give `parts`");
            }
            PartCount::Exactly(_) | PartCount::Between(..) if self.cluster == Cluster::Components => {
                let problem = "there are as many parts as connected components";
                return refused(count, problem.into(), "leave it out, or choose another `cluster`");
            }
            PartCount::Between(least, most) if least > most => {
                return refused("parts_between", format!("{least}..{most} is empty"), "put the smaller first");
            }
            PartCount::Exactly(0) | PartCount::Between(0, _) => {
                return refused(count, "0 parts".into(), "choose at least 1");
            }
            _ => {}
        }
        self.parts.check()?;
        if self.parts.detail != 0. && (exact || !by_parts) {
            let problem =
                if exact { "has no effect on an exact number of parts" } else { "applies only to the default method" };
            return refused("detail", problem.into(), "leave one of them out");
        }
        if self.landmarks.is_some_and(|l| l == 0 || l > LANDMARKS_AT_MOST) {
            let remedy = format!("choose from 1 to {LANDMARKS_AT_MOST}");
            return refused("landmarks", counted(self.landmarks.unwrap_or(0), "landmark"), &remedy);
        }
        let usual = PartsParams::default();
        let others = [
            ("decision", self.parts.decision != usual.decision),
            ("ensemble_size", self.parts.ensemble_size != usual.ensemble_size),
            ("small_part", self.parts.small_part != usual.small_part),
            ("tiny_components", self.tiny_components != TinyComponents::default() && !self.cluster.separates_tiny()),
            ("walls", self.walls != Walls::default()),
            ("boundaries", self.boundaries != Boundaries::default()),
        ];
        let idle = match (&self.embedding, others.into_iter().find(|(_, given)| *given)) {
            (Some(_), _) if !self.cluster.embeds() => Some(("embedding", "applies only to K-means and 2-means")),
            (_, Some((name, _))) if !by_parts => Some((name, "applies only to the default method")),
            _ if self.parts.decision != usual.decision && self.parts.ensemble_size != usual.ensemble_size => {
                Some(("ensemble_size", "applies only to the default decision"))
            }
            _ => None,
        };
        if let Some((name, problem)) = idle {
            return refused(name, problem.into(), "leave it out, or choose the other method");
        }
        self.embedding.map_or(Ok(()), |embedding| embedding.check())
    }

    /// The same, and rejects more parts than the mesh at `path` has `faces`.
    ///
    /// # Errors
    /// [`Error::Unusable`] for too many parts; [`Error::Parameter`].
    pub fn check_for(&self, path: &Path, faces: u64) -> Result<()> {
        self.check()?;
        let wanted = self.parts.count.least();
        if wanted as u64 > faces {
            let faces = counted(faces as usize, "face");
            let problem = format!("has {faces}, fewer than the {wanted} parts requested");
            let bounds = matches!(self.parts.count, PartCount::Between(..));
            let remedy = if bounds { "choose smaller `parts_between`" } else { "choose a smaller `parts`" };
            return Err(Error::unusable(path, problem, remedy));
        }
        Ok(())
    }

    /// Rejects more landmarks or parts than [`Budget::left_to_stages`] has room for, before rows are computed; arrays
    /// may use the rest.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn check_memory(&self, faces: u64, run: &Run) -> Result<()> {
        let faces = usize::try_from(faces).unwrap_or(usize::MAX);
        let nodes = if self.contracts(faces) { NODES } else { faces } as u64;
        let landmarks = self.landmarks_of(faces).min(faces) as u64;
        let available = Budget::left_to_stages(run.budget.total());
        let (parts, fewer) = WHAT_PARTS_TAKE;
        let needs = [
            (WHAT_LANDMARKS_TAKE, self.cluster.bytes_of_budget(landmarks, nodes), LESS_WORK),
            (parts, part_bytes_of_budget(self.parts.count.least()), fewer),
        ];
        match needs.into_iter().find(|(_, needed, _)| *needed > available) {
            Some((what, needed, remedy)) => Err(Error::Memory { what, needed, available, remedy }),
            None => Ok(()),
        }
    }
}
