//! The command line: parsed once into the library's parameter structs. The only user of clap and indicatif.

mod bars;
mod demo;
mod evaluate;
mod info;
mod options;
mod output;
mod picture;
mod plan;
mod rows;
mod segment;

use clap::{Parser, Subcommand};
use nystrom_stream::base::{Cancel, Error};
use std::io::Write;
use std::process::ExitCode;

/// Cut meshes of a million to a billion triangles into their meaningful parts, out of core.
#[derive(Debug, Parser)]
#[command(name = "nystrom-stream", version, propagate_version = true, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Cut meshes into parts and write them with labels and colours
    Segment(segment::Args),
    /// Compute the distances from all landmarks, alone or as one of several processes
    Rows(rows::Args),
    /// Put the rows of several processes together
    Merge(rows::MergeArgs),
    /// Tell memory, disk and time of a run before it starts
    Plan(plan::Args),
    /// Tell what a work directory holds
    Info(info::Args),
    /// Test every file of a work directory against its checksum
    Verify(info::Args),
    /// Score labels against people's: a mesh, or a whole benchmark
    Evaluate(evaluate::Args),
    /// Draw a mesh and its parts as a picture
    Picture(picture::Args),
    /// Make a mesh of a million faces with known parts, cut it, and compare
    Demo(demo::Args),
}

/// What every subcommand gets.
struct Surroundings {
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
    let surroundings = Surroundings { cancel: Cancel::default(), peak };
    let cancel = surroundings.cancel.clone();
    // A second signal ends at once; the first lets files be closed and temporary folders go.
    let _ = ctrlc::set_handler(move || {
        if cancel.is_cancelled() {
            std::process::exit(1);
        }
        cancel.cancel();
    });
    let result = match cli.command {
        Command::Segment(args) => segment::run(&args, &surroundings),
        Command::Rows(args) => rows::run(&args, &surroundings),
        Command::Merge(args) => rows::merge(&args, &surroundings),
        Command::Plan(args) => plan::run(&args, &surroundings),
        Command::Info(args) => info::run(&args),
        Command::Verify(args) => info::verify(&args, &surroundings),
        Command::Evaluate(args) => evaluate::run(&args, &surroundings),
        Command::Picture(args) => picture::run(&args, &surroundings),
        Command::Demo(args) => demo::run(&args, &surroundings),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failure::Reported) => ExitCode::from(1),
        Err(Failure::Failed(error)) => {
            let _ = writeln!(std::io::stderr(), "nystrom-stream: {error}");
            ExitCode::from(1)
        }
        Err(Failure::Misused(text)) => {
            let _ = writeln!(std::io::stderr(), "nystrom-stream: {text}");
            ExitCode::from(2)
        }
    }
}
