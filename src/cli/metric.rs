//! Options of the edge weights, which several subcommands share.

use super::Failure;
use super::method::misfit;
use clap::ValueEnum;
use nystrom_stream::graph::Metric;

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

/// Options of the edge weights.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Method")]
pub struct MetricArgs {
    /// Form of the edge weights
    #[arg(long = "metric", id = "metric", value_enum, default_value = "scale-free")]
    pub form: MetricArg,
    /// Length that a turn of a radian is worth (scale-free metric) [default: 5]
    #[arg(long, value_name = "B")]
    pub beta: Option<f32>,
    /// Factor of convex turning [default: 0.05, or 0.1 with the paper's metric]
    #[arg(long, value_name = "E")]
    pub eta: Option<f32>,
    /// Share of length in the paper's metric [default: 0.03]
    #[arg(long, value_name = "D")]
    pub delta: Option<f32>,
}

impl MetricArgs {
    /// The metric.
    pub fn metric(&self) -> Result<Metric, Failure> {
        let metric = match self.form {
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
        Ok(metric)
    }
}
