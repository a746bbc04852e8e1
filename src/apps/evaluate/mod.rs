//! How well labels agree with those of people: the metrics of the Princeton Segmentation Benchmark.
//!
//! Rand index, cut discrepancy, Hamming distance and consistency errors as Chen, Golovinskiy and
//! Funkhouser define them (*A Benchmark for 3D Mesh Segmentation*, 2009). A [`Surface`] is made
//! once a mesh; [`compare`] is the short way for a single pair, [`Benchmark`] judges a folder. Labels are slices with one `u32` a
//! face in the order of the mesh file; their values do not matter. Cost: O(n) a pair (10⁷ faces in
//! under a second), and for cut discrepancy a sort of the edges a mesh and a Dijkstra a labelling.

mod benchmark;
mod contingency;
mod cuts;
mod labels;
mod matching;
mod plot;
mod regions;
mod scores;
mod surface;
mod table;

pub use benchmark::{Benchmark, Evaluation, Model, fitting};
pub use contingency::{Cell, Contingency, Part, contingency};
pub use labels::read_labels;
pub use matching::matches;
pub use plot::plot;
pub use regions::{Consistency, Hamming, consistency, hamming, rand, rand_area};
pub use scores::{Scores, Segmentation, compare};
pub use surface::Surface;
pub use table::{ModelScores, Row, Table};
