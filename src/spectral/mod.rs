//! From rows of distances to an embedding: kernels, Nyström's extension, and the quality of a sample.
//!
//! Everything here is a function of the sampled block `[A B]`; C, the block of all other pairs, is never formed. Fits
//! use a constant number of columns ([`SampledColumns`]); what concerns every face streams over chunks of columns
//! ([`Embedding::chunk`]). The embeddings and their uses:
//! - [`embedding`]: the paper's segmentation and its sequences, over faces, in `f32`;
//! - [`anchor`]: the decision about parts, over cells, in `f64`;
//! - [`nystrom`]: the start of correspondence, over vertices, and the study of sampling and kernels;
//! - [`local`]: a hundred functions for refining correspondence, from distances to the nearby sample alone; with
//!   [`laplacian`] those of the Laplace–Beltrami operator.

pub mod affinity;
pub mod anchor;
pub mod embedding;
pub mod exp;
pub mod kernel;
pub mod laplacian;
pub mod local;
pub mod measures;
pub mod nystrom;

pub use embedding::{Embedding, EmbeddingParams, KernelWidth, Normalisation, SampledColumns};
pub use kernel::Kernel;
pub use nystrom::OrthogonalEmbedding;
