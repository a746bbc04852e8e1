//! The coordinates of all geometry: the mesh's bounding box, translated to the origin and scaled to diagonal 1.
//!
//! Relative to a box of diagonal 1, `f32` has a precision of 6e-8, whatever units and offsets the file has. Cost: that
//! of the bounding box ([`crate::mesh::extent`]).

use crate::base::Result;
use crate::base::bounds::{BoundingBox, centre, half_sides};
use crate::mesh::Mesh;
use crate::store::Run;
use serde::{Deserialize, Serialize};

/// Area in the frame below which a surface consists of points and lines up to rounding.
pub const NO_AREA: f64 = 1e-12;

/// The coordinates of all geometry: the bounding box of the finite vertices that faces use, translated to the origin
/// and scaled to diagonal 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Frame {
    /// Centre of the box, in units of the file.
    pub origin: [f64; 3],
    /// Diagonal of the box, in units of the file; 1 where all vertices coincide.
    pub scale: f64,
}

impl Frame {
    /// The frame of the vertices that faces of `mesh` use.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn of(mesh: &Mesh, run: &Run) -> Result<Self> {
        Ok(Self::around(mesh.extent(run)?))
    }

    /// The frame of a box; scale 1 at the origin for an empty box.
    fn around(bounds: BoundingBox) -> Self {
        if bounds[0][0] > bounds[1][0] {
            return Self { origin: [0.; 3], scale: 1. };
        }
        let (origin, half) = (centre(bounds), half_sides(bounds));
        let widest = half.into_iter().fold(0., f64::max);
        let scale =
            if widest > 0. { 2. * widest * half.map(|h| (h / widest).powi(2)).iter().sum::<f64>().sqrt() } else { 1. };
        // A diagonal that overflows is clamped to the greatest double; one that underflows counts as none.
        Self { origin, scale: if scale > 0. { scale.min(f64::MAX) } else { 1. } }
    }

    /// Whether squares and cubes of lengths in the file's units stay far within the range of doubles.
    pub fn is_of_common_size(&self) -> bool {
        (1e-60..1e60).contains(&self.scale)
    }

    /// Transforms a point of the file to the frame.
    #[inline(always)]
    pub fn place(&self, p: [f64; 3]) -> [f64; 3] {
        let [x, y, z] = self.origin;
        let moved = [p[0] - x, p[1] - y, p[2] - z];
        // A product is cheaper than three divisions, but the inverse of the smallest scales is infinite.
        let inverse = 1. / self.scale;
        if inverse < f64::INFINITY {
            [moved[0] * inverse, moved[1] * inverse, moved[2] * inverse]
        } else {
            [moved[0] / self.scale, moved[1] / self.scale, moved[2] / self.scale]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_move_into_the_frame_at_any_scale() {
        let frame = |scale| Frame { origin: [1., 2., 3.], scale };
        assert_eq!(frame(4.).place([3., 6., 11.]), [0.5, 1., 2.]);
        // One over this scale is infinite.
        let tiny = 5e-324;
        assert_eq!(Frame { origin: [0.; 3], scale: tiny }.place([tiny, -tiny, 2. * tiny]), [1., -1., 2.]);
    }
}
