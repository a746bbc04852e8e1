//! From a mesh file to faces, and from labels back to a mesh file.
//!
//! [`Mesh`] is what the floors above see: positions and faces behind mapped files, whatever the
//! file looked like. [`open()`] makes one of every PLY flavour: most are used where they lie, the
//! rest are decoded once, in one pass through small buffers.

mod cursor;
mod decode;
pub mod document;
pub mod header;
pub mod model;
pub mod open;
mod sink;
mod spool;
mod strip;
pub mod surface;
mod verify;

pub use document::Document;
pub use open::{Opened, open, open_reader};
pub use surface::{Faces, Mesh, Positions};
