//! `segment`: cut one mesh or many into parts.
//!
//! Many meshes come as files, folders and patterns; jobs take them from one list, and a table grows. Jobs
//! share threads and memory evenly, so what one mesh gets depends on `--jobs` alone. A mesh that fails is
//! reported, and the rest goes on.

use super::edits::{EditArgs, Like, LikeArgs, corrections, named as give_names};
use super::errors::{file_of, message};
use super::input::{check_there, meshes, read};
use super::made::Maker;
use super::method::MethodArgs;
use super::options::{AppContext, CliError, ForceArgs, RunArgs, ScratchArgs};
use super::output::{FormArgs, JsonArgs, Output, check_folders, check_names, ending, outputs_of};
use super::progress::{Bars, BatchBars, Style, human, tell};
use super::results::{Cut, measured};
use super::sink::{OpenSink, Sink, check_distinct, check_outside, folder_of};
use nystrom_stream::apps::edits::Edits;
use nystrom_stream::apps::measure;
use nystrom_stream::base::parallel::{catch, spawn};
use nystrom_stream::base::{Error, Progress, Result};
use nystrom_stream::pipeline::like::{self, LikeFacts, Way};
use nystrom_stream::pipeline::report::Report;
use nystrom_stream::pipeline::{Cluster, SegmentParams, input, labels, segment_corrected};
use nystrom_stream::store::json::value as to_json;
use nystrom_stream::store::{Budget, Context, Run, WorkDir};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// Arguments of `segment`.
#[derive(Clone, Debug, clap::Args)]
pub struct SegmentArgs {
    /// PLY, OBJ, OFF and STL files, also .gz; folders of them; patterns; `-` reads standard input
    #[arg(required = true, value_name = "MESH")]
    pub meshes: Vec<PathBuf>,
    /// Output, once or more: .ply, .seg, .npy, .parquet, .csv, .obj, .glb, .html or .png; a folder, ending in /, for
    /// one PLY per part; `-` for standard output. For several meshes {} stands for the name of the mesh, as in
    /// out/{}.seg [default: MESH.segmented.ply]
    #[arg(short, long, value_name = "OUT")]
    pub output: Vec<PathBuf>,
    #[command(flatten)]
    pub form: FormArgs,
    #[command(flatten)]
    pub json: JsonArgs,
    /// Measure the parts for the report: box, centroid, axes, open edges, neighbours, and the volume of closed ones
    #[arg(long)]
    pub measure: bool,
    /// Keep intermediate results in this folder and reuse them [default: a temporary folder]
    #[arg(long, value_name = "DIR")]
    pub work_dir: Option<PathBuf>,
    #[command(flatten)]
    pub force: ForceArgs,
    /// Write one line of JSON per mesh as it is done, to standard output or to FILE; with --resume after what is there
    #[arg(
        long,
        value_name = "FILE",
        num_args = 0..=1,
        default_missing_value = "-",
        require_equals = true,
        help_heading = "Many meshes"
    )]
    pub json_lines: Option<PathBuf>,
    /// Meshes at the same time; they share threads and memory evenly
    #[arg(
        long,
        value_name = "N",
        default_value_t = 1,
        value_parser = clap::value_parser!(u16).range(1..),
        help_heading = "Many meshes"
    )]
    pub jobs: u16,
    /// Skip meshes whose outputs a batch with the same options has made, after the mesh was last changed
    #[arg(long, help_heading = "Many meshes")]
    pub resume: bool,
    #[command(flatten)]
    pub edits: EditArgs,
    #[command(flatten)]
    pub like: LikeArgs,
    #[command(flatten)]
    pub method: MethodArgs,
    #[command(flatten)]
    pub run: RunArgs,
    #[command(flatten)]
    pub scratch: ScratchArgs,
    /// Do not check for free disk space before the start
    #[arg(long, help_heading = "Running")]
    pub no_plan: bool,
}

impl SegmentArgs {
    /// Whether an option for many meshes is given.
    fn is_batch(&self) -> bool {
        self.jobs > 1 || self.resume || self.json_lines.is_some()
    }
}

/// Refuses combinations of options before any work.
fn check(args: &SegmentArgs, meshes: &[PathBuf], several: bool) -> Result<(SegmentParams, Option<Edits>), CliError> {
    let mut params = args.method.params()?;
    let edits = args.edits.read(&args.method.parts, &mut params)?;
    params.check()?;
    let misused = |text: &str| Err(CliError::Usage(text.into()));
    let outputs = outputs_of(&args.output)?;
    // What is written by default is a PLY.
    let default = [Output::stdout()];
    args.form.check(if outputs.is_empty() { &default } else { &outputs })?;
    if !outputs.is_empty() {
        check_names(args.edits.names.as_deref(), &outputs, &args.json)?;
    }
    if args.measure && args.json.json.is_none() {
        return misused(
            "--measure goes with --json, which tells what is measured; or write a table, as in -o parts.csv",
        );
    }
    let stdin = meshes.iter().filter(|mesh| mesh.as_os_str() == "-").count();
    if stdin > 0 && (several || args.is_batch()) {
        return misused("standard input is one mesh; give it alone, and without options for many meshes");
    }
    if several {
        let fixed = args.output.iter().any(|path| !path.to_string_lossy().contains("{}"));
        if fixed {
            return misused(
                "-o goes with one mesh; for several, write {} for the name of the mesh, as in -o 'out/{}.seg', or leave \
                 it out: each gets MESH.segmented.ply",
            );
        }
        if args.work_dir.is_some() {
            return misused("--work-dir goes with one mesh");
        }
    }
    Ok((params, edits))
}

pub fn run(args: &SegmentArgs, app: &AppContext) -> Result<(), CliError> {
    let start = Instant::now();
    // A wrong option is reported before a missing folder.
    args.method.params()?;
    let (meshes, several) = meshes(&args.meshes)?;
    // A pattern or a list that happens to name one mesh is a batch still.
    let many = several || args.is_batch();
    let (mut params, mut edits) = check(args, &meshes, several)?;
    let like = match &args.like.like {
        Some(path) if params.cluster != Cluster::Parts => {
            return Err(CliError::Usage(format!("--like {}: goes with --cluster parts only", path.display())));
        }
        Some(path) => {
            let place = args.scratch.tmp.clone().unwrap_or_else(std::env::temp_dir);
            let (work, run) = (WorkDir::temporary(&place)?, args.run.run(&(), app));
            Some(match edits.take() {
                Some(edits) => {
                    // The others have its parts, whatever their number.
                    let own = std::mem::replace(&mut params, args.method.params()?);
                    Like::edited(path, &own, &edits, work, &run)?
                }
                None => Like::read(path, work, &run)?,
            })
        }
        None => None,
    };
    let task = Task { args, params: &params, edits: edits.as_ref(), like: like.as_ref() };
    let mut jobs = jobs(meshes, &args.output)?;
    let written = jobs.iter().flat_map(|job| &job.outputs).map(|output| output.target().to_path_buf());
    let written: Vec<PathBuf> = written.chain(args.json.json.clone()).chain(args.json_lines.clone()).collect();
    let edits = args.edits.edits.iter().chain(&args.edits.names).chain(&args.like.like);
    check_outside(args.work_dir.as_deref(), &written)?;
    check_distinct(jobs.iter().map(|job| &job.mesh).chain(edits.clone()), &written)?;
    let files = jobs.iter().map(|job| &job.mesh).chain(edits).chain(&written);
    check_folders(jobs.iter().flat_map(|job| &job.outputs), files)?;
    // Those of each mesh are looked at when its turn comes.
    args.json.json.iter().chain(&args.json_lines).try_for_each(|path| Sink::of(path).check())?;
    if many {
        return all(jobs, task, app);
    }
    let bars = args.run.bars();
    let run = args.run.run(&bars, app);
    let job = jobs.remove(0);
    let report = one(&job, task, &bars, &run, app)?;
    args.json.publish(&report)?;
    report.remarks(&params).iter().for_each(|text| run.progress.note(text));
    let faces = format!("{} face{}", human(report.input.faces as f64), if report.input.faces == 1 { "" } else { "s" });
    run.progress.note_of_work(&ending(&faces, report.parts.len(), start, &job.outputs));
    Ok(())
}

/// A mesh and where its results go.
pub struct Job {
    /// The mesh; `-` is standard input.
    pub mesh: PathBuf,
    /// At least one output.
    pub outputs: Vec<Output>,
}

impl Job {
    /// The job of `mesh`; without `outputs` the result goes beside it, or from standard input to standard output.
    fn of(mesh: PathBuf, mut outputs: Vec<Output>) -> Self {
        if outputs.is_empty() {
            outputs.push(if mesh.as_os_str() == "-" { Output::stdout() } else { Output::beside(&mesh) });
        }
        Self { mesh, outputs }
    }

    /// Whether all outputs exist and are newer than the mesh.
    fn is_newer(&self) -> bool {
        let changed = |path: PathBuf| std::fs::metadata(path).and_then(|data| data.modified()).ok();
        let Some(mesh) = changed(self.mesh.clone()) else { return false };
        self.outputs.iter().all(|output| output.last_file().and_then(changed).is_some_and(|time| time >= mesh))
    }

    /// What the outputs are made by; nothing where the mesh cannot be read.
    fn maker(&self, options: &Value) -> Option<Maker> {
        Some(Maker::new(&input::identity(&self.mesh).ok()?, options))
    }

    /// Whether `maker` made all outputs, after the mesh was last changed.
    fn is_done(&self, maker: Option<&Maker>, progress: &Bars) -> bool {
        let newer = self.is_newer();
        let done = newer && maker.is_some_and(|maker| self.outputs.iter().all(|output| maker.made(output)));
        if newer && !done {
            progress.note_of_work("its outputs are not known to be of these options, and are made anew");
        }
        done
    }

    /// One line of JSON about the job.
    fn line(&self, report: &Report, seconds: f64) -> Value {
        let outputs: Vec<_> = self.outputs.iter().filter_map(Output::path).map(Path::to_string_lossy).collect();
        let mut line = json!({
            "mesh": self.mesh.to_string_lossy(), "faces": report.input.faces, "parts": report.parts.len(), "gamma_per_face": report.gamma_per_face,
            "seconds": seconds, "outputs": outputs,
        });
        if let Some(clear) = report.clear_parts {
            line["clear_parts"] = clear.into();
            line["unsure"] = report.unsure().collect();
        }
        if let Some(like) = &report.like {
            line["like"] = like.clone();
        }
        line
    }
}

/// What is done with each mesh.
#[derive(Clone, Copy)]
pub struct Task<'a> {
    /// The arguments.
    pub args: &'a SegmentArgs,
    /// Their parameters.
    pub params: &'a SegmentParams,
    /// The edits that they name.
    pub edits: Option<&'a Edits>,
    /// The mesh that they are to be cut like.
    pub like: Option<&'a Like>,
}

/// Why a person should look at parts that were carried over.
fn doubts(facts: &LikeFacts) -> String {
    let way = if facts.way == Way::Place { "nearest faces" } else { "matched shapes" };
    let mut text = format!("parts from {way}, confidence {:.2}", facts.confidence);
    if facts.ambiguous {
        text += ", parts may be mirrored";
    }
    if !facts.missing.is_empty() {
        let parts: Vec<String> = facts.missing.iter().map(u32::to_string).collect();
        text += &format!(", without part {}", parts.join(", "));
    }
    text
}

/// Segments one mesh and writes its outputs.
pub fn one(job: &Job, task: Task<'_>, bars: &Bars, run: &Run, app: &AppContext) -> Result<Report> {
    let Task { args, params, edits, like } = task;
    let Job { mesh: path, outputs } = job;
    check_there(path)?;
    outputs.iter().try_for_each(Output::check)?;
    let beside = || outputs.iter().find_map(Output::path).map_or_else(std::env::temp_dir, folder_of);
    let work = args.scratch.work(args.work_dir.as_deref(), beside, run)?;
    if path.as_os_str() != "-" && !args.no_plan {
        super::plan::check(path, params, Context::new(&work, run))?;
    }
    let (opened, identity) = read(path, args.force, Context::new(&work, run))?;
    let painted = args.edits.hints.as_ref().map(|name| opened.face_property(name, run)).transpose()?;
    let mut carried = like.map(|like| like::carry(like.reference(), &opened, Context::new(&work, run))).transpose()?;
    let painted = carried.as_ref().map(|carried| &carried.values).or(painted.as_ref());
    let placed = edits.map(|edits| edits.on(&opened, run)).transpose()?;
    let corrections = corrections(placed.as_ref(), painted);
    let mut result = segment_corrected(&opened, &identity, params, corrections, Context::new(&work, run))?;
    if let (Some(like), Some(carried)) = (like, &mut carried) {
        result = like::settle(result, carried, like.reference(), Context::new(&work, run))?;
    }
    if give_names(&mut result.names, args.edits.names.as_deref(), result.colours.len())? {
        labels::keep(&result, Context::new(&work, run))?;
    }
    let told = carried.as_ref().map(|carried| &carried.facts);
    if let Some(facts) = told.filter(|facts| facts.look) {
        run.progress.note(&format!("look at {}: {}", path.display(), doubts(facts)));
    }
    let report = || {
        let (context, peak) = (Context::new(&work, run), Some((app.peak)()));
        let report = Report::new(opened.path(), params, &result, context, bars.told(), peak)?;
        Ok(Report { like: told.map(|facts| to_json("the likeness", facts)).transpose()?, ..report })
    };
    let cut = Cut {
        labelling: result.labelling(),
        params,
        tree: None,
        agreement: result.numbers.expected_agreement(),
        cell_labels: &result.cell_labels,
        edits,
        work: &work,
    };
    let told = || to_json("the report", &report()?);
    cut.write(outputs, args.form, Some(&opened), told, Context::new(&work, run))?;
    let mut all = report()?;
    if args.measure {
        let of_parts = |context: Context<'_>| measure::parts(&opened, &result.labels, result.colours.len(), context);
        all.measures = Some(measured(&work.file("measures"), run, of_parts)?);
    }
    Ok(all)
}

/// A job per mesh; in `patterns` of outputs `{}` stands for the name of the mesh without ending.
fn jobs(meshes: Vec<PathBuf>, patterns: &[PathBuf]) -> Result<Vec<Job>, CliError> {
    let mut owner: BTreeMap<PathBuf, PathBuf> = BTreeMap::new();
    let mut jobs = Vec::with_capacity(meshes.len());
    for mesh in meshes {
        let stem = Output::stem(&mesh);
        if mesh.as_os_str() == "-" && patterns.iter().any(|pattern| pattern.to_string_lossy().contains("{}")) {
            return Err(CliError::Usage("-o: standard input has no name to put for {}; write one".into()));
        }
        let itself = mesh.canonicalize().ok();
        let fill = |pattern: &PathBuf| Output::of(Path::new(&pattern.to_string_lossy().replace("{}", &stem)));
        let job = Job::of(mesh, patterns.iter().map(fill).collect::<Result<_, _>>()?);
        for path in job.outputs.iter().filter_map(Output::path) {
            if itself.is_some() && path.canonicalize().ok() == itself {
                return Err(CliError::Usage(format!("-o: {} is the mesh itself; name another file", path.display())));
            }
            if let Some(other) = owner.insert(path.to_path_buf(), job.mesh.clone()) {
                let (other, mesh, path) = (other.display(), job.mesh.display(), path.display());
                let remedy = "cut them one by one, each with an -o of its own";
                return Err(CliError::Usage(format!("{other} and {mesh} would both be written to {path}; {remedy}")));
            }
        }
        jobs.push(job);
    }
    Ok(jobs)
}

/// The table: its first column is as wide as the longest name.
struct Table {
    width: usize,
}

impl Table {
    fn of(jobs: &[Job]) -> Self {
        let widths = jobs.iter().map(|job| job.mesh.display().to_string().chars().count());
        Self { width: widths.max().unwrap_or(0).max("mesh".len()) }
    }

    fn row(&self, mesh: &str, faces: &str, parts: &str, seconds: &str) -> String {
        format!("{mesh:width$} {faces:>10} {parts:>6} {seconds:>9}", width = self.width)
    }

    /// The row of a mesh that is done.
    fn row_of(&self, mesh: &Path, report: &Report, seconds: f64) -> String {
        let (faces, parts) = (report.input.faces.to_string(), report.parts.len().to_string());
        self.row(&mesh.display().to_string(), &faces, &parts, &format!("{seconds:.3}"))
    }
}

/// What the jobs have done.
struct Tally {
    /// Where JSON lines go.
    lines: Option<OpenSink>,
    reports: BTreeMap<usize, Report>,
    failed: Vec<(PathBuf, String)>,
    skipped: usize,
    stop: Option<Error>,
}

/// Segments all meshes.
fn all(jobs: Vec<Job>, task: Task<'_>, app: &AppContext) -> Result<(), CliError> {
    let args = task.args;
    let start = Instant::now();
    let style = args.run.bars().style();
    let file = |path: &Option<PathBuf>| path.as_deref().map(input::identity).transpose();
    let (like, edits_of_like) = (&args.like.like, args.like.like.as_ref().and(args.edits.edits.clone()));
    let options = json!({
        "edits": task.edits, "hints": args.edits.hints, "names": file(&args.edits.names)?,
        "like": [file(like)?, file(&edits_of_like)?],
        "params": task.params, "seed": args.run.seed.unwrap_or(0), "ply_form": format!("{:?}", args.form.ply.ply_form),
        "vertex_labels": args.form.ply.vertex_labels, "split_vertices": args.form.ply.split_vertices,
        "split_faces": args.form.ply.split_faces,
        "embedding_columns": args.form.embedding_columns, "part_form": format!("{:?}", args.form.part_form),
        "cap": args.form.cap,
    });
    let bars = BatchBars::new(style, jobs.len() as u64);
    let table = Table::of(&jobs);
    let told = matches!(style, Style::Terminal | Style::Lines);
    if told {
        bars.say(&table.row("mesh", "faces", "parts", "seconds"));
    }
    let lines = args.json_lines.as_deref().map(|path| Sink::of(path).open(args.resume)).transpose()?;
    let tally = Tally { lines, reports: BTreeMap::new(), failed: Vec::new(), skipped: 0, stop: None };
    let tally = Mutex::new(tally);
    let next = AtomicUsize::new(0);
    let workers = usize::from(args.jobs).min(jobs.len());
    let whole = args.run.run(&(), app);
    let (threads, memory) = ((whole.threads / workers).max(1), whole.budget.total() / workers as u64);
    let work = || {
        loop {
            let k = next.fetch_add(1, Ordering::Relaxed);
            let lock = || tally.lock().unwrap_or_else(|poison| poison.into_inner());
            if k >= jobs.len() || lock().stop.is_some() {
                return;
            }
            let job = &jobs[k];
            let mine = bars.of_mesh(&job.mesh.display().to_string());
            let maker = job.maker(&options);
            if args.resume && job.is_done(maker.as_ref(), &mine) {
                lock().skip(job);
                bars.end(&mine, "");
                continue;
            }
            let begin = Instant::now();
            let mut run = args.run.run(&mine, app);
            (run.threads, run.budget) = (threads, Budget::new(memory));
            // A panic fails its mesh alone.
            let result = catch(|| {
                let known =
                    || job.outputs.iter().zip(std::iter::repeat(&maker)).filter_map(|(o, m)| Some((o, m.as_ref()?)));
                known().for_each(|(output, maker)| maker.forget(output));
                let report = one(job, task, &mine, &run, app)?;
                known().for_each(|(output, maker)| maker.stamp(output));
                Ok(report)
            })
            .flatten();
            let seconds = begin.elapsed().as_secs_f64();
            let row = result.as_ref().map_or(String::new(), |report| table.row_of(&job.mesh, report, seconds));
            bars.end(&mine, &row);
            if let Err(error) = &result
                && !matches!(error, Error::Cancelled)
            {
                bars.complain(&job.mesh, &message(error), file_of(error));
            }
            lock().settle(k, job, result, seconds);
        }
    };
    std::thread::scope(|scope| {
        (1..workers).for_each(|_| drop(spawn(scope, work)));
        work();
    });
    bars.finish();
    let tally = tally.into_inner().unwrap_or_else(|poison| poison.into_inner());
    if let Some(error) = tally.stop {
        return Err(error.into());
    }
    let doubtful = |(&job, report): (&usize, &Report)| {
        (report.like.as_ref()?["look"] == true).then(|| jobs[job].mesh.display().to_string())
    };
    let look: Vec<String> = tally.reports.iter().filter_map(doubtful).collect();
    if told && !look.is_empty() {
        tell(&format!("look at {} of {}: {}", look.len(), tally.reports.len(), look.join(", ")));
    }
    args.json.publish(&tally.reports.values().collect::<Vec<_>>())?;
    let (all, failed) = (jobs.len(), tally.failed.len());
    if told {
        tally.failed.iter().for_each(|(mesh, reason)| tell(&format!("failed: {}: {reason}", mesh.display())));
        let done = all - failed - tally.skipped;
        let skipped = if tally.skipped > 0 { format!(", {} skipped", tally.skipped) } else { String::new() };
        let seconds = start.elapsed().as_secs_f64();
        let all = if all == 1 { "1 mesh".to_string() } else { format!("{all} meshes") };
        tell(&format!("{all}: {done} done, {failed} failed{skipped}, in {seconds:.1} s"));
    }
    if failed == 0 {
        return Ok(());
    }
    let sum = format!("{failed} of {all} meshes failed");
    if style == Style::Quiet {
        tell(&format!("nystrom-stream: {sum}"));
    }
    Err(CliError::Reported(sum))
}

impl Tally {
    /// Writes a line of JSON where that is asked for.
    fn tell(&mut self, line: &Value) -> Result<()> {
        self.lines.as_mut().map_or(Ok(()), |lines| lines.write(format!("{line}\n").as_bytes()))
    }

    /// Notes that a mesh is done already.
    fn skip(&mut self, job: &Job) {
        self.skipped += 1;
        if let Err(error) = self.tell(&json!({"mesh": job.mesh.to_string_lossy(), "skipped": true})) {
            self.stop.get_or_insert(error);
        }
    }

    /// Notes how a mesh went.
    fn settle(&mut self, number: usize, job: &Job, result: Result<Report>, seconds: f64) {
        let written = match result {
            Ok(report) => {
                let line = job.line(&report, seconds);
                self.reports.insert(number, report);
                self.tell(&line)
            }
            Err(error @ Error::Cancelled) => Err(error),
            Err(error) => {
                let reason = message(&error);
                // Most messages begin with the file.
                let start = format!("{}: ", job.mesh.display());
                let reason = reason.strip_prefix(&start).map_or(reason.clone(), str::to_string);
                let line = json!({"mesh": job.mesh.to_string_lossy(), "seconds": seconds, "error": reason});
                self.failed.push((job.mesh.clone(), reason));
                self.tell(&line)
            }
        };
        if let Err(error) = written {
            self.stop.get_or_insert(error);
        }
    }
}
