//! Scores a folder of labels on the Princeton Segmentation Benchmark, by category, beside people.
//!
//! `cargo run --release --example psb -- BENCHMARK [LABELS] [--json FILE]`, where BENCHMARK holds
//! `N.ply`, people's `N_j.seg` and `models.tsv` (tab-separated, with the columns `model` and
//! `category`), and LABELS `N.seg`. Without LABELS people themselves are judged, each against the
//! others. Cost: about 20 ms a model and thread.

use clap::Parser;
use nystrom_stream::apps::evaluate::{ModelScores, Surface, Table};
use nystrom_stream::base::{Cancel, Error, Result, parallel};
use nystrom_stream::mesh::{self, read_seg};
use nystrom_stream::store::Run;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

/// Score labels on the Princeton Segmentation Benchmark.
#[derive(Parser)]
struct Options {
    /// Folder of N.ply, N_j.seg and models.tsv
    benchmark: PathBuf,
    /// Folder of N.seg to judge; without it people are
    labels: Option<PathBuf>,
    /// Write the table as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Only every N-th model of the list, from the first
    #[arg(long, value_name = "N", default_value_t = 1)]
    every: usize,
    /// Leave out the cut discrepancy
    #[arg(long)]
    no_cuts: bool,
    /// Worker threads
    #[arg(long, default_value_t = std::thread::available_parallelism().map_or(1, |n| n.get()))]
    threads: usize,
}

/// The scores of a model's labels, if there are any, and of people on it.
struct Outcome {
    labels: Option<ModelScores>,
    people: ModelScores,
}

fn main() -> ExitCode {
    match run(&Options::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("psb: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(options: &Options) -> Result<()> {
    let start = Instant::now();
    let models: Vec<_> = models(&options.benchmark)?.into_iter().step_by(options.every.max(1)).collect();
    let judge = |k: usize, (): &mut ()| judge(options, &models[k].0, &models[k].1);
    let outcomes = parallel::map_chunks(options.threads, &Cancel::default(), models.len(), || (), judge)?;
    let (mut judged, mut people, mut missing) = (Vec::new(), Vec::new(), Vec::new());
    for outcome in outcomes {
        match outcome.labels {
            Some(scores) => {
                judged.push(scores);
                people.push(outcome.people);
            }
            None if options.labels.is_some() => missing.push(outcome.people.model),
            None => judged.push(outcome.people),
        }
    }
    if !missing.is_empty() {
        eprintln!("psb: no labels for {} models, left out: {}", missing.len(), missing.join(" "));
    }
    let seconds = start.elapsed().as_secs_f64();
    eprintln!("psb: {} models in {seconds:.1} s, {:.0} ms each", models.len(), 1e3 * seconds / models.len() as f64);
    let table = Table::new(judged, &people);
    print!("{}", table.to_text());
    match &options.json {
        Some(path) => std::fs::write(path, table.to_json()?).map_err(Error::io(path, "write")),
        None => Ok(()),
    }
}

/// Names and categories in the order of `models.tsv`.
fn models(benchmark: &Path) -> Result<Vec<(String, String)>> {
    let path = benchmark.join("models.tsv");
    let text = std::fs::read_to_string(&path).map_err(Error::io(&path, "read"))?;
    let mut lines = text.lines().map(|line| line.split('\t').collect::<Vec<_>>());
    let head = lines.next().unwrap_or_default();
    let column = |name| {
        let problem = || Error::malformed(&path, "line 1", format!("no column {name}"), "see the usage of this tool");
        head.iter().position(|title| *title == name).ok_or_else(problem)
    };
    let (model, category) = (column("model")?, column("category")?);
    let field = |line: &[&str], at: usize| line.get(at).map(|field| (*field).to_owned());
    Ok(lines.filter_map(|line| field(&line, model).zip(field(&line, category))).collect())
}

/// Judges one model.
fn judge(options: &Options, model: &str, category: &str) -> Result<Outcome> {
    let folder = &options.benchmark;
    let scratch = tempfile::tempdir().map_err(Error::io(std::env::temp_dir(), "create a folder in"))?;
    let run = Run { threads: 1, ..Run::new(&()) };
    let mesh = mesh::open(&folder.join(format!("{model}.ply")), scratch.path(), &run)?.mesh;
    let surface = if options.no_cuts { Surface::without_edges(&mesh) } else { Surface::of(&mesh)? };
    let truths = truths(folder, model)?;
    let truths = surface.segmentations(&truths)?;
    let scored = |scores, parts| ModelScores { model: model.to_owned(), category: category.to_owned(), scores, parts };
    let mean_parts = truths.iter().map(|truth| truth.parts() as f64).sum::<f64>() / truths.len() as f64;
    let people = scored(surface.people(&truths)?, mean_parts);
    let path = options.labels.as_ref().map(|labels| labels.join(format!("{model}.seg")));
    let labels = match path.filter(|path| path.exists()) {
        Some(path) => {
            let labels = read_seg(&path)?;
            let labels = surface.segmentation(&path.display().to_string(), &labels)?;
            Some(scored(surface.compare_many(&labels, &truths)?, labels.parts() as f64))
        }
        None => None,
    };
    Ok(Outcome { labels, people })
}

/// People's labels `MODEL_0.seg`, `MODEL_1.seg`, … as far as they go; numbers may be left out.
fn truths(folder: &Path, model: &str) -> Result<Vec<Vec<u32>>> {
    let paths = (0..100).map(|j| folder.join(format!("{model}_{j}.seg"))).filter(|path| path.exists());
    paths.map(|path| read_seg(&path)).collect()
}
