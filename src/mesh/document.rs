//! The opened file as the labelled output needs it again.
//!
//! A [`Document`] keeps the mapping alive and remembers where each element lies, so that writing
//! copies what it does not change. It holds the header and a few numbers an element.

use super::header::Header;
use super::model::Encoding;
use crate::store::MappedBytes;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// An opened PLY file: its header and where its elements lie.
#[derive(Clone, Debug)]
pub struct Document {
    /// The path as the user gave it (`<stdin>` or the like for a stream).
    pub(super) path: PathBuf,
    pub(super) header: Header,
    /// The uncompressed file.
    pub(super) bytes: MappedBytes,
    /// The bytes of each element, without blanks around them where they are text.
    pub(super) ranges: Vec<Range<usize>>,
    /// Number of the element that holds the faces.
    pub(super) face: usize,
    /// Number of its property that lists the vertices.
    pub(super) list: usize,
    /// Whether that element holds triangle strips.
    pub(super) strips: bool,
    /// Bytes of every face's record where all are equal in size and layout (binary only).
    pub(super) face_bytes: Option<usize>,
}

impl Document {
    /// The path as the user gave it.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The header.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Number of the element that holds the vertices.
    pub(super) fn vertex(&self) -> Option<usize> {
        self.header.elements.iter().position(|element| element.is("vertex"))
    }

    /// Whether its numbers are text.
    pub fn is_text(&self) -> bool {
        self.header.encoding == Encoding::Ascii
    }

    /// Bytes of the uncompressed file.
    pub fn len(&self) -> u64 {
        self.bytes.len() as u64
    }

    /// Never: an empty file is refused when opened.
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// The bytes of the uncompressed file, as for a checksum that tells whether a stage's input
    /// is still the same.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }
}
