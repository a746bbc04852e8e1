//! From coordinates to labels.
//!
//! The paper's methods: [`kmeans`] or [`two_means`] on sampled columns, then one pass that labels every face.
//!
//! The default method cuts as people do: the surface into [`cells`] (with [`normals`] averaged over a radius), the
//! cells into [`parts`], and it moves the parts' [`boundary`] onto creases. Only cells, normals and boundaries use the
//! faces, in a few passes each; deciding on the parts takes constant time and memory. If more parts than cells are
//! requested, [`divide`] makes them.

pub mod area_shares;
pub mod band_graph;
pub mod boundary;
pub mod cells;
pub mod contract;
pub mod crease;
pub mod denoise;
pub mod divide;
pub mod extrapolate;
pub mod few_nodes;
pub mod kmeans;
pub mod max_flow;
pub mod mirror;
pub mod normals;
pub mod part_totals;
pub mod parts;
pub mod roughness;
pub mod shorten;
pub mod two_means;

pub use kmeans::{KMeans, KMeansParams};
