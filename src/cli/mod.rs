//! The command line: parsed once into the library's parameter structs. The only user of clap and indicatif.

mod bars;
mod batch;
mod correspond;
mod demo;
mod evaluate;
mod help;
mod info;
mod judge;
mod method;
mod metric;
mod options;
mod output;
mod picture;
mod plan;
mod plot;
mod quality;
mod rows;
mod segment;
mod sequence;
mod stages;
mod study;
mod transfer;

use clap::{Parser, Subcommand};
use nystrom_stream::base::{Cancel, Error};
use std::io::{ErrorKind, Write};
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
    Segment(segment::Args),
    /// First stage: the dual graph of a mesh, in a work directory
    #[command(after_long_help = help::STAGES)]
    Graph(stages::GraphArgs),
    /// Second stage: the distances from all landmarks, by one process or as one of several
    #[command(after_long_help = help::STAGES)]
    Rows(rows::Args),
    /// Put the rows of several processes together
    Merge(rows::MergeArgs),
    /// Third stage, for other programs: coordinates of every face in the spectral embedding
    #[command(after_long_help = help::STAGES)]
    Embed(stages::EmbedArgs),
    /// Fourth stage: parts, again and again in a moment
    #[command(after_long_help = help::STAGES)]
    Cluster(stages::ClusterArgs),
    /// Last stage: write the parts of a work directory in any form
    #[command(after_long_help = help::STAGES)]
    Export(stages::ExportArgs),
    /// Tell memory, disk and time of a run before it starts
    Plan(plan::Args),
    /// Tell what a work directory or a mesh file holds
    Info(info::InfoArgs),
    /// Test every file of a work directory against its checksum
    Verify(info::Args),
    /// Score labels against people's, or matches against true ones
    Evaluate(evaluate::Args),
    /// Tell how good samples of a mesh are, or compare samplings
    Quality(quality::Args),
    /// Test whether Γ ranks samples rightly (the paper's Fig. 1)
    Study(study::Args),
    /// Find which vertex of one mesh is which of another
    Correspond(correspond::Args),
    /// Put a mesh in an order to stream it in, or compare orders
    #[command(after_long_help = help::SEQUENCE)]
    Sequence(sequence::Args),
    /// Draw a mesh and its parts as a picture
    Picture(picture::Args),
    /// Carry labels over to another mesh of the same shape
    #[command(after_long_help = help::TRANSFER)]
    TransferLabels(transfer::Args),
    /// Plot how eigenvalues fall, and the hierarchy of parts with its cut
    Plot(plot::Args),
    /// Make a mesh of a million faces with known parts, cut it, and compare
    Demo(demo::Args),
    /// Print completions for a shell
    Completions(help::CompletionArgs),
    /// Write man pages, one a subcommand
    Man(help::ManArgs),
}

impl Command {
    /// How to go on after an interrupt, in words, where that is possible.
    fn goes_on(&self) -> Option<String> {
        let dir = match self {
            Self::Segment(args) if args.work_dir.is_none() => {
                let rest = "the same command goes on with the rest";
                let some = args.meshes.len() > 1;
                return if args.resume { Some(rest.into()) } else { some.then(|| format!("with --resume {rest}")) };
            }
            Self::Segment(args) => args.work_dir.as_ref(),
            Self::Graph(args) => Some(&args.place.work_dir),
            Self::Rows(args) => Some(&args.work_dir),
            Self::Sequence(args) => args.work_dir.as_ref(),
            Self::Correspond(args) => args.work_dir.as_ref(),
            Self::Merge(args) => Some(&args.work_dir),
            Self::Embed(args) => Some(&args.place.work_dir),
            Self::Cluster(args) => Some(&args.place.work_dir),
            Self::Export(args) => Some(&args.place.work_dir),
            _ => None,
        };
        dir.map(|dir| format!("the same command goes on from {}", dir.display()))
    }
}

/// What every subcommand gets.
struct AppContext {
    cancel: Cancel,
    peak: fn() -> u64,
}

/// How a subcommand ended short of success.
enum Failure {
    /// Exit code 1, message already printed.
    Reported,
    /// Exit code 1.
    Failed(Error),
    /// Exit code 2.
    Misused(String),
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        match error {
            Error::Parameter { .. } => Self::Misused(error.to_string()),
            error => Self::Failed(error),
        }
    }
}

/// Parses the arguments and runs. `peak` tells the most bytes allocated so far.
pub fn main(peak: fn() -> u64) -> ExitCode {
    nystrom_stream::store::mapped::report_vanishing_files();
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => {
            let _ = error.print();
            return ExitCode::from(if error.use_stderr() { 2 } else { 0 });
        }
    };
    let app = AppContext { cancel: Cancel::default(), peak };
    let cancel = app.cancel.clone();
    // A second signal ends at once; the first lets files be closed and temporary folders go.
    let _ = ctrlc::set_handler(move || {
        if cancel.is_cancelled() {
            std::process::exit(1);
        }
        cancel.cancel();
    });
    let goes_on = cli.command.goes_on();
    let result = match cli.command {
        Command::Segment(args) => segment::run(&args, &app),
        Command::Graph(args) => stages::graph(&args, &app),
        Command::Rows(args) => rows::run(&args, &app),
        Command::Merge(args) => rows::merge(&args, &app),
        Command::Embed(args) => stages::embed(&args, &app),
        Command::Cluster(args) => stages::cluster(&args, &app),
        Command::Export(args) => stages::export(&args, &app),
        Command::Plan(args) => plan::run(&args, &app),
        Command::Info(args) => info::run(&args),
        Command::Verify(args) => info::verify(&args, &app),
        Command::Evaluate(args) => evaluate::run(&args, &app),
        Command::Quality(args) => quality::run(&args, &app),
        Command::Study(args) => study::run(&args, &app),
        Command::Correspond(args) => correspond::run(&args, &app),
        Command::Sequence(args) => sequence::run(&args, &app),
        Command::Picture(args) => picture::run(&args, &app),
        Command::TransferLabels(args) => transfer::run(&args, &app),
        Command::Plot(args) => plot::run(&args),
        Command::Demo(args) => demo::run(&args, &app),
        Command::Completions(args) => help::completions(&args),
        Command::Man(args) => help::man(&args),
    };
    let (text, code) = match result {
        Ok(()) => return ExitCode::SUCCESS,
        Err(Failure::Reported) => return ExitCode::from(1),
        // Who reads our output has had enough: that needs no words.
        Err(Failure::Failed(Error::Io { source, .. })) if source.kind() == ErrorKind::BrokenPipe => {
            return ExitCode::from(1);
        }
        Err(Failure::Failed(Error::Cancelled)) => match goes_on {
            Some(how) => (format!("interrupted; {how}"), 1),
            None => ("interrupted".to_string(), 1),
        },
        Err(Failure::Failed(error)) => (error.to_string(), 1),
        Err(Failure::Misused(text)) => (text, 2),
    };
    let _ = writeln!(std::io::stderr(), "nystrom-stream: {text}");
    ExitCode::from(code)
}
