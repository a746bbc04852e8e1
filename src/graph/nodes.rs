//! Geometry of a node: centroid, normal and area of its face, in coordinates of the [`Frame`].
//!
//! All later work reads these 28 bytes per node and never the mesh again, except for the midpoints of edges, and except
//! if the mesh is larger than memory ([`super::node_geometry`]). Computed in `f64` from the file's own numbers, stored
//! in `f32`: relative to a box of diagonal 1 that is a precision of 6e-8, whatever units and offsets the file has. One
//! parallel pass, 10–20 ns per face, sequential writes.

use super::frame::Frame;
use super::node_batch::{BATCH, NodeBatch, TriangleParts};
use crate::base::Result;
use crate::base::parallel::chunk_range;
use crate::base::vector::{cross, finite, length, minus, narrow};
use crate::mesh::{Faces, Mesh};
use crate::store::npy::{ArrayMut, Item};
use crate::store::{MappedSlice, Run};
use bytemuck::{Pod, Zeroable};
use std::ops::Range;

/// Faces per chunk in passes over nodes.
pub const CHUNK: usize = 1 << 14;

/// The file of the node geometry: `f32` (n, 7): centroid, normal, area.
pub const FILE: &str = "node_geometry.npy";

/// A node of the dual graph. Degenerate faces (fewer than three corners, no area, a non-finite coordinate) have normal
/// and area 0; faces that lie exactly where another one lies have area 0.
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

    /// [`Node::of_corners`] specialised to triangles: most faces are triangles.
    #[inline]
    fn of_triangle(a: [f64; 3], b: [f64; 3], c: [f64; 3]) -> (Self, bool) {
        let TriangleParts { centroid, normal, area, is_proper } = TriangleParts::of(a, b, c);
        if is_proper { (Self { centroid, normal, area }, false) } else { Self::of_degenerate([a, b, c]) }
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

/// Calls `visit` with the node of each face of `range`, in order, and whether the face is degenerate. A duplicate has
/// no area, but is not degenerate.
#[inline]
pub fn each_node(mesh: &Mesh, frame: Frame, range: Range<usize>, mut visit: impl FnMut(usize, &Node, bool)) {
    let mut visit = |face: usize, node: &Node, flat: bool| match mesh.is_duplicate(face) {
        false => visit(face, node, flat),
        true => visit(face, &Node { area: 0., ..*node }, false),
    };
    let Faces::Triangles { .. } = mesh.faces else {
        return mesh.faces.for_each(range, |face, corners| {
            let (node, flat) = Node::of_face(corners, mesh, &frame);
            visit(face, &node, flat);
        });
    };
    let mut batch = NodeBatch::new();
    for start in range.clone().step_by(BATCH) {
        let faces = start..range.end.min(start + BATCH);
        mesh.faces.for_each(faces.clone(), |face, corners| {
            if let &[a, b, c] = corners {
                batch.set(face - start, [mesh.positions.get(a), mesh.positions.get(b), mesh.positions.get(c)]);
            }
        });
        batch.compute(frame);
        for face in faces {
            match batch.node(face - start) {
                TriangleParts { centroid, normal, area, is_proper: true } => {
                    visit(face, &Node { centroid, normal, area }, false);
                }
                _ => mesh.faces.with(face, |corners| {
                    let (node, flat) = Node::of_face(corners, mesh, &frame);
                    visit(face, &node, flat);
                }),
            }
        }
    }
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

    /// Batches of triangles give the nodes of single faces to the bit, whatever their shape, size and number.
    #[test]
    fn many_triangles_at_once_are_the_same_nodes() {
        use crate::base::random::{stream, unit};
        let mut random = stream(3, "nodes");
        let mut coordinate = |scale: f64| scale * (unit(&mut random) - 0.5);
        for (scale, count) in [(1., 1), (1e-3, 63), (1e9, 64), (1e-300, 65), (1e300, 500)] {
            let mut points: Vec<[f64; 3]> = (0..count + 2).map(|_| [(); 3].map(|()| coordinate(scale))).collect();
            let mut corners: Vec<[u32; 3]> = (0..count).map(|k| [k, k + 1, k + 2]).collect();
            if count > 64 {
                points[7] = points[8];
                points[20] = [f64::NAN, 0., f64::INFINITY];
                points[40] = points[41].map(|x| x * (1. + 1e-15));
                corners[60] = [5, 5, 6];
            }
            let mesh = Mesh::from_slices(&points, &corners).unwrap();
            let frames = [Frame::of(&mesh, &Run::new(&())).unwrap(), Frame { origin: [0.; 3], scale: 5e-324 }];
            for frame in frames {
                let mut next = 0;
                each_node(&mesh, frame, 0..corners.len(), |face, node, flat| {
                    let (slow, is_flat) = mesh.faces.with(face, |corners| Node::of_face(corners, &mesh, &frame));
                    assert_eq!((face, flat), (next, is_flat));
                    assert_eq!(bytemuck::bytes_of(node), bytemuck::bytes_of(&slow), "{scale} {count} {face}");
                    next += 1;
                });
                assert_eq!(next, corners.len());
            }
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
