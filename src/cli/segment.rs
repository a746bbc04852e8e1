//! `segment`: cut meshes into parts.

use super::bars::Bars;
use super::options::{MethodArgs, RunArgs};
use super::output::{Output, folder_of};
use super::{Failure, Surroundings};
use clap::ValueEnum;
use nystrom_stream::base::{Error, Result};
use nystrom_stream::mesh;
use nystrom_stream::mesh::labelled::PlyForm;
use nystrom_stream::pipeline::report::Report;
use nystrom_stream::pipeline::{Cluster, SegmentParams, input, segment};
use nystrom_stream::store::{Run, WorkDir, workdir};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// PLY files (.ply, .ply.gz); `-` reads standard input
    #[arg(required = true, value_name = "MESH")]
    pub meshes: Vec<PathBuf>,
    /// Output, once or more: .ply, .seg, .npy or .png, `-` for standard output [default: MESH.segmented.ply]
    #[arg(short, long, value_name = "OUT")]
    pub output: Vec<PathBuf>,
    /// Form of PLY outputs
    #[arg(long, value_enum, default_value = "same", value_name = "FORM")]
    pub ply_form: FormArg,
    /// Write a report as JSON, to FILE or to standard output; of several meshes, a list
    #[arg(long, value_name = "FILE", num_args = 0..=1, default_missing_value = "-", require_equals = true)]
    pub json: Option<PathBuf>,
    /// Keep intermediate results here and reuse them [default: a temporary folder]
    #[arg(long, value_name = "DIR")]
    pub work_dir: Option<PathBuf>,
    #[command(flatten)]
    pub method: MethodArgs,
    #[command(flatten)]
    pub run: RunArgs,
}

/// Encoding of PLY outputs.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum FormArg {
    /// As the input
    Same,
    /// Little-endian
    Binary,
    /// Text
    Ascii,
}

impl FormArg {
    fn form(self) -> PlyForm {
        match self {
            Self::Same => PlyForm::Same,
            Self::Binary => PlyForm::Binary,
            Self::Ascii => PlyForm::Ascii,
        }
    }
}

/// Refuses combinations of options before any work.
fn check(args: &Args) -> Result<(SegmentParams, Vec<Output>), Failure> {
    let params = args.method.params()?;
    if params.cluster == Cluster::KMeans && args.method.parts.is_none() {
        return Err(Failure::Misused(
            "-k: K-means needs the number of parts; give it, as in -k 6, or leave out --cluster kmeans".into(),
        ));
    }
    let outputs = args.output.iter().map(|path| Output::of(path)).collect::<Result<Vec<_>, _>>()?;
    if args.meshes.len() > 1 {
        if !outputs.is_empty() {
            return Err(Failure::Misused(
                "-o goes with one mesh; without it, each of several gets MESH.segmented.ply".into(),
            ));
        }
        if args.work_dir.is_some() {
            return Err(Failure::Misused("--work-dir goes with one mesh".into()));
        }
    }
    let stdin = args.meshes.iter().filter(|mesh| mesh.as_os_str() == "-").count();
    let to_stdout = outputs.contains(&Output::Stdout) || (stdin > 0 && outputs.is_empty());
    if stdin > 1 || (stdin == 1 && args.meshes.len() > 1) {
        return Err(Failure::Misused("standard input is one mesh; give it alone".into()));
    }
    if to_stdout && args.json.as_deref() == Some(Path::new("-")) {
        return Err(Failure::Misused("mesh and report cannot both go to standard output; give --json=FILE".into()));
    }
    Ok((params, outputs))
}

pub fn run(args: &Args, surroundings: &Surroundings) -> Result<(), Failure> {
    let (params, outputs) = check(args)?;
    let bars = Bars::new(args.run.quiet);
    let run = args.run.run(&bars, surroundings);
    let (mut failed, mut reports) = (0, Vec::new());
    for mesh in &args.meshes {
        match one(mesh, args, &params, &outputs, &bars, &run, surroundings) {
            Ok(report) if args.meshes.len() == 1 => publish(args, &report)?,
            Ok(report) => reports.push(report),
            Err(error) if args.meshes.len() == 1 || matches!(error, Error::Cancelled) => {
                if matches!(error, Error::Cancelled) && args.work_dir.is_some() {
                    let _ =
                        writeln!(std::io::stderr(), "nystrom-stream: interrupted; the same command goes on from here");
                    return Err(Failure::Reported);
                }
                return Err(error.into());
            }
            Err(error) => {
                failed += 1;
                let _ = writeln!(std::io::stderr(), "nystrom-stream: {error}");
            }
        }
    }
    if args.meshes.len() > 1 {
        publish(args, &reports)?;
    }
    if failed > 0 {
        let _ = writeln!(std::io::stderr(), "nystrom-stream: {failed} of {} meshes failed", args.meshes.len());
        return Err(Failure::Reported);
    }
    Ok(())
}

/// Writes the report, or the list of them, where it was asked for.
fn publish(args: &Args, report: &impl serde::Serialize) -> Result<(), Failure> {
    let Some(target) = &args.json else { return Ok(()) };
    let text = serde_json::to_string_pretty(report).unwrap_or_default();
    if target == Path::new("-") {
        let _ = writeln!(std::io::stdout(), "{text}");
        return Ok(());
    }
    std::fs::write(target, text + "\n").map_err(Error::io(target, "write"))?;
    Ok(())
}

/// Segments one mesh and writes its outputs.
pub fn one(
    path: &Path,
    args: &Args,
    params: &SegmentParams,
    outputs: &[Output],
    bars: &Bars,
    run: &Run,
    surroundings: &Surroundings,
) -> Result<Report> {
    let start = Instant::now();
    let stdin = path.as_os_str() == "-";
    let default = if stdin { Output::Stdout } else { Output::beside(path) };
    let outputs = if outputs.is_empty() { std::slice::from_ref(&default) } else { outputs };
    outputs.iter().try_for_each(Output::check)?;
    let work = match &args.work_dir {
        Some(dir) => WorkDir::open(dir)?,
        None => {
            let beside = outputs.iter().find_map(Output::path).map_or_else(std::env::temp_dir, folder_of);
            WorkDir::temporary(args.run.tmp.as_deref().unwrap_or(&beside))?
        }
    };
    if !stdin && !args.run.no_plan {
        super::plan::check(path, params, &work, run)?;
    }
    let (opened, _) = run.stage("read", "bytes", 0, || {
        if stdin {
            mesh::open_reader(std::io::stdin().lock(), "<stdin>", work.path(), run)
        } else {
            mesh::open(path, work.path(), run)
        }
    })?;
    opened.notes.iter().for_each(|note| run.progress.note(note));
    let identity = if stdin {
        serde_json::json!({"stdin": workdir::checksum(&work.file("input"))?})
    } else {
        input::identity(path)?
    };
    let result = segment(&opened, &identity, params, &work, run)?;
    run.stage("write", "faces", result.labels.len() as u64, || {
        outputs.iter().try_for_each(|output| output.write(&opened, &result, args.ply_form.form(), run))
    })?;
    let mut seconds = bars.take_seconds();
    seconds.insert("total".into(), start.elapsed().as_secs_f64());
    Ok(Report::new(&opened, params, &result, &work, run, seconds, Some((surroundings.peak)())))
}
