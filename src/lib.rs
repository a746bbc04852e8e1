//! Cuts meshes of a million to a billion triangles into their meaningful parts, out of core.
//!
//! An implementation of *Sub-sampling for Efficient Spectral Mesh Processing* (Liu, Jain, Zhang,
//! CGI 2006) that streams: the folders follow the data, from the lowest floor ([`base`],
//! [`store`]) over [`mesh`], [`graph`], [`distance`], [`spectral`], [`landmarks`] and [`cluster`] to the
//! applications.
//!
//! ```
//! use nystrom_stream::apps::creature::{Creature, Options};
//! use nystrom_stream::pipeline::{SegmentParams, input, segment};
//! use nystrom_stream::store::{Context, Run, WorkDir};
//!
//! # fn main() -> nystrom_stream::base::Result<()> {
//! let run = Run::new(&()); // all cores, half of the free memory, no progress
//! let work = WorkDir::temporary(&std::env::temp_dir())?;
//! let path = work.file("creature.ply");
//! Creature::new(&Options { faces: 5_000, ..Options::default() })?.write_ply(&path, &run)?;
//!
//! let opened = nystrom_stream::mesh::open(&path, work.path(), &run)?;
//! let cut = segment(&opened, &input::identity(&path)?, &SegmentParams::default(), Context::new(&work, &run))?;
//! assert_eq!(cut.labels.len(), opened.faces.len());
//! println!("{} parts", cut.numbers.faces.len());
//! # Ok(())
//! # }
//! ```
//! `examples/cut.rs` cuts a file; `examples/distances.rs` uses the floors below.

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
