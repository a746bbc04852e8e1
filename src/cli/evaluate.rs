//! `evaluate`: labels against people's, for one mesh or over the folder of a benchmark.

use super::bars::{Bars, Style};
use super::judge::judge;
use super::{AppContext, Failure};
use nystrom_stream::apps::evaluate::{
    Benchmark, Evaluator, MeanScores, ScoreTable, Scores, Segmentation, fitting, read_labels,
};
use nystrom_stream::apps::plots::charts;
use nystrom_stream::base::{Error, Result};
use nystrom_stream::mesh;
use nystrom_stream::store::Run;
use serde_json::json;
use std::io::Write;
use std::path::{Path, PathBuf};

#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// Labels to judge: .seg, .npy, or .ply with a face property `label`; with --benchmark a folder of them, named
    /// after the models, without which people are judged
    #[arg(value_name = "LABELS", required_unless_present_any = ["benchmark", "matches"])]
    pub labels: Option<PathBuf>,
    /// The mesh of the labels [default: LABELS if it is a .ply; without a mesh all faces weigh the same]
    #[arg(long, value_name = "MESH", conflicts_with = "benchmark")]
    pub mesh: Option<PathBuf>,
    /// Labels to judge by, once or more, in the same forms; with --matches a map of vertices, .npy or .csv [default there:
    /// each vertex is the one of its own number]
    #[arg(
        long,
        value_name = "LABELS",
        required_unless_present_any = ["benchmark", "matches"],
        conflicts_with = "benchmark"
    )]
    pub truth: Vec<PathBuf>,
    /// Folder of N.ply, people's N_0.seg, N_1.seg, … and models.tsv (columns model and category)
    #[arg(long, value_name = "DIR")]
    pub benchmark: Option<PathBuf>,
    /// Judge the matches of `correspond` instead, .npy or .csv; --mesh is the mesh they point to
    #[arg(long, value_name = "FILE", requires = "mesh", conflicts_with_all = ["labels", "benchmark", "plot"])]
    pub matches: Option<PathBuf>,
    /// Matches judged at the most, spread evenly
    #[arg(long, value_name = "N", default_value_t = 10_000, requires = "matches")]
    pub samples: usize,
    /// Write the scores as JSON; `-` for standard output, instead of the table
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Draw 1 - Rand by category beside people's, .svg or .png
    #[arg(long, value_name = "FILE", requires = "benchmark", requires = "labels")]
    pub plot: Option<PathBuf>,
    /// Leave out the cut discrepancy, which costs most
    #[arg(long)]
    pub no_cuts: bool,
    /// Worker threads [default: one a core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub threads: Option<u16>,
    /// Say nothing but scores and errors
    #[arg(short, long)]
    pub quiet: bool,
}

/// What comes out: a table to read and the same as JSON.
pub struct Outcome {
    pub text: String,
    pub json: String,
}

pub fn run(args: &Args, app: &AppContext) -> std::result::Result<(), Failure> {
    let charted =
        |path: &Path| path.extension().is_some_and(|end| ["svg", "png"].iter().any(|e| end.eq_ignore_ascii_case(e)));
    if let Some(path) = args.plot.as_deref().filter(|path| !charted(path)) {
        return Err(Failure::Misused(format!("--plot {}: no chart; end it with .svg or .png", path.display())));
    }
    let bars = Bars::new(if args.quiet { Style::Quiet } else { Style::of_terminal() });
    let mut run = Run::new(&bars);
    if let Some(threads) = args.threads {
        run.threads = threads.into();
    }
    run.cancel = app.cancel.clone();
    let outcome = match (&args.benchmark, &args.labels) {
        _ if args.matches.is_some() => matches(args, &run)?,
        (Some(folder), _) => folder_of_models(folder, args, &run)?,
        (None, Some(labels)) => one(labels, args, &run)?,
        (None, None) => return Err(Failure::Misused("give labels, or --benchmark".into())),
    };
    let to_stdout = args.json.as_deref() == Some(Path::new("-"));
    let text = if to_stdout { &outcome.json } else { &outcome.text };
    let _ = writeln!(std::io::stdout(), "{}", text.trim_end());
    if let Some(path) = args.json.as_ref().filter(|_| !to_stdout) {
        std::fs::write(path, outcome.json + "\n").map_err(Error::io(path, "write"))?;
    }
    Ok(())
}

/// Matches.
fn matches(args: &Args, run: &Run) -> std::result::Result<Outcome, Failure> {
    match (&args.matches, &args.mesh, &args.truth[..]) {
        (Some(matches), Some(mesh), [] | [_]) => {
            Ok(judge(matches, mesh, args.truth.first().map(PathBuf::as_path), args.samples, run)?)
        }
        _ => Err(Failure::Misused("--matches: give one --mesh, and one --truth at the most".into())),
    }
}

/// A whole benchmark.
fn folder_of_models(folder: &Path, args: &Args, run: &Run) -> Result<Outcome> {
    let benchmark = Benchmark::open(folder)?;
    let judge = || benchmark.evaluate(args.labels.as_deref(), !args.no_cuts, run);
    let (evaluation, _) = run.stage("evaluate", "models", benchmark.models.len() as u64, judge)?;
    if !evaluation.missing.is_empty() {
        let names = evaluation.missing.join(" ");
        run.progress.note(&format!("no labels for {} models, left out: {names}", evaluation.missing.len()));
    }
    if let Some(path) = &args.plot {
        charts::scores_by_category(path, &evaluation.table, &evaluation.people)?;
    }
    Ok(Outcome { text: evaluation.table.to_text(), json: evaluation.table.to_json()? })
}

/// Labels of one mesh.
fn one(labels: &Path, args: &Args, run: &Run) -> Result<Outcome> {
    let scratch = tempfile::tempdir().map_err(Error::io(std::env::temp_dir(), "create a folder in"))?;
    let is_ply = labels.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("ply"));
    let read = |path: &Path| read_labels(path, scratch.path(), run);
    let own = read(labels)?;
    let surface = match args.mesh.as_deref().or(is_ply.then_some(labels)) {
        Some(path) => {
            let mesh = mesh::open(path, scratch.path(), run)?.mesh;
            if args.no_cuts { Evaluator::without_edges(&mesh) } else { Evaluator::of(&mesh)? }
        }
        None => Evaluator::of_faces(own.len()),
    };
    let judged = fitting(&surface, labels, &own)?;
    let truths: Vec<Vec<u32>> = args.truth.iter().map(|path| read(path)).collect::<Result<_>>()?;
    let truths: Vec<Segmentation> =
        args.truth.iter().zip(&truths).map(|(path, truth)| fitting(&surface, path, truth)).collect::<Result<_>>()?;
    let each: Vec<Scores> = truths.iter().map(|truth| surface.compare(&judged, truth)).collect();
    let mean = surface.compare_many(&judged, &truths)?;
    let people = if truths.len() > 1 { Some(surface.people(&truths)?) } else { None };
    let parts = truths.iter().map(|truth| truth.parts() as f64).sum::<f64>() / truths.len() as f64;
    let row = |name: String, models, parts, scores| MeanScores { name, models, parts, scores };
    let names = || args.truth.iter().map(|path| path.display().to_string());
    let table = ScoreTable {
        categories: names()
            .zip(&truths)
            .zip(&each)
            .map(|((name, truth), scores)| row(name, 1, truth.parts() as f64, *scores))
            .collect(),
        overall: Some(row(labels.display().to_string(), truths.len(), judged.parts() as f64, mean)),
        people: people.map(|people| row("people".into(), truths.len(), parts, people)),
        models: Vec::new(),
    };
    let json = json!({
        "labels": labels.display().to_string(),
        "faces": own.len(),
        "parts": judged.parts(),
        "scores": mean,
        "truths": table.categories,
        "people": table.people,
    });
    Ok(Outcome {
        text: table.to_text_under("truth", "cuts"),
        json: serde_json::to_string_pretty(&json).unwrap_or_default(),
    })
}
