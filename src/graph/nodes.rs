//! Geometry of a node: centroid, normal and area of its face, in coordinates of the [`Frame`].
//!
//! All later work reads these 28 bytes per node and never the mesh again, except for the midpoints of edges, and except
//! if the mesh is larger than memory ([`super::node_geometry`]). Computed in `f64` from the file's own numbers, stored
//! in `f32`: relative to a box of diagonal 1 that is a precision of 6e-8, whatever units and offsets the file has. One
//! parallel pass, 10–20 ns per face, sequential writes.

use crate::base::Result;
use crate::base::parallel::chunk_range;
use crate::base::vector::{cross, finite, length, minus, narrow};
use crate::mesh::Mesh;
use crate::mesh::extent::BoundingBox;
use crate::store::npy::{ArrayMut, Item};
use crate::store::{MappedSlice, Run};
use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Faces per chunk in passes over nodes.
pub const CHUNK: usize = 1 << 14;

/// The file of the node geometry: `f32` (n, 7): centroid, normal, area.
pub const FILE: &str = "node_geometry.npy";

/// A node of the dual graph. Degenerate faces (fewer than three corners, no area, a non-finite coordinate) have normal
/// and area 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Node {
    /// Mean of the corners, in the frame.
    pub centroid: [f32; 3],
    /// Unit normal, oriented by the winding in the file (Newell's for polygons).
    pub normal: [f32; 3],
    /// Area in the frame (the box's diagonal is 1).
    pub area: f32,
}

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
        // Halved first, so that the widest range of doubles does not overflow.
        let origin = [0, 1, 2].map(|axis| bounds[0][axis] / 2. + bounds[1][axis] / 2.);
        let half = [0, 1, 2].map(|axis| bounds[1][axis] / 2. - bounds[0][axis] / 2.);
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

impl Node {
    /// The node of the face of `mesh` with the given corners; also whether it is degenerate.
    #[inline]
    pub fn of_face(corners: &[u32], mesh: &Mesh, frame: &Frame) -> (Self, bool) {
        let Mesh { positions, .. } = mesh;
        match *corners {
            // Not with a closure, which would be called three times and divide each time.
            [a, b, c] => {
                let (a, b, c) = (positions.get(a), positions.get(b), positions.get(c));
                Self::of_triangle(frame.place(a), frame.place(b), frame.place(c))
            }
            _ => Self::of_corners(corners.iter().map(|&v| frame.place(positions.get(v)))),
        }
    }

    /// [`Node::of_corners`] specialised to triangles: most faces are triangles, and this is an inner loop.
    #[inline]
    fn of_triangle(a: [f64; 3], b: [f64; 3], c: [f64; 3]) -> (Self, bool) {
        let normal = cross(minus(b, a), minus(c, a));
        let length = length(normal);
        let area = (length / 2.) as f32;
        // A NaN coordinate makes the length NaN.
        if !(area > 0. && length.is_finite()) {
            return Self::of_degenerate([a, b, c]);
        }
        let sum = [a[0] + b[0] + c[0], a[1] + b[1] + c[1], a[2] + b[2] + c[2]];
        (Self { centroid: narrow(sum, 1. / 3.), normal: narrow(normal, 1. / length), area }, false)
    }

    /// Not inlined, so that the calling loops stay small.
    #[cold]
    #[inline(never)]
    fn of_degenerate(corners: [[f64; 3]; 3]) -> (Self, bool) {
        Self::of_corners(corners.into_iter())
    }

    /// The node of a face with the given corners (in the frame); also whether it is degenerate.
    #[inline]
    fn of_corners(corners: impl Iterator<Item = [f64; 3]> + Clone) -> (Self, bool) {
        let (mut sum, mut count, mut all) = ([0f64; 3], 0u32, 0u32);
        for p in corners.clone() {
            all += 1;
            if finite(p) {
                count += 1;
                sum = [sum[0] + p[0], sum[1] + p[1], sum[2] + p[2]];
            }
        }
        let centroid = narrow(sum, 1. / f64::from(count.max(1)));
        let degenerate = Self { centroid, normal: [0.; 3], area: 0. };
        if all < 3 || count < all {
            return (degenerate, true);
        }
        let mut corners = corners;
        let (Some(first), Some(second)) = (corners.next(), corners.next()) else { return (degenerate, true) };
        let (mut normal, mut last) = ([0f64; 3], minus(second, first));
        for p in corners {
            let next = minus(p, first);
            let part = cross(last, next);
            normal = [normal[0] + part[0], normal[1] + part[1], normal[2] + part[2]];
            last = next;
        }
        let length = length(normal);
        let area = (length / 2.) as f32;
        if !(area > 0. && length.is_finite()) {
            return (degenerate, true);
        }
        (Self { centroid, normal: narrow(normal, 1. / length), area }, false)
    }
}

/// Totals over faces.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NodeSums {
    /// Sum of all areas, in the frame's units.
    pub area: f64,
    /// Faces without area, direction or finite corners.
    pub degenerate: u64,
    /// Those among them with a corner whose coordinates are not finite.
    pub nonfinite: u64,
}

impl NodeSums {
    #[inline]
    fn add(&mut self, mesh: &Mesh, face: usize, node: &Node, degenerate: bool) {
        self.area += f64::from(node.area);
        if degenerate {
            self.degenerate += 1;
            let is_placed = |v: &u32| finite(mesh.positions.get(*v));
            self.nonfinite += u64::from(!mesh.faces.with(face, |corners| corners.iter().all(is_placed)));
        }
    }

    /// With those of the chunk of [`CHUNK`] faces that follows.
    #[must_use]
    pub fn and(self, chunk: Self) -> Self {
        Self {
            area: self.area + chunk.area,
            degenerate: self.degenerate + chunk.degenerate,
            nonfinite: self.nonfinite + chunk.nonfinite,
        }
    }
}

/// Calls `visit` with the node of each face of `range`, in order, and whether the face is degenerate.
#[inline]
pub fn each_node(mesh: &Mesh, frame: Frame, range: Range<usize>, mut visit: impl FnMut(usize, &Node, bool)) {
    mesh.faces.for_each(range, |face, corners| {
        let (node, flat) = Node::of_face(corners, mesh, &frame);
        visit(face, &node, flat);
    });
}

/// Fills `array`, the content of [`FILE`], with the geometry of every face of `mesh`, in the order of the faces.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub fn build(
    mesh: &Mesh,
    frame: &Frame,
    mut array: ArrayMut<Node>,
    run: &Run,
) -> Result<(MappedSlice<Node>, NodeSums)> {
    let n = mesh.faces.len();
    let sums = run.fill_chunks(
        array.data(),
        CHUNK,
        || (),
        |k, out, ()| {
            Ok(each_and_sums(mesh, *frame, chunk_range(n, CHUNK, k), |face, node| out[face - k * CHUNK] = *node))
        },
    )?;
    Ok((array.finish(false)?, sums.into_iter().fold(NodeSums::default(), NodeSums::and)))
}

/// Calls `visit` with the node of each face of `range`, in order, and returns their sums.
#[inline]
pub fn each_and_sums(mesh: &Mesh, frame: Frame, range: Range<usize>, mut visit: impl FnMut(usize, &Node)) -> NodeSums {
    let mut sums = NodeSums::default();
    each_node(mesh, frame, range, |face, node, flat| {
        sums.add(mesh, face, node, flat);
        visit(face, node);
    });
    sums
}

impl Item for Node {
    const DESCR: &'static str = "<f4";
    const WIDTH: usize = 7;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_square_and_a_triangle() {
        let square = [[0., 0., 0.], [2., 0., 0.], [2., 2., 0.], [0., 2., 0.]];
        let (node, flat) = Node::of_corners(square.into_iter());
        assert!(!flat && node.centroid == [1., 1., 0.] && node.normal == [0., 0., 1.] && node.area == 4.);
        let (node, _) = Node::of_corners(square[..3].iter().copied());
        assert!((node.area - 2.).abs() < 1e-7);
    }

    #[test]
    fn points_move_into_the_frame_at_any_scale() {
        let frame = |scale| Frame { origin: [1., 2., 3.], scale };
        assert_eq!(frame(4.).place([3., 6., 11.]), [0.5, 1., 2.]);
        // One over this scale is infinite.
        let tiny = 5e-324;
        assert_eq!(Frame { origin: [0.; 3], scale: tiny }.place([tiny, -tiny, 2. * tiny]), [1., -1., 2.]);
    }

    #[test]
    fn a_triangle_is_the_same_node_both_ways() {
        let corners = [[1., 0., 0.25], [4., 0.5, 0.], [2., 3., -1.]];
        let (node, flat) = Node::of_triangle(corners[0], corners[1], corners[2]);
        let (slow, _) = Node::of_corners(corners.into_iter());
        assert!(!flat && (node.area - slow.area).abs() < 1e-6);
        for axis in 0..3 {
            let middle = (corners[0][axis] + corners[1][axis] + corners[2][axis]) / 3.;
            assert!((f64::from(node.centroid[axis]) - middle).abs() < 1e-6);
            assert!((slow.centroid[axis] - node.centroid[axis]).abs() < 1e-6);
            assert!((slow.normal[axis] - node.normal[axis]).abs() < 1e-6);
        }
    }

    #[test]
    fn faces_without_a_place_are_counted() {
        // A missing corner, a flat triangle, one that is whole; the last vertex is in no face.
        let points = [[0f32, 0., 0.], [1., 0., 0.], [2., 0., 0.], [0., 1., 0.], [0., f32::NAN, 0.], [f32::INFINITY; 3]];
        let mesh = Mesh::from_slices(&points, &[[0u32, 1, 4], [0, 1, 2], [0, 1, 3]]).unwrap();
        let sums = each_and_sums(&mesh, Frame { origin: [0.; 3], scale: 1. }, 0..3, |_, _| ());
        assert_eq!((sums.degenerate, sums.nonfinite, sums.area), (2, 1, 0.5));
    }

    #[test]
    fn degenerate_faces_have_no_direction_and_poison_nothing() {
        let nan = [f64::NAN, 0., 0.];
        for corners in
            [vec![], vec![[1., 2., 3.]], vec![[0.; 3]; 3], vec![[1., 0., 0.], nan, [3., 0., 0.]], vec![nan; 3]]
        {
            let (node, flat) = Node::of_corners(corners.into_iter());
            assert!(flat && node.area == 0. && node.normal == [0.; 3]);
            assert!(node.centroid.iter().all(|x| x.is_finite()));
        }
    }
}
