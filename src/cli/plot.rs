//! `plot`: charts of a run's results, from its work directory, its report, or a hierarchy of parts.

use super::options::{CliError, either};
use super::output::check_charts;
use super::sink::check_places;
use nystrom_stream::apps::colours;
use nystrom_stream::apps::plots::{Dendrogram, Spectrum, TreePlot};
use nystrom_stream::base::printable::counted;
use nystrom_stream::base::{Error, Result};
use nystrom_stream::cluster::parts::{PartCount, PartTree, PartsParams, TreeCut, detail_threshold};
use nystrom_stream::pipeline::decision::{read_tree, tree_of};
use nystrom_stream::pipeline::input::Record;
use nystrom_stream::pipeline::labels::{self, Labels};
use nystrom_stream::pipeline::recipe::{self, Eigenvalues};
use nystrom_stream::store::WorkDir;
use nystrom_stream::store::json::read_small;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Arguments of `plot`.
#[derive(Clone, Debug, clap::Args)]
pub struct PlotArgs {
    /// A work directory, a hierarchy of parts (.json), or, for eigenvalues, a report (.json)
    #[arg(value_name = "DIR|FILE", required_unless_present = "work_dir", conflicts_with = "work_dir")]
    pub from: Option<PathBuf>,
    /// The work directory
    #[arg(long, value_name = "DIR")]
    pub work_dir: Option<PathBuf>,
    /// Draw the eigenvalues, .svg or .png; repeatable
    #[arg(long, value_name = "FILE")]
    pub eigenvalues: Vec<PathBuf>,
    /// Draw the hierarchy of parts and its cut, .svg or .png; repeatable
    #[arg(long, value_name = "FILE")]
    pub tree: Vec<PathBuf>,
    /// Number of parts of the cut [default: as in the work directory, or automatic]
    #[arg(short = 'k', long = "parts", value_name = "K", value_parser = clap::value_parser!(u32).range(1..), requires = "tree")]
    pub parts: Option<u32>,
    /// Cut coarser (to -1) or finer (to 1) than the parts found
    #[arg(long, value_name = "D", allow_hyphen_values = true, conflicts_with = "parts", requires = "tree",
          value_parser = parse_detail)]
    pub detail: Option<f64>,
}

fn parse_detail(text: &str) -> Result<f64, String> {
    let detail: f64 = text.parse().map_err(|_| format!("{text:?} is not a number"))?;
    if (-1. ..=1.).contains(&detail) { Ok(detail) } else { Err("choose from -1 to 1".into()) }
}

/// The data to draw.
struct Found {
    name: String,
    eigenvalues: Result<Eigenvalues>,
    tree: Result<PartTree>,
    /// The existing cut, and its colours.
    made: Option<(PartsParams, Vec<[u8; 3]>)>,
}

impl Found {
    fn in_work_dir(path: &Path) -> Result<Self> {
        let work = WorkDir::open_existing(path)?;
        let record = Record::read(&work)?;
        let made = match (recipe::requested_parts(&work), Labels::read(&work)) {
            // Corrections renumber parts.
            (Some(params), Ok(labels)) if !labels.corrected => Some((params, labels.colours())),
            _ => None,
        };
        let exact = labels::method(&work).unwrap_or(record.params).exact_rows();
        let name = record.mesh.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let eigenvalues = recipe::eigenvalues(&work, exact).map_err(|error| match error {
            Error::WorkDir { path, problem, remedy } => {
                Error::work_dir(path, problem, remedy + ", or plot the report of `segment --json`")
            }
            error => error,
        });
        Ok(Self { name, eigenvalues, tree: tree_of(&work, exact), made })
    }

    fn in_file(path: &Path) -> Result<Self> {
        let text = read_small(path)?;
        let wrong = |problem: &str| {
            let remedy = "give a work directory, a hierarchy of `export --tree`, or for eigenvalues a report of `segment --json`";
            Error::unusable(path, problem, remedy)
        };
        let value: Value = serde_json::from_slice(&text).map_err(|_| wrong("is neither a folder nor JSON"))?;
        let numbers = |name: &str| value[name].as_array()?.iter().map(Value::as_f64).collect::<Option<Vec<_>>>();
        let eigenvalues = numbers("eigenvalues").filter(|values| !values.is_empty()).map(|values| {
            let dropped = value["dropped_eigenpairs"].as_u64().unwrap_or(0);
            Eigenvalues { dropped: (dropped as usize).min(values.len()), values }
        });
        let tree = if value.get("unions").is_some() { read_tree(path) } else { Err(wrong("holds no hierarchy")) };
        if eigenvalues.is_none() && value.get("unions").is_none() {
            return Err(wrong("has neither eigenvalues nor a hierarchy of parts"));
        }
        let input = value["input"]["path"].as_str().map_or(path, Path::new);
        let name = input.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Ok(Self { name, eigenvalues: eigenvalues.ok_or_else(|| wrong("holds no eigenvalues")), tree, made: None })
    }
}

/// Colours of the parts of a cut, different for adjacent parts.
fn colours_of(tree: &PartTree, cut: &TreeCut) -> Vec<[u8; 3]> {
    let of = |cell: u32| cut.label[cell as usize];
    let touching = tree.pairs.iter().zip(&tree.length).filter(|(pair, _)| of(pair[0]) != of(pair[1]));
    let touching: Vec<(u32, u32, f64)> = touching.map(|(&[a, b], &length)| (of(a), of(b), f64::from(length))).collect();
    colours::assign(cut.parts, &touching)
}

/// Runs `plot`.
pub fn run(args: &PlotArgs) -> Result<(), CliError> {
    if args.eigenvalues.is_empty() && args.tree.is_empty() {
        return Err(CliError::Usage("plot: nothing to draw; give --eigenvalues FILE, --tree FILE, or both".into()));
    }
    check_charts("--eigenvalues", &args.eigenvalues)?;
    check_charts("--tree", &args.tree)?;
    let from = either(&args.from, &args.work_dir);
    let in_folder = args.work_dir.is_some() || from.is_dir();
    check_places(&args.from, in_folder.then_some(from), args.eigenvalues.iter().chain(&args.tree))?;
    let found = if in_folder { Found::in_work_dir(from) } else { Found::in_file(from) }?;
    if !args.eigenvalues.is_empty() {
        let Eigenvalues { values, dropped } = &found.eigenvalues?;
        let title = format!("{}: eigenvalues of the landmarks' affinities, greatest = 1", found.name);
        let spectrum = Spectrum { title: &title, values, dropped: *dropped };
        args.eigenvalues.iter().try_for_each(|path| spectrum.plot(path))?;
    }
    if !args.tree.is_empty() {
        let tree = found.tree?;
        let (params, known) = match (args.parts, args.detail, found.made) {
            (Some(k), ..) => (PartsParams { count: PartCount::Exactly(k as usize), ..PartsParams::default() }, None),
            (_, Some(detail), _) => (PartsParams { detail, ..PartsParams::default() }, None),
            (_, _, Some((params, colours))) => (params, Some(colours)),
            _ => (PartsParams::default(), None),
        };
        // A mesh may be cut into more parts than its hierarchy has cells.
        let count = if args.parts.is_some() { params.count } else { params.count.at_most(tree.cells()) };
        let cut = tree.cut_for(count, params.detail)?;
        // Colours of labels from another hierarchy belong to other parts.
        let known = known.filter(|colours| colours.len() >= cut.parts);
        let colours = known.unwrap_or_else(|| colours_of(&tree, &cut));
        let threshold = detail_threshold(params.detail);
        let threshold = (params.count == PartCount::Found).then_some(threshold);
        let how = threshold.map_or("as requested".to_string(), |level| format!("cut at {level:.2}, dashed"));
        let title = format!("{}: {}, {how}", found.name, counted(cut.parts, "part"));
        let plot = Dendrogram::of(&tree, &cut);
        let plot = TreePlot { title: &title, plot: &plot, colours: &colours, threshold };
        args.tree.iter().try_for_each(|path| plot.plot(path))?;
    }
    Ok(())
}
