//! `plan`: memory, disk and time of a run, before it starts.

use super::bars::human;
use super::method::MethodArgs;
use super::options::RunArgs;
use super::output::folder_of;
use super::{AppContext, Failure};
use nystrom_stream::base::Result;
use nystrom_stream::pipeline::SegmentParams;
use nystrom_stream::pipeline::calibrate::{calibrate, size_of_mesh};
use nystrom_stream::pipeline::plan::{Plan, order_is_open};
use nystrom_stream::store::Budget;
use nystrom_stream::store::Context;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Arguments of `plan`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// A PLY, OBJ, OFF or STL file, .gz or not
    #[arg(value_name = "MESH")]
    pub mesh: PathBuf,
    /// Where intermediate results would be kept [default: --tmp, or beside the mesh]
    #[arg(long, value_name = "DIR")]
    pub work_dir: Option<PathBuf>,
    /// Answer as JSON
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub method: MethodArgs,
    #[command(flatten)]
    pub run: RunArgs,
}

/// The warning for a budget that makes a run slow, if there is one.
fn warning(plan: &Plan) -> Option<String> {
    plan.warning(Budget::machine_limit()?.saturating_sub(plan.memory))
}

/// Refuses a run that the disk under `work` cannot hold and warns of one that will be slow.
pub fn check(path: &Path, params: &SegmentParams, context: Context<'_>) -> Result<()> {
    let Ok(size) = size_of_mesh(path) else {
        // Reading the mesh will say what is wrong with it.
        return Ok(());
    };
    let plan = Plan::new(size, params, false, context.work.durable(), context.run);
    plan.check_disk(context.work.path(), context.work.bytes())?;
    if let Some(text) = warning(&plan) {
        context.run.progress.note(&text);
    }
    Ok(())
}

pub fn run(args: &Args, app: &AppContext) -> Result<(), Failure> {
    let params = args.method.params()?;
    let run = args.run.run(&(), app);
    let size = size_of_mesh(&args.mesh)?;
    let lasting = args.work_dir.is_some();
    let plan = Plan::new(size, &params, false, lasting, &run);
    let folder = args.work_dir.clone().or(args.run.tmp.clone()).unwrap_or_else(|| folder_of(&args.mesh));
    // A work directory may not be there yet; its disk is that of the nearest folder that is.
    let folder = folder.ancestors().find(|folder| folder.is_dir()).unwrap_or(Path::new(".")).to_path_buf();
    let measured = calibrate(&params, plan.landmarks, &folder, &run)?;
    let plan = plan.with_times(|stage| measured.get(stage).copied().unwrap_or_default());
    let mut out = std::io::stdout().lock();
    if args.json {
        let _ = writeln!(out, "{}", serde_json::to_string_pretty(&plan).unwrap_or_default());
    } else {
        print(&plan, &mut out);
        if order_is_open(&params, size.faces) {
            let sorted = Plan::new(size, &params, true, lasting, &run);
            let more = (sorted.disk_peak - plan.disk_peak) as f64;
            let _ =
                writeln!(out, "were the file's order poor: {}B of disk more, to sort faces along a curve", human(more));
        }
        if let Some(text) = warning(&plan) {
            let _ = writeln!(out, "warning: {text}");
        }
    }
    drop(out);
    Ok(plan.check_disk(&folder, 0)?)
}

fn print(plan: &Plan, out: &mut impl Write) {
    let size = plan.mesh;
    let (faces, vertices) = (human(size.faces as f64), human(size.vertices as f64));
    let _ = writeln!(out, "{faces} faces, {vertices} vertices, {} landmarks", plan.landmarks);
    let _ = writeln!(
        out,
        "{:10} {:>10} {:>10} {:>10} {:>10} {:>9}",
        "stage", "memory", "disk kept", "passing", "given up", "seconds"
    );
    let bytes = |x: u64| format!("{}B", human(x as f64));
    let seconds = |x: Option<f64>| x.map_or(String::new(), |x| format!("{x:.1}"));
    for stage in &plan.stages {
        let [memory, keeps, passing, frees] = [stage.memory, stage.keeps, stage.passing, stage.frees].map(bytes);
        let time = seconds(stage.seconds);
        let _ = writeln!(out, "{:10} {memory:>10} {keeps:>10} {passing:>10} {frees:>10} {time:>9}", stage.name);
    }
    let (memory, disk, peak) = (bytes(plan.memory), bytes(plan.disk), bytes(plan.disk_peak));
    let _ = writeln!(out, "{:10} {memory:>10} {disk:>10} {:>21} {:>9}", "in all", "", seconds(plan.seconds));
    let _ = writeln!(out, "the disk holds {peak} at the most, besides the output");
}
