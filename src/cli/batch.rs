//! `segment` of many meshes: files, folders and patterns become a list; jobs take from it; a table grows.
//!
//! Jobs share the threads and the memory evenly, so that what one mesh gets depends on `--jobs` alone, and no mesh can
//! starve another. A mesh that fails is told and the rest goes on.

use super::bars::{BatchBars, Style, tell};
use super::output::{ENDINGS, Output, publish};
use super::segment::{self, Args};
use super::{AppContext, Failure};
use nystrom_stream::base::{Error, Result};
use nystrom_stream::pipeline::SegmentParams;
use nystrom_stream::pipeline::report::Report;
use nystrom_stream::store::Budget;
use serde_json::json;
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// Endings of results, which no folder offers as meshes.
const RESULT: &str = ".segmented.ply";

fn named(path: &Path, endings: &[&str]) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    endings.iter().any(|ending| name.ends_with(ending))
}

/// The meshes that `words` name, and whether they are to be treated as many: files as they are, the meshes of folders, what
/// patterns match, in order and each once.
pub fn meshes(words: &[PathBuf]) -> Result<(Vec<PathBuf>, bool), Failure> {
    let (mut all, mut many) = (Vec::new(), words.len() > 1);
    for word in words {
        let text = word.to_string_lossy();
        if word.is_dir() {
            many = true;
            let entries = std::fs::read_dir(word).map_err(Error::io(word, "list"))?;
            let mut found: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
            found.retain(|path| named(path, &ENDINGS) && !named(path, &[RESULT]) && !path.is_dir());
            if found.is_empty() {
                return Err(Error::unusable(
                    word,
                    "holds no mesh (.ply, .obj, .off, .stl, or these with .gz)",
                    "name another folder",
                )
                .into());
            }
            found.sort();
            all.extend(found);
        } else if !word.exists() && text.contains(['*', '?', '[']) {
            many = true;
            let wrong = |problem: String| Failure::Misused(format!("{text}: {problem}"));
            let paths = glob::glob(&text).map_err(|error| wrong(format!("no pattern: {error}")))?;
            let found: Vec<PathBuf> = paths.flatten().filter(|path| !named(path, &[RESULT])).collect();
            if found.is_empty() {
                return Err(Error::unusable(word, "matches no file", "check the pattern").into());
            }
            all.extend(found);
        } else {
            all.push(word.clone());
        }
    }
    let mut seen = std::collections::BTreeSet::new();
    all.retain(|path| seen.insert(path.clone()));
    Ok((all, many))
}

/// A mesh and where its results go.
struct Job {
    mesh: PathBuf,
    outputs: Vec<Output>,
}

/// The outputs of every mesh: `patterns` with `{}` standing for the mesh's name without ending, else one beside it.
fn jobs(meshes: Vec<PathBuf>, patterns: &[PathBuf]) -> Result<Vec<Job>, Failure> {
    let mut owner: BTreeMap<PathBuf, PathBuf> = BTreeMap::new();
    let mut jobs = Vec::with_capacity(meshes.len());
    for mesh in meshes {
        let outputs = if patterns.is_empty() {
            vec![Output::beside(&mesh)]
        } else {
            let stem = Output::stem(&mesh);
            let fill = |pattern: &PathBuf| Output::of(Path::new(&pattern.to_string_lossy().replace("{}", &stem)));
            patterns.iter().map(fill).collect::<Result<_, _>>()?
        };
        for path in outputs.iter().filter_map(Output::path) {
            if let Some(other) = owner.insert(path.to_path_buf(), mesh.clone()) {
                return Err(Failure::Misused(format!(
                    "-o: {} and {} would both be written to {}",
                    other.display(),
                    mesh.display(),
                    path.display()
                )));
            }
        }
        jobs.push(Job { mesh, outputs });
    }
    Ok(jobs)
}

impl Job {
    /// Whether all outputs are there and newer than the mesh.
    fn is_done(&self) -> bool {
        let changed = |path: PathBuf| std::fs::metadata(path).and_then(|data| data.modified()).ok();
        let Some(mesh) = changed(self.mesh.clone()) else { return false };
        self.outputs.iter().all(|output| output.last_file().and_then(changed).is_some_and(|time| time >= mesh))
    }
}

/// A line of the table.
fn row(mesh: &str, faces: &str, parts: &str, gamma: &str, seconds: &str) -> String {
    format!("{mesh:40} {faces:>10} {parts:>6} {gamma:>10} {seconds:>9}")
}

fn row_of(mesh: &Path, report: &Report, seconds: f64) -> String {
    let gamma = if report.gamma > 0. { format!("{:.3e}", report.gamma_per_face) } else { "-".into() };
    let (faces, parts) = (report.input.faces.to_string(), report.parts.len().to_string());
    row(&mesh.display().to_string(), &faces, &parts, &gamma, &format!("{seconds:.3}"))
}

/// The JSON line of a mesh.
fn line_of(job: &Job, report: &Report, seconds: f64) -> serde_json::Value {
    let outputs: Vec<_> = job.outputs.iter().filter_map(Output::path).collect();
    let gamma = (report.gamma > 0.).then_some(report.gamma_per_face);
    json!({
        "mesh": job.mesh, "faces": report.input.faces, "parts": report.parts.len(), "gamma_per_face": gamma,
        "seconds": seconds, "outputs": outputs,
    })
}

/// Where JSON lines go.
enum Lines {
    Nowhere,
    Stdout,
    File(PathBuf, std::fs::File),
}

impl Lines {
    fn open(target: Option<&Path>) -> Result<Self> {
        match target {
            None => Ok(Self::Nowhere),
            Some(path) if path == Path::new("-") => Ok(Self::Stdout),
            Some(path) => Ok(Self::File(path.into(), std::fs::File::create(path).map_err(Error::io(path, "create"))?)),
        }
    }

    fn write(&mut self, line: &serde_json::Value) -> Result<()> {
        match self {
            Self::Nowhere => Ok(()),
            Self::Stdout => writeln!(std::io::stdout(), "{line}").map_err(Error::io("<stdout>", "write")),
            Self::File(path, file) => writeln!(file, "{line}").map_err(Error::io(path, "write")),
        }
    }
}

/// What the jobs have done.
struct Tally {
    lines: Lines,
    reports: BTreeMap<usize, Report>,
    failed: Vec<(PathBuf, String)>,
    skipped: usize,
    stop: Option<Error>,
}

/// Segments all `meshes`.
pub fn run(meshes: Vec<PathBuf>, args: &Args, params: &SegmentParams, app: &AppContext) -> Result<(), Failure> {
    let start = Instant::now();
    let jobs = jobs(meshes, &args.output)?;
    let style = args.run.bars().style();
    let bars = BatchBars::new(style, jobs.len() as u64);
    let told = matches!(style, Style::Terminal | Style::Lines);
    if told {
        bars.complain(&row("mesh", "faces", "parts", "Γ/n", "seconds"));
    }
    let lines = Lines::open(args.json_lines.as_deref())?;
    let tally = Tally { lines, reports: BTreeMap::new(), failed: Vec::new(), skipped: 0, stop: None };
    let tally = Mutex::new(tally);
    let next = AtomicUsize::new(0);
    let workers = usize::from(args.jobs).min(jobs.len());
    let whole = args.run.run(&(), app);
    let (threads, memory) = ((whole.threads / workers).max(1), whole.budget.total() / workers as u64);
    std::thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| {
                loop {
                    let k = next.fetch_add(1, Ordering::Relaxed);
                    let lock = || tally.lock().unwrap_or_else(|poison| poison.into_inner());
                    if k >= jobs.len() || lock().stop.is_some() {
                        return;
                    }
                    let job = &jobs[k];
                    let mine = bars.of_mesh(&job.mesh.display().to_string());
                    if args.resume && job.is_done() {
                        lock().skipped += 1;
                        bars.end(&mine, "");
                        continue;
                    }
                    let begin = Instant::now();
                    let mut run = args.run.run(&mine, app);
                    (run.threads, run.budget) = (threads, Budget::new(memory));
                    let result = segment::one(&job.mesh, args, params, &job.outputs, &mine, &run, app);
                    let seconds = begin.elapsed().as_secs_f64();
                    let mut tally = lock();
                    settle(&mut tally, job, k, result, seconds, args, (&bars, &mine));
                }
            });
        }
    });
    bars.finish();
    let tally = tally.into_inner().unwrap_or_else(|poison| poison.into_inner());
    if let Some(error) = tally.stop {
        return Err(error.into());
    }
    if let Some(target) = &args.json {
        publish(target, &tally.reports.values().collect::<Vec<_>>())?;
    }
    let (all, failed) = (jobs.len(), tally.failed.len());
    if told {
        let skipped = if tally.skipped > 0 { format!(", {} were there already", tally.skipped) } else { String::new() };
        tell(&format!(
            "{} of {all} meshes done in {:.1} s{skipped}",
            all - failed - tally.skipped,
            start.elapsed().as_secs_f64()
        ));
    }
    if failed == 0 {
        return Ok(());
    }
    if told {
        tally.failed.iter().for_each(|(mesh, reason)| tell(&format!("failed: {}: {reason}", mesh.display())));
    }
    tell(&format!("nystrom-stream: {failed} of {all} meshes failed"));
    Err(Failure::Reported)
}

/// Notes how a mesh went.
fn settle(
    tally: &mut Tally,
    job: &Job,
    number: usize,
    result: Result<Report>,
    seconds: f64,
    args: &Args,
    (bars, mine): (&BatchBars, &super::bars::Bars),
) {
    let written = match result {
        Ok(report) => {
            bars.end(mine, &row_of(&job.mesh, &report, seconds));
            let line = line_of(job, &report, seconds);
            if args.json.is_some() {
                tally.reports.insert(number, report);
            }
            tally.lines.write(&line)
        }
        Err(error @ Error::Cancelled) => Err(error),
        Err(error) => {
            bars.end(mine, "");
            bars.complain(&format!("nystrom-stream: {error}"));
            let reason = error.to_string();
            // Most messages begin with the file.
            let start = format!("{}: ", job.mesh.display());
            let reason = reason.strip_prefix(&start).map_or(reason.clone(), str::to_string);
            let line = json!({"mesh": job.mesh, "seconds": seconds, "error": reason});
            tally.failed.push((job.mesh.clone(), reason));
            tally.lines.write(&line)
        }
    };
    if let Err(error) = written {
        tally.stop.get_or_insert(error);
    }
}
