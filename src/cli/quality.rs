//! `quality`: how good a sample is, by the paper's measure and by others; or many samples side by side.

use super::method::{KernelArg, SamplingArg};
use super::metric::MetricArgs;
use super::options::RunArgs;
use super::{AppContext, Failure};
use clap::ValueEnum;
use nystrom_stream::apps::plots::charts;
use nystrom_stream::apps::study::compare::{EmbeddingError, embedding_errors};
use nystrom_stream::apps::study::summary::{Spread, one_to_text, summary, to_csv, to_text};
use nystrom_stream::apps::study::{CompareParams, Over, SampleRecord, StudyData, StudyParams, compare};
use nystrom_stream::base::{Error, Result};
use nystrom_stream::landmarks::Sampling;
use nystrom_stream::mesh;
use nystrom_stream::pipeline::input;
use nystrom_stream::store::Context;
use nystrom_stream::store::Run;
use serde_json::json;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Faces up to which `--exact` holds all distances.
const MOST: usize = 5000;

#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// PLY files (.ply, .ply.gz); several with --compare or --embedding
    #[arg(required = true, value_name = "MESH")]
    pub meshes: Vec<PathBuf>,
    /// Numbers of landmarks, separated by commas
    #[arg(short = 'l', long, value_name = "L", value_delimiter = ',', default_value = "10",
          value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub landmarks: Vec<u32>,
    /// How landmarks are chosen, separated by commas [default: farthest; with --compare uniform,cholesky,farthest,greedy]
    #[arg(long, value_enum, value_delimiter = ',')]
    pub sampling: Vec<SamplingArg>,
    /// Compare samplings, numbers of landmarks and seeds under one σ
    #[arg(long)]
    pub compare: bool,
    /// Number of seeds, from --seed on (with --compare)
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub seeds: u32,
    /// Tell how far extrapolated embeddings of six coordinates are from the true one, up to 5,000 faces
    #[arg(long, conflicts_with = "compare")]
    pub embedding: bool,
    /// From distance to affinity
    #[arg(long, value_enum, default_value = "exponential")]
    pub kernel: KernelArg,
    /// The kernel's width in mean distances
    #[arg(long, value_name = "X", default_value_t = 1.)]
    pub sigma: f64,
    /// Local widths instead: distances to the Q-th nearest landmark
    #[arg(long, value_name = "Q", conflicts_with_all = ["sigma", "exact", "embedding"],
          value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub local: Option<u32>,
    /// Drop eigenvalues of A up to this share of the greatest [default: 0.001 exponential, else 0.1/l within 0.001 and 0.01]
    #[arg(long, value_name = "T", conflicts_with = "embedding")]
    pub tolerance: Option<f64>,
    /// The kernel of the Γ that greedy sampling goes by, and of pivoted Cholesky
    #[arg(long, value_enum, value_name = "KERNEL", default_value = "exponential")]
    pub gamma_kernel: KernelArg,
    /// Compute all distances too, up to 5,000 faces: the whole residual, and for one run the Schur complement's norms and
    /// principal angles to the true eigenvectors, in time cubic in the faces
    #[arg(long)]
    pub exact: bool,
    /// What is sampled: faces, by the metric, or vertices, by distances through triangles
    #[arg(long, value_enum, default_value = "faces")]
    pub nodes: NodesArg,
    #[command(flatten)]
    pub metric: MetricArgs,
    /// Write everything as JSON; `-` for standard output, instead of the table
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Write every run as comma-separated values
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,
    /// Draw the comparison, .svg or .png, once or more
    #[arg(long, value_name = "FILE", requires = "compare")]
    pub plot: Vec<PathBuf>,
    #[command(flatten)]
    pub run: RunArgs,
}

/// What nodes are.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum NodesArg {
    /// Faces, by the metric
    Faces,
    /// Vertices, by distances through triangles
    Vertices,
}

/// Refuses charts of unknown form before any work.
pub fn check_plots(option: &str, paths: &[PathBuf]) -> Result<(), Failure> {
    let charted =
        |path: &Path| path.extension().is_some_and(|end| ["svg", "png"].iter().any(|e| end.eq_ignore_ascii_case(e)));
    match paths.iter().find(|path| !charted(path)) {
        Some(path) => Err(Failure::Misused(format!("{option} {}: no chart; end it with .svg or .png", path.display()))),
        None => Ok(()),
    }
}

/// Writes `text` and `json` where they are to go.
pub fn publish(text: &str, json: &serde_json::Value, to: Option<&Path>) -> Result<()> {
    let pretty = serde_json::to_string_pretty(json).unwrap_or_default() + "\n";
    let to_stdout = to == Some(Path::new("-"));
    let _ = std::io::stdout().write_all(if to_stdout { pretty.as_bytes() } else { text.as_bytes() });
    match to.filter(|_| !to_stdout) {
        Some(path) => std::fs::write(path, pretty).map_err(Error::io(path, "write")),
        None => Ok(()),
    }
}

/// What is asked for, checked.
fn params(args: &Args) -> Result<CompareParams, Failure> {
    check_plots("--plot", &args.plot)?;
    if !(args.sigma > 0. && args.sigma < 1e6) {
        return Err(Failure::Misused(format!("--sigma: {} is no width; choose a positive number", args.sigma)));
    }
    if args.tolerance.is_some_and(|tolerance| !(0. ..1.).contains(&tolerance)) {
        return Err(Failure::Misused("--tolerance is out of range; choose from 0 to below 1".into()));
    }
    let samplings: Vec<Sampling> = match (&args.sampling[..], args.compare) {
        ([], true) => vec![Sampling::Uniform, Sampling::Cholesky, Sampling::Farthest, Sampling::Greedy],
        ([], false) => vec![Sampling::Farthest],
        (given, _) => given.iter().map(|sampling| sampling.sampling()).collect(),
    };
    let several = samplings.len() > 1 || args.landmarks.len() > 1 || args.meshes.len() > 1;
    if several && !args.compare && !(args.embedding && samplings.len() == 1) {
        return Err(Failure::Misused("several meshes, samplings or numbers of landmarks go with --compare".into()));
    }
    let mut landmarks: Vec<usize> = args.landmarks.iter().map(|&l| l as usize).collect();
    landmarks.sort_unstable();
    landmarks.dedup();
    let seeds = if args.compare { u64::from(args.seeds) } else { 1 };
    Ok(CompareParams::default()
        .samplings(samplings)
        .landmarks(landmarks)
        .seeds((0..seeds).map(|k| args.run.seed.unwrap_or(0).wrapping_add(k)).collect())
        .kernel(args.kernel.kernel())
        .width(args.local.map_or(args.sigma, f64::from))
        .local(args.local.is_some())
        .tolerance(args.tolerance)
        .gamma_kernel(args.gamma_kernel.kernel())
        .residual(args.exact)
        .schur(args.exact && !args.compare))
}

pub fn run(args: &Args, app: &AppContext) -> Result<(), Failure> {
    let params = params(args)?;
    let bars = args.run.bars();
    let run = args.run.run(&bars, app);
    let grounds = StudyParams::default()
        .over(match args.nodes {
            NodesArg::Faces => Over::Faces,
            NodesArg::Vertices => Over::Vertices,
        })
        .metric(args.metric.metric()?)
        .matrix(if args.exact || args.compare || args.embedding { MOST } else { 0 })
        .lengths(params.samplings.iter().any(|sampling| sampling.needs_lengths()));
    let (mut records, mut errors) = (Vec::new(), Vec::new());
    for path in &args.meshes {
        let work = args.run.work(None, std::env::temp_dir, &run)?;
        let (opened, _) = run.stage("read", "bytes", 0, || mesh::open(path, work.path(), &run))?;
        let ground = StudyData::of(&opened, &input::identity(path)?, grounds, Context::new(&work, &run))?;
        if args.exact && ground.matrix.is_none() {
            let problem = format!("has {} nodes, too many for --exact", ground.len());
            return Err(Error::unusable(path, problem, "decimate it to 5,000, or leave out --exact").into());
        }
        if args.embedding {
            let (sampling, seed) = (params.samplings[0], params.seeds[0]);
            errors.push(embedding_errors(&ground, &params, sampling, seed, 6, &run)?);
        } else {
            let name = path.file_stem().unwrap_or_default().to_string_lossy();
            records.extend(compare(&ground, &name, &params, Context::new(&work, &run))?);
        }
    }
    if args.embedding {
        return Ok(tell_errors(&errors, args)?);
    }
    tell(&records, args, &run)?;
    Ok(())
}

/// Prints, writes and draws.
fn tell(records: &[SampleRecord], args: &Args, run: &Run) -> Result<()> {
    let lines = summary(records);
    let text = match records {
        [record] if !args.compare => one_to_text(record),
        _ => to_text(&lines),
    };
    let json = if args.compare { json!({"summary": lines, "runs": records}) } else { json!(records.first()) };
    if let Some(path) = &args.csv {
        std::fs::write(path, to_csv(records)).map_err(Error::io(path, "write"))?;
    }
    let title = format!("{} meshes, {} seeds, {:?} kernel", args.meshes.len(), args.seeds, args.kernel);
    for path in &args.plot {
        run.cancel.check()?;
        charts::comparison(path, &lines, &title)?;
    }
    publish(&text, &json, args.json.as_deref())
}

/// Prints the errors of embeddings, means over meshes.
fn tell_errors(errors: &[Vec<EmbeddingError>], args: &Args) -> Result<()> {
    let mut text = format!("{:>5} {:>16} {:>16} {:>16} {:>9}\n", "l", "plain", "orthogonalised", "by area", "negative");
    let sizes = errors.first().map_or(0, Vec::len);
    for k in 0..sizes {
        let spread = |value: fn(&EmbeddingError) -> f64| {
            let all: Vec<f64> = errors.iter().map(|mesh| value(&mesh[k])).collect();
            Spread::of(&all).unwrap_or_default()
        };
        let shown = |spread: Spread| format!("{:.4} ± {:.4}", spread.mean, spread.deviation);
        text += &format!(
            "{:>5} {:>16} {:>16} {:>16} {:>7.0} %\n",
            errors[0][k].l,
            shown(spread(|e| e.plain)),
            shown(spread(|e| e.orthogonal)),
            shown(spread(|e| e.by_area)),
            100. * spread(|e| e.negative).mean
        );
    }
    publish(&text, &json!(errors), args.json.as_deref())
}
