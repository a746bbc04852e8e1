//! The mesh as triangles: polygons cut into fans, what has no place in space left out.

use super::vector::Vec3;
use crate::mesh::Mesh;
use std::ops::Range;

/// Faces a thread takes at a time.
pub(super) const CHUNK: usize = 1 << 13;

/// Calls `visit(face, its corners, their positions)` for the triangles of `faces`, in order.
#[inline]
pub(super) fn for_each(mesh: &Mesh, faces: Range<usize>, mut visit: impl FnMut(usize, [u32; 3], [Vec3; 3])) {
    mesh.faces.for_each(faces, |face, corners| fan(mesh, corners, |c, p| visit(face, c, p)));
}

/// Calls `visit(corners, positions)` for the triangles of one face.
#[inline]
pub(super) fn of_face(mesh: &Mesh, face: usize, visit: impl FnMut([u32; 3], [Vec3; 3])) {
    mesh.faces.with(face, |corners| fan(mesh, corners, visit));
}

#[inline]
fn fan(mesh: &Mesh, corners: &[u32], mut visit: impl FnMut([u32; 3], [Vec3; 3])) {
    let [first, second, rest @ ..] = corners else { return };
    let origin = mesh.positions.get(*first);
    let (mut before, mut at) = (*second, mesh.positions.get(*second));
    for &corner in rest {
        let position = mesh.positions.get(corner);
        let triangle = [origin, at, position];
        if triangle.as_flattened().iter().all(|x| x.is_finite()) {
            visit([*first, before, corner], triangle);
        }
        (before, at) = (corner, position);
    }
}
