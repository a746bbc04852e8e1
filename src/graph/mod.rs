//! The dual graph: a node per face, an edge per shared mesh edge, weighted by distance and turning.
//!
//! Built out of core in three shuffles and a few sequential passes ([`DualGraph::build`]): node geometry ([`nodes`]),
//! half-edges matched by vertex or by position ([`half_edges`], [`half_edge_pairs`]), faces that occur twice set aside
//! (`duplicates`, `flaps`), edges assembled in node order ([`dual_edges`]), components found ([`components`]) and
//! joined ([`bridges`]), winding made consistent ([`orient`]), and weights ([`weights`]) as a pure function of the
//! undirected edge. If the file scatters neighbours, [`order`] sorts faces beforehand. Correspondence uses the
//! [`vertex_graph`] instead.

pub mod angle;
mod assemble_in_memory;
pub mod bridges;
mod component_blocks;
pub mod components;
pub mod csr;
pub mod dual;
pub mod dual_edges;
mod duplicates;
mod edge_links;
mod face_rows;
mod flaps;
pub mod frame;
mod half_edge_block;
pub mod half_edge_pairs;
mod half_edge_sort;
pub mod half_edges;
mod node_batch;
mod node_blocks;
pub mod node_geometry;
pub mod nodes;
mod nonmanifold;
pub mod order;
pub mod orient;
pub(crate) mod orientation_sums;
mod ranked_tree;
pub mod row_starts;
pub mod vertex_adjacency;
pub mod vertex_graph;
pub mod weights;

pub use csr::{Csr, TriangleAdjacency, WeightedGraph};
pub use dual::{DualGraph, GraphFacts};
pub use dual_edges::DualEdges;
pub use frame::Frame;
pub use node_geometry::{NodeGeometry, NodeView, SharedEdges};
pub use nodes::Node;
pub use order::{NodeOrder, Order, OrderParams, Ordered};
pub use row_starts::{OwnedRowStarts, RowStarts};
pub use vertex_adjacency::VertexAdjacency;
pub use vertex_graph::VertexGraph;
pub use weights::Metric;
