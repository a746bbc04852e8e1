//! From coordinates to labels.
//!
//! The paper's ways: [`kmeans`] or [`two_means`] on sampled columns, [`assign`] for every face. The default way cuts
//! as people do: the surface in cells ([`cells`], with [`normals`] at a radius of the shape), the cells into
//! [`parts`], and the parts' [`boundary`] onto creases.

pub mod area_shares;
pub mod assign;
pub mod boundary;
pub mod cell_rows;
pub mod cells;
pub mod contract;
pub mod extrapolate;
pub mod islands;
pub mod kmeans;
pub mod normals;
pub mod parts;
pub mod seeds;
pub mod smooth;
pub mod sums;
pub mod two_means;

pub use kmeans::{KMeans, KMeansParams};
