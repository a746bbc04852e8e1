//! Axis-aligned bounding boxes, in single precision as used by trees over points and triangles, where each node has one
//! box around all below it, and in double precision around a mesh.
//!
//! Distances are rounded like those between points, so no point in a box is nearer than the box itself. 24 or 48 bytes
//! per box.

use bytemuck::{Pod, Zeroable};

/// Least and greatest corner of a box.
pub type BoundingBox = [[f64; 3]; 2];

/// The empty box: infinite, with the least corner above the greatest.
pub const EMPTY: BoundingBox = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];

/// Grows a box to contain the points `p` and `q`; no coordinate of `q` is less than that of `p`.
#[inline]
pub fn grow([low, high]: &mut BoundingBox, p: [f64; 3], q: [f64; 3]) {
    for axis in 0..3 {
        (low[axis], high[axis]) = (low[axis].min(p[axis]), high[axis].max(q[axis]));
    }
}

/// The smallest box around several boxes.
pub fn around(extents: impl IntoIterator<Item = BoundingBox>) -> BoundingBox {
    extents.into_iter().fold(EMPTY, |mut all, [low, high]| {
        grow(&mut all, low, high);
        all
    })
}

/// The centre of a box. Halved first, so that the widest range of doubles does not overflow.
#[inline]
pub fn centre([low, high]: BoundingBox) -> [f64; 3] {
    [low[0] / 2. + high[0] / 2., low[1] / 2. + high[1] / 2., low[2] / 2. + high[2] / 2.]
}

/// Half the lengths of the sides of a box.
#[inline]
pub fn half_sides([low, high]: BoundingBox) -> [f64; 3] {
    [high[0] / 2. - low[0] / 2., high[1] / 2. - low[1] / 2., high[2] / 2. - low[2] / 2.]
}

/// An axis-aligned box: the least and greatest coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Bounds {
    /// The least of each coordinate.
    pub low: [f32; 3],
    /// The greatest of each coordinate.
    pub high: [f32; 3],
}

impl Bounds {
    /// The empty box, infinitely far from all points.
    pub const EMPTY: Self = Self { low: [f32::INFINITY; 3], high: [f32::NEG_INFINITY; 3] };

    /// The box of one point.
    #[inline(always)]
    pub fn at(p: [f32; 3]) -> Self {
        Self { low: p, high: p }
    }

    /// The smallest box around both boxes.
    #[inline(always)]
    pub fn with(&self, other: &Self) -> Self {
        let low = |k: usize| self.low[k].min(other.low[k]);
        let high = |k: usize| self.high[k].max(other.high[k]);
        Self { low: [low(0), low(1), low(2)], high: [high(0), high(1), high(2)] }
    }

    /// The squared distance from `p` to the box; infinite where the box is empty.
    #[inline(always)]
    pub fn square_from(&self, p: [f32; 3]) -> f32 {
        let out = |k: usize| (self.low[k] - p[k]).max(p[k] - self.high[k]).max(0.);
        let (x, y, z) = (out(0), out(1), out(2));
        x * x + y * y + z * z
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_those_of_the_nearest_corner_side_or_inside() {
        let corners = [[0., 2., 4.], [1., 3., 6.]];
        let bounds = corners.iter().fold(Bounds::EMPTY, |bounds, &p| bounds.with(&Bounds::at(p)));
        assert_eq!([bounds.low, bounds.high], corners);
        assert_eq!(bounds.square_from([0.5, 2.5, 5.]), 0.);
        assert_eq!(bounds.square_from([0.5, 2.5, 8.]), 4.);
        assert_eq!(bounds.square_from([-1., 5., 8.]), 1. + 4. + 4.);
        assert_eq!(Bounds::EMPTY.square_from([0.; 3]), f32::INFINITY);
    }
}
