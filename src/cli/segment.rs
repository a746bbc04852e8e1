//! `segment` on one mesh: its options, the cut, and the outputs.

use super::edits::{EditArgs, Like, LikeArgs, NameTable, corrections};
use super::input::{check_there, read};
use super::method::MethodArgs;
use super::options::{AppContext, ForceArgs, RunArgs, ScratchArgs};
use super::output::{FormArgs, JsonArgs, Output, scratch_folder};
use super::progress::Bars;
use super::provenance::{Claim, Provenance};
use super::results::Cut;
use nystrom_stream::apps::edits::Edits;
use nystrom_stream::apps::export::csv;
use nystrom_stream::apps::measure;
use nystrom_stream::base::{Progress, Result};
use nystrom_stream::pipeline::edits::Corrections;
use nystrom_stream::pipeline::like::{self, LikeFacts, TransferMethod};
use nystrom_stream::pipeline::report::Report;
use nystrom_stream::pipeline::{SegmentParams, labels, segment_corrected};
use nystrom_stream::store::json::value as to_json;
use nystrom_stream::store::{Budget, Context, Run};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Arguments of `segment`.
#[derive(Clone, Debug, clap::Args)]
pub struct SegmentArgs {
    /// PLY, OBJ, OFF and STL files, also .gz; folders of them; patterns; `-` reads standard input
    #[arg(required = true, value_name = "MESH")]
    pub meshes: Vec<PathBuf>,
    /// Output, repeatable: .ply, .seg, .npy, .parquet, .csv, .obj, .glb, .html or .png; a folder, ending in /, for one
    /// PLY per part; `-` for standard output. For several meshes, {} stands for the name of the mesh, as in out/{}.seg
    /// [default: MESH.segmented.ply]
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
    /// Write one line of JSON per mesh when it is done, to standard output or to FILE; with --resume, append to FILE
    #[arg(
        long,
        value_name = "FILE",
        num_args = 0..=1,
        default_missing_value = "-",
        require_equals = true,
        help_heading = "Many meshes"
    )]
    pub json_lines: Option<PathBuf>,
    /// Number of meshes processed at the same time; they share threads and memory evenly
    #[arg(
        long,
        value_name = "N",
        default_value_t = 1,
        value_parser = clap::value_parser!(u16).range(1..),
        help_heading = "Many meshes"
    )]
    pub jobs: u16,
    /// Skip meshes whose outputs a batch with the same options has written since the mesh was last changed, and those
    /// that another batch is working on
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
    /// Do not check free disk space before starting
    #[arg(long, help_heading = "Running")]
    pub no_plan: bool,
}

impl SegmentArgs {
    /// Whether a batch option is given.
    pub fn is_batch(&self) -> bool {
        self.jobs > 1 || self.resume || self.json_lines.is_some()
    }
}

/// A mesh and its outputs.
pub struct Job {
    /// The mesh; `-` is standard input.
    pub mesh: PathBuf,
    /// At least one output.
    pub outputs: Vec<Output>,
}

impl Job {
    /// The job of `mesh`; without `outputs` the result goes beside it, or to standard output if the mesh is standard
    /// input.
    pub fn of(mesh: PathBuf, mut outputs: Vec<Output>) -> Self {
        if outputs.is_empty() {
            outputs.push(if mesh.as_os_str() == "-" { Output::stdout() } else { Output::segmented(&mesh) });
        }
        Self { mesh, outputs }
    }

    /// Whether all outputs exist and are newer than the mesh.
    fn is_newer(&self) -> bool {
        let changed = |path: PathBuf| std::fs::metadata(path).and_then(|data| data.modified()).ok();
        let Some(mesh) = changed(self.mesh.clone()) else { return false };
        self.outputs.iter().all(|output| output.last_file().and_then(changed).is_some_and(|time| time >= mesh))
    }

    /// The provenance of the outputs; `None` if the mesh cannot be read.
    pub fn provenance(&self, options: &Value) -> Option<Provenance> {
        Provenance::new(&self.mesh, options)
    }

    /// Whether `provenance` made all outputs. It identifies the mesh by its content: the time of a mesh may be in the
    /// future, if it is from a machine whose clock is ahead.
    pub fn is_done(&self, provenance: Option<&Provenance>) -> bool {
        provenance.is_some_and(|provenance| self.outputs.iter().all(|output| provenance.is_current(output)))
    }

    /// Notes that existing outputs, which are not [done](Self::is_done), are replaced.
    pub fn tell_of_outputs(&self, progress: &Bars) {
        if self.is_newer() {
            progress.note_of_work("its outputs may be from another mesh or other options, and are written again");
        }
    }

    /// Claims the outputs.
    ///
    /// # Errors
    /// [`Error::Unusable`] if another run has claimed one.
    pub fn claims(&self) -> Result<Vec<Claim>> {
        self.outputs.iter().filter_map(|output| Claim::of(output).transpose()).collect()
    }

    /// Rejects a missing mesh, and outputs that cannot be written within `budget`, before any work.
    pub fn check(&self, budget: &Budget) -> Result<()> {
        check_there(&self.mesh)?;
        self.outputs.iter().try_for_each(|output| output.check().and_then(|()| output.check_budget(budget)))
    }

    /// One line of JSON about the job.
    pub fn line(&self, report: &Report, seconds: f64) -> Value {
        let outputs: Vec<_> = self.outputs.iter().filter_map(Output::path).map(Path::to_string_lossy).collect();
        let mut line = json!({
            "mesh": self.mesh.to_string_lossy(), "faces": report.input.faces, "parts": report.parts_with_faces(),
            "gamma_per_face": report.gamma_per_face, "seconds": seconds, "outputs": outputs,
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

/// The task for each mesh.
#[derive(Clone, Copy)]
pub struct Task<'a> {
    /// The arguments.
    pub args: &'a SegmentArgs,
    /// Their parameters.
    pub params: &'a SegmentParams,
    /// The edits.
    pub edits: Option<&'a Edits>,
    /// The names of the parts.
    pub names: Option<&'a NameTable>,
    /// The mesh whose parts it is to get.
    pub like: Option<&'a Like>,
}

/// Maximum number of parts that a note names; the report names all.
const SHOWN_PARTS: usize = 10;

/// Why a person should check parts that were transferred.
fn doubts(facts: &LikeFacts) -> String {
    let way = if facts.method == TransferMethod::Position { "nearest faces" } else { "matched shapes" };
    let mut text = format!("parts from {way}, confidence {:.2}", facts.confidence);
    if facts.ambiguous {
        text += ", parts may be mirrored";
    }
    if !facts.missing.is_empty() {
        let parts: Vec<String> = facts.missing.iter().take(SHOWN_PARTS).map(u32::to_string).collect();
        text += &format!(", missing part {}", parts.join(", "));
        if facts.missing.len() > SHOWN_PARTS {
            text += &format!(" and {} more", facts.missing.len() - SHOWN_PARTS);
        }
    }
    text
}

/// Segments one mesh, which was [checked](Job::check), and writes its outputs.
pub fn one(job: &Job, task: Task<'_>, bars: &Bars, run: &Run, app: &AppContext) -> Result<Report> {
    let SegmentArgs { edits, method, .. } = task.args;
    cut(job, task, bars, run, app).map_err(|error| edits.blamed(&method.parts, error))
}

fn cut(job: &Job, task: Task<'_>, bars: &Bars, run: &Run, app: &AppContext) -> Result<Report> {
    let Task { args, params, edits, names, like } = task;
    let Job { mesh: path, outputs } = job;
    let work = args.scratch.work(args.work_dir.as_deref(), || scratch_folder(outputs), run)?;
    if path.as_os_str() != "-" && !args.no_plan {
        super::plan::check(path, params, Context::new(&work, run))?;
    }
    let (opened, identity) = read(path, args.force, Context::new(&work, run))?;
    let of_mesh = |name: &String| opened.face_values(name, Context::new(&work, run));
    let painted = args.edits.hints.as_ref().map(of_mesh).transpose()?;
    let mut transferred =
        like.map(|like| like::transfer_labels(like.reference(), &opened, Context::new(&work, run))).transpose()?;
    let painted = transferred.as_ref().map(|transferred| &transferred.values).or(painted.as_ref());
    let placed = edits.map(|edits| edits.on(&opened, run)).transpose()?;
    let corrections = Corrections { transferred: transferred.is_some(), ..corrections(placed.as_ref(), painted) };
    let mut result = segment_corrected(&opened, &identity, params, corrections, Context::new(&work, run))?;
    if let (Some(like), Some(transferred)) = (like, &mut transferred) {
        result = like::apply_reference_numbering(result, transferred, like.reference(), Context::new(&work, run))?;
    }
    if let Some(names) = names {
        names.give(&mut result.names, result.colours.len())?;
        labels::keep(&result, Context::new(&work, run))?;
    }
    let likeness = transferred.as_ref().map(|transferred| &transferred.facts);
    if let Some(facts) = likeness.filter(|facts| facts.needs_check) {
        run.progress.note(&format!("{}: check the {}", path.display(), doubts(facts)));
    }
    let report = || {
        let (context, peak) = (Context::new(&work, run), Some((app.peak)()));
        let report = Report::new(opened.path(), params, &result, context, bars.log(), peak)?;
        Ok(Report { like: likeness.map(|facts| to_json("the likeness", facts)).transpose()?, ..report })
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
    let report_text = || to_json("the report", &report()?);
    cut.write(outputs, args.form, Some(&opened), report_text, Context::new(&work, run))?;
    let mut all = report()?;
    if args.measure {
        let of_parts = |context: Context<'_>| measure::parts(&opened, &result.labels, result.colours.len(), context);
        all.measures = Some(csv::measured(&work.file("measures"), run, of_parts)?);
    }
    Ok(all)
}
