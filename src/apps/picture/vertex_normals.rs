//! Smooth normals at vertices, for meshes whose faces are larger than samples.
//!
//! The faces' normals are added up by the angle they have at the vertex, in integers, so that threads may add in any
//! order and the sum is always the same. 12 bytes a vertex.

use super::triangles::{self, CHUNK};
use super::vector::{Vec3, dot, double_area, sub, unit};
use crate::base::Result;
use crate::base::parallel::{chunk_count, chunk_range, map_chunks};
use crate::mesh::Mesh;
use crate::store::Run;
use std::sync::atomic::{AtomicI32, Ordering};

/// Steps of a unit normal.
const STEPS: f64 = 16384.0;
/// Beyond this cosine between a face and its vertex's normal, the edge is meant to be sharp.
const SHARP: f64 = 0.65;

/// A normal a vertex, as a sum that has no unit length yet.
pub(super) struct VertexNormals {
    sums: Vec<[AtomicI32; 3]>,
}

impl VertexNormals {
    /// Adds up the normals of all faces.
    pub(super) fn of(mesh: &Mesh, run: &Run) -> Result<Self> {
        let sums: Vec<[AtomicI32; 3]> = (0..mesh.positions.len()).map(|_| Default::default()).collect();
        let n = mesh.faces.len();
        let chunk = |k, (): &mut ()| {
            triangles::for_each(mesh, chunk_range(n, CHUNK, k), |_, corners, at| {
                let normal = unit(double_area(at));
                let edges = [0, 1, 2].map(|k| unit(sub(at[(k + 1) % 3], at[k])));
                for k in 0..3 {
                    let cosine = -dot(edges[k], edges[(k + 2) % 3]);
                    // Near enough to the angle, without its cost.
                    let weight = (1.0 - cosine) * STEPS;
                    let Some(sum) = sums.get(corners[k] as usize) else { continue };
                    for axis in 0..3 {
                        sum[axis].fetch_add((normal[axis] * weight) as i32, Ordering::Relaxed);
                    }
                }
            });
            Ok(())
        };
        map_chunks(run.threads, &run.cancel, chunk_count(n, CHUNK), || (), chunk)?;
        Ok(Self { sums })
    }

    /// The normal at a corner of a face whose own unit normal is `face`: the vertex's where the surface is smooth.
    pub(super) fn at(&self, corner: u32, face: Vec3) -> Vec3 {
        let Some(sum) = self.sums.get(corner as usize) else { return face };
        let smooth = unit([0, 1, 2].map(|k| f64::from(sum[k].load(Ordering::Relaxed))));
        if dot(smooth, face) < SHARP { face } else { smooth }
    }
}
