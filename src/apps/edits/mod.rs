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
//! Edits name places on the surface, not numbers of parts or faces, so that they also apply after the mesh has been
//! decimated or scanned again. The file is small; it is read whole. What edits do to a mesh is in
//! [`crate::pipeline::edits`].

mod data;
mod names;
mod places;
mod read;

pub use data::{Colour, Edit, Edits, Place};
pub use names::read_names;
pub use places::{PlacedEdits, bounds};
pub use read::{FORMAT, VERSION};
