//! Where arrays live: mapped files, work directories, shuffles to disk, the memory budget.
//!
//! Everything of the size of the mesh is a file here, mapped on demand, so that the kernel may
//! take its pages back at any time; only what a [`Budget`] grants is allocated. Where it grants enough, arrays of temporary
//! directories are [held] in memory instead.

pub mod aligned_buffer;
pub mod budget;
pub mod check;
mod context;
pub mod held;
pub mod manifest;
pub mod mapped;
pub mod npy;
pub mod rows_file;
pub mod run;
pub mod shuffle;
pub mod sizing;
mod stages;
pub mod workdir;

pub use budget::Budget;
pub use context::Context;
pub use mapped::{MappedBytes, MappedSlice, MappedSliceMut};
pub use run::Run;
pub use workdir::WorkDir;
