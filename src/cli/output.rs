//! Where results go: the ending of an output's name chooses its form.

use super::Failure;
use nystrom_stream::apps::picture::{self, PictureParams};
use nystrom_stream::base::{Error, Result};
use nystrom_stream::mesh::labelled::{Labelling, PlyForm, write_labelled, write_labelled_to};
use nystrom_stream::mesh::{Opened, seg};
use nystrom_stream::pipeline::Segmentation;
use nystrom_stream::store::{Run, npy};
use std::ffi::OsStr;
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

    /// `MESH.segmented.ply` beside `mesh`.
    pub fn beside(mesh: &Path) -> Self {
        let name = mesh.file_name().unwrap_or_default().to_string_lossy();
        let lower = name.to_ascii_lowercase();
        let stem = [".ply.gz", ".ply"]
            .iter()
            .find(|end| lower.ends_with(*end))
            .map_or(&*name, |end| &name[..name.len() - end.len()]);
        Self::Ply(mesh.with_file_name(format!("{stem}.segmented.ply")))
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

    /// Writes the result.
    pub fn write(&self, opened: &Opened, result: &Segmentation, form: PlyForm, run: &Run) -> Result<()> {
        let labelling = Labelling { labels: &result.labels, colours: &result.colours, quality: Some(&result.quality) };
        match self {
            Self::Ply(path) => write_labelled(&opened.document, &opened.mesh, path, &labelling, form, true, run),
            Self::Seg(path) => seg::write_seg(path, &result.labels, true, run),
            Self::Npy(path) => npy::write(path, &result.labels, 1, true).map(drop),
            Self::Png(path) => {
                let params = PictureParams::default();
                picture::render(&opened.mesh, Some(&result.labels), &result.colours, &params, run)?.write_png(path)
            }
            Self::Stdout => {
                let mut out = std::io::stdout().lock();
                write_labelled_to(&opened.document, &opened.mesh, "<stdout>", &mut out, &labelling, form, run)
            }
        }
    }
}

/// The folder a file lies in.
pub fn folder_of(path: &Path) -> PathBuf {
    match path.parent() {
        Some(parent) if parent != Path::new("") => parent.to_path_buf(),
        _ => PathBuf::from("."),
    }
}
