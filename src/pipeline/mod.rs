//! The stages combined: from a mesh to one label per face, to an order, to matches.
//!
//! ```text
//! mesh ─▶ dual graph ─▶ weights ─▶ landmarks ─▶ rows [A B] ─┬▶ embedding ─▶ centres ─▶ labels ─▶ colours
//!                                                            └▶ cells ─▶ parts ─▶ boundaries ─┘
//! ```
//! Every arrow is a stage in the work directory, reused if its inputs and options are the same. [`recipe`] reads like
//! this picture; [`plan`] estimates the cost beforehand, and [`forecast`] tells it.

pub mod admission;
pub mod calibrate;
mod components;
mod contracted;
#[cfg(feature = "correspondence")]
pub mod correspond;
pub mod cuts;
pub mod decision;
pub mod edits;
pub mod embed;
pub mod forecast;
pub mod input;
pub mod labels;
#[cfg(feature = "correspondence")]
pub mod like;
mod means;
mod on_proxy;
pub mod params;
#[cfg(feature = "correspondence")]
mod partial;
mod parts;
pub mod plan;
mod proxy;
pub mod recipe;
pub mod report;
mod sample;
pub mod sequence;
pub mod sharding;
mod shared_boundaries;
#[cfg(feature = "correspondence")]
mod sides;
#[cfg(feature = "correspondence")]
mod subdivided;
mod surface;
mod units;
#[cfg(feature = "correspondence")]
mod used_vertices;

pub use labels::SegmentedMesh;
pub use params::{
    Boundaries, Cluster, SegmentParams, TinyComponents, Walls, default_landmarks_for_faces, default_landmarks_for_parts,
};
pub use recipe::{segment, segment_corrected};
