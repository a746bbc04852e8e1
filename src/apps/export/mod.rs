//! Results in other programs' formats: tables (`parquet`, [`csv`]), a scene ([`glb`]), a mesh with groups ([`obj`]),
//! one mesh per part ([`split`]). [`form`] maps file extensions to them.
//!
//! All of them stream: memory does not grow with the mesh, except for one bit per vertex in [`split`], and the edges of
//! a part if parts are closed, which come from the budget. Files appear complete or not at all.

mod by_part;
mod cap_loops;
mod caps;
pub mod csv;
pub mod form;
pub mod glb;
pub mod obj;
#[cfg(feature = "parquet")]
pub mod parquet;
pub mod split;

pub use form::{Form, SaveOptions};

use crate::base::{Error, Result};
use crate::mesh::{Labelling, Mesh};
use crate::store::{Run, WorkDir, folder_of};
use std::path::Path;

/// Faces between two checks of the stop flag.
const CHUNK: usize = 1 << 16;

/// Maximum number of parts that get a file or a primitive each.
const PARTS: usize = 1 << 16;

/// A temporary work directory for arrays that do not fit in memory, in the folder of the output `path`.
fn work_beside(path: &Path, run: &Run) -> WorkDir {
    WorkDir::in_memory(folder_of(path), &run.budget)
}

/// The number of parts: one per colour, or according to the labels; rejects labels that do not match the faces.
fn parts(mesh: &Mesh, labelling: &Labelling) -> Result<usize> {
    labelling.fit(mesh.faces.len())?;
    let most = labelling.labels.iter().max().map_or(0, |&label| label as usize + 1);
    if most > PARTS {
        let problem = format!("label {} is too large: at most {PARTS} parts can be written separately", most - 1);
        return Err(Error::parameter("labels", problem, "number the parts from 0"));
    }
    Ok(most.max(labelling.colours.len()))
}
