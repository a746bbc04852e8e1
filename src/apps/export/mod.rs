//! Results in other programs' forms: a table (`parquet`), a scene ([`glb`]), a mesh with groups ([`obj`]), one mesh
//! per part ([`split`]). [`form`] says which ending of a name chooses which.
//!
//! All stream: what is held does not grow with the mesh, but for one bit per vertex in [`split`], and the edges of a
//! part where parts are closed, which the budget grants. Files appear whole or not at all.

mod caps;
pub mod form;
pub mod glb;
pub mod obj;
#[cfg(feature = "parquet")]
pub mod parquet;
pub mod split;

pub use form::{Form, SaveOptions};

use crate::base::{Error, Result};
use crate::mesh::{Labelling, Mesh};

/// Faces between two looks at the stop flag.
const CHUNK: usize = 1 << 16;

/// Parts that get a file or a primitive each, at the most.
const PARTS: usize = 1 << 16;

/// How many parts there are: a colour each, or as the labels say; refuses labels that do not fit the faces.
fn parts(mesh: &Mesh, labelling: &Labelling) -> Result<usize> {
    labelling.fit(mesh.faces.len())?;
    let most = labelling.labels.iter().max().map_or(0, |&label| label as usize + 1);
    if most > PARTS {
        let problem = format!("{} is too great a label for something of its own each", most - 1);
        return Err(Error::parameter("labels", problem, "number the parts from 0"));
    }
    Ok(most.max(labelling.colours.len()))
}
