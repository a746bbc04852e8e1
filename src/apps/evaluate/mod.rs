//! Agreement of labels with those of people: the metrics of the Princeton Segmentation Benchmark.
//!
//! Rand index, cut discrepancy, Hamming distance and consistency errors as defined by Chen, Golovinskiy and Funkhouser
//! (*A Benchmark for 3D Mesh Segmentation*, 2009). An [`Evaluator`] is built once per mesh; [`compare`] is a shortcut
//! for a single pair, [`Benchmark`] evaluates a folder. Labels are slices with one `u32` per face in the order of the
//! mesh file; their values do not matter. Cost: O(n) per pair (10⁷ faces in under a second), and for cut discrepancy
//! one sort of the edges per mesh and one Dijkstra per labelling.

mod benchmark;
mod boundaries;
mod contingency;
mod scores;

pub use benchmark::{Benchmark, BenchmarkModel, Evaluation, LABEL_EXTENSIONS, fitting, read_labels};
pub use boundaries::Evaluator;
pub use contingency::{
    Consistency, Contingency, Hamming, Marginal, Overlap, consistency, contingency, hamming, matches, rand, rand_area,
};
pub use scores::{MeanScores, ModelScores, ScoreTable, Scores, Segmentation, compare};
