//! `plan`: memory, disk and time of a run, before it starts.

use super::method::MethodArgs;
use super::options::{AppContext, CliError, ResourceArgs, ScratchArgs};
use super::output::JsonArgs;
use super::progress::{human, words};
use super::sink::{check_places, scratch_beside};
use nystrom_stream::base::Result;
use nystrom_stream::mesh::size_of_mesh;
use nystrom_stream::pipeline::SegmentParams;
use nystrom_stream::pipeline::calibrate::calibrate;
use nystrom_stream::pipeline::plan::{Plan, StageTime, order_is_open};
use nystrom_stream::store::disk_speed::DiskSpeed;
use nystrom_stream::store::json::value as to_json;
use nystrom_stream::store::{Budget, Context, Run};
use serde_json::json;
use std::collections::BTreeMap;
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

/// Bytes available to the page cache while a run allocates what is planned.
fn page_cache(plan: &Plan) -> Option<u64> {
    Some(Budget::machine_limit()?.saturating_sub(plan.memory))
}

/// A warning if the budget makes the run slow.
fn warning(plan: &Plan) -> Option<String> {
    plan.warning(page_cache(plan)?)
}

/// Rejects a run that does not fit on the disk under `work`, and warns of one that will be slow.
pub fn check(path: &Path, params: &SegmentParams, context: Context<'_>) -> Result<()> {
    let Ok(size) = size_of_mesh(path) else {
        // Reading the mesh will report the problem.
        return Ok(());
    };
    if size.strips {
        // The file size gives only an upper bound on the faces, and fewer may fit.
        return Ok(());
    }
    let plan = Plan::new(size, params, false, context.work.durable(), context.run);
    plan.check_size(path)?;
    let (folder, there) = (context.work.path(), context.work.bytes());
    plan.check_disk(folder, there)?;
    for text in plan.disk_warning(folder, there).into_iter().chain(warning(&plan)) {
        context.run.progress.note_of_work(&text);
    }
    Ok(())
}

pub fn run(args: &PlanArgs, app: &AppContext) -> Result<(), CliError> {
    if args.mesh.as_os_str() == "-" {
        let text = "standard input has no known size until it is read; give a file";
        return Err(CliError::Usage(text.into()));
    }
    check_places([&args.mesh], None, &args.json.json)?;
    let params = args.method.params()?;
    let run = Run { seed: args.seed.unwrap_or(0), ..args.resources.run(&(), app) };
    let size = size_of_mesh(&args.mesh)?;
    let lasting = args.work_dir.is_some();
    let plan = Plan::new(size, &params, false, lasting, &run);
    plan.check_size(&args.mesh)?;
    params.check_for(&args.mesh, size.faces)?;
    params.check_memory(size.faces, &run)?;
    let folder = args.work_dir.clone().or(args.scratch.tmp.clone()).unwrap_or_else(|| scratch_beside(&args.mesh));
    // A work directory may not exist yet; its disk is that of the nearest existing folder above it.
    let folder = folder.ancestors().find(|folder| folder.is_dir()).unwrap_or(Path::new(".")).to_path_buf();
    let measured = calibrate(&params, plan.landmarks, size.faces, &folder, lasting, &run)?;
    let time_of = |of: &BTreeMap<String, StageTime>, stage: &str| of.get(stage).copied().unwrap_or_default();
    let mut plan = plan.with_times(|stage| time_of(&measured.smooth, stage), |stage| time_of(&measured.rough, stage));
    if let Some(cache) = page_cache(&plan).filter(|&cache| plan.random_access_bytes > cache) {
        plan = plan.with_waits(DiskSpeed::measure(&folder)?, cache);
    }
    let (mut text, mut notes) = (table(&plan), Vec::new());
    if order_is_open(&params, size.faces) {
        let sorted = Plan::new(size, &params, true, lasting, &run);
        let more = human((sorted.disk_peak - plan.disk_peak) as f64);
        notes.push(format!("if the order of the file is poor: {more}B more disk space, to sort faces along a curve"));
    }
    if plan.memory > run.budget.total() {
        let (needed, budget) = (human(plan.memory as f64), human(run.budget.total() as f64));
        notes.push(format!(
            "warning: at least {needed}B are allocated whatever the mesh, although --max-memory is {budget}B"
        ));
    }
    let short_of_disk = plan.check_disk(&folder, 0);
    let of_disk = plan.disk_warning(&folder, 0).filter(|_| short_of_disk.is_ok());
    notes.extend(warning(&plan).into_iter().chain(of_disk).map(|warning| format!("warning: {warning}")));
    for note in &notes {
        let _ = writeln!(text, "{note}");
    }
    let mut report = to_json("the plan", &plan)?;
    report["notes"] = json!(notes);
    args.json.publish_or_print(&report, &text)?;
    Ok(short_of_disk?)
}

/// The plan as a table.
fn table(plan: &Plan) -> String {
    let size = plan.mesh;
    let (faces, vertices) = (human(size.faces as f64), human(size.vertices as f64));
    let row = |cells: [&str; 6]| {
        let [stage, memory, keeps, temporary, frees, time] = cells;
        format!("{stage:16} {memory:>10} {keeps:>10} {temporary:>10} {frees:>10} {time:>9}\n")
    };
    let bytes = |x: u64| format!("{}B", human(x as f64));
    let seconds = |x: Option<f64>| x.map_or(String::new(), |x| format!("{x:.1}"));
    let most = if size.strips { "at most " } else { "" };
    let mut text = format!("{most}{faces} faces, {vertices} vertices, {} landmarks\n", plan.landmarks);
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
