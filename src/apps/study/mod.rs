//! The paper's study: how good are samples, by its own measure and by others, over samplings, sizes and seeds.
//!
//! [`ground`] makes of a mesh what all runs on it share (graph, held-out rows, one σ, all distances where they are few),
//! [`mod@compare`] runs samplings on it, [`table`] and [`chart`] tell; [`points`] is Fig. 1, on points that have no mesh;
//! [`embedding`] tells how far the embeddings are from the true one.

pub mod chart;
pub mod compare;
pub mod embedding;
pub mod ground;
pub mod points;
pub mod table;

pub use compare::{CompareParams, Record, compare};
pub use ground::{Over, StudyData, StudyParams};
