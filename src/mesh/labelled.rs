//! The labelled mesh file: the input with `int label`, `uchar red green blue` and `float quality`
//! on its faces, and everything else kept.
//!
//! Elements and properties of the input stay, in their order; face properties of the names above
//! are replaced; triangle strips become faces. A file whose faces are all of one size is put
//! together in parallel at the speed of the page cache (see `fixed`), any other streams through
//! one buffer (see `records`).

use super::document::Document;
use super::fixed::Fixed;
pub use super::labelling::Labelling;
use super::labelling::header;
use super::model::Encoding;
use super::output::{Gather, by_rename};
use super::records::Task;
use super::surface::Mesh;
use super::vertex_labels::VertexLabels;
use crate::base::parallel::map_chunks;
use crate::base::{Error, Result};
use crate::store::Run;
use std::cell::RefCell;
use std::fs::File;
use std::io::Write;
use std::path::Path;

/// The encoding of a labelled file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PlyForm {
    /// The input's; kept text stays as it stands.
    #[default]
    Same,
    /// Little-endian.
    Binary,
    /// Text; floating-point numbers as short as they come back exactly.
    Ascii,
}

/// What a labelled file is to be, besides labelled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlyOptions {
    /// Its encoding.
    pub form: PlyForm,
    /// Whether each vertex gets the label that most faces around it have, as `float scalar_label` (-1 without faces):
    /// a scalar field in CloudCompare, which knows none of faces.
    pub vertex_labels: bool,
}

impl From<PlyForm> for PlyOptions {
    fn from(form: PlyForm) -> Self {
        Self { form, vertex_labels: false }
    }
}

impl PlyForm {
    pub(super) fn encoding(self, document: &Document) -> Encoding {
        match self {
            Self::Same => document.header.encoding,
            Self::Binary => Encoding::Little,
            Self::Ascii => Encoding::Ascii,
        }
    }
}

/// Writes the labelled file `out`, by rename, after syncing it to the disk where `durable`. `mesh`
/// and `document` come from the same [`super::open()`]; `out` may be the input itself.
///
/// # Errors
/// [`Error::Parameter`] when there is not a label (and a quality) for every face; [`Error::Io`];
/// [`Error::Cancelled`]; [`Error::Malformed`] should the input have changed since it was opened.
pub fn write_labelled(
    document: &Document,
    mesh: &Mesh,
    out: &Path,
    labelling: &Labelling,
    options: impl Into<PlyOptions>,
    durable: bool,
    run: &Run,
) -> Result<()> {
    check(labelling, mesh)?;
    let options = options.into();
    let target = options.form.encoding(document);
    let header = header(document, labelling, target, mesh.faces.len(), options.vertex_labels);
    if cfg!(unix)
        && !options.vertex_labels
        && target == document.header.encoding
        && let Some(plan) = Fixed::plan(document, labelling, header.len())?
    {
        return by_rename(out, plan.total(), durable, |file| {
            write_at(file, &header, 0, out)?;
            let write = |k: usize, buffer: &mut Vec<u8>| {
                let (place, bytes) = plan.part(k, buffer);
                write_at(file, bytes, place, out)
            };
            map_chunks(run.threads, &run.cancel, plan.jobs(), Vec::new, write).map(drop)
        });
    }
    by_rename(out, 0, durable, |file| stream(document, mesh, out, file, labelling, options, run))
}

/// Writes the labelled file to a stream, `name` in messages: standard output, a socket.
///
/// # Errors
/// As [`write_labelled`].
pub fn write_labelled_to(
    document: &Document,
    mesh: &Mesh,
    name: &str,
    writer: &mut dyn Write,
    labelling: &Labelling,
    options: impl Into<PlyOptions>,
    run: &Run,
) -> Result<()> {
    check(labelling, mesh)?;
    stream(document, mesh, Path::new(name), writer, labelling, options.into(), run)
}

fn stream(
    document: &Document,
    mesh: &Mesh,
    path: &Path,
    writer: &mut dyn Write,
    labelling: &Labelling,
    options: PlyOptions,
    run: &Run,
) -> Result<()> {
    let target = options.form.encoding(document);
    let header = header(document, labelling, target, mesh.faces.len(), options.vertex_labels);
    let mut out = Gather::new(path, writer);
    out.pass(&header)?;
    if target == document.header.encoding
        && !options.vertex_labels
        && let Some(plan) = Fixed::plan(document, labelling, header.len())?
    {
        let mut buffer = Vec::new();
        for k in 0..plan.jobs() {
            run.cancel.check()?;
            out.pass(plan.part(k, &mut buffer).1)?;
        }
    } else {
        let votes = options.vertex_labels.then(|| VertexLabels::new(mesh, labelling.labels, run)).transpose()?;
        Task { document, mesh, labelling, target, votes: votes.map(RefCell::new), run }.elements(&mut out)?;
    }
    out.finish()
}

/// Refuses labels that do not fit the faces.
fn check(labelling: &Labelling, mesh: &Mesh) -> Result<()> {
    let faces = mesh.faces.len();
    let wrong = |name: &str, count: usize| {
        let problem = format!("{count} values for {faces} faces");
        Err(Error::parameter(name, problem, "give one for every face of the file"))
    };
    match labelling.quality {
        _ if labelling.labels.len() != faces => wrong("labels", labelling.labels.len()),
        Some(quality) if quality.len() != faces => wrong("quality", quality.len()),
        _ => Ok(()),
    }
}

#[cfg(unix)]
fn write_at(file: &File, bytes: &[u8], place: u64, out: &Path) -> Result<()> {
    std::os::unix::fs::FileExt::write_all_at(file, bytes, place).map_err(Error::io(out, "write"))
}

#[cfg(not(unix))]
fn write_at(_: &File, _: &[u8], _: u64, out: &Path) -> Result<()> {
    Err(Error::io(out, "write")(std::io::ErrorKind::Unsupported.into()))
}
