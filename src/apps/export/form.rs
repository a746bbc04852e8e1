//! The formats of a labelled mesh: which file extension selects which, their options, and their writers.

use super::split::{self, Folder, PartForm};
use super::{glb, obj};
use crate::base::{Error, Result};
use crate::mesh::{Labelling, Mesh, PlyForm, PlyOptions, seg, write_labelled};
use crate::store::{Run, npy};
use std::ffi::OsStr;
use std::path::Path;

/// The output formats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// The mesh with labels, colours and qualities of its faces.
    Ply,
    /// One label per line.
    Seg,
    /// Labels as a NumPy array.
    Npy,
    /// The mesh with one group per part.
    Obj,
    /// A scene with one primitive per part.
    Glb,
    /// A picture.
    Png,
    /// A table of the faces.
    Parquet,
    /// A table of the parts.
    Csv,
    /// A web page that shows the mesh.
    Html,
    /// One file per part, in a folder.
    Folder,
}

impl Form {
    /// The format for `path`: a folder if it exists as one or `path` ends with `/`, else by the file extension,
    /// ignoring case.
    ///
    /// ```
    /// use nystrom_stream::apps::export::Form;
    /// let of = |path: &str| Form::of(path.as_ref());
    /// assert_eq!([of("a.PLY"), of("a.htm")], [Some(Form::Ply), Some(Form::Html)]);
    /// assert_eq!(of("parts.ply/"), Some(Form::Folder));
    /// assert_eq!(of("a.doc"), None);
    /// ```
    pub fn of(path: &Path) -> Option<Self> {
        if path.to_string_lossy().ends_with(['/', std::path::MAIN_SEPARATOR]) || path.is_dir() {
            return Some(Self::Folder);
        }
        match path.extension().and_then(OsStr::to_str)?.to_ascii_lowercase().as_str() {
            "ply" => Some(Self::Ply),
            "seg" => Some(Self::Seg),
            "npy" => Some(Self::Npy),
            "obj" => Some(Self::Obj),
            "glb" => Some(Self::Glb),
            "png" => Some(Self::Png),
            "parquet" => Some(Self::Parquet),
            "csv" => Some(Self::Csv),
            "html" | "htm" => Some(Self::Html),
            _ => None,
        }
    }

    /// Whether it contains only labels, so that it can be written without the mesh.
    pub fn is_labels_alone(self) -> bool {
        matches!(self, Self::Seg | Self::Npy)
    }

    /// Writes `labelling` in this format to `path`; the `mesh` may be omitted if the format [contains only
    /// labels](Self::is_labels_alone).
    ///
    /// # Errors
    /// [`Error::Parameter`] for a format that needs more than a labelling (a table of parts, a page), is not compiled
    /// in, or needs the missing mesh; those of the format's own writer.
    pub fn write(
        self,
        path: &Path,
        mesh: Option<&Mesh>,
        labelling: &Labelling,
        options: &SaveOptions,
        run: &Run,
    ) -> Result<()> {
        let there = || mesh.ok_or_else(|| Error::parameter("mesh", "this format needs it", "give the mesh"));
        match self {
            Self::Seg => seg::write_seg(path, labelling.labels, run),
            Self::Npy => npy::write(path, labelling.labels, 1, true).map(drop),
            Self::Ply => write_labelled(there()?, path, labelling, options.ply, run),
            Self::Obj => obj::write(path, there()?, labelling, run),
            Self::Glb => glb::write(path, there()?, labelling, run),
            Self::Folder => split::write(path, there()?, labelling, options.folder, run),
            #[cfg(feature = "parquet")]
            Self::Parquet => super::parquet::write(path, there()?, labelling, None, run),
            #[cfg(feature = "pictures")]
            Self::Png => {
                let params = crate::apps::picture::PictureParams::default();
                let work = super::work_beside(path, run);
                let context = crate::store::Context::new(&work, run);
                let (labels, marks) = (Some(labelling.labels), (labelling.colours, labelling.names));
                crate::apps::picture::render_named(there()?, labels, marks, &params, context)
                    .map_err(|error| error.with_remedy(crate::apps::picture::NO_PICTURE))?
                    .write_png(path)
            }
            _ => Err(unknown(path)),
        }
    }
}

/// The error for a `path` without a known format.
pub(crate) fn unknown(path: &Path) -> Error {
    let remedy = "use .ply, .seg, .npy, .obj or .glb (.png, .parquet and, for a segmentation, .html with their \
                  features), or end the path with / for a folder";
    Error::extension("path", path, remedy)
}

/// Options for a `.ply` and a folder of parts.
///
/// ```
/// use nystrom_stream::SaveOptions;
/// let solids = SaveOptions::new().cap(true);
/// let sharp = SaveOptions::new().split_vertices(true);
/// assert_ne!(solids, sharp);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct SaveOptions {
    /// For a `.ply`.
    pub ply: PlyOptions,
    /// For a folder of parts.
    pub folder: Folder,
}

impl Default for SaveOptions {
    fn default() -> Self {
        Self { ply: PlyForm::Same.into(), folder: PartForm::Binary.into() }
    }
}

impl SaveOptions {
    /// The defaults of [`Mesh::save`].
    pub fn new() -> Self {
        Self::default()
    }

    /// The encoding of a `.ply`.
    #[must_use]
    pub fn ply_form(mut self, form: PlyForm) -> Self {
        self.ply.form = form;
        self
    }

    /// Whether vertices of a `.ply` have labels and colours too, for programs that do not read face properties.
    #[must_use]
    pub fn vertex_labels(mut self, wanted: bool) -> Self {
        self.ply.vertex_labels = wanted;
        self
    }

    /// Whether parts share no vertex of a `.ply`, so that vertex colours end at boundaries.
    #[must_use]
    pub fn split_vertices(mut self, wanted: bool) -> Self {
        self.ply.split_vertices = wanted;
        self
    }

    /// Whether triangles of a `.ply` are split where smooth boundaries cross them ([`crate::mesh::split_faces`]);
    /// cannot be combined with the two vertex options.
    #[must_use]
    pub fn split_faces(mut self, wanted: bool) -> Self {
        self.ply.split_faces = wanted;
        self
    }

    /// Whether the parts of a folder are closed where they were cut off, and at holes.
    #[must_use]
    pub fn cap(mut self, wanted: bool) -> Self {
        self.folder.cap = wanted;
        self
    }

    /// The format of the files in a folder.
    #[must_use]
    pub fn part_form(mut self, form: PartForm) -> Self {
        self.folder.form = form;
        self
    }

    /// Rejects options that do not apply to the chosen format.
    ///
    /// # Errors
    /// [`Error::Parameter`].
    pub(crate) fn check(&self, form: Option<Form>) -> Result<()> {
        let untouched = Self::default();
        let (option, form) = if self.folder != untouched.folder && form != Some(Form::Folder) {
            ("cap and part_form", "a folder of parts: end the path with /")
        } else if self.ply != untouched.ply && form != Some(Form::Ply) {
            ("vertex_labels, split_vertices, split_faces and ply_form", "a .ply")
        } else {
            return Ok(());
        };
        Err(Error::parameter("options", format!("{option} apply to another format"), format!("write {form}")))
    }
}
