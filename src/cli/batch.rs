//! `segment` over all of its meshes: validation before any work, and batches.
//!
//! Meshes are given as files, folders and patterns; jobs take them from one list, and a table grows. Jobs share threads
//! and memory evenly, so the resources of one mesh depend on `--jobs` alone. A mesh that fails is reported, and the
//! rest continues.

use super::edits::{Like, NameTable};
use super::errors::{file_of, message};
use super::input::{Given, meshes};
use super::options::{AppContext, CliError, misfit};
use super::output::{Output, check_folders, check_names, closing_line, outputs_of};
use super::progress::{BatchBars, Style, tell};
use super::provenance::{Claim, Provenance};
use super::segment::{Job, SegmentArgs, Task, one};
use super::sink::{OpenSink, Sink, check_distinct, check_outside};
use nystrom_stream::apps::edits::Edits;
use nystrom_stream::base::parallel::{catch, lock, spawn};
use nystrom_stream::base::printable::{counted, line};
use nystrom_stream::base::{Error, Progress, Result};
use nystrom_stream::pipeline::report::Report;
use nystrom_stream::pipeline::{Cluster, SegmentParams, input};
use nystrom_stream::store::json::value as to_json;
use nystrom_stream::store::{Budget, WorkDir};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

/// Why a mesh is skipped that is not done.
const ELSEWHERE: &str = "another run is working on it";

/// Rejects invalid combinations of options before any work.
fn check(args: &SegmentArgs, meshes: &[PathBuf], several: bool) -> Result<(SegmentParams, Option<Edits>), CliError> {
    let mut params = args.method.params()?;
    let edits = args.edits.read(&args.method.parts, &mut params)?;
    params.check().map_err(|error| args.edits.blamed(&args.method.parts, error))?;
    let misused = |text: &str| Err(CliError::Usage(text.into()));
    if args.run.seed.is_some() && params.cluster == Cluster::Components {
        return Err(misfit("--seed", "--cluster parts, kmeans or two-means"));
    }
    let outputs = outputs_of(&args.output)?;
    // The default output is a PLY.
    let default = [Output::stdout()];
    args.form.check(if outputs.is_empty() { &default } else { &outputs })?;
    if !outputs.is_empty() {
        check_names(args.edits.names.as_deref(), &outputs, &args.json)?;
    }
    if args.measure && args.json.json.is_none() {
        return misused("--measure requires --json; or write a table, as in -o parts.csv");
    }
    let stdin = meshes.iter().filter(|mesh| mesh.as_os_str() == "-").count();
    if stdin > 0 && (several || args.is_batch()) {
        return misused("standard input is a single mesh; give it alone, and without options for many meshes");
    }
    if several {
        let fixed = args.output.iter().any(|path| !path.to_string_lossy().contains("{}"));
        if fixed {
            return misused(
                "-o names a single file; for several meshes, write {} for the name of the mesh, as in -o \
                 'out/{}.seg', or leave it out: each gets MESH.segmented.ply",
            );
        }
        let files = [("--json", &args.json.json), ("--json-lines", &args.json_lines)];
        let filled = |path: &PathBuf| path.to_string_lossy().contains("{}");
        if let Some((option, _)) = files.iter().find(|(_, path)| path.as_ref().is_some_and(filled)) {
            return misused(&format!("{option} writes the reports of all meshes to one file; leave out {{}}"));
        }
        if args.work_dir.is_some() {
            return misused("--work-dir can only be used with a single mesh; leave it out, or cut meshes one by one");
        }
    }
    Ok((params, edits))
}

/// Runs `segment`, on one mesh or on many.
pub fn run(args: &SegmentArgs, app: &AppContext) -> Result<(), CliError> {
    let start = Instant::now();
    // A wrong option is reported before a missing folder.
    args.method.params()?;
    let Given { meshes, several, unlisted } = meshes(&args.meshes)?;
    // A pattern or a list that happens to match one mesh is still a batch.
    let many = several || args.is_batch();
    let (mut params, mut edits) = check(args, &meshes, several)?;
    if let (Some(path), true) = (&args.like.like, params.cluster != Cluster::Parts) {
        return Err(CliError::Usage(format!("--like {}: can only be used with --cluster parts", path.display())));
    }
    let names = NameTable::read(args.edits.names.as_deref())?;
    let mut jobs = jobs(meshes, &args.output)?;
    let written = jobs.iter().flat_map(|job| &job.outputs).map(|output| output.target().to_path_buf());
    let written: Vec<PathBuf> = written.chain(args.json.json.clone()).chain(args.json_lines.clone()).collect();
    let given = args.edits.edits.iter().chain(&args.edits.names).chain(&args.like.like);
    check_outside(args.work_dir.as_deref(), &written)?;
    check_distinct(jobs.iter().map(|job| &job.mesh).chain(given.clone()), &written)?;
    let files = jobs.iter().map(|job| &job.mesh).chain(given).chain(&written);
    check_folders(jobs.iter().flat_map(|job| &job.outputs), files)?;
    // The inputs and outputs of each mesh are checked when its turn comes.
    args.json.json.iter().chain(&args.json_lines).try_for_each(|path| Sink::of(path).check())?;
    if !many {
        jobs[0].check(&args.run.run(&(), app).budget)?;
    }
    let like = match &args.like.like {
        Some(path) => {
            let place = args.scratch.tmp.clone().unwrap_or_else(std::env::temp_dir);
            let (work, run) = (WorkDir::temporary(&place)?, args.run.run(&(), app));
            Some(match edits.take() {
                Some(edits) => {
                    // The other meshes get its parts, whatever their number.
                    let own = std::mem::replace(&mut params, args.method.params()?);
                    Like::edited(path, &own, &edits, work, &run)?
                }
                None => Like::read(path, work, &run)?,
            })
        }
        None => None,
    };
    let task = Task { args, params: &params, edits: edits.as_ref(), names: names.as_ref(), like: like.as_ref() };
    if many {
        return all(jobs, unlisted, task, app);
    }
    let bars = args.run.bars();
    let run = args.run.run(&bars, app);
    let job = jobs.remove(0);
    let report = one(&job, task, &bars, &run, app)?;
    args.json.publish(&report)?;
    report.remarks(&params).iter().for_each(|text| run.progress.note(text));
    let faces = report.input.faces as usize;
    run.progress.note_of_work(&closing_line(faces, report.parts_with_faces(), start, &job.outputs));
    Ok(())
}

/// `pattern`, whose name need not be UTF-8, with `stem` in place of each `{}`.
fn filled(pattern: &Path, stem: &[u8]) -> PathBuf {
    let (mut name, mut rest) = (Vec::new(), pattern.as_os_str().as_bytes());
    while let Some(at) = rest.windows(2).position(|pair| pair == b"{}") {
        name.extend_from_slice(&rest[..at]);
        name.extend_from_slice(stem);
        rest = &rest[at + 2..];
    }
    name.extend_from_slice(rest);
    OsString::from_vec(name).into()
}

/// One job per mesh; in the output `patterns`, `{}` stands for the name of the mesh without extension.
fn jobs(meshes: Vec<PathBuf>, patterns: &[PathBuf]) -> Result<Vec<Job>, CliError> {
    let mut owner: BTreeMap<PathBuf, PathBuf> = BTreeMap::new();
    let mut jobs = Vec::with_capacity(meshes.len());
    for mesh in meshes {
        if mesh.as_os_str() == "-" && patterns.iter().any(|pattern| pattern.to_string_lossy().contains("{}")) {
            return Err(CliError::Usage("-o: standard input has no name to replace {}; write a name".into()));
        }
        let itself = mesh.canonicalize().ok();
        let fill = |pattern: &PathBuf| Output::of(&filled(pattern, Output::stem(&mesh)));
        let outputs = patterns.iter().map(fill).collect::<Result<_, _>>()?;
        let job = Job::of(mesh, outputs);
        for path in job.outputs.iter().filter_map(Output::path) {
            if itself.is_some() && path.canonicalize().ok() == itself {
                return Err(CliError::Usage(format!("-o: {} is the mesh itself; choose another file", path.display())));
            }
            if let Some(other) = owner.insert(path.to_path_buf(), job.mesh.clone()) {
                let (other, mesh, path) = (other.display(), job.mesh.display(), path.display());
                let remedy = "cut them one by one, each with its own -o";
                return Err(CliError::Usage(format!("{other} and {mesh} would both be written to {path}; {remedy}")));
            }
        }
        jobs.push(job);
    }
    Ok(jobs)
}

/// The name of a mesh on one line, as in messages.
fn shown(mesh: &Path) -> String {
    line(&mesh.display().to_string()).into_owned()
}

/// The table: its first column is as wide as the longest name.
struct Table {
    width: usize,
}

impl Table {
    fn of(jobs: &[Job]) -> Self {
        let widths = jobs.iter().map(|job| shown(&job.mesh).chars().count());
        Self { width: widths.max().unwrap_or(0).max("mesh".len()) }
    }

    fn row(&self, mesh: &str, faces: &str, parts: &str, seconds: &str) -> String {
        format!("{mesh:width$} {faces:>10} {parts:>6} {seconds:>9}", width = self.width)
    }

    /// The row of a finished mesh.
    fn row_of(&self, mesh: &Path, report: &Report, seconds: f64) -> String {
        let (faces, parts) = (report.input.faces.to_string(), report.parts_with_faces().to_string());
        self.row(&shown(mesh), &faces, &parts, &format!("{seconds:.3}"))
    }
}

/// The reports in the file of `--json`, by the paths of their meshes: those of meshes that this run skips stay there.
fn earlier_reports(args: &SegmentArgs) -> Result<BTreeMap<String, Value>> {
    // A pipe or a device has no reports, and might wait for some.
    let Some(path) = args.json.json.as_deref().filter(|path| args.resume && path.is_file()) else {
        return Ok(BTreeMap::new());
    };
    let text = std::fs::read(path).map_err(Error::io(path, "read"))?;
    let reports: Vec<Value> = serde_json::from_slice(&text).map_err(|_| {
        Error::unusable(path, "holds no reports of a batch to go on with", "choose another name, or remove the file")
    })?;
    let named = |report: Value| Some((report["input"]["path"].as_str()?.to_string(), report));
    Ok(reports.into_iter().filter_map(named).collect())
}

/// The progress of the jobs.
#[derive(Default)]
struct Tally {
    /// Destination of JSON lines.
    lines: Option<OpenSink>,
    reports: BTreeMap<usize, Report>,
    /// Reports of an earlier run, by the paths of their meshes.
    earlier: BTreeMap<String, Value>,
    failed: Vec<(PathBuf, String)>,
    skipped: usize,
    /// Of the skipped ones, those that another run was working on.
    elsewhere: usize,
    stop: Option<Error>,
}

impl Tally {
    /// Writes a line of JSON if requested.
    fn tell(&mut self, line: &Value) -> Result<()> {
        self.lines.as_mut().map_or(Ok(()), |lines| lines.write(format!("{line}\n").as_bytes()))
    }

    /// Records that a mesh was already done, or that another run is working on it.
    fn skip(&mut self, job: &Job, elsewhere: bool) {
        self.skipped += 1;
        self.elsewhere += usize::from(elsewhere);
        let mut line = json!({"mesh": job.mesh.to_string_lossy(), "skipped": true});
        if elsewhere {
            line["reason"] = ELSEWHERE.into();
        }
        if let Err(error) = self.tell(&line) {
            self.stop.get_or_insert(error);
        }
    }

    /// The reports of `jobs`, in their order, as JSON: those of this run, and earlier ones of other meshes.
    fn all_reports(&mut self, jobs: &[Job]) -> Result<Vec<Value>> {
        for (mesh, _) in &self.failed {
            self.earlier.remove(&*mesh.to_string_lossy());
        }
        let report = |(k, job): (usize, &Job)| match self.reports.get(&k) {
            Some(report) => Some(to_json("the report", report)),
            None => self.earlier.remove(&*job.mesh.to_string_lossy()).map(Ok),
        };
        jobs.iter().enumerate().filter_map(report).collect()
    }

    /// Records the result of a mesh; returns whether its line is written, if there is to be one.
    fn record_result(&mut self, number: usize, job: &Job, result: Result<Report>, seconds: f64) -> bool {
        let written = match result {
            Ok(report) => {
                let line = job.line(&report, seconds);
                self.reports.insert(number, report);
                self.tell(&line)
            }
            Err(error @ Error::Cancelled) => Err(error),
            Err(error) => self.record_failure(&job.mesh, &error, seconds),
        };
        written.map_err(|error| self.stop.get_or_insert(error)).is_ok()
    }

    /// Records why `mesh` failed.
    fn record_failure(&mut self, mesh: &Path, error: &Error, seconds: f64) -> Result<()> {
        let reason = message(error);
        // Most messages start with the file name, which the table already shows.
        let start = format!("{}: ", shown(mesh));
        let reason = reason.strip_prefix(&start).map_or(reason.clone(), str::to_string);
        let line = json!({"mesh": mesh.to_string_lossy(), "seconds": seconds, "error": reason});
        self.failed.push((mesh.to_path_buf(), reason));
        self.tell(&line)
    }
}

/// A running batch.
struct Batch<'a> {
    jobs: Vec<Job>,
    task: Task<'a>,
    app: &'a AppContext,
    /// Everything besides the mesh that the outputs depend on.
    options: Value,
    bars: BatchBars,
    table: Table,
    /// How progress is shown.
    style: Style,
    /// Threads and bytes of memory per mesh.
    share: (usize, u64),
    next: AtomicUsize,
    /// Number of folders that could not be listed.
    unlisted: usize,
    tally: Mutex<Tally>,
}

/// Segments all meshes; the `unlisted` folders are reported as failed ones.
fn all(jobs: Vec<Job>, unlisted: Vec<(PathBuf, Error)>, task: Task<'_>, app: &AppContext) -> Result<(), CliError> {
    let args = task.args;
    let start = Instant::now();
    let style = args.run.bars().style();
    let workers = usize::from(args.jobs).min(jobs.len());
    let whole = args.run.run(&(), app);
    let lines = args.json_lines.as_deref();
    let mut batch = Batch {
        options: options(task)?,
        bars: BatchBars::new(style, jobs.len() as u64),
        table: Table::of(&jobs),
        style,
        share: ((whole.threads / workers).max(1), whole.budget.total() / workers as u64),
        next: AtomicUsize::new(0),
        unlisted: unlisted.len(),
        tally: Mutex::default(),
        jobs,
        task,
        app,
    };
    if batch.shows_lines() {
        batch.bars.say(&batch.table.row("mesh", "faces", "parts", "seconds"));
    }
    batch.tally.get_mut().unwrap_or_else(PoisonError::into_inner).lines =
        lines.map(|path| Sink::of(path).open(args.resume)).transpose()?;
    batch.tally.get_mut().unwrap_or_else(PoisonError::into_inner).earlier = earlier_reports(args)?;
    for (folder, error) in unlisted {
        batch.bars.complain(&folder, &message(&error), file_of(&error));
        batch.tally.get_mut().unwrap_or_else(PoisonError::into_inner).record_failure(&folder, &error, 0.)?;
    }
    std::thread::scope(|scope| {
        (1..workers).for_each(|_| drop(spawn(scope, || batch.work())));
        batch.work();
    });
    batch.conclude(start)
}

/// Everything besides the mesh that outputs depend on.
fn options(task: Task<'_>) -> Result<Value> {
    let args = task.args;
    let file = |path: &Option<PathBuf>| path.as_deref().map(input::identity).transpose();
    let (like, edits_of_like) = (&args.like.like, args.like.like.as_ref().and(args.edits.edits.clone()));
    Ok(json!({
        "edits": task.edits, "hints": args.edits.hints, "names": file(&args.edits.names)?,
        "like": [file(like)?, file(&edits_of_like)?],
        "params": task.params, "seed": args.run.seed.unwrap_or(0), "ply_form": format!("{:?}", args.form.ply.ply_form),
        "vertex_labels": args.form.ply.vertex_labels, "split_vertices": args.form.ply.split_vertices,
        "split_faces": args.form.ply.split_faces,
        "embedding_columns": args.form.embedding_columns, "part_form": format!("{:?}", args.form.part_form),
        "cap": args.form.cap,
    }))
}

impl Batch<'_> {
    /// Whether human-readable lines are written.
    fn shows_lines(&self) -> bool {
        matches!(self.style, Style::Terminal | Style::Lines)
    }

    /// Runs one job after another, until none is left or the batch is to stop.
    fn work(&self) {
        loop {
            let k = self.next.fetch_add(1, Ordering::Relaxed);
            if k >= self.jobs.len() || lock(&self.tally).stop.is_some() {
                return;
            }
            self.job(k);
        }
    }

    /// The claims on the outputs of `job`; `None` if it is done and need not be done again.
    ///
    /// # Errors
    /// [`Error::Unusable`] if another run is making them, and this one leaves them to it.
    fn claims(&self, job: &Job, provenance: Option<&Provenance>) -> Result<Option<Vec<Claim>>> {
        if !self.task.args.resume {
            return Ok(Some(job.claims().unwrap_or_default()));
        }
        if job.is_done(provenance) {
            return Ok(None);
        }
        let claims = job.claims()?;
        // Another run may have finished it meanwhile.
        Ok((!job.is_done(provenance)).then_some(claims))
    }

    /// Cuts mesh `k`, unless its outputs exist, or another run is making them.
    fn job(&self, k: usize) {
        let (job, args) = (&self.jobs[k], self.task.args);
        let mine = self.bars.of_mesh(&job.mesh.display().to_string());
        let provenance = job.provenance(&self.options);
        let claims = match self.claims(job, provenance.as_ref()) {
            Ok(Some(claims)) => claims,
            skipped => {
                let elsewhere = skipped.is_err();
                if elsewhere {
                    mine.note_of_work(&format!("{ELSEWHERE}, and it is skipped"));
                }
                lock(&self.tally).skip(job, elsewhere);
                self.bars.end(&mine, "");
                return;
            }
        };
        if args.resume {
            job.tell_of_outputs(&mine);
        }
        let begin = Instant::now();
        let mut run = args.run.run(&mine, self.app);
        (run.threads, run.budget) = (self.share.0, Budget::new(self.share.1));
        let mark = |provenance| job.outputs.iter().map(move |output| Provenance::mark(provenance, output));
        let marks: Vec<_> = provenance.iter().flat_map(mark).collect();
        // A panic fails only its mesh.
        let work = || job.check(&run.budget).and_then(|()| one(job, self.task, &mine, &run, self.app));
        let result = catch(work).flatten();
        let seconds = begin.elapsed().as_secs_f64();
        let row = result.as_ref().map_or(String::new(), |report| self.table.row_of(&job.mesh, report, seconds));
        self.bars.end(&mine, &row);
        if let Err(error) = &result
            && !matches!(error, Error::Cancelled)
        {
            self.bars.complain(&job.mesh, &message(error), file_of(error));
        }
        let is_done = result.is_ok();
        let is_told = lock(&self.tally).record_result(k, job, result, seconds);
        // Only now does it count as done: a mesh that is skipped has its line.
        for mark in marks {
            if !is_done {
                mark.undo();
            } else if is_told {
                mark.complete();
            }
        }
        drop(claims);
    }

    /// Reports the result of the batch, which started at `start`.
    fn conclude(self, start: Instant) -> Result<(), CliError> {
        self.bars.finish();
        let shows_lines = self.shows_lines();
        let mut tally = self.tally.into_inner().unwrap_or_else(PoisonError::into_inner);
        let json = &self.task.args.json;
        if let Some(error) = tally.stop.take() {
            // What is done stays done, so its reports stay too, in a file to which another run can add.
            if matches!(error, Error::Cancelled) && !json.to_stdout() {
                json.publish(&tally.all_reports(&self.jobs)?)?;
            }
            return Err(error.into());
        }
        let needs_check = |(&job, report): (&usize, &Report)| {
            (report.like.as_ref()?["needs_check"] == true).then(|| shown(&self.jobs[job].mesh))
        };
        let doubtful: Vec<String> = tally.reports.iter().filter_map(needs_check).collect();
        if shows_lines && !doubtful.is_empty() {
            tell(&format!("check {} of {}: {}", doubtful.len(), tally.reports.len(), doubtful.join(", ")));
        }
        json.publish(&tally.all_reports(&self.jobs)?)?;
        let (all, failed) = (self.jobs.len() + self.unlisted, tally.failed.len());
        if shows_lines {
            tally.failed.iter().for_each(|(mesh, reason)| tell(&format!("failed: {}: {reason}", shown(mesh))));
            let done = all - failed - tally.skipped;
            let mut skipped = if tally.skipped > 0 { format!(", {} skipped", tally.skipped) } else { String::new() };
            if tally.elsewhere > 0 {
                skipped += &format!(" ({} in another run)", tally.elsewhere);
            }
            let seconds = start.elapsed().as_secs_f64();
            let all = counted(all, "mesh");
            tell(&format!("{all}: {done} done, {failed} failed{skipped}, in {seconds:.1} s"));
        }
        if failed == 0 {
            return Ok(());
        }
        let sum = format!("{failed} of {} failed", counted(all, "mesh"));
        if self.style == Style::Quiet {
            tell(&format!("nystrom-stream: {sum}"));
        }
        Err(CliError::Reported(sum))
    }
}
