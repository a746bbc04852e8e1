//! Which vertex of one mesh corresponds to which of another: §7.1 of the paper, without known matches and at any size.
//!
//! Both meshes are embedded ([`crate::spectral::nystrom`]), the embeddings aligned ([`mod@align`]), the alignments
//! refined in a hundred functions and ranked ([`mod@refine`]), and vertices matched to the nearest ([`mod@dense`],
//! [`mod@matches`]). A part and a whole are matched differently ([`partial`]). Matches transfer colours, labels and
//! other properties ([`carry`]) and are compared with true ones ([`accuracy`]).

pub mod accuracy;
pub mod align;
pub mod carry;
pub mod dense;
pub mod files;
pub mod functional;
pub mod matches;
pub mod orientation;
pub mod pairs;
pub mod partial;
pub mod points;
pub mod refine;
pub mod search;
#[cfg(feature = "pictures")]
pub mod show;

pub use accuracy::Errors;
pub use align::{Alignment, Alignments, Shape, align};
pub use matches::{AlignedPair, Match, Matching, Pair, matches};
pub use orientation::Tensor;
pub use points::SurfacePoint;
pub use refine::{Outcome, Refine};
pub use search::EmbeddingSearch;
