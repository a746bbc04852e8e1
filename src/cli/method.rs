//! Options of the method, grouped by subcommand, and their conversion to parameters.
//!
//! An option that has no effect in combination with the others is rejected before any work.

use super::choices::choice;
use super::options::{CliError, misfit};
use nystrom_stream::cluster::parts::{Decision, PartCount, PartsParams};
use nystrom_stream::cluster::two_means;
use nystrom_stream::graph::{Metric, Order};
use nystrom_stream::landmarks::Sampling;
use nystrom_stream::pipeline::{Boundaries, Cluster, SegmentParams, TinyComponents, Walls};
use nystrom_stream::spectral::embedding::KernelWidth;
use nystrom_stream::spectral::{EmbeddingParams, Kernel, Normalisation};

/// Parses bounds such as "4..12".
fn parse_range(text: &str) -> Result<(usize, usize), String> {
    let wrong = || format!("{text:?} is not a range; write 4..12");
    let (low, high) = text.split_once("..").ok_or_else(wrong)?;
    match (low.trim().parse(), high.trim_start_matches('=').trim().parse()) {
        (Ok(low), Ok(high)) if 0 < low && low <= high => Ok((low, high)),
        _ => Err(wrong()),
    }
}

/// Options of the edge weights, shared by several subcommands.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Method")]
pub struct MetricArgs {
    /// Form of the edge weights [default: scale-free]
    #[arg(long = "metric", id = "metric", value_name = "METRIC", value_parser = choice::<Metric>())]
    pub form: Option<Metric>,
    /// Length equivalent to turning by one radian, in the scale-free metric [default: 5]
    #[arg(long, value_name = "B")]
    pub beta: Option<f32>,
    /// Factor for convex turning [default: 0.05, or 0.1 in the paper's metric]
    #[arg(long, value_name = "E")]
    pub eta: Option<f32>,
    /// Share of length in the paper's metric [default: 0.03]
    #[arg(long, value_name = "D")]
    pub delta: Option<f32>,
}

impl MetricArgs {
    /// The first given option, if any.
    pub fn given(&self) -> Option<&'static str> {
        let weights = [(self.beta, "--beta"), (self.eta, "--eta"), (self.delta, "--delta")];
        let weight = weights.into_iter().find_map(|(value, option)| value.map(|_| option));
        self.form.map(|_| "--metric").or(weight)
    }

    /// The metric.
    pub fn metric(&self) -> Result<Metric, CliError> {
        let metric = match self.form.unwrap_or_default() {
            Metric::ScaleFree { .. } if self.delta.is_some() => return Err(misfit("--delta", "--metric paper")),
            Metric::ScaleFree { beta, eta } => {
                Metric::ScaleFree { beta: self.beta.unwrap_or(beta), eta: self.eta.unwrap_or(eta) }
            }
            Metric::Paper { .. } if self.beta.is_some() => return Err(misfit("--beta", "--metric scale-free")),
            Metric::Paper { delta, eta } => {
                Metric::Paper { delta: self.delta.unwrap_or(delta), eta: self.eta.unwrap_or(eta) }
            }
            Metric::Geodesic if self.beta.or(self.eta).or(self.delta).is_some() => {
                return Err(CliError::Usage("--metric geodesic takes no --beta, --eta or --delta".into()));
            }
            Metric::Geodesic => Metric::Geodesic,
        };
        metric.check()?;
        Ok(metric)
    }
}

/// How many parts, and how they are decided on.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Parts")]
pub struct PartsArgs {
    /// Exact number of parts [default: automatic]
    #[arg(short = 'k', long = "parts", value_name = "K", allow_negative_numbers = true, conflicts_with_all = ["parts_range", "detail"])]
    pub parts: Option<usize>,
    /// Bounds for the automatic number of parts
    #[arg(long, value_name = "A..B", value_parser = parse_range)]
    pub parts_range: Option<(usize, usize)>,
    /// Coarser (to -1) or finer (to 1) than the parts found
    #[arg(long, value_name = "D", allow_hyphen_values = true)]
    pub detail: Option<f64>,
    /// How faces become parts [default: parts, or as in the work directory]
    #[arg(long, value_parser = choice::<Cluster>())]
    pub cluster: Option<Cluster>,
    /// How parts are decided, with --cluster parts [default: soft-trees, or as in the work directory]
    #[arg(long, value_parser = choice::<Decision>())]
    pub decision: Option<Decision>,
    /// What to do with components too small to be parts, with --cluster parts or components; join leaves the latter as
    /// they are [default: join, or as in the work directory]
    #[arg(long, alias = "dust", value_parser = choice::<TinyComponents>())]
    pub tiny_components: Option<TinyComponents>,
    /// What to do with the inner walls of hollow bodies, with --cluster parts [default: follow, or as in the work
    /// directory]
    #[arg(long, value_parser = choice::<Walls>())]
    pub walls: Option<Walls>,
    /// How faces near boundaries get their labels, with --cluster parts [default: front, or as in the work directory]
    #[arg(long, value_parser = choice::<Boundaries>(), hide_short_help = true)]
    pub boundaries: Option<Boundaries>,
}

/// How distances become coordinates.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Embedding (kmeans and two-means)")]
pub struct KernelArgs {
    /// Kernel from distance to affinity [default: gaussian, or as in the work directory]
    #[arg(long, hide_short_help = true, value_parser = choice::<Kernel>())]
    pub kernel: Option<Kernel>,
    /// Width of the kernel, in mean distances [default: 0.25; without anchor graph 1, as in the paper, or as in the
    /// work directory]
    #[arg(long, hide_short_help = true, value_name = "X")]
    pub sigma: Option<f64>,
    /// How affinities are normalised [default: anchor, or as in the work directory]
    #[arg(long, hide_short_help = true, value_parser = choice::<Normalisation>())]
    pub normalise: Option<Normalisation>,
    /// Do not scale the coordinates of each face to unit length [default: scale them, or as in the work directory]
    #[arg(long, hide_short_help = true)]
    pub no_unit_rows: bool,
}

/// In which order faces are worked on.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Distances")]
pub struct OrderArgs {
    /// Order in which faces are processed; labels are always in the order of the file [default: auto, or as in the work
    /// directory]
    #[arg(long, value_parser = choice::<Order>(), hide_short_help = true)]
    pub order: Option<Order>,
}

/// How distances are measured, and from where.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Distances")]
pub struct DistanceArgs {
    /// Number of landmarks, up to 4096 [default: 120, above 300,000 faces 240; with --exact above 60,000 faces 60 to 20
    /// by size; with kmeans and two-means twice the parts, 10 to 60, above 60,000 faces 60 without --exact, but always
    /// more than parts, up to 512]
    #[arg(short = 'l', long, hide_short_help = true, value_name = "L", value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub landmarks: Option<u32>,
    /// How landmarks are chosen [default: farthest; distance-weighted above 60,000 faces, but not
    /// with --exact, kmeans and two-means]
    #[arg(long, hide_short_help = true, value_parser = choice::<Sampling>())]
    pub sampling: Option<Sampling>,
    /// Compute rows of distances over the faces of the file, neither over a coarser copy of a large mesh nor over a
    /// finer one of long triangles or a denoised one of a rough mesh
    #[arg(long, hide_short_help = true)]
    pub exact: bool,
    /// Now the default
    #[arg(long, hide = true, conflicts_with = "exact")]
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
    /// The order; `other` if not given.
    pub fn or(&self, other: Order) -> Order {
        self.order.unwrap_or(other)
    }
}

impl KernelArgs {
    /// The first given option, if any.
    fn given(&self) -> Option<&'static str> {
        let unit_rows = self.no_unit_rows.then_some("--no-unit-rows");
        let (kernel, sigma) = (self.kernel.map(|_| "--kernel"), self.sigma.map(|_| "--sigma"));
        kernel.or(sigma).or(self.normalise.map(|_| "--normalise")).or(unit_rows)
    }

    /// The requested embedding in `dimensions` coordinates, where options not given are taken from `kept`; `None` if
    /// none was given and none is kept.
    pub fn params(&self, dimensions: usize, kept: Option<EmbeddingParams>) -> Option<EmbeddingParams> {
        if self.given().is_none() && kept.is_none() {
            return None;
        }
        let normalisation = self.normalise.or(kept.map(|kept| kept.normalisation)).unwrap_or(Normalisation::Anchor);
        // A kept width applies only to its own normalisation.
        let kept_width = kept.filter(|kept| kept.normalisation == normalisation).map(|kept| kept.width);
        let default = if normalisation == Normalisation::Anchor { 0.25 } else { 1. };
        Some(EmbeddingParams {
            kernel: self.kernel.or(kept.map(|kept| kept.kernel)).unwrap_or(Kernel::Gaussian),
            width: self.sigma.map(KernelWidth::Mean).or(kept_width).unwrap_or(KernelWidth::Mean(default)),
            normalisation,
            unit_rows: !self.no_unit_rows && kept.is_none_or(|kept| kept.unit_rows),
            ..EmbeddingParams::for_parts(dimensions)
        })
    }
}

impl PartsArgs {
    /// Whether they tell how many parts there are to be.
    pub fn counts(&self) -> bool {
        self.parts.is_some() || self.parts_range.is_some() || self.detail.is_some()
    }

    /// Sets the clustering options in `params`; options not given stay unchanged, except for the number of parts and
    /// the detail, which get their defaults.
    pub fn apply(&self, kernel: &KernelArgs, params: &mut SegmentParams) -> Result<(), CliError> {
        params.cluster = self.cluster.unwrap_or(params.cluster);
        if let Some(option) = kernel.given().filter(|_| !params.cluster.embeds()) {
            return Err(misfit(option, "--cluster kmeans or two-means"));
        }
        if self.tiny_components.is_some() && !params.cluster.separates_tiny() {
            return Err(misfit("--tiny-components", "--cluster parts or components"));
        }
        if params.cluster != Cluster::Parts {
            let own = [
                ("--decision", self.decision.is_some()),
                ("--detail", self.detail.is_some()),
                ("--walls", self.walls.is_some()),
                ("--boundaries", self.boundaries.is_some()),
            ];
            if let Some((option, _)) = own.into_iter().find(|(_, given)| *given) {
                return Err(misfit(option, "--cluster parts"));
            }
        }
        params.parts = PartsParams {
            decision: self.decision.unwrap_or(params.parts.decision),
            count: match (self.parts, self.parts_range) {
                (Some(parts), _) => PartCount::Exactly(parts),
                (None, Some((least, most))) => PartCount::Between(least, most),
                (None, None) => PartCount::Found,
            },
            detail: self.detail.unwrap_or(0.),
            ..params.parts
        };
        params.tiny_components = self.tiny_components.unwrap_or(params.tiny_components);
        params.walls = self.walls.unwrap_or(params.walls);
        params.boundaries = self.boundaries.unwrap_or(params.boundaries);
        params.embedding = kernel.params(self.parts.unwrap_or(two_means::DIMENSIONS), params.embedding);
        Ok(())
    }
}

impl DistanceArgs {
    /// The first given option, if any.
    fn given(&self) -> Option<&'static str> {
        let sampling = self.sampling.map(|_| "--sampling").or(self.exact.then_some("--exact"));
        self.landmarks.map(|_| "--landmarks").or(sampling).or(self.metric.given())
    }

    /// Sets the distance options in `params`.
    pub fn apply(&self, params: &mut SegmentParams) -> Result<(), CliError> {
        params.metric = self.metric.metric()?;
        params.landmarks = self.landmarks.map(|l| l as usize);
        params.sampling = self.sampling;
        params.exact = self.exact;
        Ok(())
    }
}

impl MethodArgs {
    /// The parameters of `segment`.
    pub fn params(&self) -> Result<SegmentParams, CliError> {
        let mut params = SegmentParams::default().order(self.order.or(Order::default()));
        self.parts.apply(&self.kernel, &mut params)?;
        if let Some(option) = self.distance.given().filter(|_| params.cluster == Cluster::Components) {
            return Err(misfit(option, "--cluster parts, kmeans or two-means"));
        }
        self.distance.apply(&mut params)?;
        Ok(params.resolved())
    }
}
