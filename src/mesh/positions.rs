//! Vertex positions in mapped bytes or an array in memory, at any offset in each record.
//!
//! Floating-point coordinates in a file are read in place, whatever else its records contain. A position costs its 12
//! or 24 bytes of mapped file, and a few nanoseconds; repaired positions of strays are few and kept in memory. So are
//! the boxes around runs of 65,536 vertices, 48 bytes each, once they have been asked for.

use crate::base::bounds::{BoundingBox, EMPTY, grow};
use crate::base::vector::finite;
use crate::base::{Error, Result};
use crate::store::{MappedBytes, Run};
use std::ops::Range;
use std::path::Path;
use std::sync::{Arc, OnceLock};

/// Vertices in a box of [`Positions::boxes`].
pub(super) const BOX: usize = 1 << 16;

/// Vertices, ascending, and their replacement positions.
type Repairs = Arc<[(u32, [f64; 3])]>;

/// The layout of coordinates in a run of bytes.
#[derive(Clone, Copy, Debug)]
pub struct StridedLayout {
    /// Byte of the first record.
    pub offset: usize,
    /// Bytes from record to record.
    pub stride: usize,
    /// Bytes from a record's start to its x, y, z.
    pub at: [usize; 3],
    /// Whether coordinates have 8 bytes rather than 4.
    pub double: bool,
    /// Number of records.
    pub len: usize,
}

impl StridedLayout {
    /// Records of x, y, z alone.
    pub fn packed(offset: usize, double: bool, len: usize) -> Self {
        let size = if double { 8 } else { 4 };
        Self { offset, stride: 3 * size, at: [0, size, 2 * size], double, len }
    }
}

/// Vertex positions at a fixed stride in mapped bytes, `f32` or `f64`, little-endian.
#[derive(Clone, Debug)]
pub struct Positions {
    bytes: MappedBytes,
    layout: StridedLayout,
    /// Positions that replace those in the bytes; see [`super::strays`].
    repairs: Option<Repairs>,
    /// The result of [`Positions::boxes`], once it is known.
    boxes: Arc<OnceLock<Vec<BoundingBox>>>,
}

impl Positions {
    /// The positions in `bytes`, laid out as in `layout`.
    ///
    /// # Errors
    /// [`Error::Malformed`] naming `path` when they do not fit.
    pub fn strided(path: &Path, bytes: MappedBytes, layout: StridedLayout) -> Result<Self> {
        let StridedLayout { offset, stride, at, double, len } = layout;
        check_fit(path, "vertices", bytes.len(), offset, stride, len)?;
        let size = if double { 8 } else { 4 };
        if at.iter().any(|at| at + size > stride) {
            let problem = "coordinates lie outside their record";
            return Err(Error::malformed(path, "vertices", problem, "write the file again"));
        }
        Ok(Self { bytes, layout, repairs: None, boxes: Arc::default() })
    }

    /// Replaces positions in the bytes by `repairs`, ascending by vertex.
    pub(super) fn repair(&mut self, repairs: Vec<(u32, [f64; 3])>) {
        self.repairs = (!repairs.is_empty()).then(|| repairs.into());
        if self.repairs.is_some() {
            self.boxes = Arc::default();
        }
    }

    pub(super) fn layout(&self) -> StridedLayout {
        self.layout
    }

    pub(super) fn bytes(&self) -> &MappedBytes {
        &self.bytes
    }

    /// Number of vertices.
    pub fn len(&self) -> usize {
        self.layout.len
    }

    /// Whether coordinates have 64 bits.
    pub fn is_double(&self) -> bool {
        self.layout.double
    }

    /// The box around the finite positions of each run of [`BOX`] vertices. Computed once.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub(super) fn boxes(&self, run: &Run) -> Result<&[BoundingBox]> {
        if let Some(known) = self.boxes.get() {
            return Ok(known);
        }
        let around_run = |range: Range<usize>| {
            let mut extent = EMPTY;
            for v in range {
                let p = self.get(v as u32);
                if finite(p) {
                    grow(&mut extent, p, p);
                }
            }
            Ok(extent)
        };
        let boxes = run.map_ranges(self.len(), BOX, around_run)?;
        Ok(self.boxes.get_or_init(|| boxes))
    }

    /// The position of vertex `v`; NaN if there is no such vertex. Always inlined, so that coordinates stay in
    /// registers: through memory, a pass over all corners takes half as long again.
    #[inline(always)]
    pub fn get(&self, v: u32) -> [f64; 3] {
        if let Some(repairs) = &self.repairs
            && let Some(position) = repaired(repairs, v)
        {
            return position;
        }
        let StridedLayout { offset, stride, at, double, len } = self.layout;
        let start = offset + v as usize * stride;
        let Some(record) = self.bytes.get(start..start + stride).filter(|_| (v as usize) < len) else {
            return [f64::NAN; 3];
        };
        // Unrolled: mapping over the array is not always inlined, and this is every pass's inner loop.
        let [x, y, z] = at;
        if double {
            let get = |at: usize| f64::from_le_bytes(eight(&record[at..at + 8]));
            [get(x), get(y), get(z)]
        } else {
            let get = |at: usize| f64::from(f32::from_le_bytes(four(&record[at..at + 4])));
            [get(x), get(y), get(z)]
        }
    }
}

/// Out of line: few meshes have any.
#[cold]
#[inline(never)]
fn repaired(repairs: &[(u32, [f64; 3])], v: u32) -> Option<[f64; 3]> {
    repairs.binary_search_by_key(&v, |repair| repair.0).ok().map(|k| repairs[k].1)
}

#[inline(always)]
pub(super) fn four(bytes: &[u8]) -> [u8; 4] {
    [bytes[0], bytes[1], bytes[2], bytes[3]]
}

#[inline(always)]
fn eight(bytes: &[u8]) -> [u8; 8] {
    [bytes[0], bytes[1], bytes[2], bytes[3], bytes[4], bytes[5], bytes[6], bytes[7]]
}

/// Rejects `len` records that `bytes` cannot hold.
pub(super) fn check_fit(path: &Path, what: &str, bytes: usize, offset: usize, stride: usize, len: usize) -> Result<()> {
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
