//! From a mesh file or arrays to faces, and from labels back to a mesh file.
//!
//! [`Mesh`] is what the layers above see: positions and faces in mapped files or arrays in memory, whatever the format
//! of the file. [`open()`] reads every flavour of PLY: most are used in place, the rest are decoded once, in one pass
//! through small buffers. OBJ, OFF and STL are converted to PLY first. [`ply`] holds all code that knows this format.
//! [`strays`] finds vertices far outside the rest, `duplicates` knows faces that occur twice, `long_edges` makes long
//! triangles short, [`split_faces`] cuts faces along smooth boundaries.

pub(crate) mod duplicates;
pub mod extent;
pub mod faces;
pub mod geometry;
pub mod import;
pub(crate) mod long_edges;
pub mod open;
pub(crate) mod output;
pub mod ply;
pub mod polygon;
pub mod positions;
mod sampling;
pub mod seg;
pub mod size;
pub mod split_faces;
pub mod strays;

pub use faces::Faces;
pub use geometry::{Coordinate, Mesh};
pub use open::{Pipe, open, open_reader};
pub use output::ends_with;
pub use ply::document::Document;
pub use ply::labelled::{Labelling, PlyForm, PlyOptions, UNLABELLED, write_labelled, write_labelled_to};
pub use positions::{Positions, StridedLayout};
pub use seg::{read_seg, write_seg, write_seg_to};
pub use size::{MeshSize, size_of_mesh};
