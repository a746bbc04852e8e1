//! Which vertex of one mesh is which of another: §7.1 of the paper, without known matches and at any size.
//!
//! Both meshes are embedded ([`crate::spectral::orthogonal`]), the embeddings aligned ([`mod@align`]), vertices matched to
//! the nearest ([`mod@matches`]). Matches carry colours, labels and other properties over ([`carry`]) and are judged by
//! true ones ([`error`]).

pub mod align;
pub mod candidates;
pub mod carry;
mod confidence;
pub mod error;
pub mod files;
pub mod matches;
pub mod nearest;
pub mod orientation;
pub mod show;
pub mod transport;

pub use align::{Alignment, Alignments, Shape, align};
pub use error::Errors;
pub use matches::{Match, Matching, Pair, matches};
pub use nearest::Nearest;
pub use orientation::Tensor;
