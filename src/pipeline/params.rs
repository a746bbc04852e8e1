//! The parameters of `segment`, and the check that they make sense together.

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
use crate::store::Run;
use crate::store::budget::Grant;
use crate::store::needs::BESIDE_BUDGET;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// How faces become parts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Cluster {
    /// Parts as people would cut them: over-segmented, merged by concavity and convexity, refined.
    #[default]
    Parts,
    /// The paper's: K-means in the embedding.
    KMeans,
    /// The paper's other: parts halved by 2-means in the embedding, the one that gains most first.
    TwoMeans,
}

/// What becomes of components too small to be parts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TinyComponents {
    /// Each joins the part that it floats beside.
    #[default]
    Join,
    /// All of them together are a part of their own, besides those that are found or asked for.
    Own,
}

/// What becomes of walls: the inside of hollow bodies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Walls {
    /// They have the labels of the outside behind them.
    #[default]
    Follow,
    /// All of them together are a part of their own, besides those that are found or asked for; not where more parts
    /// are asked for than the surface has cells.
    Own,
}

/// How faces near the boundaries of [`Cluster::Parts`] get their labels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Boundaries {
    /// By one front between the parts' cores, which is held up on creases.
    #[default]
    Front,
    /// By Nyström's extrapolation: each face goes to the part nearest to it in the embedding.
    Embedding,
}

/// What `segment` is asked to do.
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
    /// Whether rows are computed over all faces of any mesh. By default a large mesh is contracted first, and there are
    /// more rows over the contraction.
    #[serde(default)]
    pub exact: bool,
    /// What becomes of components too small to be parts, with [`Cluster::Parts`].
    #[serde(default)]
    pub tiny_components: TinyComponents,
    /// What becomes of the inside of hollow bodies, with [`Cluster::Parts`].
    #[serde(default)]
    pub walls: Walls,
    /// How faces near boundaries get their labels, with [`Cluster::Parts`].
    #[serde(default)]
    pub boundaries: Boundaries,
    /// How rows become coordinates, for [`Cluster::KMeans`] and [`Cluster::TwoMeans`];
    /// by default [`EmbeddingParams::for_parts`].
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
    /// Whether parts are decided with rows over all faces of any mesh.
    pub fn exact_rows(&self) -> bool {
        self.exact || self.boundaries == Boundaries::Embedding
    }

    /// Whether parts of a mesh of `faces` faces are decided on its contraction: if it is large, unless `exact` is set,
    /// its boundaries are found in the embedding of all faces, or K-means and 2-means are asked for more parts than
    /// can be told apart there.
    pub fn contracts(&self, faces: usize) -> bool {
        let few = self.centres().is_none_or(|parts| parts <= NODES / NODES_A_PART);
        !self.exact_rows() && faces > contract::LARGE && few
    }

    /// How many parts K-means or 2-means may make, where that is known; `None` with [`Cluster::Parts`] too.
    pub(super) fn centres(&self) -> Option<usize> {
        match (self.cluster, self.parts.count) {
            (Cluster::KMeans | Cluster::TwoMeans, PartCount::Exactly(parts)) => Some(parts),
            (Cluster::TwoMeans, PartCount::Found) => Some(two_means::MOST),
            (Cluster::TwoMeans, PartCount::Between(_, most)) => Some(most),
            _ => None,
        }
    }

    /// The number of landmarks for a mesh of `faces` faces: the one asked for, else as many as pay.
    ///
    /// Over a contraction rows cost hardly anything. There K-means has at least 60: on 38 models of the benchmark,
    /// subdivided to 150,000 to 600,000 faces, 1 − Rand was .140, .124, .117, .130 with 10, 20, 60, 120
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

    /// The number of landmarks for deciding parts with rows over all of `nodes` nodes: the one asked for, else as many
    /// as pay.
    pub(super) fn landmarks_over(&self, nodes: usize) -> usize {
        self.landmarks.unwrap_or_else(|| default_landmarks_for_faces(nodes))
    }

    /// How landmarks of a mesh of `faces` faces are chosen: as asked for, else by area and distance where
    /// [`Cluster::Parts`] has rows over a contraction, and farthest points where rows are over all faces, or are
    /// those of the paper's methods.
    pub fn sampling_of(&self, faces: usize) -> Sampling {
        let weighted = self.cluster == Cluster::Parts && self.contracts(faces);
        self.sampling.unwrap_or(if weighted { Sampling::DistanceWeighted } else { Sampling::Farthest })
    }

    /// In which order the faces of a mesh of so many are worked on.
    pub fn ordering(&self, faces: usize) -> OrderParams {
        OrderParams { order: self.order, has_rows: !self.contracts(faces) }
    }

    /// Whether rows of distances are kept, in a work directory that is `lasting` or temporary: in one that lasts
    /// always, else where their columns are read again, by K-means, 2-means, and boundaries by the embedding.
    pub fn keeps_rows(&self, lasting: bool) -> bool {
        lasting || self.cluster != Cluster::Parts || self.boundaries == Boundaries::Embedding
    }
}

/// Nodes of the contraction that each part of K-means should have, at least.
const NODES_A_PART: usize = 30;
/// Landmarks that may be asked for: matrices of l × l then take some hundred megabytes, and their eigenvectors minutes.
pub const LANDMARKS_AT_MOST: usize = 4096;
/// Landmarks for K-means at the most, but for very many parts.
const MOST_LANDMARKS: usize = 60;

/// Landmarks for K-means into `parts` parts with rows over all faces: twice as many, so that every part can
/// hold two, at least 10 and at most 60, but more than parts up to 512: beyond, eigenvectors would cost
/// more than they tell apart.
pub fn default_landmarks_for_parts(parts: usize) -> usize {
    (2 * parts).clamp(10, MOST_LANDMARKS).max((parts + 1).min(512))
}

/// Faces up to which a mesh has fewer landmarks on its contraction, and more over all faces.
const MEDIUM: usize = 300_000;

/// Landmarks for deciding parts with rows over all of `faces` faces: 120 where fronts are cheap, fewer where
/// each costs. On the 190 models of the benchmark 1 − Rand was .094, .093, .089, .087, .087, .086 with 20, 30,
/// 40, 60, 80, 120 under seed 0. From 60 on more do not agree better with people, but two seeds with each
/// other: see `docs/quality.md`.
pub fn default_landmarks_for_faces(faces: usize) -> usize {
    let landmarks = [(contract::LARGE, 120), (MEDIUM, 60), (2_000_000, 40), (20_000_000, 30)];
    landmarks.into_iter().find(|&(most, _)| faces <= most).map_or(20, |(_, landmarks)| landmarks)
}

/// Landmarks for deciding parts with rows over the contraction of a mesh of `faces` faces: 240 where their time is
/// small beside that of all else, else 120.
pub fn landmarks_on_contraction(faces: usize) -> usize {
    if faces > MEDIUM { 240 } else { 120 }
}

/// Coordinates wanted for the paper's methods.
pub(super) fn dimensions(params: &SegmentParams) -> usize {
    if let PartCount::Exactly(k) = params.parts.count { k } else { two_means::DIMENSIONS }
}

/// What deciding parts allocates at the least: the ensemble and its co-association over two thousand cells (measured).
const DECISION: u64 = 20 << 20;

impl Cluster {
    /// Bytes that finding parts allocates, whatever the budget and the mesh, by `landmarks` rows over `nodes` nodes:
    /// for the decision, or for the sample that centres are found on.
    pub(super) fn fixed_bytes(self, landmarks: u64, nodes: u64) -> u64 {
        match self {
            Self::Parts => decision_bytes(landmarks).max(DECISION),
            Self::KMeans | Self::TwoMeans => fit_bytes(landmarks, nodes),
        }
    }

    /// What of [`Cluster::fixed_bytes`] the budget has to have room for.
    fn bytes_of_budget(self, landmarks: u64, nodes: u64) -> u64 {
        self.fixed_bytes(landmarks, nodes).saturating_sub(BESIDE_BUDGET)
    }

    /// The same taken from the budget, for as long as parts are found by `landmarks` rows over `nodes` nodes.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub(super) fn grant(self, landmarks: usize, nodes: usize, run: &Run) -> Result<Grant> {
        let bytes = self.bytes_of_budget(landmarks as u64, nodes as u64);
        run.budget.take(WHAT_LANDMARKS_TAKE, bytes, bytes)
    }

    /// Bytes that each thread but one allocates besides, where the budget has room for it.
    pub(super) fn thread_bytes(self, landmarks: u64) -> u64 {
        match self {
            Self::Parts => member_bytes(landmarks as usize, cells::CELLS),
            Self::KMeans | Self::TwoMeans => 4 * FACES_PER_CHUNK as u64 * landmarks,
        }
    }
}

/// What [`Error::Memory`] calls what landmarks take.
const WHAT_LANDMARKS_TAKE: &str = "finding parts with so many landmarks";

impl SegmentParams {
    /// Refuses options that are out of range, that contradict each other, or that have no effect on the method that is
    /// chosen.
    ///
    /// # Errors
    /// [`Error::Parameter`] naming the option.
    pub fn check(&self) -> Result<()> {
        let refused = |name: &str, problem: String, remedy: &str| Err(Error::parameter(name, problem, remedy));
        let by_parts = self.cluster == Cluster::Parts;
        let exact = matches!(self.parts.count, PartCount::Exactly(_));
        match self.parts.count {
            PartCount::Found if self.cluster == Cluster::KMeans => {
                let remedy = "give it, as in `parts` 6, or choose `cluster` parts";
                return refused("parts", "K-means needs the number of parts".into(), remedy);
            }
            PartCount::Between(..) if self.cluster == Cluster::KMeans => {
                return refused("parts_between", "K-means needs an exact number of parts".into(), "give `parts`");
            }
            PartCount::Between(least, most) if least > most => {
                return refused("parts_between", format!("{least}..{most} is empty"), "put the smaller first");
            }
            PartCount::Exactly(0) | PartCount::Between(0, _) => {
                return refused("parts", "0 parts".into(), "choose at least 1");
            }
            _ => {}
        }
        self.parts.check()?;
        if self.parts.detail != 0. && (exact || !by_parts) {
            let problem =
                if exact { "has no effect on an exact number of parts" } else { "goes with the default method" };
            return refused("detail", problem.into(), "leave one of them out");
        }
        if self.landmarks.is_some_and(|l| l == 0 || l > LANDMARKS_AT_MOST) {
            let remedy = format!("choose from 1 to {LANDMARKS_AT_MOST}");
            return refused("landmarks", format!("{} landmarks", self.landmarks.unwrap_or(0)), &remedy);
        }
        let usual = PartsParams::default();
        let others = [
            ("decision", self.parts.decision != usual.decision),
            ("ensemble_size", self.parts.ensemble_size != usual.ensemble_size),
            ("small_part", self.parts.small_part != usual.small_part),
            ("tiny_components", self.tiny_components != TinyComponents::default()),
            ("walls", self.walls != Walls::default()),
            ("boundaries", self.boundaries != Boundaries::default()),
        ];
        let idle = match (&self.embedding, others.into_iter().find(|(_, given)| *given)) {
            (Some(_), _) if by_parts => Some(("embedding", "goes with K-means and 2-means")),
            (_, Some((name, _))) if !by_parts => Some((name, "goes with the default method")),
            _ if self.parts.decision != usual.decision && self.parts.ensemble_size != usual.ensemble_size => {
                Some(("ensemble_size", "goes with the default decision"))
            }
            _ => None,
        };
        if let Some((name, problem)) = idle {
            return refused(name, problem.into(), "leave it out, or choose the other method");
        }
        self.embedding.map_or(Ok(()), |embedding| embedding.check())
    }

    /// The same, and refuses more parts than the mesh at `path` has `faces`.
    ///
    /// # Errors
    /// [`Error::Unusable`] for these; [`Error::Parameter`].
    pub fn check_for(&self, path: &Path, faces: u64) -> Result<()> {
        self.check()?;
        let wanted = self.parts.count.least();
        if wanted as u64 > faces {
            let problem = format!(
                "has {faces} face{}, fewer than the {wanted} parts asked for",
                if faces == 1 { "" } else { "s" }
            );
            return Err(Error::unusable(path, problem, "choose a smaller `parts`"));
        }
        Ok(())
    }

    /// Refuses more landmarks than half of the budget has room for, before rows are computed; arrays may have the other
    /// half.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn check_memory(&self, faces: u64, run: &Run) -> Result<()> {
        let faces = usize::try_from(faces).unwrap_or(usize::MAX);
        let nodes = if self.contracts(faces) { NODES } else { faces } as u64;
        let landmarks = self.landmarks_of(faces).min(faces) as u64;
        let needed = self.cluster.bytes_of_budget(landmarks, nodes);
        let available = run.budget.total() / 2;
        if needed > available {
            return Err(Error::Memory { what: WHAT_LANDMARKS_TAKE, needed, available });
        }
        Ok(())
    }
}
