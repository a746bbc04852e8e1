//! The paper's study: the quality of samples, by its own measure and by others, over samplings, sizes and seeds.
//!
//! [`data`] holds what all runs on a mesh share (graph, held-out rows, one σ, all distances if there are few),
//! [`mod@compare`] runs samplings on it and compares embeddings with the true one, [`summary`] summarises the results;
//! [`points`] is Fig. 1, on points without a mesh. `plots::charts` draws the charts.

pub mod compare;
pub mod data;
pub mod points;
pub mod summary;

pub use compare::{CompareParams, SampleRecord, StudyWidth, compare};
pub use data::{Over, StudyData, StudyParams};
