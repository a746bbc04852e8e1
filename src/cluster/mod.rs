//! From coordinates to labels.

pub mod assign;
pub mod kmeans;

pub use kmeans::{KMeans, KMeansParams};
