//! `--edits` and `--hints`: what a person corrects.

use super::method::PartsArgs;
use super::options::{CliError, misfit};
use nystrom_stream::apps::edits::Edits;
use nystrom_stream::cluster::parts::PartCount;
use nystrom_stream::pipeline::edits::Corrections;
use nystrom_stream::pipeline::{Cluster, SegmentParams};
use std::path::PathBuf;

/// Options of corrections.
#[derive(Clone, Debug, Default, clap::Args)]
#[command(next_help_heading = "Corrections")]
pub struct EditArgs {
    /// Apply the edits in this file: merge, split, cut, hints, names, colours (docs/edits.md)
    #[arg(long, value_name = "FILE")]
    pub edits: Option<PathBuf>,
    /// Take hints from this face property of the mesh: faces of equal values belong together, of different ones apart; 0
    /// says nothing
    #[arg(long, value_name = "PROPERTY")]
    pub hints: Option<String>,
}

impl EditArgs {
    /// Reads the edits, where there are any. The number of parts that they start from is taken where none is asked for.
    pub fn read(&self, parts: &PartsArgs, params: &mut SegmentParams) -> Result<Option<Edits>, CliError> {
        if params.cluster != Cluster::Parts {
            let given = self.edits.as_ref().map(|_| "--edits").or(self.hints.as_ref().map(|_| "--hints"));
            if let Some(option) = given {
                return Err(misfit(option, "--cluster parts"));
            }
        }
        let Some(path) = &self.edits else { return Ok(None) };
        let edits = Edits::read(path)?;
        if parts.parts.is_none() && parts.parts_range.is_none() && parts.detail.is_none() {
            params.parts.count = edits.parts.map_or(params.parts.count, PartCount::Exactly);
            params.parts.detail = edits.detail.unwrap_or(params.parts.detail);
        }
        Ok(Some(edits))
    }
}

/// Edits and painted values as the library takes them.
pub fn corrections<'a>(edits: Option<&'a Edits>, painted: Option<&'a Vec<u32>>) -> Corrections<'a> {
    Corrections { edits, painted: painted.map(Vec::as_slice) }
}
