//! Cuts meshes of a thousand to a billion triangles into their meaningful parts, in memory or out of core.
//!
//! ```
//! # fn main() -> nystrom_stream::Result<()> {
//! # let dir = tempfile::tempdir().unwrap();
//! # let scan = dir.path().join("scan.ply");
//! # let creature = nystrom_stream::Mesh::creature(4_000)?;
//! # let labels = vec![0; creature.faces.len()];
//! # let plain =
//! #     nystrom_stream::Labelling { labels: &labels, colours: &[[128; 3]], quality: None, names: &[], fine: None };
//! # creature.save(&scan, plain)?;
//! # let (scan, parts) = (&scan, dir.path().join("parts.ply"));
//! use nystrom_stream::{Mesh, Segmenter};
//!
//! let mesh = Mesh::open(scan)?; // or Mesh::from_slices(&positions, &triangles)?
//! let cut = Segmenter::new().parts(6).run(&mesh)?;
//! cut.save(parts)?;
//! # assert_eq!((cut.labels().len(), cut.parts()), (mesh.faces.len(), 6));
//! # Ok(())
//! # }
//! ```
//!
//! # What
//!
//! A surface is cut where people would cut it: legs from a body, a handle from a cup. Every face gets a label and a
//! confidence, every part a colour; the number of parts is given or found. Meshes may have holes, many components,
//! polygons, and edges with more than two faces. The same embedding orders meshes for streaming and matches their
//! vertices.
//!
//! # How
//!
//! A streaming implementation of *Sub-sampling for Efficient Spectral Mesh Processing* (Liu, Jain, Zhang, CGI 2006).
//! Faces are the nodes of a dual graph, whose edges are weighted by distance and turning. Of the n × n affinity matrix
//! only l rows are computed: distances from l landmarks, chosen by farthest-point sampling or drawn by area and
//! distance. Above 60,000 faces the default method computes them over a contraction to 30,000 nodes. Nyström's method
//! extends the eigenvectors of the l × l block to all faces (eq. 1 and 2). An ensemble of over-segmentations of some
//! two thousand cells is merged by concavity and convexity into a hierarchy, which can be cut into any number of parts;
//! one more front moves the boundaries onto creases. Results are the same bytes whatever threads, memory and chunk
//! sizes are used.
//!
//! # Entry points
//!
//! | Type | Question that it answers |
//! |---|---|
//! | [`Mesh`] | a file ([`Mesh::open`]), slices ([`Mesh::from_slices`]) or vectors ([`Mesh::from_vecs`]) |
//! | [`Segmenter`] → [`Segmentation`] | Which parts does it have? |
//! | [`Hierarchy`] | And in any other number of parts? |
//! | [`Sequencer`] → [`Sequence`] | In which order does it stream best? |
//! | `Matcher` → `Correspondence` | Which vertices of two meshes correspond? (feature `correspondence`) |
//! | [`SamplingQuality`] → [`SampleRecord`] | How well do l landmarks represent it (Γ, eq. 6)? |
//! | [`evaluate()`] → [`Scores`] | How far are labels from those of people? |
//! | [`LabelTransfer`] → [`Transferred`] | Which labels does another version of it get? |
//!
//! The types of their options are in [`options`]. `examples/cut.rs` cuts a file; `examples/distances.rs` uses the
//! layers below.
//!
//! # Layers
//!
//! All layers are public, for those who want only rows or fronts. Each layer uses only those before it in this list:
//! [`base`] (errors, threads, random numbers), [`store`] (arrays on disk or in memory, stages, budget), [`mesh`] (files
//! and arrays), [`graph`] (dual graph, weights, order), [`distance`] (fronts and the rows they compute), [`spectral`]
//! (kernels, Nyström), [`landmarks`] (samplings), [`cluster`] (K-means, parts, boundaries), [`apps`] (what is done with
//! parts), [`pipeline`] (stages put together), [`api`] (this page).
//!
//! # Systems
//!
//! The library is tested on Linux and compiles for macOS; other systems are rejected at compile time. Memory pages may
//! have any size; numbers must be little-endian.
//!
//! # Features
//!
//! None is needed to cut meshes, so a crate that does may depend on this one with `default-features = false`.
//! `pictures`, `plots`, `pages` and `parquet` add output formats, `correspondence` adds matching, `sprs` the weighted
//! graph as a matrix of that crate (version 0.11), `cli` (on by default) the program.
//!
//! A debug build takes some ten times as long; `opt-level = 3` under `[profile.dev.package."*"]` avoids that.

#[cfg(not(unix))]
compile_error!("nystrom-stream maps files and locks folders as Unix does: Linux is supported, macOS compiles");

pub mod api;
pub mod apps;
pub mod base;
pub mod cluster;
pub mod distance;
pub mod graph;
pub mod landmarks;
pub mod mesh;
pub mod pipeline;
pub mod spectral;
pub mod store;

pub use api::options;
#[cfg(feature = "correspondence")]
pub use api::{Correspondence, Matcher};
pub use api::{
    Hierarchy, LabelTransfer, SampleRecord, SamplingQuality, SaveOptions, Scores, Segmentation, Segmenter, Sequence,
    Sequencer, Transferred, evaluate,
};
pub use base::{Cancel, Error, Progress, Result};
pub use mesh::{Labelling, Mesh};
