//! Where results go: the ending of an output's name chooses its form.

use super::Failure;
use clap::ValueEnum;
use nystrom_stream::apps::export::parquet::{self, Coordinates};
use nystrom_stream::apps::export::{glb, split};
use nystrom_stream::apps::page::{Cuts, Page};
use nystrom_stream::apps::picture::{self, PictureParams};
use nystrom_stream::base::{Error, Result};
use nystrom_stream::mesh::labelled::{Labelling, PlyForm, PlyOptions, write_labelled, write_labelled_to};
use nystrom_stream::mesh::{Opened, seg};
use nystrom_stream::pipeline::cuts::KeptCuts;
use nystrom_stream::store::{Run, npy};
use serde_json::Value;
use std::ffi::OsStr;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Endings of meshes, longer before shorter.
pub const ENDINGS: [&str; 8] = [".ply.gz", ".obj.gz", ".off.gz", ".stl.gz", ".ply", ".obj", ".off", ".stl"];

/// Options of PLY outputs.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct PlyArgs {
    /// Form of PLY outputs
    #[arg(long, value_enum, default_value = "same", value_name = "FORM")]
    pub ply_form: FormArg,
    /// Give vertices of PLY outputs a label too, as scalar_label: what CloudCompare shows
    #[arg(long)]
    pub vertex_labels: bool,
}

/// Options of outputs.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct FormArgs {
    #[command(flatten)]
    pub ply: PlyArgs,
    /// Give .parquet outputs the coordinates of the spectral embedding too
    #[arg(long)]
    pub embedding_columns: bool,
}

/// Encoding of PLY outputs.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum FormArg {
    /// As the input
    Same,
    /// Little-endian
    Binary,
    /// Text
    Ascii,
}

impl FormArg {
    /// The library's.
    pub fn form(self) -> PlyForm {
        match self {
            Self::Same => PlyForm::Same,
            Self::Binary => PlyForm::Binary,
            Self::Ascii => PlyForm::Ascii,
        }
    }
}

impl PlyArgs {
    /// The library's.
    pub fn options(self) -> PlyOptions {
        PlyOptions { form: self.ply_form.form(), vertex_labels: self.vertex_labels }
    }

    /// Refuses options that none of `outputs` would follow.
    pub fn check(self, outputs: &[Output]) -> Result<(), Failure> {
        let is_ply = |output: &Output| matches!(output, Output::Ply(_) | Output::Stdout);
        if self.vertex_labels && !outputs.is_empty() && !outputs.iter().any(is_ply) {
            return Err(Failure::Misused("--vertex-labels goes with a .ply output".into()));
        }
        Ok(())
    }
}

impl FormArgs {
    /// Refuses options that none of `outputs` would follow.
    pub fn check(self, outputs: &[Output]) -> Result<(), Failure> {
        self.ply.check(outputs)?;
        if self.embedding_columns && !outputs.iter().any(|output| matches!(output, Output::Parquet(_))) {
            return Err(Failure::Misused("--embedding-columns goes with a .parquet output".into()));
        }
        Ok(())
    }
}

/// What there is to write.
pub struct Results<'a> {
    /// Labels, colours, qualities.
    pub labelling: Labelling<'a>,
    /// Of PLY outputs.
    pub options: PlyOptions,
    /// For tables, where it was asked for.
    pub embedding: Option<Coordinates<'a>>,
    /// For pages: the run's report.
    pub report: Value,
    /// For pages: other numbers of parts.
    pub cuts: Option<&'a KeptCuts>,
}

/// An output and its form.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Output {
    /// A labelled PLY.
    Ply(PathBuf),
    /// A label a line.
    Seg(PathBuf),
    /// Labels as a NumPy array.
    Npy(PathBuf),
    /// A picture.
    Png(PathBuf),
    /// A table of the faces.
    Parquet(PathBuf),
    /// A scene, a primitive a part.
    Glb(PathBuf),
    /// A page to turn the mesh on.
    Html(PathBuf),
    /// A PLY a part, in this folder.
    Folder(PathBuf),
    /// A labelled PLY on standard output.
    Stdout,
}

impl Output {
    /// The output that `path` names.
    pub fn of(path: &Path) -> Result<Self, Failure> {
        if path == Path::new("-") {
            return Ok(Self::Stdout);
        }
        if path.to_string_lossy().ends_with(['/', std::path::MAIN_SEPARATOR]) || path.is_dir() {
            return Ok(Self::Folder(path.into()));
        }
        match path.extension().and_then(OsStr::to_str).map(str::to_ascii_lowercase).as_deref() {
            Some("ply") => Ok(Self::Ply(path.into())),
            Some("seg") => Ok(Self::Seg(path.into())),
            Some("npy") => Ok(Self::Npy(path.into())),
            Some("png") => Ok(Self::Png(path.into())),
            Some("parquet") => Ok(Self::Parquet(path.into())),
            Some("glb") => Ok(Self::Glb(path.into())),
            Some("html" | "htm") => Ok(Self::Html(path.into())),
            _ => Err(Failure::Misused(format!(
                "-o {}: its ending says no known form; end it with .ply, .seg, .npy, .parquet, .glb, .html or .png, or \
                 with / for a PLY a part in that folder",
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

    /// The file, or folder, if it is one.
    pub fn path(&self) -> Option<&Path> {
        match self {
            Self::Ply(path) | Self::Seg(path) | Self::Npy(path) | Self::Png(path) => Some(path),
            Self::Parquet(path) | Self::Glb(path) | Self::Html(path) | Self::Folder(path) => Some(path),
            Self::Stdout => None,
        }
    }

    /// The file that is written last, if it is one.
    pub fn last_file(&self) -> Option<PathBuf> {
        match self {
            Self::Folder(path) => Some(path.join(split::LIST)),
            _ => self.path().map(Path::to_path_buf),
        }
    }

    /// Its folder exists; said before any work.
    pub fn check(&self) -> Result<()> {
        let Some(path) = self.path() else { return Ok(()) };
        let folder = folder_of(path);
        if folder.is_dir() {
            Ok(())
        } else {
            Err(Error::unusable(path, format!("its folder {} does not exist", folder.display()), "make it first"))
        }
    }

    /// Whether it cannot be written without the mesh.
    pub fn needs_mesh(&self) -> bool {
        !matches!(self, Self::Seg(_) | Self::Npy(_))
    }

    /// Whether it is a page, which needs report and cuts.
    pub fn is_page(&self) -> bool {
        matches!(self, Self::Html(_))
    }

    /// Writes the result; `opened` must be there where [`Output::needs_mesh`].
    pub fn write(&self, opened: Option<&Opened>, results: &Results, run: &Run) -> Result<()> {
        match (self, opened) {
            (Self::Seg(path), _) => seg::write_seg(path, results.labelling.labels, true, run),
            (Self::Npy(path), _) => npy::write(path, results.labelling.labels, 1, true).map(drop),
            (_, Some(opened)) => self.write_mesh(opened, results, run),
            (_, None) => Err(Error::parameter("-o", "this form needs the mesh", "name the mesh")),
        }
    }

    fn write_mesh(&self, opened: &Opened, results: &Results, run: &Run) -> Result<()> {
        let Opened { document, mesh, .. } = opened;
        let Results { labelling, options, embedding, .. } = results;
        match self {
            Self::Seg(_) | Self::Npy(_) => Ok(()),
            Self::Ply(path) => write_labelled(document, mesh, path, labelling, *options, true, run),
            Self::Png(path) => {
                let params = PictureParams::default();
                picture::render(mesh, Some(labelling.labels), labelling.colours, &params, run)?.write_png(path)
            }
            Self::Parquet(path) => parquet::write(path, mesh, labelling, *embedding, true, run),
            Self::Glb(path) => glb::write(path, mesh, labelling, true, run),
            Self::Html(path) => {
                let title = document.path().file_name().unwrap_or_default().to_string_lossy();
                let cuts = results.cuts.map(|cuts| Cuts { cells: &cuts.cells, parts: &cuts.parts });
                let (labels, colours, report) = (labelling.labels, labelling.colours, &results.report);
                Page { title: &title, mesh, labels, colours, cuts, report }.write(path, run)
            }
            Self::Folder(path) => {
                let text = match options.form {
                    PlyForm::Same => document.is_text(),
                    form => form == PlyForm::Ascii,
                };
                split::write(path, mesh, labelling, text, true, run)
            }
            Self::Stdout => {
                let mut out = std::io::stdout().lock();
                write_labelled_to(document, mesh, "<stdout>", &mut out, labelling, *options, run)
            }
        }
    }
}

/// Writes `bytes` to standard output.
pub fn print(bytes: &[u8]) -> Result<()> {
    let mut out = std::io::stdout().lock();
    out.write_all(bytes).and_then(|()| out.flush()).map_err(Error::io("<stdout>", "write"))
}

/// Writes `report` as JSON to the file `target`, or to standard output where that is `-`.
pub fn publish(target: &Path, report: &impl serde::Serialize) -> Result<()> {
    write_text(target, &(serde_json::to_string_pretty(report).unwrap_or_default() + "\n"))
}

/// Writes `text` to standard output where `target` is `-`, else to that file, which appears whole or not at all. What is
/// there and no file, such as a device or a pipe, is written to as it is.
pub fn write_text(target: &Path, text: &str) -> Result<()> {
    if target == Path::new("-") {
        return print(text.as_bytes());
    }
    if std::fs::metadata(target).is_ok_and(|known| !known.is_file()) {
        return std::fs::write(target, text).map_err(Error::io(target, "write"));
    }
    let mut partial = target.as_os_str().to_owned();
    partial.push(".partial");
    let written = std::fs::write(&partial, text).and_then(|()| std::fs::rename(&partial, target));
    written.map_err(|error| {
        let _ = std::fs::remove_file(&partial);
        Error::io(target, "write")(error)
    })
}

/// The folder a file lies in.
pub fn folder_of(path: &Path) -> PathBuf {
    match path.parent() {
        Some(parent) if parent != Path::new("") => parent.to_path_buf(),
        _ => PathBuf::from("."),
    }
}
