//! Where arrays live: mapped files, work directories, shuffles to disk, the memory budget.
//!
//! Everything of the size of the mesh is a file here, mapped on demand, so that the kernel may reclaim its pages at any
//! time; only what a [`Budget`] grants is allocated. If it grants enough, arrays of temporary directories are kept in
//! memory instead ([`in_memory`]).

pub mod access;
pub mod budget;
pub mod checked;
mod claims;
pub mod direct;
pub mod disk_speed;
mod existing;
mod folder;
pub mod in_memory;
pub mod json;
pub mod leftovers;
pub mod manifest;
pub mod mapped;
pub mod needs;
pub(crate) mod new_file;
pub mod npy;
pub(crate) mod npy_header;
pub mod rows_file;
pub mod run;
pub mod scratch_array;
pub mod shuffle;
pub mod stage;
pub mod verify;
pub mod workdir;

pub use budget::Budget;
pub use folder::{PrivateFolder, private as private_folder};
pub use mapped::{MappedBytes, MappedSlice, MappedSliceMut};
pub use new_file::{create as create_locked, folder_of, partial_name};
pub use run::{Context, Run};
pub use scratch_array::ScratchArray;
pub use stage::Stage;
pub use workdir::WorkDir;

/// Without the bytes: a mesh would be printed in full.
impl std::fmt::Debug for MappedBytes {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("MappedBytes").field("len", &self.len()).finish_non_exhaustive()
    }
}
