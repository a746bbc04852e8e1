//! The mesh as the floors above see it: positions and faces over mapped bytes.
//!
//! Two layouts serve every file. A binary little-endian PLY of triangles is read where it lies
//! (records at a fixed stride); anything else is decoded once into plain arrays of the work
//! directory, which are records at a fixed stride too, or, for polygons, corner lists. Nothing is
//! allocated here; a face costs 13 bytes of mapped file read, a position 12 or more.

use crate::base::vector::finite;
use crate::base::{Error, Result};
use crate::store::npy;
use crate::store::{MappedBytes, MappedSlice};
use std::ops::Range;
use std::path::Path;

/// Vertex positions at a fixed stride in mapped bytes, `f32` or `f64`, little-endian.
#[derive(Clone, Debug)]
pub struct Positions {
    bytes: MappedBytes,
    /// Byte of the first record.
    offset: usize,
    /// Bytes from record to record.
    stride: usize,
    /// Bytes from a record's start to its x, y, z.
    at: [usize; 3],
    double: bool,
    len: usize,
}

impl Positions {
    /// Positions inside `bytes`: `len` records of `stride` bytes from `offset`, coordinates at
    /// `at` within a record, of 8 bytes if `double`, else of 4.
    ///
    /// # Errors
    /// [`Error::Malformed`] naming `path` when they do not fit.
    pub fn strided(
        path: &Path,
        bytes: MappedBytes,
        offset: usize,
        stride: usize,
        at: [usize; 3],
        double: bool,
        len: usize,
    ) -> Result<Self> {
        check_fit(path, "vertices", bytes.len(), offset, stride, len)?;
        let size = if double { 8 } else { 4 };
        if at.iter().any(|at| at + size > stride) {
            return Err(Error::malformed(
                path,
                "vertices",
                "coordinates lie outside their record",
                "write the file again",
            ));
        }
        Ok(Self { bytes, offset, stride, at, double, len })
    }

    /// Number of vertices.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Whether coordinates have 64 bits.
    pub fn is_double(&self) -> bool {
        self.double
    }

    /// The position of vertex `v`; NaN where there is no such vertex. Handed over in registers: through memory, two numbers
    /// at a time are waited for after one at a time was written, a third of a pass over all corners.
    #[inline(always)]
    pub fn get(&self, v: u32) -> [f64; 3] {
        let start = self.offset + v as usize * self.stride;
        let Some(record) = self.bytes.get(start..start + self.stride).filter(|_| (v as usize) < self.len) else {
            return [f64::NAN; 3];
        };
        // Written out: mapping over the array is not always inlined, and this is every pass's inner loop.
        let [x, y, z] = self.at;
        if self.double {
            let get = |at: usize| f64::from_le_bytes(eight(&record[at..at + 8]));
            [get(x), get(y), get(z)]
        } else {
            let get = |at: usize| f64::from(f32::from_le_bytes(four(&record[at..at + 4])));
            [get(x), get(y), get(z)]
        }
    }
}

#[inline(always)]
fn four(bytes: &[u8]) -> [u8; 4] {
    [bytes[0], bytes[1], bytes[2], bytes[3]]
}

#[inline(always)]
fn eight(bytes: &[u8]) -> [u8; 8] {
    [bytes[0], bytes[1], bytes[2], bytes[3], bytes[4], bytes[5], bytes[6], bytes[7]]
}

/// Refuses `len` records that `bytes` cannot hold.
fn check_fit(path: &Path, what: &str, bytes: usize, offset: usize, stride: usize, len: usize) -> Result<()> {
    let end = len.checked_mul(stride).and_then(|size| size.checked_add(offset));
    if end.is_none_or(|end| end > bytes) {
        return Err(Error::malformed(
            path,
            what,
            format!("{len} records of {stride} bytes do not fit in the file's {bytes} bytes"),
            "the file is cut short; get it again",
        ));
    }
    Ok(())
}

/// The faces: vertex indices per face. Indices may be out of range; see [`Mesh::new`].
#[derive(Clone, Debug)]
pub enum Faces {
    /// Triangles at a fixed stride: three little-endian 4-byte indices a record.
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

impl Faces {
    /// Triangles at a fixed stride.
    ///
    /// # Errors
    /// [`Error::Malformed`] naming `path` when they do not fit.
    pub fn triangles(path: &Path, bytes: MappedBytes, offset: usize, stride: usize, len: usize) -> Result<Self> {
        let inside = stride.min(12);
        check_fit(path, "faces", bytes.len(), offset, stride, len.saturating_sub(1))?;
        check_fit(path, "faces", bytes.len(), offset + len.saturating_sub(1) * stride, inside, len.min(1))?;
        Ok(Self::Triangles { bytes, offset, stride: stride.max(12), len })
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

    /// The corners of face `f` as a range of corner numbers: corners are numbered through all faces.
    #[inline]
    pub fn corner_range(&self, face: usize) -> Range<usize> {
        match self {
            Self::Triangles { .. } => 3 * face..3 * face + 3,
            Self::Polygons { starts, .. } => starts[face] as usize..starts[face + 1] as usize,
        }
    }

    /// The face that corner number `corner` belongs to. Constant for triangles and where all
    /// faces have equally many corners, else a search from a good guess.
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
                while starts[high] as usize <= corner {
                    (high, step) = ((high + step).min(n), step * 2);
                }
                low + starts[low..high].partition_point(|&start| start as usize <= corner) - 1
            }
        }
    }

    /// Calls `visit(face, its corners)` for every face of `range`, in order.
    #[inline]
    pub fn for_each(&self, range: Range<usize>, mut visit: impl FnMut(usize, &[u32])) {
        match self {
            Self::Triangles { bytes, offset, stride, .. } => {
                for face in range {
                    let start = offset + face * stride;
                    let record = &bytes[start..start + 12];
                    let corner = |k: usize| u32::from_le_bytes(four(&record[4 * k..4 * k + 4]));
                    visit(face, &[corner(0), corner(1), corner(2)]);
                }
            }
            Self::Polygons { starts, corners } => {
                let (starts, corners) = (&starts[..], &corners[..]);
                for face in range {
                    visit(face, &corners[starts[face] as usize..starts[face + 1] as usize]);
                }
            }
        }
    }

    /// Calls `visit(corners)` for one face.
    #[inline]
    pub fn with<R>(&self, face: usize, visit: impl FnOnce(&[u32]) -> R) -> R {
        match self {
            Self::Triangles { bytes, offset, stride, .. } => {
                let start = offset + face * stride;
                let record = &bytes[start..start + 12];
                let corner = |k: usize| u32::from_le_bytes(four(&record[4 * k..4 * k + 4]));
                visit(&[corner(0), corner(1), corner(2)])
            }
            Self::Polygons { starts, corners } => visit(&corners[starts[face] as usize..starts[face + 1] as usize]),
        }
    }
}

/// A mesh: positions, and faces whose indices are all in range.
#[derive(Clone, Debug)]
pub struct Mesh {
    /// Vertex positions.
    pub positions: Positions,
    /// Faces, in the order of the file.
    pub faces: Faces,
}

impl Mesh {
    /// Puts positions and faces together. The caller has checked every index (the readers of this
    /// floor do, while decoding); [`Positions::get`] answers NaN to a wrong one all the same.
    pub fn new(positions: Positions, faces: Faces) -> Self {
        Self { positions, faces }
    }

    /// Calls `visit(corners, positions)` for the triangles of the fan of a face's `corners`; those without a place in
    /// space are left out.
    #[inline]
    pub fn fan(&self, corners: &[u32], mut visit: impl FnMut([u32; 3], [[f64; 3]; 3])) {
        let [first, second, rest @ ..] = corners else { return };
        let origin = self.positions.get(*first);
        let (mut before, mut at) = (*second, self.positions.get(*second));
        for &corner in rest {
            let position = self.positions.get(corner);
            if finite(origin) && finite(at) && finite(position) {
                visit([*first, before, corner], [origin, at, position]);
            }
            (before, at) = (corner, position);
        }
    }

    /// A mesh from arrays in memory, written to `folder` (`vertices.npy`, `face_starts.npy`,
    /// `face_vertices.npy`): for tests, generators and bindings.
    ///
    /// # Errors
    /// [`Error::Io`], or [`Error::Malformed`] for an index out of range.
    pub fn from_arrays<F: AsRef<[u32]>>(folder: &Path, vertices: &[[f64; 3]], faces: &[F]) -> Result<Self> {
        let path = folder.join("vertices.npy");
        npy::write(&path, vertices.as_flattened(), 3, false)?;
        let positions =
            Positions::strided(&path, MappedBytes::open(&path)?, npy::HEADER, 24, [0, 8, 16], true, vertices.len())?;
        let mut starts = vec![0u64];
        let mut corners = Vec::new();
        for (f, face) in faces.iter().enumerate() {
            if let Some(v) = face.as_ref().iter().find(|&&v| v as usize >= vertices.len()) {
                return Err(Error::malformed(
                    &path,
                    format!("face {f}"),
                    format!("names vertex {v} of {}", vertices.len()),
                    "correct the indices",
                ));
            }
            corners.extend_from_slice(face.as_ref());
            starts.push(corners.len() as u64);
        }
        let starts = npy::write(&folder.join("face_starts.npy"), &starts, 1, false)?;
        let corners = npy::write(&folder.join("face_vertices.npy"), &corners, 1, false)?;
        Ok(Self::new(positions, Faces::Polygons { starts, corners }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_make_a_mesh() {
        let dir = tempfile::tempdir().unwrap();
        let mesh = Mesh::from_arrays(
            dir.path(),
            &[[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]],
            &[vec![0u32, 1, 2, 3], vec![0, 2, 1]],
        )
        .unwrap();
        let mut seen = Vec::new();
        mesh.faces.for_each(0..2, |f, corners| seen.push((f, corners.to_vec())));
        assert_eq!(seen, [(0, vec![0, 1, 2, 3]), (1, vec![0, 2, 1])]);
        assert_eq!(mesh.positions.get(2), [1., 1., 0.]);
        assert_eq!((0..7).map(|c| mesh.faces.face_of_corner(c)).collect::<Vec<_>>(), [0, 0, 0, 0, 1, 1, 1]);
        assert!(mesh.positions.get(9)[0].is_nan());
        assert!(Mesh::from_arrays(dir.path(), &[[0.; 3]], &[[0u32, 0, 1]]).is_err());
    }
}
