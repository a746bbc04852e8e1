//! From rows of distances to an embedding: kernels, Nyström extrapolation, quality.
//!
//! Everything here is a function of the sampled block `[A B]`; C, the block of all other pairs, is never formed.
//! Fits run on a constant number of columns ([`columns`]); what covers every face streams over
//! chunks of columns ([`Embedding::chunk`]).

pub mod block;
pub mod columns;
pub mod embedding;
pub mod exact;
pub mod exp;
pub mod kernel;
pub mod measures;
pub mod nystrom;
pub mod orthogonal;
pub mod preprocess;
pub mod quality;

pub use crate::base::eigen;
pub use columns::Columns;
pub use embedding::{Embedding, EmbeddingParams, Normalisation};
pub use kernel::Kernel;
pub use orthogonal::Orthogonal;
