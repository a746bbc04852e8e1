//! The mesh as triangles: polygons cut into fans, what has no place in space left out.

use super::vector::Vec3;
use crate::mesh::Mesh;
use std::ops::Range;

/// Faces a thread takes at a time.
pub(super) const CHUNK: usize = 1 << 13;

/// Calls `visit(face, its corners, their positions)` for the triangles of `faces`, in order.
#[inline]
pub(super) fn for_each(mesh: &Mesh, faces: Range<usize>, mut visit: impl FnMut(usize, [u32; 3], [Vec3; 3])) {
    mesh.faces.for_each(faces, |face, corners| mesh.fan(corners, |c, p| visit(face, c, p)));
}

/// Calls `visit(corners, positions)` for the triangles of one face.
#[inline]
pub(super) fn of_face(mesh: &Mesh, face: usize, visit: impl FnMut([u32; 3], [Vec3; 3])) {
    mesh.faces.with(face, |corners| mesh.fan(corners, visit));
}
