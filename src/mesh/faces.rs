//! The faces of a mesh: vertex indices over mapped bytes or arrays in memory.
//!
//! Two layouts serve every file and every array. A binary little-endian PLY of triangles is read in place (records at a
//! fixed stride). Anything else is decoded once into plain arrays of the work directory, which are records at a fixed
//! stride too, or corner lists for polygons. Nothing is allocated per face; a face reads 13 bytes of mapped file.

use super::positions::{check_fit, four};
use crate::base::Result;
use crate::base::vector::MapEach;
use crate::store::{MappedBytes, MappedSlice};
use std::convert::Infallible;
use std::ops::Range;
use std::path::Path;

/// The faces: vertex indices per face. Indices may be out of range; see [`Mesh::new`](super::Mesh::new).
#[derive(Clone, Debug)]
pub enum Faces {
    /// Triangles at a fixed stride: three little-endian 4-byte indices per record.
    Triangles {
        /// The mapped bytes.
        bytes: MappedBytes,
        /// Byte of the first index of face 0.
        offset: usize,
        /// Bytes from face to face.
        stride: usize,
        /// Number of faces.
        len: usize,
    },
    /// Polygons of any size: face `f` has the corners `corners[starts[f]..starts[f + 1]]`.
    Polygons {
        /// Faces + 1 offsets into `corners`, ascending from 0.
        starts: MappedSlice<u64>,
        /// Vertex indices.
        corners: MappedSlice<u32>,
    },
}

/// The corners of the triangle at `start`. A separate function, since the passes over faces are compiled for each
/// visitor.
#[inline]
fn triangle(bytes: &[u8], start: usize) -> [u32; 3] {
    let record = &bytes[start..start + 12];
    [0, 4, 8].map_each(|k| u32::from_le_bytes(four(&record[k..k + 4])))
}

impl Faces {
    /// Triangles at a fixed stride.
    ///
    /// # Errors
    /// [`crate::base::Error::Malformed`] naming `path` when they do not fit.
    pub fn triangles(path: &Path, bytes: MappedBytes, offset: usize, stride: usize, len: usize) -> Result<Self> {
        let stride = stride.max(12);
        check_fit(path, "faces", bytes.len(), offset, stride, len.saturating_sub(1))?;
        check_fit(path, "faces", bytes.len(), offset + len.saturating_sub(1) * stride, 12, len.min(1))?;
        Ok(Self::Triangles { bytes, offset, stride, len })
    }

    /// Number of faces.
    pub fn len(&self) -> usize {
        match self {
            Self::Triangles { len, .. } => *len,
            Self::Polygons { starts, .. } => starts.len().saturating_sub(1),
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Corners of all faces together.
    pub fn corner_count(&self) -> usize {
        match self {
            Self::Triangles { len, .. } => 3 * len,
            Self::Polygons { corners, .. } => corners.len(),
        }
    }

    /// The number of triangles in a triangulation of all faces; a face of fewer than three corners has none.
    pub fn triangle_count(&self) -> u64 {
        match self {
            Self::Triangles { len, .. } => *len as u64,
            Self::Polygons { starts, .. } => starts.windows(2).map(|ends| (ends[1] - ends[0]).saturating_sub(2)).sum(),
        }
    }

    /// The corners of face `f` as a range of corner numbers: corners are numbered through all faces.
    #[inline]
    pub fn corner_range(&self, face: usize) -> Range<usize> {
        match self {
            Self::Triangles { .. } => 3 * face..3 * face + 3,
            Self::Polygons { starts, .. } => starts[face] as usize..starts[face + 1] as usize,
        }
    }

    /// The face that corner number `corner`, below [`Faces::corner_count`], belongs to. Constant time for triangles and
    /// where all faces have the same number of corners, else a search from a good guess.
    #[inline]
    pub fn face_of_corner(&self, corner: usize) -> usize {
        match self {
            Self::Triangles { .. } => corner / 3,
            Self::Polygons { starts, corners } => {
                let n = starts.len() - 1;
                let guess = (corner as u128 * n as u128 / corners.len().max(1) as u128) as usize;
                let (mut low, mut high) = (guess.min(n - 1), guess.min(n - 1) + 1);
                let mut step = 1;
                while starts[low] as usize > corner {
                    (low, step) = (low.saturating_sub(step), step * 2);
                }
                step = 1;
                while high < n && starts[high] as usize <= corner {
                    (high, step) = ((high + step).min(n), step * 2);
                }
                low + starts[low..high].partition_point(|&start| start as usize <= corner) - 1
            }
        }
    }

    /// Calls `visit(face, its corners)` for every face of `range`, in order.
    #[inline]
    pub fn for_each(&self, range: Range<usize>, mut visit: impl FnMut(usize, &[u32])) {
        let Ok(()) = self.try_for_each(range, |face, corners| {
            visit(face, corners);
            Ok::<(), Infallible>(())
        });
    }

    /// The same, but stops when `visit` fails.
    ///
    /// # Errors
    /// The first error of `visit`.
    #[inline]
    pub fn try_for_each<E>(
        &self,
        range: Range<usize>,
        mut visit: impl FnMut(usize, &[u32]) -> Result<(), E>,
    ) -> Result<(), E> {
        match self {
            Self::Triangles { bytes, offset, stride, .. } => {
                for face in range {
                    visit(face, &triangle(bytes, offset + face * stride))?;
                }
            }
            Self::Polygons { starts, corners } => {
                let (starts, corners) = (&starts[..], &corners[..]);
                for face in range {
                    visit(face, &corners[starts[face] as usize..starts[face + 1] as usize])?;
                }
            }
        }
        Ok(())
    }

    /// Calls `visit(corners)` for one face.
    #[inline]
    pub fn with<R>(&self, face: usize, visit: impl FnOnce(&[u32]) -> R) -> R {
        match self {
            Self::Triangles { bytes, offset, stride, .. } => visit(&triangle(bytes, offset + face * stride)),
            Self::Polygons { starts, corners } => visit(&corners[starts[face] as usize..starts[face + 1] as usize]),
        }
    }
}
