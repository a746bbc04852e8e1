//! The lowest layer: errors, progress, cancellation, deterministic parallel loops, loops on wide
//! vectors, boxes, sets of bits, disjoint sets, lists by owner, short sorts, shortest paths, moments and small
//! eigenproblems.
//!
//! Nothing here knows about meshes, files or command lines.

pub mod bit_set;
pub mod bounds;
pub mod cancel;
pub mod dijkstra;
pub mod eigen;
pub mod error;
pub mod groups;
pub mod moments;
pub mod parallel;
pub mod printable;
pub mod progress;
pub mod random;
pub(crate) mod setters;
pub mod simd;
pub mod sort;
pub mod tally;
pub mod union_find;
pub mod vector;

pub use cancel::Cancel;
pub use error::{Error, Result};
pub use progress::{Progress, RunLog};
