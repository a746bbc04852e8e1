//! From a mesh file to faces, and from labels back to a mesh file.
//!
//! [`Mesh`] is what the floors above see: positions and faces behind mapped files, whatever the
//! file looked like. [`open()`] makes one of every PLY flavour: most are used where they lie, the
//! rest are decoded once, in one pass through small buffers. OBJ, OFF and STL become PLY first.

pub mod annotated;
pub mod columns;
mod cursor;
mod decode;
pub mod document;
mod encode;
pub mod face_columns;
mod face_property;
mod fixed;
pub mod header;
pub mod import;
pub mod labelled;
mod labelling;
pub mod model;
pub mod open;
pub(crate) mod output;
mod pieces;
pub mod rearranged;
mod records;
pub mod seg;
mod sink;
mod spool;
mod strip;
pub mod surface;
mod verify;
mod vertex_labels;

pub use document::Document;
pub use labelled::{Labelling, PlyForm, PlyOptions, write_labelled, write_labelled_to};
pub use open::{Opened, open, open_reader};
pub use seg::{read_seg, write_seg, write_seg_to};
pub use surface::{Faces, Mesh, Positions};
