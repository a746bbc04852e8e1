//! The paper's study: how good are samples, by its own measure and by others, over samplings, sizes and seeds.
//!
//! [`data`] makes of a mesh what all runs on it share (graph, held-out rows, one σ, all distances where they are few),
//! [`mod@compare`] runs samplings on it and compares embeddings with the true one, [`summary`] tells the results;
//! [`points`] is Fig. 1, on points that have no mesh. Charts are drawn by `plots::charts`.

pub mod compare;
pub mod data;
pub mod points;
pub mod summary;

pub use compare::{CompareParams, SampleRecord, compare};
pub use data::{Over, StudyData, StudyParams};
