//! Nodes of triangles, a batch at a time in vector registers.
//!
//! The formula of a node is some thirty operations, a root and two divisions, the same for each triangle. So corners
//! are gathered into one array per coordinate, and a vector loop takes four or eight triangles at once. Degenerate
//! faces are marked and left to [`super::nodes::Node::of_face`]. The numbers are the same to the bit (tested there).
//! Memory: 7 KiB on the stack. Time: see [`super::nodes`].

use super::frame::Frame;
use crate::base::simd::{SimdKernel, dispatch};
use crate::base::vector::{cross, length, minus, narrow};

/// The node of a triangle, if it is not degenerate.
pub(super) struct TriangleParts {
    pub centroid: [f32; 3],
    pub normal: [f32; 3],
    pub area: f32,
    /// Whether the rest is of any use.
    pub is_proper: bool,
}

impl TriangleParts {
    /// Those of a triangle in the frame. Without a branch, for vector loops.
    #[inline(always)]
    pub fn of(a: [f64; 3], b: [f64; 3], c: [f64; 3]) -> Self {
        let normal = cross(minus(b, a), minus(c, a));
        let length = length(normal);
        let area = (length / 2.) as f32;
        let sum = [a[0] + b[0] + c[0], a[1] + b[1] + c[1], a[2] + b[2] + c[2]];
        // A NaN coordinate makes the length NaN.
        let is_proper = (area > 0.) & (length < f64::INFINITY);
        Self { centroid: narrow(sum, 1. / 3.), normal: narrow(normal, 1. / length), area, is_proper }
    }
}

/// Triangles at a time.
pub(super) const BATCH: usize = 64;

/// Triangles and their nodes; each array is over the triangles.
pub(super) struct NodeBatch {
    /// Coordinates in units of the file: x, y, z of the first corners, then of the second and third ones.
    corners: [[f64; BATCH]; 9],
    centroid: [[f32; BATCH]; 3],
    normal: [[f32; BATCH]; 3],
    area: [f32; BATCH],
    /// 1 for a proper triangle, 0 for a degenerate one.
    proper: [u32; BATCH],
}

impl NodeBatch {
    pub fn new() -> Self {
        let (centroid, normal) = ([[0.; BATCH]; 3], [[0.; BATCH]; 3]);
        Self { corners: [[0.; BATCH]; 9], centroid, normal, area: [0.; BATCH], proper: [0; BATCH] }
    }

    /// Sets the corners of triangle `k`.
    #[inline(always)]
    pub fn set(&mut self, k: usize, [a, b, c]: [[f64; 3]; 3]) {
        for axis in 0..3 {
            self.corners[axis][k] = a[axis];
            self.corners[3 + axis][k] = b[axis];
            self.corners[6 + axis][k] = c[axis];
        }
    }

    /// Computes the nodes of all triangles in `frame`; further ones than were set are of no use.
    #[inline(always)]
    pub fn compute(&mut self, frame: Frame) {
        dispatch(Computing { batch: self, frame });
    }

    /// The node of triangle `k`.
    #[inline(always)]
    pub fn node(&self, k: usize) -> TriangleParts {
        let ([x, y, z], [nx, ny, nz]) = (&self.centroid, &self.normal);
        let is_proper = self.proper[k] == 1;
        TriangleParts { centroid: [x[k], y[k], z[k]], normal: [nx[k], ny[k], nz[k]], area: self.area[k], is_proper }
    }
}

struct Computing<'a> {
    batch: &'a mut NodeBatch,
    frame: Frame,
}

impl SimdKernel for Computing<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { batch: NodeBatch { corners, centroid, normal, area, proper }, frame } = self;
        let [ax, ay, az, bx, by, bz, cx, cy, cz] = corners;
        let ([x, y, z], [nx, ny, nz]) = (centroid, normal);
        for k in 0..BATCH {
            let a = frame.place([ax[k], ay[k], az[k]]);
            let b = frame.place([bx[k], by[k], bz[k]]);
            let c = frame.place([cx[k], cy[k], cz[k]]);
            let TriangleParts { centroid, normal, area: size, is_proper } = TriangleParts::of(a, b, c);
            ([x[k], y[k], z[k]], [nx[k], ny[k], nz[k]]) = (centroid, normal);
            area[k] = size;
            proper[k] = u32::from(is_proper);
        }
    }
}
