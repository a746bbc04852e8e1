//! What can be done with a mesh besides cutting it, and with its labels.
//!
//! One folder per application; none of them uses the pipeline above. Drawing and formats of other programs are behind
//! features of their own, so that users of the core build without them: `pictures`, `plots`, `pages`, `parquet`,
//! `correspondence`.

mod assignment;
pub mod colours;
#[cfg(feature = "correspondence")]
pub mod correspond;
pub mod creature;
pub mod edits;
pub mod evaluate;
pub mod export;
mod integers;
pub mod labelled_faces;
pub mod measure;
#[cfg(feature = "pages")]
pub mod page;
#[cfg(feature = "pictures")]
pub mod picture;
#[cfg(feature = "plots")]
pub mod plots;
pub mod sequence;
pub mod study;
#[cfg(feature = "pictures")]
mod text;
pub mod transfer;
mod vertex_sums;

pub use integers::open_labels;
