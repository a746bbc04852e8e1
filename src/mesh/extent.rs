//! The bounding box of a mesh: that of the vertices that faces use.
//!
//! Range grids and crops keep vertices that no face uses, often at the origin, far from a mesh in survey coordinates.
//! In a box around these the mesh is a speck, which single precision no longer resolves. But nearly all meshes have no
//! unused vertices, and a pass over every corner would take as long as reading the mesh. So the box of all vertices is
//! taken if faces use the vertices that it touches.
//!
//! Cost: about 1 ns per position, once for a mesh and its clones, which keep the boxes around runs of vertices; plus a
//! few faces near each of six vertices. If these are not found there, a pass over all corner indices, less than 1 ns
//! each; if no face uses one of them, a pass over all corner positions.

use super::geometry::Mesh;
use super::positions::BOX;
use crate::base::Result;
use crate::base::bounds::{EMPTY, around, grow};
use crate::base::vector::finite;
use crate::store::Run;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

pub use crate::base::bounds::BoundingBox;

/// Faces of a chunk.
const CHUNK: usize = 1 << 16;
/// Faces searched first on either side of where a vertex is expected to be used, judging by its number.
const NEAR: usize = 1 << 11;

impl Mesh {
    /// The bounding box of the vertices that faces use and that have a position, as least and greatest corner.
    /// Infinite, with the least above the greatest, if there are none.
    ///
    /// ```
    /// use nystrom_stream::{mesh::Mesh, store::Run};
    /// # fn main() -> nystrom_stream::base::Result<()> {
    /// let corners = [[1., 0., 0.], [2., 0., 0.], [2., 1., 0.], [9., 9., 9.]];
    /// let mesh = Mesh::from_slices(&corners, &[[0, 1, 2]])?;
    /// assert_eq!(mesh.extent(&Run::new(&()))?, [[1., 0., 0.], [2., 1., 0.]]);
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn extent(&self, run: &Run) -> Result<BoundingBox> {
        let positions = &self.positions;
        let extents = positions.boxes(run)?;
        let all = around(extents.iter().copied());
        let mut outer: Vec<u32> = Vec::with_capacity(6);
        for (end, axis) in (0..2).flat_map(|end| (0..3).map(move |axis| (end, axis))) {
            let Some(chunk) = extents.iter().position(|extent| extent[end][axis] == all[end][axis]) else { continue };
            let vertices = chunk * BOX..positions.len().min((chunk + 1) * BOX);
            let touches = |v: &u32| {
                let p = positions.get(*v);
                finite(p) && p[axis] == all[end][axis]
            };
            outer.extend(vertices.map(|v| v as u32).find(touches));
        }
        if self.uses(&outer, run)? {
            return Ok(all);
        }
        let of_faces = |range: Range<usize>| {
            let mut extent = EMPTY;
            self.faces.for_each(range, |_, corners| {
                for p in corners.iter().map(|&v| positions.get(v)).filter(|&p| finite(p)) {
                    grow(&mut extent, p, p);
                }
            });
            Ok(extent)
        };
        Ok(around(run.map_ranges(self.faces.len(), CHUNK, of_faces)?))
    }

    /// Whether every one of `vertices` is used by some face.
    fn uses(&self, vertices: &[u32], run: &Run) -> Result<bool> {
        let n = self.faces.len();
        let used: Vec<AtomicBool> = vertices.iter().map(|_| AtomicBool::new(false)).collect();
        // A small table rejects nearly every corner.
        let mut table = [0u64; 64];
        let bit = |v: u32| ((v >> 6 & 63) as usize, 1u64 << (v & 63));
        vertices.iter().for_each(|&v| table[bit(v).0] |= bit(v).1);
        let look = |range: Range<usize>| {
            self.faces.for_each(range, |_, corners| {
                for &corner in corners {
                    if table[bit(corner).0] & bit(corner).1 != 0 {
                        for (_, used) in vertices.iter().zip(&used).filter(|(vertex, _)| **vertex == corner) {
                            used.store(true, Relaxed);
                        }
                    }
                }
            });
        };
        let all_are = || used.iter().all(|used| used.load(Relaxed));
        for &vertex in vertices {
            let expected = (f64::from(vertex) / self.positions.len() as f64 * n as f64) as usize;
            look(expected.saturating_sub(NEAR)..n.min(expected + NEAR));
        }
        if !all_are() {
            run.map_ranges(n, CHUNK, |range| {
                if !all_are() {
                    look(range);
                }
                Ok(())
            })?;
        }
        Ok(all_are())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{below, stream};

    #[test]
    fn the_box_is_that_of_the_corners_of_faces() {
        let run = Run::new(&());
        for seed in 0..200 {
            let mut random = stream(seed, "extent");
            let n = 3 + below(&mut random, 40);
            let mut number = |most: usize| below(&mut random, most);
            let place = |k: usize| if k == 0 { f64::NAN } else { k as f64 };
            let corners: Vec<[f64; 3]> = (0..n).map(|_| [0; 3].map(|_| place(number(30)))).collect();
            let faces: Vec<[u32; 3]> = (0..1 + number(8)).map(|_| [0; 3].map(|_| number(n) as u32)).collect();
            let mesh = Mesh::from_slices(&corners, &faces).unwrap();
            let mut expected = EMPTY;
            for p in faces.iter().flatten().map(|&v| corners[v as usize]).filter(|p| p.iter().all(|x| !x.is_nan())) {
                grow(&mut expected, p, p);
            }
            assert_eq!(mesh.extent(&run).unwrap(), expected, "{seed}");
        }
    }
}
