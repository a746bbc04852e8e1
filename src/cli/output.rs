//! Destinations of results: the file extension of an output selects its format. JSON and text reports.

use super::choices::choice;
use super::options::CliError;
use super::sink::{Sink, check_is_no_stream, print};
use nystrom_stream::SaveOptions;
use nystrom_stream::apps::export::Form;
use nystrom_stream::apps::export::split::{self, PartForm};
use nystrom_stream::apps::picture::{NO_PICTURE, PictureParams};
use nystrom_stream::base::printable::{counted, human, noun};
use nystrom_stream::base::{Error, Result, RunLog, printable};
use nystrom_stream::mesh::ply::labelled::PlyForm;
use nystrom_stream::mesh::{Document, Mesh, ends_with};
use nystrom_stream::store::json::pretty;
use nystrom_stream::store::{Budget, folder_of};
use serde_json::{Value, json};
use std::collections::HashSet;
use std::ffi::{OsStr, OsString};
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The name of standard output on the command line.
const STDOUT: &str = "-";
/// Extensions of mesh files, longer ones first.
pub const MESH_EXTENSIONS: [&str; 8] = [".ply.gz", ".obj.gz", ".off.gz", ".stl.gz", ".ply", ".obj", ".off", ".stl"];

/// Options of PLY outputs.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct PlyArgs {
    /// Encoding of PLY outputs
    #[arg(long, value_parser = choice::<PlyForm>(), default_value = "same", value_name = "FORM")]
    pub ply_form: PlyForm,
    /// Label and colour the vertices of PLY outputs too (scalar_label, red, green, blue), for Blender, CloudCompare and
    /// Open3D, which do not show face colours; existing vertex colours are replaced
    #[arg(long)]
    pub vertex_labels: bool,
    /// Give each part its own vertices in PLY outputs, labelled and coloured, so that colours end at boundaries; other
    /// properties of the input are left out
    #[arg(long, conflicts_with = "vertex_labels")]
    pub split_vertices: bool,
    /// Split the triangles of PLY outputs where smooth boundaries cross them, instead of placing boundaries along
    /// edges; creases stay on edges
    #[arg(long, conflicts_with_all = ["vertex_labels", "split_vertices"])]
    pub split_faces: bool,
}

/// `--json`, which is the same in all subcommands.
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

    /// Writes `report` with the seconds and the notes of the run, if requested.
    pub fn publish_with(&self, mut report: Value, log: &RunLog) -> Result<()> {
        report["seconds"] = json!(log.seconds());
        report["notes"] = json!(log.notes());
        self.publish(&report)
    }

    /// Writes `report` if requested.
    pub fn publish(&self, report: &impl serde::Serialize) -> Result<()> {
        let Some(target) = &self.json else { return Ok(()) };
        let text = pretty("the report", report)?;
        Sink::of(target).write(&(text + "\n"))
    }

    /// Prints `text`, unless JSON goes to standard output, and writes `report` if requested.
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
    /// Binary STL, triangles only
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
    /// Close the parts of a folder where they were cut off, and fill their holes: parts of a closed mesh become solids
    #[arg(long)]
    pub cap: bool,
    /// Add the coordinates of the spectral embedding to .parquet outputs
    #[arg(long)]
    pub embedding_columns: bool,
}

impl PlyArgs {
    /// Rejects options that apply to none of `outputs`.
    pub fn check(self, outputs: &[Output]) -> Result<(), CliError> {
        let has = |form: Form| outputs.iter().any(|output| output.form == form);
        let (file, a_file) = (has(Form::Ply), "a .ply output");
        check_needs(&[
            (self.split_faces && !file, "--split-faces", "a .ply output; other outputs keep the faces"),
            (self.vertex_labels && !file, "--vertex-labels", a_file),
            (self.split_vertices && !file, "--split-vertices", a_file),
            (self.ply_form != PlyForm::Same && !file && !has(Form::Folder), "--ply-form", a_file),
        ])
    }
}

/// Rejects the first of the options that is given without what it needs.
fn check_needs(rules: &[(bool, &str, &str)]) -> Result<(), CliError> {
    match rules.iter().find(|(broken, ..)| *broken) {
        Some((_, option, needed)) => Err(CliError::Usage(format!("{option} requires {needed}"))),
        None => Ok(()),
    }
}

impl From<PlyArgs> for FormArgs {
    fn from(ply: PlyArgs) -> Self {
        Self { ply, part_form: PartFile::Ply, cap: false, embedding_columns: false }
    }
}

impl FormArgs {
    /// In the form that the library takes for `mesh`, whose encoding its PLY files may have.
    pub fn options(self, mesh: Option<&Mesh>) -> SaveOptions {
        let is_text = match self.ply.ply_form {
            PlyForm::Same => mesh.and_then(Mesh::document).is_some_and(Document::is_text),
            form => form == PlyForm::Ascii,
        };
        let part_form = match self.part_form {
            PartFile::Stl => PartForm::Stl,
            PartFile::Ply if is_text => PartForm::Text,
            PartFile::Ply => PartForm::Binary,
        };
        let PlyArgs { ply_form, vertex_labels, split_vertices, split_faces } = self.ply;
        let ply = SaveOptions::new().ply_form(ply_form).vertex_labels(vertex_labels);
        ply.split_vertices(split_vertices).split_faces(split_faces).part_form(part_form).cap(self.cap)
    }

    /// Rejects options that apply to none of `outputs`.
    pub fn check(self, outputs: &[Output]) -> Result<(), CliError> {
        self.ply.check(outputs)?;
        let has = |form: Form| outputs.iter().any(|output| output.form == form);
        let (folder, a_folder) = (has(Form::Folder), "a folder of parts, as in -o parts/");
        let solids = self.part_form == PartFile::Stl && !has(Form::Ply);
        check_needs(&[
            (self.ply.ply_form != PlyForm::Same && solids, "--ply-form", "a .ply output, or parts that are .ply files"),
            (self.part_form != PartFile::Ply && !folder, "--part-form", a_folder),
            (self.cap && !folder, "--cap", a_folder),
            (self.embedding_columns && !has(Form::Parquet), "--embedding-columns", "a .parquet output"),
        ])
    }
}

/// An output and its format.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Output {
    form: Form,
    /// `-` for standard output.
    target: PathBuf,
}

impl std::fmt::Display for Output {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self.path() {
            Some(path) => path.display().fmt(f),
            None => f.write_str("standard output"),
        }
    }
}

/// Rejects a picture under `params`, whose size is no option of the command, if `budget` is too small for it.
pub fn check_picture(params: &PictureParams, budget: &Budget) -> Result<()> {
    params.check_budget(budget).map_err(|error| error.with_remedy(NO_PICTURE))
}

impl Output {
    /// The output named by `path`.
    pub fn of(path: &Path) -> Result<Self, CliError> {
        if path == Path::new(STDOUT) {
            return Ok(Self::stdout());
        }
        let form = Form::of(path);
        if form != Some(Form::Folder) {
            check_is_no_stream("-o", path)?;
        }
        let unknown = || {
            CliError::Usage(format!(
                "-o {}: unknown extension; use .ply, .seg, .npy, .parquet, .csv, .obj, .glb, .html or .png, or end \
                 the path with / for a folder with one PLY per part",
                path.display()
            ))
        };
        Ok(Self { form: form.ok_or_else(unknown)?, target: path.into() })
    }

    /// A labelled PLY on standard output.
    pub fn stdout() -> Self {
        Self { form: Form::Ply, target: STDOUT.into() }
    }

    /// The name of `mesh` without folder and extension; it need not be UTF-8.
    pub fn stem(mesh: &Path) -> &[u8] {
        let name = mesh.file_name().unwrap_or_default().as_bytes();
        let lower = name.to_ascii_lowercase();
        let extension = MESH_EXTENSIONS.into_iter().find(|extension| lower.ends_with(extension.as_bytes()));
        &name[..name.len() - extension.map_or(0, str::len)]
    }

    /// `mesh` with `ending` in place of its extension.
    pub fn beside(mesh: &Path, ending: &str) -> PathBuf {
        mesh.with_file_name(OsString::from_vec([Self::stem(mesh), ending.as_bytes()].concat()))
    }

    /// `MESH.segmented.ply` beside `mesh`.
    pub fn segmented(mesh: &Path) -> Self {
        Self { form: Form::Ply, target: Self::beside(mesh, ".segmented.ply") }
    }

    /// Its format.
    pub fn form(&self) -> Form {
        self.form
    }

    /// Its name on the command line: the file or folder, or `-`.
    pub fn target(&self) -> &Path {
        &self.target
    }

    /// The file or folder, unless it is standard output.
    pub fn path(&self) -> Option<&Path> {
        (self.target != Path::new(STDOUT)).then_some(&self.target)
    }

    /// The file that is written last, unless it is standard output.
    pub fn last_file(&self) -> Option<PathBuf> {
        self.path().map(|path| if self.form == Form::Folder { path.join(split::LIST) } else { path.into() })
    }

    /// Rejects an output that cannot be written, before any work.
    pub fn check(&self) -> Result<()> {
        let sink = Sink::of(&self.target);
        if self.form != Form::Folder {
            return sink.check();
        }
        if !self.target.as_os_str().as_encoded_bytes().ends_with(b"/") {
            let remedy = "end it with / for one file per part, or give a file";
            return Err(Error::unusable(&self.target, "is a folder", remedy));
        }
        sink.check_place()
    }

    /// Rejects a picture for which `budget` is too small, before any work.
    pub fn check_budget(&self, budget: &Budget) -> Result<()> {
        if self.form == Form::Png { check_picture(&PictureParams::default(), budget) } else { Ok(()) }
    }

    /// Whether it has more than the labels: then it needs the mesh, and contains the names of parts.
    pub fn has_more_than_labels(&self) -> bool {
        !self.form.is_labels_alone()
    }

    /// Whether it is a page, which needs report and cuts.
    pub fn is_page(&self) -> bool {
        self.form == Form::Html
    }
}

/// The outputs named by `paths`, without duplicates.
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

/// The default folder for scratch files: beside the first file among `outputs`, or the system's temporary folder.
pub fn scratch_folder(outputs: &[Output]) -> PathBuf {
    outputs.iter().find_map(Output::path).map_or_else(std::env::temp_dir, |path| folder_of(path).to_path_buf())
}

/// Rejects `files`, both inputs and outputs, that a folder of parts among `outputs` would overwrite, or that would
/// overwrite one of its own.
pub fn check_folders<'a>(
    outputs: impl IntoIterator<Item = &'a Output>,
    files: impl IntoIterator<Item = &'a PathBuf>,
) -> Result<(), CliError> {
    let folders = outputs.into_iter().filter(|output| output.form == Form::Folder);
    let folders: HashSet<PathBuf> = folders.filter_map(|output| output.target.canonicalize().ok()).collect();
    let clashes = |path: &&PathBuf| {
        let named = path.file_name().and_then(OsStr::to_str).is_some_and(split::is_file_name);
        named && folder_of(path).canonicalize().is_ok_and(|folder| folders.contains(&folder))
    };
    match files.into_iter().find(clashes) {
        Some(path) => {
            let text = "lies in a folder of parts, which will contain a file of this name; choose another file or \
                        folder";
            Err(CliError::Usage(format!("{}: {text}", path.display())))
        }
        None => Ok(()),
    }
}

/// How many `faces` are in how many `parts`, rounded as on the lines of stages.
pub fn faces_in_parts(faces: usize, parts: usize) -> String {
    format!("{} {} in {}", human(faces as f64), noun(faces, "face"), counted(parts, "part"))
}

/// The last line of a command: how many `faces` are in how many `parts`, the time it took, and the outputs.
pub fn closing_line(faces: usize, parts: usize, start: Instant, outputs: &[Output]) -> String {
    let outputs: Vec<String> = outputs.iter().map(Output::to_string).collect();
    let seconds = start.elapsed().as_secs_f64();
    format!("{} in {seconds:.2} s, written to {}", faces_in_parts(faces, parts), outputs.join(", "))
}

/// Rejects a table of names if neither any of `outputs` nor `json` would contain them.
pub fn check_names(names: Option<&Path>, outputs: &[Output], json: &JsonArgs) -> Result<(), CliError> {
    if names.is_some() && json.json.is_none() && !outputs.iter().any(Output::has_more_than_labels) {
        let text = "--names requires --json or an output that holds names: any except .seg and .npy";
        return Err(CliError::Usage(text.into()));
    }
    Ok(())
}

/// Rejects charts in an unknown format before any work.
pub fn check_charts(option: &str, paths: &[PathBuf]) -> Result<(), CliError> {
    check_extensions(option, paths, &["svg", "png"], "use .svg or .png")
}

/// Rejects `paths` for `option` that end with none of `endings`, before any work.
pub fn check_extensions<'a>(
    option: &str,
    paths: impl IntoIterator<Item = &'a PathBuf>,
    endings: &[&str],
    remedy: &str,
) -> Result<(), CliError> {
    match paths.into_iter().find(|path| !endings.iter().any(|ending| ends_with(path, ending))) {
        Some(path) => Err(CliError::Usage(format!("{option} {}: unknown extension; {remedy}", path.display()))),
        None => Ok(()),
    }
}
