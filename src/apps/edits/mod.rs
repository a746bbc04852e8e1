//! Corrections by a person, as data: merge, split, cut, hints, names, colours.
//!
//! ```json
//! {
//!   "format": "nystrom-stream edits", "version": 1, "parts": 9,
//!   "edits": [
//!     {"edit": "merge", "at": [[0.1, 0.2, 0.9], [0.1, 0.4, 0.8]]},
//!     {"edit": "name", "at": [0.1, 0.2, 0.9], "name": "left arm"}
//!   ]
//! }
//! ```
//!
//! Edits identify places on the surface, not numbers of parts or faces, so that they also apply after the mesh has been
//! decimated or scanned again. The file is small and read as a whole. [`crate::pipeline::edits`] applies edits to a
//! mesh.

mod data;
mod names;
mod places;
mod read;

pub use data::{Colour, Edit, Edits, Place};
pub use names::read_names;
pub use places::{PlacedEdits, bounds};
pub use read::{FORMAT, VERSION};
