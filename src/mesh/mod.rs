//! From a mesh file or arrays to faces, and from labels back to a mesh file.
//!
//! [`Mesh`] is what the layers above see: positions and faces behind mapped files or arrays in memory, whatever
//! the file looked like. [`open()`] makes one of every PLY flavour: most are used where they lie, the rest are
//! decoded once, in one pass through small buffers. OBJ, OFF and STL become PLY first. [`ply`] holds all that
//! knows this format. [`strays`] finds vertices that lie far outside of the rest, [`split_faces`] cuts faces
//! along smooth boundaries.

pub mod extent;
pub mod geometry;
pub mod import;
pub mod open;
pub(crate) mod output;
pub mod ply;
pub mod polygon;
pub mod positions;
pub mod seg;
pub mod size;
pub mod split_faces;
pub mod strays;

pub use geometry::{Coordinate, Faces, Mesh};
pub use open::{Pipe, open, open_reader};
pub use output::ends_with;
pub use ply::document::Document;
pub use ply::labelled::{Labelling, PlyForm, PlyOptions, UNLABELLED, write_labelled, write_labelled_to};
pub use positions::{Positions, StridedLayout};
pub use seg::{read_seg, write_seg, write_seg_to};
pub use size::{MeshSize, size_of_mesh};
