//! From a mesh file to faces, and from labels back to a mesh file.
//!
//! [`Mesh`] is what the floors above see: positions and faces behind mapped files, whatever the
//! file looked like.

pub mod surface;

pub use surface::{Faces, Mesh, Positions};
