//! `plan`: memory, disk and time of a run, before it starts.

use super::errors::with_flags;
use super::method::MethodArgs;
use super::options::{AppContext, CliError, ResourceArgs, ScratchArgs};
use super::output::JsonArgs;
use super::progress::words;
use super::sink::{check_places, scratch_beside};
use nystrom_stream::base::Result;
use nystrom_stream::base::printable::{counted, human, noun};
use nystrom_stream::mesh::size_of_mesh;
use nystrom_stream::pipeline::SegmentParams;
use nystrom_stream::pipeline::forecast::{Forecast, Place};
use nystrom_stream::pipeline::plan::Plan;
use nystrom_stream::store::json::value as to_json;
use nystrom_stream::store::{Context, Run};
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Arguments of `plan`.
#[derive(Clone, Debug, clap::Args)]
pub struct PlanArgs {
    /// A PLY, OBJ, OFF or STL file; PLY also .gz
    #[arg(value_name = "MESH")]
    pub mesh: PathBuf,
    /// Folder that would keep intermediate results [default: --tmp, or beside the mesh]
    #[arg(long, value_name = "DIR")]
    pub work_dir: Option<PathBuf>,
    #[command(flatten)]
    pub json: JsonArgs,
    #[command(flatten)]
    pub method: MethodArgs,
    #[command(flatten)]
    pub resources: ResourceArgs,
    /// Seed of all random choices [default: 0, or as in the work directory]
    #[arg(long, value_name = "S", help_heading = "Running")]
    pub seed: Option<u64>,
    #[command(flatten)]
    pub scratch: ScratchArgs,
}

/// Rejects more parts than the mesh has faces, and a run that does not fit on the disk under `work`, before the mesh is
/// read. Warns of a run that will be slow.
pub fn check(path: &Path, params: &SegmentParams, context: Context<'_>) -> Result<()> {
    let Ok(size) = size_of_mesh(path, &context.run.cancel) else {
        // Reading the mesh will report the problem.
        return Ok(());
    };
    if size.strips {
        // The file size gives only an upper bound on the faces, and fewer may fit.
        return Ok(());
    }
    let plan = Plan::new(size, params, false, context.work.durable(), context.run);
    plan.check_size(path)?;
    params.check_for(path, size.faces)?;
    let (folder, there) = (context.work.path(), context.work.bytes());
    plan.check_disk(folder, there)?;
    for text in plan.disk_warning(folder, there).into_iter().chain(plan.warning()) {
        context.run.progress.note_of_work(&text);
    }
    Ok(())
}

/// Runs `plan`.
pub fn run(args: &PlanArgs, app: &AppContext) -> Result<(), CliError> {
    if args.mesh.as_os_str() == "-" {
        let text = "standard input has no known size until it is read; give a file";
        return Err(CliError::Usage(text.into()));
    }
    check_places([&args.mesh], None, &args.json.json)?;
    let params = args.method.params()?;
    let run = Run { seed: args.seed.unwrap_or(0), ..args.resources.run(&(), app) };
    let size = size_of_mesh(&args.mesh, &run.cancel)?;
    let folder = args.work_dir.clone().or(args.scratch.tmp.clone()).unwrap_or_else(|| scratch_beside(&args.mesh));
    let place = Place { folder: &folder, lasting: args.work_dir.is_some() };
    let mut forecast = Forecast::new(&args.mesh, size, &params, place, true, &run)?;
    forecast.notes.iter_mut().for_each(|note| *note = with_flags(note));
    let mut text = table(&forecast.plan);
    for note in &forecast.notes {
        let _ = writeln!(text, "{note}");
    }
    args.json.publish_or_print(&to_json("the plan", &forecast)?, &text)?;
    Ok(forecast.shortage.map_or(Ok(()), Err)?)
}

/// The plan as a table.
fn table(plan: &Plan) -> String {
    let size = plan.mesh;
    let size_of = |count: u64, word| format!("{} {}", human(count as f64), noun(count as usize, word));
    let (faces, vertices) = (size_of(size.faces, "face"), size_of(size.vertices, "vertex"));
    let row = |cells: [&str; 6]| {
        let [stage, memory, keeps, temporary, frees, time] = cells;
        format!("{stage:16} {memory:>10} {keeps:>10} {temporary:>10} {frees:>10} {time:>9}\n")
    };
    let bytes = |x: u64| format!("{}B", human(x as f64));
    let seconds = |x: Option<f64>| x.map_or(String::new(), |x| format!("{x:.1}"));
    let most = if size.strips { "at most " } else { "" };
    let mut text = format!("{most}{faces}, {vertices}, {}\n", counted(plan.landmarks, "landmark"));
    text += &row(["stage", "memory", "disk kept", "temporary", "freed", "seconds"]);
    for stage in &plan.stages {
        let [memory, keeps, temporary, frees] =
            [stage.needs.memory, stage.needs.keeps, stage.needs.temporary, stage.needs.frees].map(bytes);
        text += &row([words(stage.name), &memory, &keeps, &temporary, &frees, &seconds(stage.seconds)]);
    }
    let (memory, disk, peak) = (bytes(plan.memory), bytes(plan.disk), bytes(plan.disk_peak));
    text += &row(["overall", &memory, &disk, "", "", &seconds(plan.seconds)]);
    let smooth = match plan.disk_peak_smooth {
        least if least < plan.disk_peak => format!(" for a rough surface, {} for a smooth one", bytes(least)),
        _ => String::new(),
    };
    let _ = writeln!(text, "peak disk use: {peak}{smooth}, besides the output");
    if let Some(slow) = plan.seconds_rough {
        let _ = writeln!(
            text,
            "seconds are for a smooth surface; a rough one, such as a raw scan, takes about {slow:.1} s"
        );
    }
    text
}
