//! `segment`: cut meshes into parts.

use super::bars::Bars;
use super::method::{MethodArgs, check_count};
use super::options::RunArgs;
use super::output::{FormArgs, Output, Results, folder_of, publish};
use super::stages::{KeptEmbedding, embedding, read};
use super::{AppContext, Failure, batch};
use nystrom_stream::base::Result;
use nystrom_stream::mesh::labelled::Labelling;
use nystrom_stream::pipeline::report::Report;
use nystrom_stream::pipeline::{Cluster, SegmentParams, cuts, segment};
use nystrom_stream::store::Context;
use nystrom_stream::store::Run;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// PLY, OBJ, OFF and STL files, .gz or not, folders of them, or patterns; `-` reads standard input
    #[arg(required = true, value_name = "MESH")]
    pub meshes: Vec<PathBuf>,
    /// Output, once or more: .ply, .seg, .npy, .parquet, .glb, .html or .png, a folder with / at its end for a PLY a part,
    /// `-` for standard output; of several meshes with `{}` for the mesh's name, like out/{}.seg
    /// [default: MESH.segmented.ply]
    #[arg(short, long, value_name = "OUT")]
    pub output: Vec<PathBuf>,
    #[command(flatten)]
    pub form: FormArgs,
    /// Write a report as JSON, to FILE or to standard output; of several meshes, a list
    #[arg(long, value_name = "FILE", num_args = 0..=1, default_missing_value = "-", require_equals = true)]
    pub json: Option<PathBuf>,
    /// Keep intermediate results here and reuse them [default: a temporary folder]
    #[arg(long, value_name = "DIR")]
    pub work_dir: Option<PathBuf>,
    /// Write a line of JSON a mesh as it is done, to FILE or to standard output
    #[arg(
        long,
        value_name = "FILE",
        num_args = 0..=1,
        default_missing_value = "-",
        require_equals = true,
        help_heading = "Many meshes"
    )]
    pub json_lines: Option<PathBuf>,
    /// Meshes at a time; they share threads and memory evenly
    #[arg(
        long,
        value_name = "N",
        default_value_t = 1,
        value_parser = clap::value_parser!(u16).range(1..),
        help_heading = "Many meshes"
    )]
    pub jobs: u16,
    /// Skip meshes whose outputs are all there and newer than the mesh
    #[arg(long, help_heading = "Many meshes")]
    pub resume: bool,
    #[command(flatten)]
    pub method: MethodArgs,
    #[command(flatten)]
    pub run: RunArgs,
}

/// Refuses combinations of options before any work.
fn check(args: &Args, meshes: &[PathBuf], many: bool) -> Result<(SegmentParams, Vec<Output>), Failure> {
    let params = args.method.params()?;
    check_count(&params)?;
    let misused = |text: &str| Err(Failure::Misused(text.into()));
    let outputs = args.output.iter().map(|path| Output::of(path)).collect::<Result<Vec<_>, _>>()?;
    args.form.check(&outputs)?;
    let stdin = meshes.iter().filter(|mesh| mesh.as_os_str() == "-").count();
    if stdin > 0 && many {
        return misused("standard input is one mesh; give it alone");
    }
    if many {
        let fixed = args.output.iter().any(|path| !path.to_string_lossy().contains("{}"));
        if fixed {
            return misused(
                "-o goes with one mesh; of several, write {} for the mesh's name, as in -o 'out/{}.seg', or leave it \
                 out: each gets MESH.segmented.ply",
            );
        }
        if args.work_dir.is_some() {
            return misused("--work-dir goes with one mesh");
        }
    } else {
        let alone = [(args.jobs > 1, "--jobs"), (args.resume, "--resume"), (args.json_lines.is_some(), "--json-lines")];
        if let Some((_, option)) = alone.into_iter().find(|(given, _)| *given) {
            return Err(Failure::Misused(format!("{option} goes with several meshes, a folder or a pattern")));
        }
    }
    let is_stdout = |target: &Option<PathBuf>| target.as_deref() == Some(Path::new("-"));
    let to_stdout = outputs.contains(&Output::Stdout) || (stdin > 0 && outputs.is_empty());
    if to_stdout && is_stdout(&args.json) {
        return misused("mesh and report cannot both go to standard output; give --json=FILE");
    }
    if is_stdout(&args.json) && is_stdout(&args.json_lines) {
        return misused("--json and --json-lines cannot both go to standard output; give one of them a file");
    }
    Ok((params, outputs))
}

pub fn run(args: &Args, app: &AppContext) -> Result<(), Failure> {
    // A wrong option is told before a missing folder.
    args.method.params()?;
    let (meshes, many) = batch::meshes(&args.meshes)?;
    let (params, outputs) = check(args, &meshes, many)?;
    if many {
        return batch::run(meshes, args, &params, app);
    }
    let bars = args.run.bars();
    let run = args.run.run(&bars, app);
    let report = one(&meshes[0], args, &params, &outputs, &bars, &run, app)?;
    if let Some(target) = &args.json {
        publish(target, &report)?;
    }
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
    app: &AppContext,
) -> Result<Report> {
    let start = Instant::now();
    let stdin = path.as_os_str() == "-";
    let default = if stdin { Output::Stdout } else { Output::beside(path) };
    let outputs = if outputs.is_empty() { std::slice::from_ref(&default) } else { outputs };
    outputs.iter().try_for_each(Output::check)?;
    let beside = || outputs.iter().find_map(Output::path).map_or_else(std::env::temp_dir, folder_of);
    let work = args.run.work(args.work_dir.as_deref(), beside, run)?;
    if !stdin && !args.run.no_plan {
        super::plan::check(path, params, Context::new(&work, run))?;
    }
    let (opened, identity) = read(path, Context::new(&work, run))?;
    opened.notes.iter().for_each(|note| run.progress.note(note));
    let result = segment(&opened, &identity, params, Context::new(&work, run))?;
    let coordinates =
        if args.form.embedding_columns { Some(embedding(params, Context::new(&work, run))?) } else { None };
    let pages = outputs.iter().any(Output::is_page);
    let cut = pages && params.cluster == Cluster::Parts;
    let cuts = if cut { cuts::kept(params.coarse, None, Context::new(&work, run))? } else { None };
    let mut seconds = bars.take_seconds();
    let report = |mut seconds: BTreeMap<String, f64>| {
        seconds.insert("total".into(), start.elapsed().as_secs_f64());
        Report::new(&opened, params, &result, Context::new(&work, run), seconds, Some((app.peak)()))
    };
    let results = Results {
        labelling: Labelling { labels: &result.labels, colours: &result.colours, quality: Some(&result.quality) },
        options: args.form.ply.options(),
        embedding: coordinates.as_ref().map(KeptEmbedding::coordinates),
        report: if pages { serde_json::to_value(report(seconds.clone())).unwrap_or_default() } else { Value::Null },
        cuts: cuts.as_ref(),
    };
    run.stage("write", "faces", result.labels.len() as u64, || {
        outputs.iter().try_for_each(|output| output.write(Some(&opened), &results, run))
    })?;
    seconds.extend(bars.take_seconds());
    Ok(report(seconds))
}
