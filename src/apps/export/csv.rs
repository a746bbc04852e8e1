//! The table of the parts as a file: comma-separated values, one row per label ([`measure::table`]).
//!
//! The adjacency graph of the faces, which neighbours and volumes need, is kept in memory or beside the file meanwhile.

use super::work_beside;
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
    let measures = measured(path, run, |context| measure::labelled(mesh, labelling.labels, context))?;
    json::publish(path, measure::table(&measures, labelling.colours, labelling.names, agreement).as_bytes())
}

/// The result of `measure`, without reporting its stages; the adjacency graph is kept in memory or beside `path`.
///
/// # Errors
/// Those of `measure`.
pub fn measured<R>(path: &Path, run: &Run, measure: impl FnOnce(Context<'_>) -> Result<R>) -> Result<R> {
    let silent = Run { threads: run.threads, budget: run.budget.clone(), cancel: run.cancel.clone(), ..Run::new(&()) };
    measure(Context::new(&work_beside(path, &silent), &silent))
}
