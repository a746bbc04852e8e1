//! The command line: parses arguments into library parameters, runs a subcommand, reports errors. The only user of clap
//! and indicatif.

mod allocator;
mod batch;
mod choices;
mod command;
mod correspond;
mod demo;
mod edits;
mod errors;
mod evaluate;
mod help;
mod info;
mod input;
mod method;
mod options;
mod output;
mod patterns;
mod picture;
mod plan;
mod plot;
mod progress;
mod provenance;
mod quality;
mod results;
mod segment;
mod sequence;
mod signals;
mod sink;
mod stages;
mod transfer;
mod usage;

use clap::{FromArgMatches, Parser, Subcommand};
use nystrom_stream::base::parallel::catch;
use nystrom_stream::base::{Cancel, Error};
use options::{AppContext, CliError};
use progress::Style;
use serde_json::{Value, json};
use std::io::{ErrorKind, Write as _};
use std::process::ExitCode;

/// Cut meshes of a million to a billion triangles into their meaningful parts, out of core.
#[derive(Debug, Parser)]
#[command(name = "nystrom-stream", version, propagate_version = true, arg_required_else_help = true)]
#[command(after_long_help = help::PROGRAM)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Cut meshes into parts and write them with labels and colours
    #[command(after_long_help = help::SEGMENT)]
    Segment(segment::SegmentArgs),
    /// Stage 1: read a mesh and build its dual graph, in a work directory
    #[command(after_long_help = help::STAGES)]
    Graph(stages::GraphArgs),
    /// Stage 2: compute the distances from all landmarks to all faces, in one process or as one of several
    #[command(after_long_help = help::STAGES)]
    Rows(stages::RowsArgs),
    /// Compute one share of a step of segment, for several processes that cut one large mesh together
    #[command(after_long_help = help::SHARE)]
    Share(stages::ShareArgs),
    /// Combine the distances that several processes have computed with rows --shard
    Merge(stages::MergeArgs),
    /// Stage 3, for use by other programs: compute coordinates of all faces in the spectral embedding; K-means of
    /// `cluster` then takes the same kernel, unless another is given
    #[command(after_long_help = help::STAGES)]
    Embed(stages::EmbedArgs),
    /// Stage 4: cut into parts; changing their number takes a moment
    #[command(after_long_help = help::STAGES)]
    Cluster(stages::ClusterArgs),
    /// Stage 5: write the parts of a work directory in any output format
    #[command(after_long_help = help::STAGES)]
    Export(stages::ExportArgs),
    /// Predict memory, disk space and time of a run
    Plan(plan::PlanArgs),
    /// Show the contents of a work directory, or the properties of a mesh
    Info(info::InfoArgs),
    /// Check every file of a work directory against its checksum
    Verify(info::VerifyArgs),
    /// Score labels against human ones, or matches against true ones
    Evaluate(evaluate::EvaluateArgs),
    /// Measure how well landmarks sample a mesh, or compare ways of sampling
    Quality(quality::QualityArgs),
    /// Test whether Γ ranks samples correctly (Fig. 1 of the paper)
    Study(quality::StudyArgs),
    /// Match the vertices of two meshes of similar shape
    Correspond(correspond::CorrespondArgs),
    /// Reorder a mesh for streaming, or compare orders
    #[command(after_long_help = help::SEQUENCE)]
    Sequence(sequence::SequenceArgs),
    /// Draw a mesh and its parts as a picture
    Picture(picture::PictureArgs),
    /// Copy labels to another mesh of the same shape
    #[command(after_long_help = help::TRANSFER)]
    TransferLabels(transfer::TransferArgs),
    /// Plot the eigenvalues, and the hierarchy of parts with its cut
    Plot(plot::PlotArgs),
    /// Generate a mesh of a million faces with known parts, cut it, and compare
    Demo(demo::DemoArgs),
    /// Print completions for a shell
    Completions(help::CompletionArgs),
    /// Write man pages, one per subcommand
    Man(help::ManArgs),
}

impl Command {
    /// How to continue after an interrupt, if that is possible.
    fn how_to_continue(&self) -> Option<String> {
        let dir = match self {
            Self::Segment(args) if args.work_dir.is_none() => {
                let rest = "the same command continues with the rest";
                let given = || args.meshes.iter().filter(|mesh| mesh.as_os_str() != "-");
                let some = given().count() > 1 || given().any(|mesh| mesh.is_dir() || !mesh.exists());
                return if args.resume { Some(rest.into()) } else { some.then(|| format!("with --resume {rest}")) };
            }
            Self::Segment(args) => args.work_dir.as_ref(),
            Self::Graph(args) => Some(&args.place.work_dir),
            Self::Rows(args) => Some(&args.place.work_dir),
            Self::Share(args) => Some(&args.rows.place.work_dir),
            Self::Sequence(args) => args.work_dir.as_ref(),
            Self::Correspond(args) => args.work_dir.as_ref(),
            Self::Merge(args) => return Some(continue_from(args.place.path())),
            Self::Embed(args) => Some(&args.place.work_dir),
            Self::Cluster(args) => Some(&args.place.work_dir),
            Self::Export(args) => Some(&args.place.work_dir),
            _ => None,
        };
        dir.map(|dir| continue_from(dir))
    }
}

fn continue_from(dir: &std::path::Path) -> String {
    format!("the same command continues from {}", dir.display())
}

/// How the program ends.
pub enum End {
    /// With this exit code.
    Code(u8),
    /// By this signal, which was caught to clean up first.
    Signal(i32),
}

impl End {
    /// As fields of an event; for a signal, with a shell's exit code.
    fn facts(&self) -> Value {
        match self {
            Self::Code(code) => json!({"exit_code": code}),
            Self::Signal(signal) => json!({"exit_code": signals::code(*signal), "signal": signal}),
        }
    }

    /// The exit code; if it ends by a signal, the program ends here.
    pub fn code(self) -> ExitCode {
        match self {
            Self::Code(code) => ExitCode::from(code),
            Self::Signal(signal) => signals::end_by(signal),
        }
    }
}

/// Parses the arguments and runs. `peak` returns the peak of allocated bytes so far.
pub fn main(peak: fn() -> u64) -> End {
    nystrom_stream::store::mapped::report_vanishing_files();
    let matches = command::parsed().try_get_matches().inspect(allocator::return_memory_at_once);
    let parsed = matches.and_then(|matches| Cli::from_arg_matches(&matches));
    let style = if usage::asks_for_events() { Style::Json } else { Style::Lines };
    let cli = match parsed {
        Ok(cli) => cli,
        Err(error) => {
            let code = if error.use_stderr() { 2 } else { 0 };
            match usage::line(&error, &command::parsed()) {
                Some(text) => progress::tell_error(style, &text, None, json!({"exit_code": code})),
                None => {
                    let written = error.print().and_then(|()| std::io::stdout().flush());
                    if let (0, Err(failed)) = (code, written)
                        && failed.kind() != ErrorKind::BrokenPipe
                    {
                        let text = errors::message(&Error::io("<stdout>", "write")(failed));
                        progress::tell_error(style, &text, None, json!({"exit_code": 1}));
                        return End::Code(1);
                    }
                }
            }
            return End::Code(code);
        }
    };
    let app = AppContext { cancel: Cancel::default(), peak };
    let received = signals::cancel_on(app.cancel.clone());
    let how_to_continue = cli.command.how_to_continue();
    let result = catch(|| dispatch(cli.command, &app)).unwrap_or_else(|error| Err(error.into()));
    sink::sync_names();
    let (code, text) = match &result {
        Ok(()) => (0, None),
        Err(CliError::Reported(sum)) => (1, (style == Style::Json).then(|| sum.clone())),
        // The reader of standard output has closed it: nothing to report.
        Err(CliError::Failed(Error::Io { source, .. })) if source.kind() == ErrorKind::BrokenPipe => (1, None),
        Err(CliError::Failed(Error::Cancelled)) => {
            let how = how_to_continue.map_or(String::new(), |how| format!("; {how}"));
            (1, Some(format!("interrupted{how}")))
        }
        Err(CliError::Failed(error)) => (1, Some(errors::message(error))),
        Err(CliError::Usage(text)) => (2, Some(text.clone())),
    };
    let end = received.exit_signal(code == 0).map_or(End::Code(code), End::Signal);
    if let Some(text) = text {
        let file = if let Err(CliError::Failed(error)) = &result { errors::file_of(error) } else { None };
        progress::tell_error(style, &text, file, end.facts());
    }
    end
}

/// Runs a subcommand.
fn dispatch(command: Command, app: &AppContext) -> Result<(), CliError> {
    match command {
        Command::Segment(args) => batch::run(&args, app),
        Command::Graph(args) => stages::graph(&args, app),
        Command::Rows(args) => stages::rows(&args, app),
        Command::Share(args) => stages::share(&args, app),
        Command::Merge(args) => stages::merge(&args, app),
        Command::Embed(args) => stages::embed(&args, app),
        Command::Cluster(args) => stages::cluster(&args, app),
        Command::Export(args) => stages::export(&args, app),
        Command::Plan(args) => plan::run(&args, app),
        Command::Info(args) => info::run(&args, app),
        Command::Verify(args) => info::verify(&args, app),
        Command::Evaluate(args) => evaluate::run(&args, app),
        Command::Quality(args) => quality::quality(&args, app),
        Command::Study(args) => quality::study(&args, app),
        Command::Correspond(args) => correspond::run(&args, app),
        Command::Sequence(args) => sequence::run(&args, app),
        Command::Picture(args) => picture::run(&args, app),
        Command::TransferLabels(args) => transfer::run(&args, app),
        Command::Plot(args) => plot::run(&args),
        Command::Demo(args) => demo::run(&args, app),
        Command::Completions(args) => help::completions(&args, command::parsed()),
        Command::Man(args) => help::man(&args, command::parsed()),
    }
}
