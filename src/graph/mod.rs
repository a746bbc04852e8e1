//! The dual graph: a node a face, an edge a shared mesh edge, weighted by distance and turning.
//!
//! Built out of core in three shuffles and a few sequential passes ([`DualGraph::build`]): node
//! geometry, half-edges matched by vertex ([`adjacency`]) or by position ([`weld`]), rows
//! assembled in node order ([`assemble`]), components bridged ([`components`], [`bridge`]), and
//! weights ([`weights`]) as a pure function of the undirected edge. Correspondence walks over [`vertices`] instead.

pub mod adjacency;
pub mod angle;
pub mod assemble;
pub mod bridge;
pub mod components;
pub mod dual;
pub mod duplicate_vertices;
pub mod half_edge_pairs;
pub mod nodes;
pub mod order;
pub mod orient;
pub mod triangle_adjacency;
pub mod vertex_adjacency;
pub mod vertices;
pub mod weights;
pub mod weld;

pub use dual::{DualGraph, GraphFacts};
pub use nodes::{Frame, Node};
pub use order::{NodeOrder, Order, Ordered};
pub use vertex_adjacency::VertexAdjacency;
pub use vertices::VertexGraph;
pub use weights::Metric;
