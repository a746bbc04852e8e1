//! The table of the parts as a file: comma-separated values, one row per label ([`measure::table`]).
//!
//! The adjacency graph of the faces, which neighbours and volumes need, is kept in memory or beside the file meanwhile.

use super::scratch_beside;
use crate::apps::measure;
use crate::base::Result;
use crate::mesh::{Labelling, Mesh};
use crate::store::{Context, Run, json};
use std::path::Path;

/// Measures the parts of `mesh` and writes their table to `path`, by rename. `agreement` is the share of people
/// expected to have each part, as far as it is known.
///
/// # Errors
/// As [`measure::labelled`]; [`crate::base::Error::Io`].
pub fn write(path: &Path, mesh: &Mesh, labelling: &Labelling, agreement: &[f64], run: &Run) -> Result<()> {
    // Its stages are part of writing.
    let silent = Run { threads: run.threads, budget: run.budget.clone(), cancel: run.cancel.clone(), ..Run::new(&()) };
    let work = scratch_beside(path, &silent);
    let measures = measure::labelled(mesh, labelling.labels, Context::new(&work, &silent))?;
    json::publish(path, measure::table(&measures, labelling.colours, labelling.names, agreement).as_bytes())
}
