//! `quality` and `study`: the quality of samples, by the paper's Γ and by other measures, on meshes and on random
//! points.

use super::choices::{choice, name_of};
use super::input::{check_there, open_file};
use super::method::MetricArgs;
use super::options::{AppContext, CliError, RunArgs, ScratchArgs, misfit};
use super::output::{JsonArgs, check_charts};
use super::sink::{Sink, check_places};
use nystrom_stream::apps::plots::charts;
use nystrom_stream::apps::study::compare::{EmbeddingError, embedding_errors};
use nystrom_stream::apps::study::points::{PointsParams, SampleMeasures, agreement, pairs};
use nystrom_stream::apps::study::summary::{Spread, one_to_text, summary, to_csv, to_text};
use nystrom_stream::apps::study::{CompareParams, Over, SampleRecord, StudyData, StudyParams, StudyWidth, compare};
use nystrom_stream::base::printable::{Significant, counted};
use nystrom_stream::base::{Error, Result};
use nystrom_stream::landmarks::{Sampler, Sampling};
use nystrom_stream::pipeline::input;
use nystrom_stream::spectral::Kernel;
use nystrom_stream::store::{Context, Run};
use serde_json::json;
use std::fmt::Write;
use std::path::PathBuf;

/// Maximum number of faces for `--exact`, which stores all distances.
const MOST: usize = 5000;

/// Default number of seeds to compare.
const SEEDS: u32 = 5;

/// Arguments of `quality`.
#[derive(Clone, Debug, clap::Args)]
pub struct QualityArgs {
    /// PLY, OBJ, OFF or STL files, also .gz; several with --compare or --embedding
    #[arg(required = true, value_name = "MESH")]
    pub meshes: Vec<PathBuf>,
    /// Numbers of landmarks, separated by commas
    #[arg(short = 'l', long, value_name = "L", value_delimiter = ',', default_value = "10",
          value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub landmarks: Vec<u32>,
    /// How landmarks are chosen, separated by commas [default: farthest; with --compare
    /// uniform,cholesky,farthest,greedy]
    #[arg(long, value_parser = choice::<Sampling>(), value_delimiter = ',')]
    pub sampling: Vec<Sampling>,
    /// Compare samplings, numbers of landmarks and seeds under one σ
    #[arg(long)]
    pub compare: bool,
    /// Number of seeds, starting at --seed, with --compare [default: 5]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub seeds: Option<u32>,
    /// Measure instead how far extrapolated embeddings in six coordinates are from the exact one, for up to 5,000 faces
    #[arg(long, conflicts_with = "compare")]
    pub embedding: bool,
    /// Kernel from distance to affinity
    #[arg(long, value_parser = choice::<Kernel>(), default_value = "exponential")]
    pub kernel: Kernel,
    /// Width of the kernel, in mean distances
    #[arg(long, value_name = "X", default_value_t = 1.)]
    pub sigma: f64,
    /// Local widths instead: distances to the Q-th nearest landmark
    #[arg(long, value_name = "Q", conflicts_with_all = ["sigma", "exact", "embedding"],
          value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub local: Option<u32>,
    /// Drop eigenvalues of A up to this fraction of the greatest [default: 0.001 with the exponential kernel, else
    /// 0.1/l, from 0.001 to 0.01]
    #[arg(long, value_name = "T", conflicts_with = "embedding")]
    pub tolerance: Option<f64>,
    /// Kernel of pivoted Cholesky and of the Γ that greedy sampling maximises [default: exponential]
    #[arg(long, value_parser = choice::<Kernel>(), value_name = "KERNEL")]
    pub gamma_kernel: Option<Kernel>,
    /// Compute all distances too, for up to 5,000 faces: the exact residual, and for one run the norms of the Schur
    /// complement and the principal angles to the exact eigenvectors, in time cubic in the number of faces
    #[arg(long, conflicts_with = "embedding")]
    pub exact: bool,
    /// What is sampled
    #[arg(long, value_parser = choice::<Over>(), default_value = "faces")]
    pub nodes: Over,
    #[command(flatten)]
    pub metric: MetricArgs,
    #[command(flatten)]
    pub json: JsonArgs,
    /// Write one line per run as comma-separated values
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,
    /// Draw the comparison, .svg or .png; repeatable
    #[arg(long, value_name = "FILE")]
    pub plot: Vec<PathBuf>,
    #[command(flatten)]
    pub run: RunArgs,
    #[command(flatten)]
    pub scratch: ScratchArgs,
}

/// The checked parameters.
fn params(args: &QualityArgs) -> Result<CompareParams, CliError> {
    check_charts("--plot", &args.plot)?;
    if !args.plot.is_empty() && !args.compare {
        return Err(CliError::Usage("--plot requires --compare: it draws a comparison".into()));
    }
    if args.csv.is_some() && args.embedding {
        return Err(CliError::Usage("--csv cannot be used with --embedding: it has one line per sample".into()));
    }
    if args.seeds.is_some() && !args.compare {
        return Err(misfit("--seeds", "--compare"));
    }
    if let Some(option) = args.metric.given().filter(|_| args.nodes == Over::Vertices) {
        return Err(misfit(option, "--nodes faces"));
    }
    if !(args.sigma > 0. && args.sigma < 1e6) {
        let problem = format!("--sigma: {} is not a width", Significant(args.sigma));
        return Err(CliError::Usage(problem + "; choose a positive number below 1000000"));
    }
    if args.tolerance.is_some_and(|tolerance| !(0. ..1.).contains(&tolerance)) {
        return Err(CliError::Usage("--tolerance is out of range; choose from 0 to below 1".into()));
    }
    let samplings: Vec<Sampling> = match (&args.sampling[..], args.compare) {
        ([], true) => vec![Sampling::Uniform, Sampling::Cholesky, Sampling::Farthest, Sampling::Greedy],
        ([], false) => vec![Sampling::Farthest],
        (given, _) => given.to_vec(),
    };
    let by_kernel = [Sampling::Cholesky, Sampling::Greedy, Sampling::PooledGreedy];
    if args.gamma_kernel.is_some() && !samplings.iter().any(|sampling| by_kernel.contains(sampling)) {
        return Err(misfit("--gamma-kernel", "--sampling cholesky, greedy or pooled-greedy"));
    }
    let several = samplings.len() > 1 || args.landmarks.len() > 1 || args.meshes.len() > 1;
    if several && !args.compare && !(args.embedding && samplings.len() == 1) {
        return Err(CliError::Usage("several meshes, samplings or numbers of landmarks require --compare".into()));
    }
    let mut landmarks: Vec<usize> = args.landmarks.iter().map(|&l| l as usize).collect();
    landmarks.sort_unstable();
    landmarks.dedup();
    let seeds = if args.compare { u64::from(args.seeds.unwrap_or(SEEDS)) } else { 1 };
    Ok(CompareParams::default()
        .samplings(samplings)
        .landmarks(landmarks)
        .seeds((0..seeds).map(|k| args.run.seed.unwrap_or(0).wrapping_add(k)).collect())
        .kernel(args.kernel)
        .width(args.local.map_or(StudyWidth::Mean(args.sigma), |q| StudyWidth::Local(q as usize)))
        .tolerance(args.tolerance)
        .gamma_kernel(args.gamma_kernel.unwrap_or(Kernel::Exponential))
        .residual(args.exact)
        .schur(args.exact && !args.compare))
}

/// The names of `meshes` in records: their file names without extension, or their paths if several have the same name,
/// since samples of the same mesh are compared with each other.
fn names(meshes: &[PathBuf]) -> Vec<String> {
    let stem = |path: &PathBuf| path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let is_shared = |name: &String| meshes.iter().filter(|other| stem(other) == *name).count() > 1;
    let path = |path: &PathBuf| path.to_string_lossy().into_owned();
    meshes.iter().map(|mesh| Some(stem(mesh)).filter(|name| !is_shared(name)).unwrap_or_else(|| path(mesh))).collect()
}

/// Runs `quality`.
pub fn quality(args: &QualityArgs, app: &AppContext) -> Result<(), CliError> {
    let params = params(args)?;
    params.check()?;
    check_places(&args.meshes, None, args.plot.iter().chain(&args.csv).chain(&args.json.json))?;
    args.meshes.iter().try_for_each(|path| check_there(path))?;
    let bars = args.run.bars();
    let run = args.run.run(&bars, app);
    let grounds = StudyParams::default()
        .over(args.nodes)
        .metric(args.metric.metric()?)
        .matrix(if args.exact || args.compare || args.embedding { MOST } else { 0 })
        .lengths(params.samplings.iter().any(|sampling| sampling.needs_lengths()));
    let (mut records, mut errors) = (Vec::new(), Vec::new());
    for (path, name) in args.meshes.iter().zip(names(&args.meshes)) {
        let work = args.scratch.work(None, std::env::temp_dir, &run)?;
        let opened = open_file(path, work.path(), &run)?;
        let ground = StudyData::of(&opened, &input::identity(path)?, grounds, Context::new(&work, &run))?;
        let all_distances = [(args.exact, "--exact"), (args.embedding, "--embedding")];
        if let Some((_, option)) = all_distances.iter().find(|(given, _)| *given && ground.matrix.is_none()) {
            let problem = format!("has {} nodes, too many for {option}", ground.len());
            return Err(Error::unusable(path, problem, format!("decimate it to 5,000, or leave out {option}")).into());
        }
        if args.embedding {
            let (sampling, seed) = (params.samplings[0], params.seeds[0]);
            errors.push(embedding_errors(&ground, &params, sampling, seed, &run)?);
        } else {
            records.extend(compare(&ground, &name, &params, Context::new(&work, &run))?);
        }
    }
    if args.embedding {
        return Ok(tell_errors(&errors, args)?);
    }
    tell(&records, args, &run)?;
    Ok(())
}

/// Prints, writes and draws the results.
fn tell(records: &[SampleRecord], args: &QualityArgs, run: &Run) -> Result<()> {
    let lines = summary(records);
    let text = match records {
        [record] if !args.compare => one_to_text(record),
        _ => to_text(&lines),
    };
    let json = if args.compare { json!({"summary": lines, "runs": records}) } else { json!(records.first()) };
    if let Some(path) = &args.csv {
        Sink::of(path).write(&to_csv(records))?;
    }
    let meshes = counted(args.meshes.len(), "mesh");
    let seeds = counted(args.seeds.unwrap_or(SEEDS) as usize, "seed");
    let title = format!("{meshes}, {seeds}, {} kernel", name_of(args.kernel));
    for path in &args.plot {
        run.cancel.check()?;
        charts::comparison(path, &lines, &title)?;
    }
    args.json.publish_or_print(&json, &text)
}

/// Prints the errors of embeddings, averaged over meshes.
fn tell_errors(errors: &[Vec<EmbeddingError>], args: &QualityArgs) -> Result<()> {
    let mut text = format!("{:>5} {:>16} {:>16} {:>16} {:>9}\n", "l", "plain", "orthogonalised", "by area", "negative");
    let sizes = errors.first().map_or(0, Vec::len);
    for k in 0..sizes {
        let spread = |value: fn(&EmbeddingError) -> f64| {
            let all: Vec<f64> = errors.iter().map(|mesh| value(&mesh[k])).collect();
            Spread::of(&all).unwrap_or_default()
        };
        // Fewer if a mesh has fewer nodes.
        let numbers = || errors.iter().map(|mesh| mesh[k].l);
        let l = match (numbers().min(), numbers().max()) {
            (Some(least), Some(most)) if least < most => format!("{least}-{most}"),
            (_, most) => most.unwrap_or(0).to_string(),
        };
        let shown = |spread: Spread| format!("{:.4} ± {:.4}", spread.mean, spread.deviation);
        text += &format!(
            "{l:>5} {:>16} {:>16} {:>16} {:>7.0} %\n",
            shown(spread(|e| e.plain)),
            shown(spread(|e| e.orthogonal)),
            shown(spread(|e| e.by_area)),
            100. * spread(|e| e.negative_share).mean
        );
    }
    args.json.publish_or_print(&json!(errors), &text)
}

/// Arguments of `study`.
#[derive(Clone, Debug, clap::Args)]
pub struct StudyArgs {
    /// Points per run
    #[arg(long, value_name = "N", default_value_t = 500, value_parser = clap::value_parser!(u32).range(2..=2000))]
    pub points: u32,
    /// Number of landmarks among them
    #[arg(short = 'l', long, value_name = "L", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub landmarks: u32,
    /// Runs per seed, two samples each
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub runs: u32,
    /// Number of seeds, starting at --seed
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub seeds: u32,
    #[command(flatten)]
    pub json: JsonArgs,
    /// Draw the markers of the first seed with their quadrants, .svg or .png; repeatable
    #[arg(long, value_name = "FILE")]
    pub plot: Vec<PathBuf>,
    #[command(flatten)]
    pub run: RunArgs,
}

/// Runs `study`.
pub fn study(args: &StudyArgs, app: &AppContext) -> Result<(), CliError> {
    check_charts("--plot", &args.plot)?;
    // Of all points there is only one sample.
    if args.landmarks >= args.points {
        return Err(CliError::Usage(format!(
            "-l: {} landmarks for {} points; choose fewer",
            args.landmarks, args.points
        )));
    }
    check_places([], None, args.plot.iter().chain(&args.json.json))?;
    let bars = args.run.bars();
    let run = args.run.run(&bars, app);
    let params = PointsParams::default()
        .points(args.points as usize)
        .landmarks(args.landmarks as usize)
        .runs(args.runs as usize);
    type Norm = (&'static str, fn(&SampleMeasures) -> f64);
    let norms: [Norm; 3] = [("frobenius", |s| s.frobenius), ("spectral", |s| s.spectral), ("nuclear", |s| s.nuclear)];
    let mut text = String::from("agreement with Γ, per cent, by norm of the Schur complement\n");
    let _ = writeln!(text, "{:>6} {:>10} {:>10} {:>10}", "seed", norms[0].0, norms[1].0, norms[2].0);
    let (mut all, mut sums) = (Vec::new(), [0.; 3]);
    for k in 0..u64::from(args.seeds) {
        let seed = args.run.seed.unwrap_or(0).wrapping_add(k);
        let (pairs, _) = run.stage("runs", "runs", u64::from(args.runs), || pairs(params, seed, &run))?;
        let shares = norms.map(|(_, norm)| 100. * agreement(&pairs, norm));
        let _ = writeln!(text, "{seed:>6} {:>10.1} {:>10.1} {:>10.1}", shares[0], shares[1], shares[2]);
        (0..3).for_each(|i| sums[i] += shares[i] / f64::from(args.seeds));
        if k == 0 {
            let title = format!("{:.0} % in the first and third quadrants", shares[0]);
            args.plot.iter().try_for_each(|path| charts::scatter(path, &pairs, &title))?;
        }
        all.push(
            json!({"seed": seed, "agreement": {"frobenius": shares[0], "spectral": shares[1], "nuclear": shares[2]},
                        "runs": pairs}),
        );
    }
    let _ = writeln!(text, "{:>6} {:>10.1} {:>10.1} {:>10.1}", "mean", sums[0], sums[1], sums[2]);
    Ok(args.json.publish_or_print(&json!(all), &text)?)
}
