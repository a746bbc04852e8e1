//! `evaluate`: scores labels against those of people, for one mesh or for the folder of a benchmark; scores matches of
//! `correspond` against true ones.

use super::input::{check_is_file, check_there};
use super::options::{AppContext, CliError, misfit};
use super::output::{JsonArgs, check_charts, check_extensions};
use super::progress::{Bars, Style};
use super::sink::check_places;
use nystrom_stream::apps::correspond::{Errors, accuracy, files};
use nystrom_stream::apps::evaluate::{
    Benchmark, Evaluator, LABEL_EXTENSIONS, MeanScores, ScoreTable, Scores, Segmentation, fitting, read_labels,
};
use nystrom_stream::apps::plots::charts;
use nystrom_stream::base::printable::counted;
use nystrom_stream::base::{Error, Result};
use nystrom_stream::graph::VertexGraph;
use nystrom_stream::mesh::{self, ends_with};
use nystrom_stream::store::{Context, Run, WorkDir, private_folder};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Maximum number of matches that are scored by default.
const SAMPLES: u32 = 10_000;

#[derive(Clone, Debug, clap::Args)]
pub struct EvaluateArgs {
    /// Labels to score: .seg, .npy, or .ply with a face property `label`; with --benchmark a folder of them, named
    /// after the models [default with --benchmark: each person is scored against the others]
    #[arg(value_name = "LABELS", required_unless_present_any = ["benchmark", "matches"])]
    pub labels: Option<PathBuf>,
    /// The mesh of the labels: PLY, OBJ, OFF or STL, also .gz [default: LABELS if it is a .ply; without a mesh
    /// all faces weigh the same]
    #[arg(long, value_name = "MESH", conflicts_with = "benchmark")]
    pub mesh: Option<PathBuf>,
    /// Reference labels, repeatable, in the same formats; with --matches a map of vertices, .npy or .csv [default with
    /// --matches: vertices with the same number match]
    #[arg(
        long,
        value_name = "LABELS",
        required_unless_present_any = ["benchmark", "matches"],
        conflicts_with = "benchmark"
    )]
    pub truth: Vec<PathBuf>,
    /// Folder of a benchmark: N.ply, human labels N_0.seg, N_1.seg, …, and models.tsv (columns model and category)
    #[arg(long, value_name = "DIR")]
    pub benchmark: Option<PathBuf>,
    /// Score the matches of `correspond` instead, .npy or .csv; --mesh is the mesh they point to
    #[arg(long, value_name = "FILE", requires = "mesh", conflicts_with_all = ["labels", "benchmark", "plot"])]
    pub matches: Option<PathBuf>,
    /// Maximum number of matches to score, spread evenly [default: 10000]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub samples: Option<u32>,
    #[command(flatten)]
    pub json: JsonArgs,
    /// Plot 1 - Rand by category, beside that of people, .svg or .png
    #[arg(long, value_name = "FILE", requires = "benchmark", requires = "labels")]
    pub plot: Option<PathBuf>,
    /// Skip the cut discrepancy, the slowest metric
    #[arg(long, conflicts_with = "matches")]
    pub no_cuts: bool,
    /// Worker threads [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub threads: Option<u16>,
    /// Print nothing but scores and errors
    #[arg(short, long)]
    pub quiet: bool,
}

/// A readable table, and the same data as JSON.
type Outcome = (String, Value);

/// Runs `evaluate`.
pub fn run(args: &EvaluateArgs, app: &AppContext) -> std::result::Result<(), CliError> {
    check_charts("--plot", args.plot.as_slice())?;
    if args.plot.is_some() && args.benchmark.is_none() {
        return Err(misfit("--plot", "--benchmark"));
    }
    // The parser lets it pass beside labels, which exclude --matches.
    if args.samples.is_some() && args.matches.is_none() {
        return Err(misfit("--samples", "--matches"));
    }
    check_formats(args)?;
    let inputs = args.labels.iter().chain(&args.mesh).chain(&args.truth).chain(&args.matches);
    let folders = [&args.benchmark, &args.labels].into_iter().flatten().filter(|_| args.benchmark.is_some());
    let scored: Vec<PathBuf> = folders.flat_map(|folder| files_of_benchmark(folder)).collect();
    check_places(inputs.clone().chain(&scored), None, args.plot.iter().chain(&args.json.json))?;
    args.mesh.iter().try_for_each(|path| check_is_file(path))?;
    inputs.into_iter().try_for_each(|path| check_there(path))?;
    let bars = Bars::new(if args.quiet { Style::Quiet } else { Style::of_terminal() });
    let mut run = Run::new(&bars);
    if let Some(threads) = args.threads {
        run.threads = threads.into();
    }
    run.cancel = app.cancel.clone();
    let (text, json) = match (&args.benchmark, &args.labels) {
        _ if args.matches.is_some() => matches(args, &run)?,
        (Some(folder), _) => folder_of_models(folder, args, &run)?,
        (None, Some(labels)) => one(labels, args, &run)?,
        (None, None) => return Err(CliError::Usage("give labels, or --benchmark".into())),
    };
    Ok(args.json.publish_or_print(&json, &format!("{}\n", text.trim_end()))?)
}

/// The meshes, labels and tables in a folder, which no output may overwrite.
fn files_of_benchmark(folder: &Path) -> impl Iterator<Item = PathBuf> {
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let is_read = |path: &PathBuf| {
        path.extension().is_some_and(|extension| extension == "tsv" || LABEL_EXTENSIONS.iter().any(|x| extension == *x))
    };
    files.filter(is_read)
}

/// Rejects files of labels or matches in an unknown format, before any work.
fn check_formats(args: &EvaluateArgs) -> std::result::Result<(), CliError> {
    if args.matches.is_some() {
        let (known, remedy) = (["npy", "csv"], "give a .npy or .csv file");
        check_extensions("--matches", &args.matches, &known, remedy)?;
        return check_extensions("--truth", &args.truth, &known, remedy);
    }
    let remedy = "give a .seg, .npy or .ply file";
    // Those of a benchmark are a folder.
    let labels = args.labels.iter().filter(|_| args.benchmark.is_none());
    check_extensions("LABELS", labels, &LABEL_EXTENSIONS, remedy)?;
    check_extensions("--truth", &args.truth, &LABEL_EXTENSIONS, remedy)
}

/// Checks the arguments for matches, and scores them.
fn matches(args: &EvaluateArgs, run: &Run) -> std::result::Result<Outcome, CliError> {
    match (&args.matches, &args.mesh, &args.truth[..]) {
        (Some(matches), Some(mesh), [] | [_]) => {
            let samples = args.samples.unwrap_or(SAMPLES) as usize;
            Ok(evaluate_matches(matches, mesh, args.truth.first().map(PathBuf::as_path), samples, run)?)
        }
        _ => Err(CliError::Usage("--matches: give one --mesh, and at most one --truth".into())),
    }
}

/// A whole benchmark.
fn folder_of_models(folder: &Path, args: &EvaluateArgs, run: &Run) -> Result<Outcome> {
    let benchmark = Benchmark::open(folder)?;
    let evaluate = || benchmark.evaluate(args.labels.as_deref(), !args.no_cuts, run);
    let (evaluation, _) = run.stage("evaluate", "models", benchmark.models.len() as u64, evaluate)?;
    if !evaluation.missing.is_empty() {
        let names = evaluation.missing.join(" ");
        run.progress.note(&format!("no labels for {}, left out: {names}", counted(evaluation.missing.len(), "model")));
    }
    if let Some(path) = &args.plot {
        charts::scores_by_category(path, &evaluation.table, &evaluation.people)?;
    }
    Ok((evaluation.table.to_text(), json!(evaluation.table)))
}

/// Labels of one mesh.
fn one(labels: &Path, args: &EvaluateArgs, run: &Run) -> Result<Outcome> {
    let scratch = private_folder(&std::env::temp_dir())?;
    let is_ply = ends_with(labels, "ply");
    let read = |path: &Path| read_labels(path, scratch.path(), run);
    let own = read(labels)?;
    let surface = match args.mesh.as_deref().or(is_ply.then_some(labels)) {
        Some(path) => {
            let mesh = mesh::open(path, scratch.path(), run)?;
            let all = || Evaluator::stopped_by(&mesh, run.cancel.clone());
            if args.no_cuts { Evaluator::without_edges(&mesh) } else { all()? }
        }
        None => Evaluator::of_faces(own.len()),
    };
    let judged = fitting(&surface, labels, &own)?;
    let truths: Vec<Vec<u32>> = args.truth.iter().map(|path| read(path)).collect::<Result<_>>()?;
    if args.mesh.is_none()
        && !is_ply
        && let Some((path, truth)) = args.truth.iter().zip(&truths).find(|(_, truth)| truth.len() != own.len())
    {
        let problem = format!("has {}, but {} has {}", counted(truth.len(), "label"), labels.display(), own.len());
        return Err(Error::unusable(path, problem, "give labels of the same mesh"));
    }
    let truths: Vec<Segmentation> =
        args.truth.iter().zip(&truths).map(|(path, truth)| fitting(&surface, path, truth)).collect::<Result<_>>()?;
    let each: Vec<Scores> = truths.iter().map(|truth| surface.compare(&judged, truth)).collect::<Result<_>>()?;
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
    Ok((table.to_text_under("truth", "cuts"), json))
}

/// Scores `matches`, which refer to vertices of `mesh`, against the vertex map `truth` (identity if none), at up to
/// `samples` vertices, evenly spread.
fn evaluate_matches(matches: &Path, mesh: &Path, truth: Option<&Path>, samples: usize, run: &Run) -> Result<Outcome> {
    let found = files::read(matches)?;
    let real = truth.map(files::read).transpose()?;
    if let Some(real) = real.as_ref().filter(|real| real.len() != found.len()) {
        let problem = format!("has {}, the matches have {}", counted(real.len(), "vertex"), found.len());
        return Err(Error::unusable(truth.unwrap_or(matches), problem, "give the map of this mesh"));
    }
    let work = WorkDir::temporary(&std::env::temp_dir())?;
    let opened = mesh::open(mesh, work.path(), run)?;
    let graph = VertexGraph::build(&opened, mesh, Context::new(&work, run))?;
    let n = graph.len();
    let beyond = |map: &[Option<u32>]| map.iter().flatten().find(|&&v| v as usize >= n).copied();
    if let Some(v) = beyond(&found) {
        let problem = format!("names vertex {v}, but {} has only {}", mesh.display(), counted(n, "vertex"));
        return Err(Error::unusable(matches, problem, "give --mesh the mesh that the matches point to"));
    }
    if let (Some(v), Some(path)) = (real.as_deref().and_then(beyond), truth) {
        let problem = format!("names vertex {v}, but {} has only {}", mesh.display(), counted(n, "vertex"));
        return Err(Error::unusable(path, problem, "give the true matches in this mesh"));
    }
    if real.is_none() && found.len() > n {
        let problem = format!("has {}, but {} has only {n}", counted(found.len(), "vertex"), mesh.display());
        return Err(Error::unusable(matches, problem, "vertices cannot be matched by number; give --truth"));
    }
    let errors = accuracy::errors(&graph, &found, real.as_deref(), samples, run)?;
    if errors.evaluated == 0 {
        let (path, problem) = match truth {
            Some(truth) if errors.unmatched == 0 => (truth, "names no true match of a sampled vertex"),
            _ => (matches, "has no match of a sampled vertex"),
        };
        return Err(Error::unusable(path, problem, "give other matches, or raise --samples"));
    }
    let mut text = format!(
        "{} scored, {} without a match\nerror / √area: mean {:.4}, median {:.4}, 90 % below {:.4}, greatest \
         {:.4}\n",
        counted(errors.evaluated as usize, "vertex"),
        errors.unmatched,
        errors.mean,
        errors.median,
        errors.ninth_decile,
        errors.maximum
    );
    for (i, share) in errors.curve.iter().enumerate().filter(|(i, _)| [0, 2, 5, 10, 20, 30, 40, 50].contains(i)) {
        text += &format!("{:5.1} % within {:.3}\n", 100. * share, Errors::END * i as f64 / 50.);
    }
    let json = json!({"matches": matches.display().to_string(), "mesh": mesh.display().to_string(), "errors": errors});
    Ok((text, json))
}
