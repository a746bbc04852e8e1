//! `--edits`, `--hints` and `--like`: a person's corrections, and parts transferred to similar meshes.

use super::errors::of_file;
use super::input::{check_is_file, read};
use super::method::PartsArgs;
use super::options::{CliError, ForceArgs, misfit};
use nystrom_stream::apps::edits::{Edits, PlacedEdits, read_names};
use nystrom_stream::apps::labelled_faces::LabelledFaces;
use nystrom_stream::base::Error;
use nystrom_stream::cluster::parts::PartCount;
use nystrom_stream::mesh::{self, Mesh};
use nystrom_stream::pipeline::edits::Corrections;
use nystrom_stream::pipeline::like::Reference;
use nystrom_stream::pipeline::{Cluster, SegmentParams, segment_corrected};
use nystrom_stream::store::{Context, MappedSlice, Run, WorkDir};
use std::path::{Path, PathBuf};

/// Options of corrections.
#[derive(Clone, Debug, Default, clap::Args)]
#[command(next_help_heading = "Corrections")]
pub struct EditArgs {
    /// Apply the edits in this file: merge, split, cut, hints, names, colours (docs/edits.md)
    #[arg(long, value_name = "FILE")]
    pub edits: Option<PathBuf>,
    /// Take hints from this face property of the mesh: faces with equal values belong together, with different values
    /// apart; 0 means no hint
    #[arg(long, value_name = "PROPERTY")]
    pub hints: Option<String>,
    /// Name the parts from this table, one line per part: its number, a tab, its name
    #[arg(long, value_name = "TSV")]
    pub names: Option<PathBuf>,
}

/// `--like`.
#[derive(Clone, Debug, Default, clap::Args)]
#[command(next_help_heading = "Corrections")]
pub struct LikeArgs {
    /// Find the parts of this labelled mesh, with their numbers, colours and names, on scans in the same place or of a
    /// similar shape. With --edits, it is cut and edited first and needs no labels
    #[arg(long, value_name = "MESH", conflicts_with_all = ["hints", "parts", "parts_range", "detail"])]
    pub like: Option<PathBuf>,
}

/// A labelled mesh whose parts others are to get.
pub struct Like {
    _work: WorkDir,
    mesh: Mesh,
    labels: MappedSlice<u32>,
    colours: Vec<[u8; 3]>,
    names: Vec<String>,
}

impl Like {
    /// Reads the labelled mesh at `path`.
    pub fn read(path: &Path, work: WorkDir, run: &Run) -> Result<Self, CliError> {
        let mesh = mesh::open(path, work.path(), run)?;
        let remedy = "give a mesh written by nystrom-stream segment, or edits with `edits`";
        let mut found = LabelledFaces::needed_of_mesh(&mesh, remedy, Context::new(&work, run))?;
        let labels = found.labels.clone();
        let colours = found.colours(&mesh, &labels, run)?;
        Ok(Self { _work: work, mesh, labels, colours, names: found.names })
    }

    /// Cuts the mesh at `path` under `params` and corrects it by `edits`.
    pub fn edited(
        path: &Path,
        params: &SegmentParams,
        edits: &Edits,
        work: WorkDir,
        run: &Run,
    ) -> Result<Self, CliError> {
        let (mesh, identity) = read(path, ForceArgs::default(), Context::new(&work, run))?;
        let edits = edits.on(&mesh, run)?;
        let corrections = corrections(Some(&edits), None);
        let cut = segment_corrected(&mesh, &identity, params, corrections, Context::new(&work, run))?;
        Ok(Self { _work: work, mesh, labels: cut.labels, colours: cut.colours, names: cut.names })
    }

    /// In the form that the library takes.
    pub fn reference(&self) -> Reference<'_> {
        Reference { mesh: &self.mesh, labels: &self.labels, colours: &self.colours, names: &self.names }
    }
}

impl EditArgs {
    /// Reads the edits, if there are any. Their initial number of parts is used if none is requested.
    pub fn read(&self, parts: &PartsArgs, params: &mut SegmentParams) -> Result<Option<Edits>, CliError> {
        if params.cluster != Cluster::Parts {
            let given = self.edits.as_ref().map(|_| "--edits").or(self.hints.as_ref().map(|_| "--hints"));
            if let Some(option) = given {
                return Err(misfit(option, "--cluster parts"));
            }
        }
        let Some(path) = &self.edits else { return Ok(None) };
        check_is_file(path)?;
        let edits = Edits::read(path)?;
        if !parts.counts() {
            params.parts.count = edits.parts.map_or(params.parts.count, PartCount::Exactly);
            params.parts.detail = edits.detail.unwrap_or(params.parts.detail);
        }
        Ok(Some(edits))
    }

    /// `error`, of the file of edits if it is about the number of parts that was taken from there.
    pub fn blamed(&self, parts: &PartsArgs, error: Error) -> Error {
        let Some(path) = self.edits.as_deref().filter(|_| !parts.counts()) else { return error };
        match of_file(of_file(error, "parts", Some(path)), "detail", Some(path)) {
            Error::Unusable { path: mesh, problem, remedy } if remedy.ends_with("`parts`") => {
                Error::unusable(mesh, problem, format!("correct their number in {}", path.display()))
            }
            error => error,
        }
    }
}

/// A table of names of parts. It is read before any work, and only once: it may be a pipe.
pub struct NameTable {
    path: PathBuf,
    names: Vec<String>,
}

impl NameTable {
    /// Reads the table `path`, if one is given.
    pub fn read(path: Option<&Path>) -> Result<Option<Self>, Error> {
        let Some(path) = path else { return Ok(None) };
        check_is_file(path)?;
        Ok(Some(Self { path: path.into(), names: read_names(path)? }))
    }

    /// Gives the parts in `names` their names, where the table has one; there are `parts` parts.
    pub fn give(&self, names: &mut Vec<String>, parts: usize) -> Result<(), Error> {
        let Self { path, names: table } = self;
        if table.len() > parts {
            let there = match parts {
                1 => "there is only part 0".to_string(),
                parts => format!("there are only {parts} parts, counted from 0"),
            };
            let problem = format!("names part {}, but {there}", table.len() - 1);
            return Err(Error::unusable(path, problem, "remove its line"));
        }
        names.resize(parts, String::new());
        names.iter_mut().zip(table).filter(|(_, new)| !new.is_empty()).for_each(|(name, new)| name.clone_from(new));
        Ok(())
    }
}

/// Edits and painted values in the form that the library takes.
pub fn corrections<'a>(edits: Option<&'a PlacedEdits<'a>>, painted: Option<&'a MappedSlice<u32>>) -> Corrections<'a> {
    Corrections { edits, painted: painted.map(|values| &values[..]), transferred: false }
}
