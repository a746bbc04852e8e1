//! Plots of what a run found: how eigenvalues fall ([`spectrum`]), the hierarchy of parts with its cut ([`tree`]),
//! scores and the study's charts ([`charts`]). SVG or PNG.
//!
//! Text in a PNG is of an embedded typeface, so that a plot needs no font of the machine. Cost: milliseconds,
//! whatever the mesh.

mod canvas;
pub mod charts;
pub mod spectrum;
pub mod tree;

pub use spectrum::Spectrum;
pub use tree::{Dendrogram, TreePlot};
