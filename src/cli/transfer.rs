//! `transfer-labels`: transfers labels to another mesh of the same shape.

use super::errors::of_file;
use super::input::{check_there, open_file};
use super::options::{AppContext, CliError, ResourceArgs, ScratchArgs, ShownArgs};
use super::output::{JsonArgs, Output, PlyArgs, check_folders, outputs_of, scratch_folder};
use super::picture::check_labels;
use super::results::Results;
use super::sink::check_places_or_folders;
use nystrom_stream::apps::labelled_faces::LabelledFaces;
use nystrom_stream::apps::transfer::transfer;
use nystrom_stream::base::printable::counted;
use nystrom_stream::mesh::ply::labelled::Labelling;
use nystrom_stream::store::{Context, WorkDir};
use serde_json::json;
use std::path::PathBuf;

/// Arguments of `transfer-labels`.
#[derive(Clone, Debug, clap::Args)]
pub struct TransferArgs {
    /// The labelled mesh: PLY, OBJ, OFF or STL, also .gz
    #[arg(value_name = "FROM")]
    pub from: PathBuf,
    /// The mesh to label, in the same coordinates
    #[arg(value_name = "TO")]
    pub to: PathBuf,
    /// Output, repeatable, as in segment
    #[arg(short, long, value_name = "OUT", required = true)]
    pub output: Vec<PathBuf>,
    /// Labels of FROM, .seg or .npy of any integers, negative for none [default: the property `label` of its faces]
    #[arg(long, value_name = "LABELS")]
    pub labels: Option<PathBuf>,
    #[command(flatten)]
    pub json: JsonArgs,
    #[command(flatten)]
    pub ply: PlyArgs,
    #[command(flatten)]
    pub resources: ResourceArgs,
    #[command(flatten)]
    pub shown: ShownArgs,
    #[command(flatten)]
    pub scratch: ScratchArgs,
}

/// Runs `transfer-labels`.
pub fn run(args: &TransferArgs, app: &AppContext) -> Result<(), CliError> {
    let outputs = outputs_of(&args.output)?;
    args.ply.check(&outputs)?;
    check_labels(args.labels.as_ref())?;
    let inputs = [&args.from, &args.to].into_iter().chain(&args.labels);
    check_places_or_folders(inputs.clone(), None, args.output.iter().chain(&args.json.json))?;
    check_folders(&outputs, inputs.chain(&args.output).chain(&args.json.json))?;
    [&args.from, &args.to].into_iter().try_for_each(|path| check_there(path))?;
    let bars = args.shown.bars();
    let run = args.resources.run(&bars, app);
    outputs.iter().try_for_each(|output| output.check_budget(&run.budget))?;
    let tmp = args.scratch.tmp.clone().unwrap_or_else(|| scratch_folder(&outputs));
    // Both meshes may have to be decoded, each into its own folder.
    let (work, source) = (WorkDir::temporary(&tmp)?, WorkDir::temporary(&tmp)?);
    let from = open_file(&args.from, source.path(), &run)?;
    let mut found = match &args.labels {
        Some(path) => LabelledFaces::of_file(path, &from, &source)?,
        None => {
            let remedy = "segment it first, or give --labels";
            LabelledFaces::needed_of_mesh(&from, remedy, Context::new(&source, &run))?
        }
    };
    let to = open_file(&args.to, work.path(), &run)?;
    let of = args.labels.as_ref().unwrap_or(&args.from);
    let result = transfer(&from, &found.labels, &to, Context::new(&work, &run))
        .map_err(|error| of_file(error, "labels", Some(of)))?;
    let facts = result.facts;
    let share = facts.uncertain as f64 / facts.faces.max(1) as f64;
    run.progress.note_of_work(&format!(
        "{}, {:.2} % of them uncertain; {} filled in, {} in islands",
        counted(facts.faces as usize, "face"),
        100. * share,
        facts.filled,
        facts.islands
    ));
    if let Some(note) = facts.note(&args.to) {
        run.progress.note(&note);
    }
    let coloured = outputs.iter().any(Output::has_more_than_labels);
    let colours = if coloured { found.colours(&to, &result.labels, &run)? } else { Vec::new() };
    let report = json!({
        "from": args.from.to_string_lossy(), "mesh": args.to.to_string_lossy(), "uncertain_share": share, "transfer": facts,
        "input": {"path": args.to.to_string_lossy(), "faces": facts.faces, "vertices": to.positions.len()},
    });
    let (labels, quality) = (&result.labels[..], Some(&result.quality[..]));
    let labelling = Labelling { labels, colours: &colours, quality, names: &found.names, fine: None };
    let results = Results { report: report.clone(), ..Results::new(labelling, args.ply.into()) };
    results.write(&outputs, Some(&to), &run).map_err(|error| of_file(error, "labels", Some(of)))?;
    Ok(args.json.publish_with(report, bars.log())?)
}
