//! Plots of results: the decay of eigenvalues ([`spectrum`]), the hierarchy of parts with its cut ([`tree`]), scores
//! and the study's charts ([`charts`]). SVG or PNG.
//!
//! Text in a PNG uses an embedded typeface, so that a plot needs no system font. Cost: milliseconds, whatever the mesh.

mod canvas;
pub mod charts;
pub mod spectrum;
pub mod tree;

pub use spectrum::Spectrum;
pub use tree::{Dendrogram, TreePlot};
