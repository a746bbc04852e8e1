//! `demo`: generates a mesh with known parts, cuts it, and compares. A first try without a mesh of one's own.

use super::options::{AppContext, CliError, RunArgs, ScratchArgs};
use super::output::Output;
use super::segment::{self, Job, SegmentArgs, Task};
use super::sink::print;
use clap::Parser;
use nystrom_stream::apps::creature::{Creature, Options, parse_faces};
use nystrom_stream::apps::evaluate::{contingency, matches, rand};
use nystrom_stream::base::Error;
use nystrom_stream::base::printable::human;
use nystrom_stream::mesh::seg;
use nystrom_stream::pipeline::labels::Part;
use std::path::PathBuf;

/// Arguments of `demo`.
#[derive(Clone, Debug, clap::Args)]
pub struct DemoArgs {
    /// Minimum number of faces of the mesh; may be written as 1.3e6
    #[arg(long, value_name = "N", default_value = "1.3e6", value_parser = parse_faces)]
    pub faces: u64,
    /// Noise, as a fraction of the edge length
    #[arg(long, value_name = "X", default_value_t = 0.)]
    pub noise: f64,
    /// Folder for the files
    #[arg(long, value_name = "DIR", default_value = "nystrom-stream-demo")]
    pub folder: PathBuf,
    #[command(flatten)]
    pub run: RunArgs,
    #[command(flatten)]
    pub scratch: ScratchArgs,
    /// Do not check free disk space before starting
    #[arg(long, help_heading = "Running")]
    pub no_plan: bool,
}

/// Runs `demo`.
pub fn run(args: &DemoArgs, app: &AppContext) -> Result<(), CliError> {
    let bars = args.run.bars();
    let run = args.run.run(&bars, app);
    let creature = Creature::new(&Options {
        faces: args.faces,
        noise: args.noise,
        seed: args.run.seed.unwrap_or(0),
        ..Options::default()
    })?;
    std::fs::create_dir_all(&args.folder).map_err(Error::io(&args.folder, "create"))?;
    let mesh = args.folder.join("creature.ply");
    creature.write_ply(&mesh, &run)?;
    let truth_file = args.folder.join("creature.seg");
    creature.write_truth_seg(&truth_file, &run)?;
    let names = Creature::part_names();

    let (ply, labels_file) = (args.folder.join("creature.segmented.ply"), args.folder.join("creature.labels.seg"));
    let words = ["segment".into(), mesh.clone().into_os_string()];
    let cut = CutArgs::try_parse_from(words).map_err(|error| CliError::Usage(error.to_string()))?.args;
    let cut = SegmentArgs { run: args.run.clone(), scratch: args.scratch.clone(), no_plan: args.no_plan, ..cut };
    let job = Job { mesh, outputs: vec![Output::of(&ply)?, Output::of(&labels_file)?] };
    let params = cut.method.params()?;
    // Generating the mesh is not part of the measurement.
    let bars = args.run.bars();
    let run = args.run.run(&bars, app);
    let task = Task { args: &cut, params: &params, edits: None, names: None, like: None };
    let report = segment::one(&job, task, &bars, &run, app)?;

    let table = contingency(&seg::read_seg(&labels_file)?, &seg::read_seg(&truth_file)?, None)?;
    let mut lines = vec![
        format!(
            "{} faces in {} parts in {:.2} s ({}faces/s), at most {:.0} MiB allocated",
            report.input.faces,
            report.parts.len(),
            report.seconds["total"],
            human(report.input.faces as f64 / report.seconds["total"]),
            report.bytes.peak_allocated.unwrap_or(0) as f64 / f64::from(1 << 20),
        ),
        format!("agreement with the true parts ({}):", names.join(", ")),
        format!("  Rand index              {:.4}", 1. - rand(&table)),
        format!("  faces in matching parts {:.1} %", 100. * matches(&table)),
    ];
    let part = |part: &Part| format!("  part {:2}  {:>9} faces  rgb {:?}", part.label, part.faces, part.colour);
    lines.extend(report.parts.iter().map(part));
    lines.push(format!("open {} in MeshLab, or draw it: nystrom-stream picture {0}\n", ply.display()));
    Ok(print(lines.join("\n").as_bytes())?)
}

/// The arguments of `segment`, parsed as a separate command.
#[derive(Debug, Parser)]
struct CutArgs {
    #[command(flatten)]
    args: SegmentArgs,
}
