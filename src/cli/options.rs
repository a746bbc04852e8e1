//! Options that several subcommands share, and how they become parameters.

use super::{Failure, Surroundings};
use clap::ValueEnum;
use nystrom_stream::base::Progress;
use nystrom_stream::cluster::parts::{Decision, PartCount, PartsParams};
use nystrom_stream::cluster::two_means;
use nystrom_stream::distance::landmarks::Sampling;
use nystrom_stream::graph::{Metric, Order};
use nystrom_stream::pipeline::{Cluster, SegmentParams};
use nystrom_stream::spectral::embedding::Width;
use nystrom_stream::spectral::{EmbeddingParams, Kernel, Normalisation};
use nystrom_stream::store::{Budget, Run};
use std::path::PathBuf;

/// Options of a run.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Running")]
pub struct RunArgs {
    /// Worker threads [default: one a core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub threads: Option<u16>,
    /// Memory to allocate at the most, like 512MiB or 2GiB [default: half of what is free]
    #[arg(long, value_name = "SIZE", value_parser = parse_size)]
    pub max_memory: Option<u64>,
    /// Seed of everything random
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// Where temporary files go [default: beside the output]
    #[arg(long, value_name = "DIR")]
    pub tmp: Option<PathBuf>,
    /// Start without testing whether the disk will do
    #[arg(long)]
    pub no_plan: bool,
    /// Say nothing but errors
    #[arg(short, long)]
    pub quiet: bool,
}

impl RunArgs {
    /// The run's surroundings.
    pub fn run<'a>(&self, progress: &'a dyn Progress, surroundings: &Surroundings) -> Run<'a> {
        let mut run = Run::new(progress);
        if let Some(threads) = self.threads {
            run.threads = usize::from(threads);
        }
        if let Some(bytes) = self.max_memory {
            run.budget = Budget::new(bytes);
        }
        run.seed = self.seed;
        run.cancel = surroundings.cancel.clone();
        run
    }
}

/// Bytes from "2GiB", "512 MB", "1073741824".
pub fn parse_size(text: &str) -> Result<u64, String> {
    let text = text.trim();
    let digits = text.find(|c: char| !(c.is_ascii_digit() || c == '.')).unwrap_or(text.len());
    let number: f64 = text[..digits].parse().map_err(|_| format!("{text:?} is no size; write 512MiB or 2GiB"))?;
    let unit = match text[digits..].trim().to_ascii_lowercase().as_str() {
        "" | "b" => 1.,
        "k" | "kib" => 1024.,
        "m" | "mib" => 1024f64.powi(2),
        "g" | "gib" => 1024f64.powi(3),
        "t" | "tib" => 1024f64.powi(4),
        "kb" => 1e3,
        "mb" => 1e6,
        "gb" => 1e9,
        "tb" => 1e12,
        other => return Err(format!("{other:?} is no unit; write MiB or GiB")),
    };
    let bytes = number * unit;
    if (1e6..1e18).contains(&bytes) { Ok(bytes as u64) } else { Err(format!("{text} is out of range; at least 1MB")) }
}

/// How landmarks are sampled.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum SamplingArg {
    /// Max–min farthest points from an extremity (the paper's §6.2)
    Farthest,
    /// At random, by area
    Random,
}

/// The kernel.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum KernelArg {
    /// exp(−d²/2σ²)
    Gaussian,
    /// exp(−d/σ)
    Exponential,
    /// max(0, 1 − d/4σ)³
    Polynomial,
    /// 1/√(1 + d²/σ²)
    InverseMultiquadric,
}

/// The edge weights.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum MetricArg {
    /// Length + β·turning, in units of the shape's size
    ScaleFree,
    /// δ·length/mean + (1−δ)·(1−cos)/mean, as the paper
    Paper,
    /// Length alone
    Geodesic,
}

/// How affinities are normalised.
#[derive(Clone, Copy, Debug, ValueEnum)]
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
#[derive(Clone, Copy, Debug, ValueEnum)]
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

/// Bounds from "4..12".
fn parse_range(text: &str) -> Result<(usize, usize), String> {
    let wrong = || format!("{text:?} is no range; write 4..12");
    let (low, high) = text.split_once("..").ok_or_else(wrong)?;
    match (low.trim().parse(), high.trim_start_matches('=').trim().parse()) {
        (Ok(low), Ok(high)) if 0 < low && low <= high => Ok((low, high)),
        _ => Err(wrong()),
    }
}

/// Options of the method.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Method")]
pub struct MethodArgs {
    /// Number of parts, exactly [default: found]
    #[arg(short = 'k', long = "parts", value_name = "K", conflicts_with_all = ["parts_range", "detail"])]
    pub parts: Option<usize>,
    /// Bounds for the number of parts found
    #[arg(long, value_name = "A..B", value_parser = parse_range)]
    pub parts_range: Option<(usize, usize)>,
    /// Coarser (to -1) or finer (to 1) than the parts found
    #[arg(long, value_name = "D", allow_negative_numbers = true)]
    pub detail: Option<f64>,
    /// Number of landmarks [default: 60 to 20 by size; otherwise twice the parts, 10 to 60]
    #[arg(short = 'l', long, value_name = "L", value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub landmarks: Option<u32>,
    /// How landmarks are chosen
    #[arg(long, value_enum, default_value = "farthest")]
    pub sampling: SamplingArg,
    /// In which order faces are worked on; labels always come in the file's
    #[arg(long, value_enum, default_value = "auto")]
    pub order: OrderArg,
    /// How faces become parts
    #[arg(long, value_enum, default_value = "parts")]
    pub cluster: ClusterArg,
    /// How parts are decided (with --cluster parts)
    #[arg(long, value_enum, default_value = "soft-trees")]
    pub decision: DecisionArg,
    /// Preview: decide on a contraction of the mesh; the rows over all faces are left out
    #[arg(long)]
    pub coarse: bool,
    /// Form of the edge weights
    #[arg(long, value_enum, default_value = "scale-free")]
    pub metric: MetricArg,
    /// Length that a turn of a radian is worth (scale-free metric) [default: 5]
    #[arg(long, value_name = "B")]
    pub beta: Option<f32>,
    /// Factor of convex turning [default: 0.05, or 0.1 with the paper's metric]
    #[arg(long, value_name = "E")]
    pub eta: Option<f32>,
    /// Share of length in the paper's metric [default: 0.03]
    #[arg(long, value_name = "D")]
    pub delta: Option<f32>,
    /// From distance to affinity
    #[arg(long, value_enum, default_value = "gaussian")]
    pub kernel: KernelArg,
    /// The kernel's width in mean distances [default: 0.25; 1 without anchor graph, as the paper]
    #[arg(long, value_name = "X")]
    pub sigma: Option<f64>,
    /// How affinities are normalised
    #[arg(long, value_enum, default_value = "anchor")]
    pub normalise: NormaliseArg,
    /// Leave the lengths of embedded faces as they are
    #[arg(long)]
    pub no_unit_rows: bool,
}

impl MethodArgs {
    /// The parameters of `segment`.
    pub fn params(&self) -> Result<SegmentParams, Failure> {
        let misfit = |option: &str, only: &str| Failure::Misused(format!("{option} goes with {only} only"));
        let metric = match self.metric {
            MetricArg::ScaleFree if self.delta.is_some() => return Err(misfit("--delta", "--metric paper")),
            MetricArg::ScaleFree => Metric::ScaleFree { beta: self.beta.unwrap_or(5.), eta: self.eta.unwrap_or(0.05) },
            MetricArg::Paper if self.beta.is_some() => return Err(misfit("--beta", "--metric scale-free")),
            MetricArg::Paper => Metric::Paper { delta: self.delta.unwrap_or(0.03), eta: self.eta.unwrap_or(0.1) },
            MetricArg::Geodesic if self.beta.or(self.eta).or(self.delta).is_some() => {
                return Err(Failure::Misused("--metric geodesic takes no --beta, --eta or --delta".into()));
            }
            MetricArg::Geodesic => Metric::Geodesic,
        };
        metric.check()?;
        let normalisation = match self.normalise {
            NormaliseArg::None => Normalisation::None,
            NormaliseArg::Degree => Normalisation::Degree,
            NormaliseArg::Anchor => Normalisation::Anchor,
        };
        let width = self.sigma.unwrap_or(if normalisation == Normalisation::Anchor { 0.25 } else { 1. });
        if !(width > 0. && width < 1e6) {
            return Err(Failure::Misused(format!("--sigma: {width} is no width; choose a positive number")));
        }
        let embedding = EmbeddingParams {
            kernel: match self.kernel {
                KernelArg::Gaussian => Kernel::Gaussian,
                KernelArg::Exponential => Kernel::Exponential,
                KernelArg::Polynomial => Kernel::Polynomial { degree: 3 },
                KernelArg::InverseMultiquadric => Kernel::InverseMultiquadric,
            },
            width: Width::Mean(width),
            normalisation,
            unit_rows: !self.no_unit_rows,
            ..EmbeddingParams::for_parts(self.parts.unwrap_or(two_means::DIMENSIONS))
        };
        if self.coarse && matches!(self.cluster, ClusterArg::Kmeans) {
            return Err(misfit("--coarse", "--cluster parts"));
        }
        let detail = self.detail.unwrap_or(0.);
        if !(-1. ..=1.).contains(&detail) {
            return Err(Failure::Misused(format!("--detail: {detail} is out of range; choose from -1 to 1")));
        }
        Ok(SegmentParams {
            parts: PartsParams {
                decision: match self.decision {
                    DecisionArg::SoftTrees => Decision::SoftTrees,
                    DecisionArg::Consensus => Decision::Consensus,
                    DecisionArg::Single => Decision::Single,
                },
                count: match (self.parts, self.parts_range) {
                    (Some(parts), _) => PartCount::Exactly(parts),
                    (None, Some((least, most))) => PartCount::Between(least, most),
                    (None, None) => PartCount::Found,
                },
                detail,
                ..PartsParams::default()
            },
            landmarks: self.landmarks.map(|l| l as usize),
            sampling: match self.sampling {
                SamplingArg::Farthest => Sampling::Farthest,
                SamplingArg::Random => Sampling::Random,
            },
            metric,
            order: match self.order {
                OrderArg::Keep => Order::Keep,
                OrderArg::Hilbert => Order::Hilbert,
                OrderArg::Auto => Order::Auto,
            },
            cluster: match self.cluster {
                ClusterArg::Parts => Cluster::Parts,
                ClusterArg::Kmeans => Cluster::KMeans,
                ClusterArg::TwoMeans => Cluster::TwoMeans,
            },
            coarse: self.coarse,
            embedding: Some(embedding),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::parse_size;

    #[test]
    fn sizes() {
        assert_eq!(parse_size("2GiB"), Ok(2 << 30));
        assert_eq!(parse_size("1.5 GB"), Ok(1_500_000_000));
        assert_eq!(parse_size("67108864"), Ok(64 << 20));
        for bad in ["", "x", "2 parsecs", "12", "-1GiB", "1e30TiB"] {
            assert!(parse_size(bad).is_err(), "{bad}");
        }
    }
}
