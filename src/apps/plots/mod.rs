//! Plots of what a run found: how eigenvalues fall ([`spectrum`]), and the hierarchy of parts with its cut ([`tree`]).
//! SVG or PNG.
//!
//! Text in a PNG is of a built-in bitmap font, so that a plot needs no font of the machine. Cost: milliseconds,
//! whatever the mesh.

pub(in crate::apps) mod canvas;
pub mod dendrogram;
pub mod spectrum;
pub mod tree;

pub use dendrogram::Dendrogram;
pub use spectrum::Spectrum;
pub use tree::TreePlot;
