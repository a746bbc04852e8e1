//! Cuts meshes of a million to a billion triangles into their meaningful parts, out of core.
//!
//! An implementation of *Sub-sampling for Efficient Spectral Mesh Processing* (Liu, Jain, Zhang,
//! CGI 2006) that streams: the folders follow the data, from the lowest floor ([`base`],
//! [`store`]) over [`mesh`], [`graph`], [`distance`], [`spectral`] and [`cluster`] to the
//! applications.

pub mod apps;
pub mod pipeline;
pub mod base;
pub mod cluster;
pub mod distance;
pub mod graph;
pub mod mesh;
pub mod spectral;
pub mod store;
