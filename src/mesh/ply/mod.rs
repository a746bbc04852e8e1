//! The PLY format: headers, numbers, and files read and written.
//!
//! From the bottom up: `header` and `values` know the grammar and the numbers of each encoding; `read` finds and
//! decodes positions and faces; `document` keeps what a copy of the file needs; [`labelled`], [`rearranged`] and
//! [`plain`] write.

pub mod document;
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
pub use header::{Element, Encoding, Header, HeaderWriter, Kind, Property, Scalar};
pub use plain::{Column, write_annotated};
pub use values::Encoder;
