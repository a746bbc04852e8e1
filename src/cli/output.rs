//! Where results go: the ending of an output's name chooses its form.

use super::Failure;
use nystrom_stream::apps::picture::{self, PictureParams};
use nystrom_stream::base::{Error, Result};
use nystrom_stream::mesh::labelled::{Labelling, PlyForm, write_labelled, write_labelled_to};
use nystrom_stream::mesh::{Opened, seg};
use nystrom_stream::store::{Run, npy};
use std::ffi::OsStr;
use std::io::Write;
use std::path::{Path, PathBuf};

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
    /// A labelled PLY on standard output.
    Stdout,
}

impl Output {
    /// The output that `path` names.
    pub fn of(path: &Path) -> Result<Self, Failure> {
        if path == Path::new("-") {
            return Ok(Self::Stdout);
        }
        match path.extension().and_then(OsStr::to_str).map(str::to_ascii_lowercase).as_deref() {
            Some("ply") => Ok(Self::Ply(path.into())),
            Some("seg") => Ok(Self::Seg(path.into())),
            Some("npy") => Ok(Self::Npy(path.into())),
            Some("png") => Ok(Self::Png(path.into())),
            _ => Err(Failure::Misused(format!(
                "-o {}: its ending says no known form; end it with .ply, .seg, .npy or .png",
                path.display()
            ))),
        }
    }

    /// The name of `mesh` without folder and ending.
    pub fn stem(mesh: &Path) -> String {
        let name = mesh.file_name().unwrap_or_default().to_string_lossy();
        let lower = name.to_ascii_lowercase();
        let ending = [".ply.gz", ".ply"].into_iter().find(|ending| lower.ends_with(ending)).unwrap_or("");
        name[..name.len() - ending.len()].to_string()
    }

    /// `MESH.segmented.ply` beside `mesh`.
    pub fn beside(mesh: &Path) -> Self {
        Self::Ply(mesh.with_file_name(format!("{}.segmented.ply", Self::stem(mesh))))
    }

    /// The file, if it is one.
    pub fn path(&self) -> Option<&Path> {
        match self {
            Self::Ply(path) | Self::Seg(path) | Self::Npy(path) | Self::Png(path) => Some(path),
            Self::Stdout => None,
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

    /// Writes the result; `opened` must be there where [`Output::needs_mesh`].
    pub fn write(&self, opened: Option<&Opened>, labelling: &Labelling, form: PlyForm, run: &Run) -> Result<()> {
        match (self, opened) {
            (Self::Seg(path), _) => seg::write_seg(path, labelling.labels, true, run),
            (Self::Npy(path), _) => npy::write(path, labelling.labels, 1, true).map(drop),
            (_, Some(opened)) => self.write_mesh(opened, labelling, form, run),
            (_, None) => Err(Error::parameter("-o", "this form needs the mesh", "name the mesh")),
        }
    }

    fn write_mesh(&self, opened: &Opened, labelling: &Labelling, form: PlyForm, run: &Run) -> Result<()> {
        match self {
            Self::Seg(_) | Self::Npy(_) => Ok(()),
            Self::Ply(path) => write_labelled(&opened.document, &opened.mesh, path, labelling, form, true, run),
            Self::Png(path) => {
                let params = PictureParams::default();
                picture::render(&opened.mesh, Some(labelling.labels), labelling.colours, &params, run)?.write_png(path)
            }
            Self::Stdout => {
                let mut out = std::io::stdout().lock();
                write_labelled_to(&opened.document, &opened.mesh, "<stdout>", &mut out, labelling, form, run)
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
    let text = serde_json::to_string_pretty(report).unwrap_or_default();
    if target == Path::new("-") {
        return print((text + "\n").as_bytes());
    }
    std::fs::write(target, text + "\n").map_err(Error::io(target, "write"))
}

/// The folder a file lies in.
pub fn folder_of(path: &Path) -> PathBuf {
    match path.parent() {
        Some(parent) if parent != Path::new("") => parent.to_path_buf(),
        _ => PathBuf::from("."),
    }
}
