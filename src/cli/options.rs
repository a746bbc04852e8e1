//! Shared by subcommands: their context, their errors, the options of a run, and `--work-dir`.

use super::errors::message;
use super::progress::{Bars, Style};
use clap::ValueEnum;
use nystrom_stream::base::{Cancel, Error, Progress, Result};
use nystrom_stream::store::{Budget, Run, WorkDir};
use std::path::{Path, PathBuf};

/// The context of every subcommand.
pub struct AppContext {
    /// Set by a signal.
    pub cancel: Cancel,
    /// The peak of allocated bytes so far.
    pub peak: fn() -> u64,
}

/// How a subcommand failed.
pub enum CliError {
    /// Exit code 1. The errors were already reported; this is a summary, for event listeners.
    Reported(String),
    /// Exit code 1.
    Failed(Error),
    /// Invalid command line: exit code 2.
    Usage(String),
}

impl From<Error> for CliError {
    fn from(error: Error) -> Self {
        match error {
            Error::Parameter { .. } => Self::Usage(message(&error)),
            error => Self::Failed(error),
        }
    }
}

/// The error for an option that has an effect only with `only`.
pub fn misfit(option: &str, only: &str) -> CliError {
    CliError::Usage(format!("{option} can only be used with {only}"))
}

/// A work directory that must exist.
#[derive(Clone, Debug, clap::Args)]
pub struct WorkDirArgs {
    /// The work directory; the same as --work-dir
    #[arg(value_name = "DIR", required_unless_present = "work_dir", conflicts_with = "work_dir")]
    pub folder: Option<PathBuf>,
    /// The work directory
    #[arg(long, value_name = "DIR")]
    pub work_dir: Option<PathBuf>,
}

impl WorkDirArgs {
    /// The folder, given by position or by option.
    pub fn path(&self) -> &Path {
        either(&self.folder, &self.work_dir)
    }
}

/// Whether a work directory may change hands.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
pub struct ForceArgs {
    /// Empty and reuse a work directory of another mesh
    #[arg(long, requires = "work_dir")]
    pub force: bool,
}

/// Opens (or creates) the work directory at `path`; notes if other processes cannot be kept out.
pub fn open(path: &Path, run: &Run) -> Result<WorkDir> {
    let work = WorkDir::open(path)?.heeding(&run.cancel, run.threads);
    if !work.is_locked() {
        run.progress.note_of_work(&format!(
            "{}: the file system does not support locks; run one command at a time",
            path.display()
        ));
    }
    Ok(work)
}

/// The given one of two forms of an argument; clap makes sure that one is given.
pub fn either<'a>(positional: &'a Option<PathBuf>, option: &'a Option<PathBuf>) -> &'a Path {
    positional.as_deref().or(option.as_deref()).unwrap_or(Path::new(""))
}

/// How progress is shown on standard error.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum ProgressArg {
    /// One bar per stage on a terminal, otherwise one line per stage
    Auto,
    /// One line per stage, even on a terminal
    Lines,
    /// One JSON object per line: stage, unit, done, total, seconds; or a note; or an error
    Json,
    /// Nothing
    None,
}

/// What a run may use.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Running")]
pub struct ResourceArgs {
    /// Worker threads [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub threads: Option<u16>,
    /// Maximum memory to allocate, such as 512MiB or 2GiB [default: half of the free memory]
    #[arg(long, value_name = "SIZE", value_parser = parse_size)]
    pub max_memory: Option<u64>,
}

impl ResourceArgs {
    /// The context of a run without random choices.
    pub fn run<'a>(&self, progress: &'a dyn Progress, app: &AppContext) -> Run<'a> {
        let mut run = Run::new(progress);
        if let Some(threads) = self.threads {
            run.threads = usize::from(threads);
        }
        if let Some(bytes) = self.max_memory {
            run.budget = Budget::new(bytes);
        }
        run.cancel = app.cancel.clone();
        run
    }
}

/// What a run tells while it lasts.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Running")]
pub struct ShownArgs {
    /// Print nothing but errors, and results that go to standard output
    #[arg(short, long)]
    pub quiet: bool,
    /// How progress is shown on standard error
    #[arg(long, value_enum, default_value = "auto", conflicts_with = "quiet")]
    pub progress: ProgressArg,
}

impl ShownArgs {
    /// The listener selected by --progress and --quiet.
    pub fn bars(&self) -> Bars {
        Bars::new(match self.progress {
            _ if self.quiet => Style::Quiet,
            ProgressArg::Auto => Style::of_terminal(),
            ProgressArg::Lines => Style::Lines,
            ProgressArg::Json => Style::Json,
            ProgressArg::None => Style::Quiet,
        })
    }
}

/// Where a run keeps what it needs while it lasts.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Running")]
pub struct ScratchArgs {
    /// Folder for temporary files [default: that of the output]
    #[arg(long, value_name = "DIR")]
    pub tmp: Option<PathBuf>,
}

impl ScratchArgs {
    /// The work directory `kept`; if there is none, a temporary one, under `--tmp` or else `beside`, which keeps arrays
    /// in memory as far as the budget of `run` allows.
    pub fn work(&self, kept: Option<&Path>, beside: impl FnOnce() -> PathBuf, run: &Run) -> Result<WorkDir> {
        match kept {
            Some(dir) => open(dir, run),
            None => Ok(WorkDir::temporary(&self.tmp.clone().unwrap_or_else(beside))?.holding(&run.budget)),
        }
    }
}

/// Options of a run with random choices.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Running")]
pub struct RunArgs {
    #[command(flatten)]
    pub resources: ResourceArgs,
    /// Seed of all random choices [default: 0, or as in the work directory]
    #[arg(long, value_name = "S")]
    pub seed: Option<u64>,
    #[command(flatten)]
    pub shown: ShownArgs,
}

impl RunArgs {
    /// The listener selected by --progress and --quiet.
    pub fn bars(&self) -> Bars {
        self.shown.bars()
    }

    /// The context of the run: threads, memory, seed, progress and cancellation.
    pub fn run<'a>(&self, progress: &'a dyn Progress, app: &AppContext) -> Run<'a> {
        Run { seed: self.seed.unwrap_or(0), ..self.resources.run(progress, app) }
    }
}

/// Parses sizes such as "2GiB", "512 MB", "1073741824".
pub fn parse_size(text: &str) -> Result<u64, String> {
    let text = text.trim();
    let digits = text.find(|c: char| !(c.is_ascii_digit() || c == '.')).unwrap_or(text.len());
    let number: f64 = text[..digits].parse().map_err(|_| format!("{text:?} is not a size; write 512MiB or 2GiB"))?;
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
        other => return Err(format!("{other:?} is not a unit; write MiB or GiB")),
    };
    let bytes = number * unit;
    let wrong = |bound| Err(format!("{text} is out of range; {bound}"));
    match bytes {
        ..1e6 => wrong("at least 1MB"),
        1e18.. => wrong("less than 1000000TB"),
        bytes => Ok(bytes as u64),
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
