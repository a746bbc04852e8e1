//! The PLY format: headers, numbers, and files read and written.
//!
//! From the bottom up: [`element`] and [`values`] know the types and the numbers of each encoding, [`header`] the
//! grammar; `read` finds and decodes positions and faces; [`document`] keeps what a copy of the file needs;
//! [`labelled`], [`rearranged`] and [`plain`] write.

pub mod document;
pub mod element;
mod fixed_records;
pub mod header;
pub mod labelled;
mod labelling;
pub mod names;
pub mod plain;
pub(super) mod read;
pub mod rearranged;
mod split_records;
mod split_vertices;
pub mod values;
mod vertex_labels;

pub use document::{Document, ElementKind, NumberProperty};
pub use element::{Element, Encoding, Kind, Property, Scalar};
pub use header::{Header, HeaderWriter};
pub use plain::{Column, write_annotated};
pub use values::Encoder;
