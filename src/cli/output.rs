//! Where results go: the ending of the name of an output chooses its format. JSON and text reports.

use super::choices::choice;
use super::options::CliError;
use super::progress::counted;
use super::sink::{Sink, check_is_no_stream, folder_of, print};
use nystrom_stream::apps::edits::Edits;
use nystrom_stream::apps::export::parquet::{self, Coordinates};
use nystrom_stream::apps::export::split::{self, Folder, PartForm};
use nystrom_stream::apps::export::{glb, obj};
use nystrom_stream::apps::measure;
use nystrom_stream::apps::page::{CellModel, Cuts, Page};
use nystrom_stream::apps::picture::{self, PictureParams};
use nystrom_stream::base::{Error, Result, Told, printable};
use nystrom_stream::mesh::ply::labelled::{Labelling, PlyForm, PlyOptions, write_labelled, write_labelled_to};
use nystrom_stream::mesh::{Document, Mesh, ends_with, seg};
use nystrom_stream::pipeline::cuts::KeptCuts;
use nystrom_stream::store::{Context, Run, WorkDir, json, npy};
use serde_json::{Value, json};
use std::collections::HashSet;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Endings of mesh files, longer ones first.
pub const ENDINGS: [&str; 8] = [".ply.gz", ".obj.gz", ".off.gz", ".stl.gz", ".ply", ".obj", ".off", ".stl"];

/// Options of PLY outputs.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct PlyArgs {
    /// Encoding of PLY outputs
    #[arg(long, value_parser = choice::<PlyForm>(), default_value = "same", value_name = "FORM")]
    pub ply_form: PlyForm,
    /// Label and colour the vertices of PLY outputs too (scalar_label, red, green, blue), for Blender, CloudCompare and
    /// Open3D, which show no colours of faces; colours that the vertices have are replaced
    #[arg(long)]
    pub vertex_labels: bool,
    /// Give each part vertices of its own in PLY outputs, labelled and coloured, so that colours end at boundaries;
    /// other properties of the input are left out
    #[arg(long, conflicts_with = "vertex_labels")]
    pub split_vertices: bool,
    /// Split the triangles of PLY outputs where smooth boundaries cross them, in the place of boundaries along
    /// edges; creases stay on edges
    #[arg(long, conflicts_with_all = ["vertex_labels", "split_vertices"])]
    pub split_faces: bool,
}

/// `--json`, in the one form that it has everywhere.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct JsonArgs {
    /// Write a report as JSON, to standard output or to FILE
    #[arg(long, value_name = "FILE", num_args = 0..=1, default_missing_value = "-", require_equals = true)]
    pub json: Option<PathBuf>,
}

impl JsonArgs {
    /// Whether JSON goes to standard output.
    pub fn to_stdout(&self) -> bool {
        self.json.as_deref() == Some(Path::new("-"))
    }

    /// Writes `report` with the seconds and the notes of the run, where it is asked for.
    pub fn publish_with(&self, mut report: Value, told: &Told) -> Result<()> {
        report["seconds"] = json!(told.seconds());
        report["notes"] = json!(told.notes());
        self.publish(&report)
    }

    /// Writes `report` where it is asked for.
    pub fn publish(&self, report: &impl serde::Serialize) -> Result<()> {
        let Some(target) = &self.json else { return Ok(()) };
        let text = serde_json::to_string_pretty(report).map_err(|error| {
            Error::unusable(target, format!("the report cannot be told as JSON: {error}"), "report this as a fault")
        })?;
        Sink::of(target).write(&(text + "\n"))
    }

    /// Prints `text`, unless JSON goes to standard output, and writes `report` where it is asked for.
    pub fn publish_or_print(&self, report: &impl serde::Serialize, text: &str) -> Result<()> {
        if !self.to_stdout() {
            print(printable::lines(text).as_bytes())?;
        }
        self.publish(report)
    }
}

/// Formats of the files of a folder of parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum PartFile {
    /// PLY, with the number of each face in the input
    Ply,
    /// Binary STL, triangles alone
    Stl,
}

/// Options of outputs.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct FormArgs {
    #[command(flatten)]
    pub ply: PlyArgs,
    /// Format of the files in a folder of parts
    #[arg(long, value_enum, default_value = "ply", value_name = "FORM")]
    pub part_form: PartFile,
    /// Close the parts of a folder where they were cut off, and their holes: parts of a closed mesh become solids
    #[arg(long)]
    pub cap: bool,
    /// Add the coordinates of the spectral embedding to .parquet outputs
    #[arg(long)]
    pub embedding_columns: bool,
}

impl PlyArgs {
    /// As the library takes them.
    pub fn options(self) -> PlyOptions {
        PlyOptions::new(self.ply_form, self.vertex_labels)
            .splitting(self.split_vertices)
            .splitting_faces(self.split_faces)
    }

    /// Refuses options that none of `outputs` would follow.
    pub fn check(self, outputs: &[Output]) -> Result<(), CliError> {
        let is_file = |output: &Output| matches!(output, Output::Ply(_) | Output::Stdout);
        if self.split_faces && !outputs.iter().any(is_file) {
            return Err(CliError::Usage("--split-faces goes with a .ply output; other outputs keep the faces".into()));
        }
        let is_ply = |output: &Output| matches!(output, Output::Ply(_) | Output::Folder(_) | Output::Stdout);
        let split = (self.split_vertices, "--split-vertices");
        let given = [(self.vertex_labels, "--vertex-labels"), split, (self.ply_form != PlyForm::Same, "--ply-form")];
        match given.into_iter().find(|(given, _)| *given) {
            Some((_, option)) if !outputs.iter().any(is_ply) => {
                Err(CliError::Usage(format!("{option} goes with a .ply output")))
            }
            _ => Ok(()),
        }
    }
}

impl FormArgs {
    /// Refuses options that none of `outputs` would follow.
    pub fn check(self, outputs: &[Output]) -> Result<(), CliError> {
        self.ply.check(outputs)?;
        let folder = outputs.iter().any(|output| matches!(output, Output::Folder(_)));
        let table = outputs.iter().any(|output| matches!(output, Output::Parquet(_)));
        let (a_folder, a_table) = ("a folder of parts, as in -o parts/", "a .parquet output");
        let rules = [
            (self.part_form != PartFile::Ply && !folder, "--part-form", a_folder),
            (self.cap && !folder, "--cap", a_folder),
            (self.embedding_columns && !table, "--embedding-columns", a_table),
        ];
        match rules.into_iter().find(|(broken, ..)| *broken) {
            Some((_, option, output)) => Err(CliError::Usage(format!("{option} goes with {output}"))),
            None => Ok(()),
        }
    }
}

/// The results to write.
pub struct Results<'a> {
    /// Labels, colours, qualities.
    pub labelling: Labelling<'a>,
    /// Of PLY outputs.
    pub options: PlyOptions,
    /// Of folders of parts.
    pub part_form: PartFile,
    /// Whether the parts of folders are closed.
    pub cap: bool,
    /// For tables, if asked for.
    pub embedding: Option<Coordinates<'a>>,
    /// For tables of parts: the share of people who are expected to have each, where that is known.
    pub agreement: &'a [f64],
    /// For pages: the run's report.
    pub report: Value,
    /// For pages: other numbers of parts.
    pub cuts: Option<&'a KeptCuts>,
    /// For pages: the part of each cell, where it is known.
    pub cell_labels: &'a [u32],
    /// For pages: the edits that the labels are of.
    pub edits: Option<&'a Edits>,
}

/// An output and its form.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Output {
    /// A labelled PLY.
    Ply(PathBuf),
    /// One label per line.
    Seg(PathBuf),
    /// Labels as a NumPy array.
    Npy(PathBuf),
    /// A picture.
    Png(PathBuf),
    /// A table of the faces.
    Parquet(PathBuf),
    /// A mesh with one group per part.
    Obj(PathBuf),
    /// A table of the parts.
    Csv(PathBuf),
    /// A scene with one primitive per part.
    Glb(PathBuf),
    /// A page that shows the mesh.
    Html(PathBuf),
    /// One PLY per part, in this folder.
    Folder(PathBuf),
    /// A labelled PLY on standard output.
    Stdout,
}

impl std::fmt::Display for Output {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Self::Stdout => f.write_str("standard output"),
            _ => self.target().display().fmt(f),
        }
    }
}

impl Output {
    /// The output that `path` names.
    pub fn of(path: &Path) -> Result<Self, CliError> {
        if path == Path::new("-") {
            return Ok(Self::Stdout);
        }
        if path.to_string_lossy().ends_with(['/', std::path::MAIN_SEPARATOR]) || path.is_dir() {
            return Ok(Self::Folder(path.into()));
        }
        check_is_no_stream("-o", path)?;
        match path.extension().and_then(OsStr::to_str).map(str::to_ascii_lowercase).as_deref() {
            Some("ply") => Ok(Self::Ply(path.into())),
            Some("seg") => Ok(Self::Seg(path.into())),
            Some("npy") => Ok(Self::Npy(path.into())),
            Some("png") => Ok(Self::Png(path.into())),
            Some("parquet") => Ok(Self::Parquet(path.into())),
            Some("obj") => Ok(Self::Obj(path.into())),
            Some("csv") => Ok(Self::Csv(path.into())),
            Some("glb") => Ok(Self::Glb(path.into())),
            Some("html" | "htm") => Ok(Self::Html(path.into())),
            _ => Err(CliError::Usage(format!(
                "-o {}: unknown ending; end it with .ply, .seg, .npy, .parquet, .csv, .obj, .glb, .html or .png, or \
                 with / for a folder with one PLY per part",
                path.display()
            ))),
        }
    }

    /// The name of `mesh` without folder and ending.
    pub fn stem(mesh: &Path) -> String {
        let name = mesh.file_name().unwrap_or_default().to_string_lossy();
        let lower = name.to_ascii_lowercase();
        let ending = ENDINGS.into_iter().find(|ending| lower.ends_with(ending)).unwrap_or("");
        name[..name.len() - ending.len()].to_string()
    }

    /// `MESH.segmented.ply` beside `mesh`.
    pub fn beside(mesh: &Path) -> Self {
        Self::Ply(mesh.with_file_name(format!("{}.segmented.ply", Self::stem(mesh))))
    }

    /// As it is named on the command line: the file or folder, or `-`.
    pub fn target(&self) -> &Path {
        match self {
            Self::Ply(path) | Self::Seg(path) | Self::Npy(path) | Self::Png(path) | Self::Parquet(path) => path,
            Self::Csv(path) | Self::Obj(path) | Self::Glb(path) | Self::Html(path) | Self::Folder(path) => path,
            Self::Stdout => Path::new("-"),
        }
    }

    /// The file, or folder, if it is one.
    pub fn path(&self) -> Option<&Path> {
        (*self != Self::Stdout).then(|| self.target())
    }

    /// The file that is written last, if it is one.
    pub fn last_file(&self) -> Option<PathBuf> {
        match self {
            Self::Folder(path) => Some(path.join(split::LIST)),
            _ => self.path().map(Path::to_path_buf),
        }
    }

    /// Refuses an output that cannot be written, before any work.
    pub fn check(&self) -> Result<()> {
        Sink::of(self.target()).check()
    }

    /// Whether it cannot be written without the mesh.
    pub fn needs_mesh(&self) -> bool {
        !matches!(self, Self::Seg(_) | Self::Npy(_))
    }

    /// Whether it holds the names of parts.
    pub fn holds_names(&self) -> bool {
        !matches!(self, Self::Seg(_) | Self::Npy(_))
    }

    /// Whether it is a page, which needs report and cuts.
    pub fn is_page(&self) -> bool {
        matches!(self, Self::Html(_))
    }

    /// Writes the result; `opened` must be there where [`Output::needs_mesh`].
    pub fn write(&self, opened: Option<&Mesh>, results: &Results, run: &Run) -> Result<()> {
        match (self, opened) {
            (Self::Seg(path), _) => seg::write_seg(path, results.labelling.labels, run),
            (Self::Npy(path), _) => npy::write(path, results.labelling.labels, 1, true).map(drop),
            (_, Some(opened)) => self.write_mesh(opened, results, run),
            (_, None) => Err(Error::parameter("-o", "this form needs the mesh", "name the mesh")),
        }
    }

    fn write_mesh(&self, opened: &Mesh, results: &Results, run: &Run) -> Result<()> {
        let mesh = opened;
        let Results { labelling, options, embedding, .. } = results;
        match self {
            Self::Seg(_) | Self::Npy(_) => Ok(()),
            Self::Ply(path) => write_labelled(mesh, path, labelling, *options, run),
            Self::Png(path) => {
                let params = PictureParams::default();
                let marks = (labelling.colours, labelling.names);
                picture::render_named(mesh, Some(labelling.labels), marks, &params, run)?.write_png(path)
            }
            Self::Parquet(path) => parquet::write(path, mesh, labelling, *embedding, run),
            Self::Csv(path) => {
                let of_labels = |context: Context<'_>| measure::labelled(mesh, labelling.labels, context);
                let measures = measured(path, run, of_labels)?;
                json::publish(
                    path,
                    measure::table(&measures, labelling.colours, labelling.names, results.agreement).as_bytes(),
                )
            }
            Self::Obj(path) => obj::write(path, mesh, labelling, run),
            Self::Glb(path) => glb::write(path, mesh, labelling, run),
            Self::Html(path) => {
                let title = mesh.path().file_name().unwrap_or_default().to_string_lossy();
                let cuts = results.cuts.map(|cuts| Cuts {
                    cells: &cuts.cells,
                    parts: &cuts.parts,
                    model: Some(CellModel {
                        affinities: cuts.kept.affinities(),
                        tree: &cuts.kept.decision.tree,
                        start: results.cell_labels,
                    }),
                });
                let (labels, colours, report) = (labelling.labels, labelling.colours, &results.report);
                let (names, edits) = (labelling.names, results.edits);
                Page { title: &title, mesh, labels, colours, names, cuts, edits, report }.write(path, run)
            }
            Self::Folder(path) => {
                let text = match options.form {
                    PlyForm::Same => mesh.document().is_some_and(Document::is_text),
                    form => form == PlyForm::Ascii,
                };
                let form = match results.part_form {
                    PartFile::Stl => PartForm::Stl,
                    PartFile::Ply if text => PartForm::Text,
                    PartFile::Ply => PartForm::Binary,
                };
                split::write(path, mesh, labelling, Folder { form, cap: results.cap }, run)
            }
            Self::Stdout => {
                let mut out = std::io::stdout().lock();
                write_labelled_to(mesh, "<stdout>", &mut out, labelling, *options, run)
            }
        }
    }
}

/// The outputs that `paths` name, each once.
pub fn outputs_of(paths: &[PathBuf]) -> Result<Vec<Output>, CliError> {
    let mut outputs: Vec<Output> = Vec::with_capacity(paths.len());
    for path in paths {
        let output = Output::of(path)?;
        if outputs.contains(&output) {
            return Err(CliError::Usage(format!("-o {}: given more than once; give it once", path.display())));
        }
        outputs.push(output);
    }
    Ok(outputs)
}

/// Refuses `files`, inputs as well as outputs, that a folder of parts among `outputs` would replace, or that would
/// replace one of its own.
pub fn check_folders<'a>(
    outputs: impl IntoIterator<Item = &'a Output>,
    files: impl IntoIterator<Item = &'a PathBuf>,
) -> Result<(), CliError> {
    let folder = |output: &Output| if let Output::Folder(path) = output { path.canonicalize().ok() } else { None };
    let folders: HashSet<PathBuf> = outputs.into_iter().filter_map(folder).collect();
    let clashes = |path: &&PathBuf| {
        let named = path.file_name().and_then(OsStr::to_str).is_some_and(split::is_file_name);
        named && folder_of(path).canonicalize().is_ok_and(|folder| folders.contains(&folder))
    };
    match files.into_iter().find(clashes) {
        Some(path) => {
            let text = "lies in a folder of parts, which has a file of this name; name another file or folder";
            Err(CliError::Usage(format!("{}: {text}", path.display())))
        }
        None => Ok(()),
    }
}

/// What a command ends with: how many `faces` are in how many `parts`, how long it took, and where they went.
pub fn ending(faces: &str, parts: usize, start: Instant, outputs: &[Output]) -> String {
    let outputs: Vec<String> = outputs.iter().map(Output::to_string).collect();
    let (parts, seconds) = (counted(parts, "part"), start.elapsed().as_secs_f64());
    format!("{faces} in {parts} in {seconds:.2} s, written to {}", outputs.join(", "))
}

/// Refuses a table of names where neither one of `outputs` nor `json` would hold them.
pub fn check_names(names: Option<&Path>, outputs: &[Output], json: &JsonArgs) -> Result<(), CliError> {
    if names.is_some() && json.json.is_none() && !outputs.iter().any(Output::holds_names) {
        let text = "--names goes with --json or an output that holds names: any but .seg and .npy";
        return Err(CliError::Usage(text.into()));
    }
    Ok(())
}

/// What `measure` finds without telling of its stages; the graph that says which faces touch goes beside `path`.
pub fn measured<R>(path: &Path, run: &Run, measure: impl FnOnce(Context<'_>) -> Result<R>) -> Result<R> {
    let work = WorkDir::temporary(&folder_of(path))?.holding(&run.budget);
    let silent = Run { threads: run.threads, budget: run.budget.clone(), cancel: run.cancel.clone(), ..Run::new(&()) };
    measure(Context::new(&work, &silent))
}

/// A number with as many significant digits as the precision says; without an exponent where it
/// is neither huge nor tiny.
pub struct Significant(pub f64);

impl std::fmt::Display for Significant {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let digits = f.precision().unwrap_or(6) as i32;
        let power = if self.0 == 0. { 0 } else { self.0.abs().log10().floor() as i32 };
        if (-5..15).contains(&power) {
            write!(f, "{:.*}", (digits - 1 - power).max(0) as usize, self.0)
        } else {
            write!(f, "{:.*e}", (digits - 1).max(0) as usize, self.0)
        }
    }
}

/// Refuses charts of an unknown form before any work.
pub fn check_charts(option: &str, paths: &[PathBuf]) -> Result<(), CliError> {
    match paths.iter().find(|path| !["svg", "png"].iter().any(|ending| ends_with(path, ending))) {
        Some(path) => Err(CliError::Usage(format!("{option} {}: no chart; end it with .svg or .png", path.display()))),
        None => Ok(()),
    }
}
