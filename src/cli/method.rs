//! Options of the method, in the groups that subcommands take, and how they become parameters.
//!
//! What only one way of clustering uses is refused with another, before any work.

use super::Failure;
use super::metric::MetricArgs;
use clap::ValueEnum;
use nystrom_stream::cluster::parts::{Decision, PartCount, PartsParams};
use nystrom_stream::cluster::two_means;
use nystrom_stream::graph::Order;
use nystrom_stream::landmarks::Sampling;
use nystrom_stream::pipeline::{Boundaries, Cluster, SegmentParams, TinyComponents};
use nystrom_stream::spectral::embedding::KernelWidth;
use nystrom_stream::spectral::{EmbeddingParams, Kernel, Normalisation};

/// How landmarks are sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum SamplingArg {
    /// Max–min farthest points from an extremity (the paper's §6.2)
    Farthest,
    /// At random, by area
    Random,
    /// At random, each face alike (the paper's random sampling)
    Uniform,
    /// Farthest points in length alone, whatever the metric
    GeodesicFarthest,
    /// Farthest points moved to the middle of their cells
    Centroids,
    /// Randomly pivoted Cholesky
    Cholesky,
    /// The best of 90 random candidates by Γ (the paper's §6.1): 90 fronts a landmark
    Greedy,
    /// The same, with candidates kept: 90 fronts, and one a landmark
    PooledGreedy,
}

impl SamplingArg {
    /// The library's.
    pub fn sampling(self) -> Sampling {
        match self {
            Self::Farthest => Sampling::Farthest,
            Self::Random => Sampling::Random,
            Self::Uniform => Sampling::Uniform,
            Self::GeodesicFarthest => Sampling::GeodesicFarthest,
            Self::Centroids => Sampling::Centroids,
            Self::Cholesky => Sampling::Cholesky,
            Self::Greedy => Sampling::Greedy,
            Self::PooledGreedy => Sampling::PooledGreedy,
        }
    }
}

/// The kernel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum KernelArg {
    /// exp(−d²/2σ²)
    Gaussian,
    /// exp(−d/σ)
    Exponential,
    /// max(0, 1 − d/4σ)³
    Polynomial,
    /// 1/√(1 + d²/σ²)
    InverseMultiquadric,
    /// (1 + √3 d/σ) exp(−√3 d/σ)
    Matern,
    /// 1/(1 + d²/σ²)
    Cauchy,
}

impl KernelArg {
    /// The library's.
    pub fn kernel(self) -> Kernel {
        match self {
            Self::Gaussian => Kernel::Gaussian,
            Self::Exponential => Kernel::Exponential,
            Self::Polynomial => Kernel::Polynomial { degree: 3 },
            Self::InverseMultiquadric => Kernel::InverseMultiquadric,
            Self::Matern => Kernel::Matern,
            Self::Cauchy => Kernel::Cauchy,
        }
    }
}

/// How affinities are normalised.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum NormaliseArg {
    /// Not at all (eq. 1)
    None,
    /// By the roots of both degrees
    Degree,
    /// As an anchor graph
    Anchor,
}

/// In which order faces are worked on.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum OrderArg {
    /// As in the file
    Keep,
    /// Sorted along Hilbert's curve
    Hilbert,
    /// Sorted where the mesh is large and the file's order poor
    Auto,
}

/// How faces become parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ClusterArg {
    /// Parts as people would cut them; their number is found
    Parts,
    /// K-means in the embedding, as the paper
    Kmeans,
    /// Iterative 2-means in the embedding, as the paper; without -k until no split gains much
    TwoMeans,
}

/// How parts are decided.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum DecisionArg {
    /// Twelve merge trees with probabilities, the labelling of the greatest expected Rand index
    SoftTrees,
    /// Merging stopped by a constant, agreed on by average linkage
    Consensus,
    /// One over-segmentation, merged until a constant
    Single,
}

/// What becomes of dust.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum TinyComponentsArg {
    /// Each speck joins the part it floats beside
    Join,
    /// All specks are a part of their own, the last one, not counted by -k
    Own,
}

/// How faces near boundaries get their labels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum BoundariesArg {
    /// By a front between the parts' cores, which meets on creases
    Front,
    /// By each face's place in the embedding (Nyström's extrapolation)
    Embedding,
}

/// Bounds from "4..12".
fn parse_range(text: &str) -> Result<(usize, usize), String> {
    let wrong = || format!("{text:?} is no range; write 4..12");
    let (low, high) = text.split_once("..").ok_or_else(wrong)?;
    match (low.trim().parse(), high.trim_start_matches('=').trim().parse()) {
        (Ok(low), Ok(high)) if 0 < low && low <= high => Ok((low, high)),
        _ => Err(wrong()),
    }
}

/// The refusal of an option that has no effect but with `only`.
pub fn misfit(option: &str, only: &str) -> Failure {
    Failure::Misused(format!("{option} goes with {only} only"))
}

/// How many parts, and how they are decided on.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Parts")]
pub struct PartsArgs {
    /// Number of parts, exactly [default: found]
    #[arg(short = 'k', long = "parts", value_name = "K", conflicts_with_all = ["parts_range", "detail"])]
    pub parts: Option<usize>,
    /// Bounds for the number of parts found
    #[arg(long, value_name = "A..B", value_parser = parse_range)]
    pub parts_range: Option<(usize, usize)>,
    /// Coarser (to -1) or finer (to 1) than the parts found
    #[arg(long, value_name = "D", allow_negative_numbers = true)]
    pub detail: Option<f64>,
    /// How faces become parts [default: parts, or as in the work directory]
    #[arg(long, value_enum)]
    pub cluster: Option<ClusterArg>,
    /// How parts are decided [default: soft-trees] (with --cluster parts)
    #[arg(long, value_enum)]
    pub decision: Option<DecisionArg>,
    /// What becomes of components too small to be parts [default: join] (with --cluster parts)
    #[arg(long, alias = "dust", value_enum)]
    pub tiny_components: Option<TinyComponentsArg>,
    /// How faces near boundaries get their labels [default: front] (with --cluster parts)
    #[arg(long, value_enum, hide_short_help = true)]
    pub boundaries: Option<BoundariesArg>,
}

/// How distances become coordinates.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Embedding (kmeans and two-means)")]
pub struct KernelArgs {
    /// From distance to affinity [default: gaussian]
    #[arg(long, hide_short_help = true, value_enum)]
    pub kernel: Option<KernelArg>,
    /// The kernel's width in mean distances [default: 0.25; 1 without anchor graph, as the paper]
    #[arg(long, hide_short_help = true, value_name = "X")]
    pub sigma: Option<f64>,
    /// How affinities are normalised [default: anchor]
    #[arg(long, hide_short_help = true, value_enum)]
    pub normalise: Option<NormaliseArg>,
    /// Leave the lengths of embedded faces as they are
    #[arg(long, hide_short_help = true)]
    pub no_unit_rows: bool,
}

/// In which order faces are worked on.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Distances")]
pub struct OrderArgs {
    /// In which order faces are worked on; labels always come in the file's [default: auto, or as in the work directory]
    #[arg(long, value_enum, hide_short_help = true)]
    pub order: Option<OrderArg>,
}

/// How distances are measured, and from where.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Distances")]
pub struct DistanceArgs {
    /// Number of landmarks [default: 60 to 20 by size; otherwise twice the parts, 10 to 60]
    #[arg(short = 'l', long, hide_short_help = true, value_name = "L", value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub landmarks: Option<u32>,
    /// How landmarks are chosen
    #[arg(long, hide_short_help = true, value_enum, default_value = "farthest")]
    pub sampling: SamplingArg,
    /// Preview: decide on a contraction of the mesh; the rows over all faces are left out
    #[arg(long)]
    pub coarse: bool,
    #[command(flatten)]
    pub metric: MetricArgs,
}

/// Options of the whole method.
#[derive(Clone, Debug, clap::Args)]
pub struct MethodArgs {
    #[command(flatten)]
    pub parts: PartsArgs,
    #[command(flatten)]
    pub distance: DistanceArgs,
    #[command(flatten)]
    pub order: OrderArgs,
    #[command(flatten)]
    pub kernel: KernelArgs,
}

impl OrderArgs {
    /// The order; `other` where none is asked for.
    pub fn or(&self, other: Order) -> Order {
        match self.order {
            Some(OrderArg::Keep) => Order::Keep,
            Some(OrderArg::Hilbert) => Order::Hilbert,
            Some(OrderArg::Auto) => Order::Auto,
            None => other,
        }
    }
}

impl KernelArgs {
    /// The first option that was given, if any.
    fn given(&self) -> Option<&'static str> {
        let unit_rows = self.no_unit_rows.then_some("--no-unit-rows");
        let (kernel, sigma) = (self.kernel.map(|_| "--kernel"), self.sigma.map(|_| "--sigma"));
        kernel.or(sigma).or(self.normalise.map(|_| "--normalise")).or(unit_rows)
    }

    /// The embedding in `dimensions` coordinates that was asked for; nothing where no option was given.
    pub fn params(&self, dimensions: usize) -> Result<Option<EmbeddingParams>, Failure> {
        if self.given().is_none() {
            return Ok(None);
        }
        let normalisation = match self.normalise.unwrap_or(NormaliseArg::Anchor) {
            NormaliseArg::None => Normalisation::None,
            NormaliseArg::Degree => Normalisation::Degree,
            NormaliseArg::Anchor => Normalisation::Anchor,
        };
        let width = self.sigma.unwrap_or(if normalisation == Normalisation::Anchor { 0.25 } else { 1. });
        if !(width > 0. && width < 1e6) {
            return Err(Failure::Misused(format!("--sigma: {width} is no width; choose a positive number")));
        }
        Ok(Some(EmbeddingParams {
            kernel: self.kernel.unwrap_or(KernelArg::Gaussian).kernel(),
            width: KernelWidth::Mean(width),
            normalisation,
            unit_rows: !self.no_unit_rows,
            ..EmbeddingParams::for_parts(dimensions)
        }))
    }
}

impl PartsArgs {
    /// Sets what concerns clustering in `params`; where `--cluster` is missing, it stays as it is there.
    pub fn apply(&self, kernel: &KernelArgs, params: &mut SegmentParams) -> Result<(), Failure> {
        match self.cluster {
            Some(ClusterArg::Parts) => params.cluster = Cluster::Parts,
            Some(ClusterArg::Kmeans) => params.cluster = Cluster::KMeans,
            Some(ClusterArg::TwoMeans) => params.cluster = Cluster::TwoMeans,
            None => {}
        }
        let detail = self.detail.unwrap_or(0.);
        if !(-1. ..=1.).contains(&detail) {
            return Err(Failure::Misused(format!("--detail: {detail} is out of range; choose from -1 to 1")));
        }
        if params.cluster == Cluster::Parts {
            if let Some(option) = kernel.given() {
                return Err(misfit(option, "--cluster kmeans or two-means"));
            }
        } else {
            let decision = self.decision.map(|_| "--decision").or(self.tiny_components.map(|_| "--tiny-components"));
            let boundaries = self.boundaries.map(|_| "--boundaries");
            if let Some(option) = decision.or(self.detail.map(|_| "--detail")).or(boundaries) {
                return Err(misfit(option, "--cluster parts"));
            }
        }
        params.parts = PartsParams {
            decision: match self.decision.unwrap_or(DecisionArg::SoftTrees) {
                DecisionArg::SoftTrees => Decision::SoftTrees,
                DecisionArg::Consensus => Decision::Consensus,
                DecisionArg::Single => Decision::Single,
            },
            count: match (self.parts, self.parts_range) {
                (Some(0), _) => return Err(Failure::Misused("-k: 0 parts; choose at least 1".into())),
                (Some(parts), _) => PartCount::Exactly(parts),
                (None, Some((least, most))) => PartCount::Between(least, most),
                (None, None) => PartCount::Found,
            },
            detail,
            ..PartsParams::default()
        };
        params.tiny_components = match self.tiny_components.unwrap_or(TinyComponentsArg::Join) {
            TinyComponentsArg::Join => TinyComponents::Join,
            TinyComponentsArg::Own => TinyComponents::Own,
        };
        params.boundaries = match self.boundaries.unwrap_or(BoundariesArg::Front) {
            BoundariesArg::Front => Boundaries::Front,
            BoundariesArg::Embedding => Boundaries::Embedding,
        };
        params.embedding = kernel.params(self.parts.unwrap_or(two_means::DIMENSIONS))?;
        Ok(())
    }
}

/// Refuses K-means without a number of parts.
pub fn check_count(params: &SegmentParams) -> Result<(), Failure> {
    match (params.cluster, params.parts.count) {
        (Cluster::KMeans, PartCount::Found) => {
            let remedy = "give it, as in -k 6, or leave out --cluster kmeans";
            Err(Failure::Misused(format!("-k: K-means needs the number of parts; {remedy}")))
        }
        (Cluster::KMeans, PartCount::Between(..)) => Err(misfit("--parts-range", "--cluster parts or two-means")),
        _ => Ok(()),
    }
}

impl DistanceArgs {
    /// Sets what concerns distances in `params`.
    pub fn apply(&self, params: &mut SegmentParams) -> Result<(), Failure> {
        params.metric = self.metric.metric()?;
        params.landmarks = self.landmarks.map(|l| l as usize);
        params.sampling = self.sampling.sampling();
        if self.coarse && params.cluster != Cluster::Parts {
            return Err(misfit("--coarse", "--cluster parts"));
        }
        if self.coarse && params.boundaries == Boundaries::Embedding {
            return Err(misfit("--boundaries embedding", "rows over all faces, not with --coarse,"));
        }
        params.coarse = self.coarse;
        Ok(())
    }
}

impl MethodArgs {
    /// The parameters of `segment`.
    pub fn params(&self) -> Result<SegmentParams, Failure> {
        let mut params = SegmentParams { order: self.order.or(Order::default()), ..SegmentParams::default() };
        self.parts.apply(&self.kernel, &mut params)?;
        self.distance.apply(&mut params)?;
        if params.cluster != Cluster::Parts && params.embedding.is_none() {
            params.embedding = Some(EmbeddingParams::for_parts(self.parts.parts.unwrap_or(two_means::DIMENSIONS)));
        }
        Ok(params)
    }
}
