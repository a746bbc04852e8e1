//! The paper's Fig. 3: error of correspondence against mesh size, un-sampled and with farthest and random landmarks.
//!
//! `cargo run --release -p nystrom-stream-tools --bin figure3 -- SERIES [--base base.ply] [--out FOLDER]`, where SERIES holds a folder a mesh as
//! `tools/decimate_series.py` makes them. Every smaller mesh of a series is matched to the base; its vertices are vertices of
//! the base at the same position, so truth is known; the error is the distance along the base from the vertex found to the
//! true one over √area, averaged over all vertices. *Aligned* embeddings are brought together by the true matches, which leaves the
//! approximation alone to be judged; *automatic* ones as `correspond` does. Writes `figure3.json` and
//! `figure3.svg`, and prints the table. The un-sampled case takes a row a vertex: minutes a mesh of 8,000.

use clap::Parser;
use nystrom_stream::apps::correspond::align::{apply, procrustes};
use nystrom_stream::apps::correspond::{Alignment, EmbeddingSearch, Errors, Shape, Tensor, accuracy, align};
use nystrom_stream::base::{Error, Result};
use nystrom_stream::distance::DistanceRows;
use nystrom_stream::distance::march::Surface;
use nystrom_stream::distance::rows::RowParams;
use nystrom_stream::distance::vertex_rows::{self, Distance};
use nystrom_stream::graph::VertexGraph;
use nystrom_stream::landmarks::Sampling;
use nystrom_stream::mesh::{self, Mesh};
use nystrom_stream::spectral::Kernel;
use nystrom_stream::spectral::nystrom::{Eigenvectors, OrthogonalEmbedding, OrthogonalParams, Point};
use nystrom_stream::store::{Context, Run, WorkDir};
use plotters::prelude::{
    ChartBuilder, IntoDrawingArea, IntoLogRange, PathElement, RGBColor, SVGBackend, SeriesLabelPosition, WHITE,
};
use serde::Serialize;
use std::cell::OnceCell;
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[path = "figure3/full.rs"]
mod full;

/// Repeat the paper's Fig. 3.
#[derive(Clone, Parser)]
struct Options {
    /// Folder of series
    series: PathBuf,
    /// Name of the meshes that the smaller ones are matched to
    #[arg(long, default_value = "base.ply")]
    base: String,
    /// Where results go
    #[arg(long, default_value = ".")]
    out: PathBuf,
    /// Leave out the un-sampled case
    #[arg(long)]
    no_full: bool,
    /// Automatic alignment only, farthest landmarks by area only
    #[arg(long)]
    automatic: bool,
    /// Distances along edges instead of through triangles
    #[arg(long)]
    edges: bool,
    /// Eigenvectors
    #[arg(long, default_value_t = OrthogonalParams::default().dimensions)]
    vectors: usize,
    /// Seed
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

/// A way to embed.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Way {
    Full { by_area: bool },
    Landmarks { l: usize, sampling: Sampling, eigenvectors: Eigenvectors },
}

impl Way {
    fn name(self) -> String {
        match self {
            Self::Full { by_area: false } => "un-sampled".into(),
            Self::Full { by_area: true } => "un-sampled, by area".into(),
            Self::Landmarks { l, sampling, eigenvectors } => {
                let kind = if sampling == Sampling::Farthest { "farthest" } else { "random" };
                let eigenvectors = if eigenvectors == Eigenvectors::Plain { " plain" } else { "" };
                format!("{kind}{eigenvectors} {l}")
            }
        }
    }

    fn all(options: &Options) -> Vec<Self> {
        let mut ways = Vec::new();
        if !options.no_full && !options.automatic {
            ways.extend([Self::Full { by_area: false }, Self::Full { by_area: true }]);
        }
        for l in [10, 20, 50] {
            ways.push(Self::Landmarks { l, sampling: Sampling::Farthest, eigenvectors: Eigenvectors::Orthogonal });
        }
        if !options.automatic {
            for (l, sampling) in [10, 20, 50].into_iter().flat_map(|l| [(l, Sampling::Farthest), (l, Sampling::Random)])
            {
                ways.push(Self::Landmarks { l, sampling, eigenvectors: Eigenvectors::Plain });
            }
        }
        ways
    }
}

/// One matching.
#[derive(Clone, Debug, Serialize)]
struct Trial {
    mesh: String,
    vertices: usize,
    size: usize,
    way: String,
    alignment: &'static str,
    mean: f64,
    orientation: f64,
    ambiguous: bool,
    /// The error that alignment by truth leaves.
    aligned: f64,
}

/// A mesh of a series with its graph.
struct Member {
    opened: Mesh,
    graph: VertexGraph,
    work: WorkDir,
    /// All distances, once the un-sampled case asked for them.
    distances: OnceCell<Vec<f32>>,
}

/// An embedded mesh.
struct Embedded {
    points: Vec<Point>,
    variance: Vec<f64>,
    tensor: Tensor,
    rows: Option<DistanceRows>,
}

impl Member {
    fn open(path: &Path, run: &Run) -> Result<Self> {
        let work = WorkDir::temporary(&std::env::temp_dir())?;
        let opened = mesh::open(path, work.path(), run)?;
        let graph = VertexGraph::build(&opened, path, Context::new(&work, run))?;
        Ok(Self { opened, graph, work, distances: OnceCell::new() })
    }

    fn rows(&self, l: usize, sampling: Sampling, options: &Options, run: &Run) -> Result<DistanceRows> {
        let surface = Surface::of(&self.graph);
        let landmarks = vertex_rows::landmarks(surface, RowParams { l, sampling }, Context::new(&self.work, run))?;
        self.rows_from(landmarks, options, run)
    }

    fn rows_from(&self, landmarks: Vec<u32>, options: &Options, run: &Run) -> Result<DistanceRows> {
        let distance = if options.edges { Distance::Edges } else { Distance::March };
        vertex_rows::rows(Surface::of(&self.graph), landmarks, distance, "rows.npy", Context::new(&self.work, run))
    }

    fn embed(&self, way: Way, options: &Options, run: &Run) -> Result<Embedded> {
        let k = options.vectors;
        let (points, variance, rows) = match way {
            Way::Full { by_area } => {
                if self.distances.get().is_none() {
                    let rows = self.rows_from((0..self.graph.len() as u32).collect(), options, run)?;
                    let _ = self.distances.set(full::symmetric(&rows));
                }
                let distances = self.distances.get().map_or(&[][..], Vec::as_slice);
                let (points, variance) = full::embed(distances, &self.graph.nodes, by_area, k, run)?;
                (points, variance, None)
            }
            Way::Landmarks { l, sampling, eigenvectors } => {
                // Random landmarks are other vertices on every mesh.
                let seed = run.seed + self.graph.len() as u64;
                let run = Run { seed, budget: run.budget.clone(), cancel: run.cancel.clone(), ..*run };
                let rows = self.rows(l, sampling, options, &run)?;
                let params = OrthogonalParams { kernel: Kernel::Gaussian, width: 1., dimensions: k, eigenvectors };
                let fit = OrthogonalEmbedding::fit(&rows, &self.graph.nodes, params, &run)?;
                let points = fit.embed(&rows, fit.sigma, "embedding.npy", Context::new(&self.work, &run))?;
                (points.to_vec(), fit.variance, Some(rows))
            }
        };
        let tensor = Tensor::of(&self.opened, &points, variance.len(), run)?;
        Ok(Embedded { points, variance, tensor, rows })
    }
}

/// As alignment sees it.
fn shape<'a>(embedded: &'a Embedded, graph: &'a VertexGraph) -> Shape<'a> {
    Shape {
        points: &embedded.points,
        nodes: &graph.nodes,
        variance: &embedded.variance,
        tensor: &embedded.tensor,
        rows: embedded.rows.as_ref(),
        unit: 1. / graph.facts.area.sqrt(),
    }
}

/// The mean error of matching all vertices of `a` to `base` under `alignment`.
fn mean_error(
    a: &Embedded,
    b: &Embedded,
    base: &Member,
    alignment: &Alignment,
    truth: &[Option<u32>],
    run: &Run,
) -> Result<f64> {
    let k = alignment.transform.nrows();
    let nearest = EmbeddingSearch::new(&b.points, base.graph.csr(), k, Context::new(&base.work, run))?;
    let pairs: Vec<(u32, u32)> = truth
        .iter()
        .enumerate()
        .filter_map(|(v, real)| Some((nearest.nearest(&apply(&alignment.transform, &a.points[v])).vertex, (*real)?)))
        .collect();
    Ok(Errors::of(accuracy::distances(&base.graph, &pairs, run)?, 0).mean)
}

/// All trials of one series.
fn series(folder: &Path, options: &Options, run: &Run) -> Result<Vec<Trial>> {
    let base_path = folder.join(&options.base);
    let base = Member::open(&base_path, run)?;
    let bits = |p: [f64; 3]| p.map(f64::to_bits);
    let place: HashMap<[u64; 3], u32> =
        (0..base.graph.len() as u32).map(|v| (bits(base.opened.positions.get(v)), v)).collect();
    let mut paths: Vec<PathBuf> = std::fs::read_dir(folder)
        .map_err(Error::io(folder, "list"))?
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.extension().is_some_and(|end| end == "ply") && *path != base_path)
        .collect();
    paths.sort();
    let members = paths.iter().map(|path| Member::open(path, run)).collect::<Result<Vec<_>>>()?;
    let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let mut trials = Vec::new();
    for way in Way::all(options) {
        let whole = base.embed(way, options, run)?;
        for (path, member) in paths.iter().zip(&members) {
            let truth: Vec<Option<u32>> = (0..member.graph.len() as u32)
                .map(|v| place.get(&bits(member.opened.positions.get(v))).copied())
                .collect();
            let part = member.embed(way, options, run)?;
            let k = part.variance.len().min(whole.variance.len());
            let pairs = truth
                .iter()
                .enumerate()
                .filter_map(|(v, real)| Some((part.points[v], whole.points[(*real)? as usize])));
            let known = Alignment {
                transform: procrustes(pairs, k),
                cost: 0.,
                transport: None,
                distortion: None,
                orientation: 1.,
            };
            let aligned = mean_error(&part, &whole, &base, &known, &truth, run)?;
            let trial = Trial {
                mesh: name.clone(),
                vertices: member.graph.len(),
                size: path.file_stem().and_then(|stem| stem.to_str()?.parse().ok()).unwrap_or(0),
                way: way.name(),
                alignment: "truth",
                mean: aligned,
                orientation: 1.,
                ambiguous: false,
                aligned,
            };
            let by_area = matches!(
                way,
                Way::Full { by_area: true } | Way::Landmarks { eigenvectors: Eigenvectors::Orthogonal, .. }
            );
            if by_area {
                let found = align(shape(&part, &member.graph), shape(&whole, &base.graph), run)?;
                let mean = mean_error(&part, &whole, &base, &found.found[0], &truth, run)?;
                let orientation = found.found[0].orientation;
                let ambiguous = found.ambiguous;
                trials.push(Trial { alignment: "automatic", mean, orientation, ambiguous, ..trial.clone() });
            }
            trials.push(trial);
        }
        eprintln!("{name}: {}", way.name());
    }
    Ok(trials)
}

/// Mean over meshes by way and size, in the order of the ways.
fn means(trials: &[Trial], ways: &[Way], alignment: &str) -> Vec<(String, BTreeMap<usize, f64>)> {
    ways.iter()
        .map(|way| {
            let mut by_size: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
            for trial in trials.iter().filter(|trial| trial.way == way.name() && trial.alignment == alignment) {
                by_size.entry(trial.size).or_default().push(trial.mean);
            }
            let mean = |errors: Vec<f64>| errors.iter().sum::<f64>() / errors.len() as f64;
            (way.name(), by_size.into_iter().map(|(size, errors)| (size, mean(errors))).collect())
        })
        .filter(|(_, by_size): &(_, BTreeMap<_, _>)| !by_size.is_empty())
        .collect()
}

/// Prints a table and tells failures.
fn tell(trials: &[Trial], ways: &[Way]) {
    for alignment in ["truth", "automatic"] {
        let table = means(trials, ways, alignment);
        let sizes: Vec<usize> = table.first().map(|(_, row)| row.keys().copied().collect()).unwrap_or_default();
        println!(
            "\naligned by {alignment}\n| |{} mean | failures |",
            sizes.iter().map(|s| format!(" {s} |")).collect::<String>()
        );
        println!("| --- |{}", " --- |".repeat(sizes.len() + 2));
        for (name, row) in &table {
            let cells: String = row.values().map(|error| format!(" {error:.4} |")).collect();
            let mine = || trials.iter().filter(|t| t.way == *name && t.alignment == alignment);
            let mean = mine().map(|t| t.mean).sum::<f64>() / mine().count().max(1) as f64;
            // Mapped elsewhere, not merely inexactly.
            let failed = mine().filter(|t| t.mean > (2. * t.aligned).max(t.aligned + 0.05)).count();
            let known = mine().filter(|t| t.mean > (2. * t.aligned).max(t.aligned + 0.05) && t.ambiguous).count();
            println!(
                "| {name} |{cells} {mean:.4} | {failed} of {}, {known} of them said to be ambiguous |",
                mine().count()
            );
        }
    }
}

/// Draws error against size.
fn draw(trials: &[Trial], ways: &[Way], path: &Path) -> std::result::Result<(), Box<dyn std::error::Error>> {
    const COLOURS: [RGBColor; 11] = [
        RGBColor(0, 0, 0),
        RGBColor(120, 120, 120),
        RGBColor(86, 180, 233),
        RGBColor(0, 114, 178),
        RGBColor(0, 50, 110),
        RGBColor(230, 159, 0),
        RGBColor(213, 94, 0),
        RGBColor(0, 158, 115),
        RGBColor(204, 121, 167),
        RGBColor(11, 79, 44),
        RGBColor(136, 34, 85),
    ];
    let table = means(trials, ways, "truth");
    let most = table.iter().flat_map(|(_, row)| row.values()).fold(0.01f64, |a, &b| a.max(b));
    let area = SVGBackend::new(path, (900, 520)).into_drawing_area();
    area.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&area)
        .margin(12)
        .x_label_area_size(40)
        .y_label_area_size(60)
        .build_cartesian_2d((230f64..4300.).log_scale(), 0f64..1.05 * most)?;
    chart
        .configure_mesh()
        .x_desc("vertices of the decimated mesh")
        .y_desc("mean error over √area")
        .x_label_formatter(&|x| format!("{x:.0}"))
        .draw()?;
    for ((name, row), colour) in table.iter().zip(COLOURS) {
        let line = row.iter().map(|(&size, &error)| (size as f64, error));
        chart
            .draw_series(std::iter::once(PathElement::new(line.collect::<Vec<_>>(), colour)))?
            .label(name)
            .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 18, y)], colour));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .border_style(RGBColor(200, 200, 200))
        .draw()?;
    area.present()?;
    Ok(())
}

fn run(options: &Options) -> Result<()> {
    let run = Run { seed: options.seed, ..Run::new(&()) };
    let folder = &options.series;
    let mut folders: Vec<PathBuf> = std::fs::read_dir(folder)
        .map_err(Error::io(folder, "list"))?
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.join(&options.base).is_file())
        .collect();
    folders.sort();
    let mut trials = Vec::new();
    for folder in &folders {
        trials.extend(series(folder, options, &run)?);
    }
    let ways = Way::all(options);
    tell(&trials, &ways);
    let path = options.out.join("figure3.json");
    let text = serde_json::to_string_pretty(&trials).unwrap_or_default();
    std::fs::write(&path, text + "\n").map_err(Error::io(&path, "write"))?;
    let path = options.out.join("figure3.svg");
    draw(&trials, &ways, &path).map_err(|error| Error::unusable(&path, error.to_string(), "check the folder"))
}

fn main() -> ExitCode {
    match run(&Options::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("figure3: {error}");
            ExitCode::FAILURE
        }
    }
}
