//! Options that all runs share.

use super::AppContext;
use super::bars::{Bars, Style};
use clap::ValueEnum;
use nystrom_stream::base::{Progress, Result};
use nystrom_stream::store::{Budget, Run, WorkDir};
use std::path::{Path, PathBuf};

/// How progress is told on standard error.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum ProgressArg {
    /// A bar a stage on a terminal, a line a stage otherwise
    Auto,
    /// A line a stage, on a terminal too
    Lines,
    /// A JSON object a line: stage, unit, done, total, seconds
    Json,
    /// Nothing
    None,
}

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
    /// Seed of everything random [default: 0, or as in the work directory]
    #[arg(long, value_name = "S")]
    pub seed: Option<u64>,
    /// Where temporary files go [default: beside the output]
    #[arg(long, value_name = "DIR")]
    pub tmp: Option<PathBuf>,
    /// Start without testing whether the disk will do
    #[arg(long)]
    pub no_plan: bool,
    /// Say nothing but errors
    #[arg(short, long)]
    pub quiet: bool,
    /// How progress is told on standard error
    #[arg(long, value_enum, default_value = "auto", conflicts_with = "quiet")]
    pub progress: ProgressArg,
}

impl RunArgs {
    /// The listener that was asked for.
    pub fn bars(&self) -> Bars {
        Bars::new(match self.progress {
            _ if self.quiet => Style::Quiet,
            ProgressArg::Auto => Style::of_terminal(),
            ProgressArg::Lines => Style::Lines,
            ProgressArg::Json => Style::Json,
            ProgressArg::None => Style::Quiet,
        })
    }

    /// The run's surroundings.
    pub fn run<'a>(&self, progress: &'a dyn Progress, app: &AppContext) -> Run<'a> {
        let mut run = Run::new(progress);
        if let Some(threads) = self.threads {
            run.threads = usize::from(threads);
        }
        if let Some(bytes) = self.max_memory {
            run.budget = Budget::new(bytes);
        }
        run.seed = self.seed.unwrap_or(0);
        run.cancel = app.cancel.clone();
        run
    }

    /// The work directory `kept`; without one a temporary one, under `--tmp` or else `beside`, which holds arrays in memory
    /// as far as the budget of `run` allows.
    pub fn work(&self, kept: Option<&Path>, beside: impl FnOnce() -> PathBuf, run: &Run) -> Result<WorkDir> {
        match kept {
            Some(dir) => WorkDir::open(dir),
            None => Ok(WorkDir::temporary(&self.tmp.clone().unwrap_or_else(beside))?.holding(&run.budget)),
        }
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
