//! Vertex normals: those of the surrounding faces, summed with their angles as weights.
//!
//! In integers, so that threads may add in any order and the sum is always the same. 12 bytes per vertex, in a file
//! where memory is short, and some 130 ns of processor time per face: nine atomic additions, and three angles.

use crate::base::Result;
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::vector::{MapEach, dot, double_area, length, minus, unit};
use crate::mesh::Mesh;
use crate::store::{Context, Run, ScratchArray};
use std::ops::Range;
use std::sync::atomic::{AtomicI32, Ordering::Relaxed};

/// Quantisation steps of a unit normal.
const STEPS: f64 = 16384.0;
/// Cosine (40°) between a face and the normal of its vertex below which there is a crease.
pub(super) const SMOOTH: f64 = 0.766;
/// Number of chunks of faces sampled for creases.
const CREASE_CHUNKS: usize = 8;
/// Faces per chunk.
pub(super) const CHUNK: usize = 1 << 14;

/// The angle of the direction (`along`, `across`), `across` not negative, to within 0.004, with one division.
#[inline]
fn angle(across: f64, along: f64) -> f64 {
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};
    let near = |r: f64| r * (FRAC_PI_4 + 0.273 * (1.0 - r.abs()));
    if along.abs() >= across {
        if along == 0.0 {
            return 0.0;
        }
        let angle = near(across / along);
        if along < 0.0 { PI + angle } else { angle }
    } else {
        FRAC_PI_2 - near(along / across)
    }
}

/// Calls `visit(corner, its vertex, normal of the face, angle)` for the corners of `faces`.
pub(super) fn each_corner(mesh: &Mesh, faces: Range<usize>, mut visit: impl FnMut(u32, [f64; 3], f64)) {
    mesh.faces.for_each(faces, |_, corners| {
        mesh.triangles(corners, |corners, at| {
            let normal = double_area(at);
            let area = length(normal);
            let normal = if area > 0.0 { normal.map_each(|x| x / area) } else { [0.0; 3] };
            let edges = [0, 1, 2].map_each(|k| minus(at[(k + 1) % 3], at[k]));
            for k in 0..3 {
                visit(corners[k], normal, angle(area, -dot(edges[k], edges[(k + 2) % 3])));
            }
        });
    });
}

/// What a corner adds to the sum of its vertex.
#[inline(always)]
fn addend(normal: [f64; 3], angle: f64) -> [i32; 3] {
    normal.map_each(|x| (x * angle * STEPS) as i32)
}

/// One normal per vertex, not normalised.
pub(super) struct VertexSums(Sums);

enum Sums {
    Memory(Vec<[AtomicI32; 3]>),
    Scratch(ScratchArray<[i32; 3]>),
}

impl VertexSums {
    /// Bytes for the sums of `mesh`.
    pub fn bytes(mesh: &Mesh) -> u64 {
        12 * mesh.positions.len() as u64
    }

    /// Sums the normals of all faces.
    pub fn of(mesh: &Mesh, run: &Run) -> Result<Self> {
        let sums: Vec<[AtomicI32; 3]> = (0..mesh.positions.len()).map(|_| Default::default()).collect();
        let n = mesh.faces.len();
        let chunk = |k, (): &mut ()| {
            each_corner(mesh, chunk_range(n, CHUNK, k), |corner, normal, angle| {
                let Some(sum) = sums.get(corner as usize) else { return };
                let added = addend(normal, angle);
                for axis in 0..3 {
                    sum[axis].fetch_add(added[axis], Relaxed);
                }
            });
            Ok(())
        };
        run.map_chunks(chunk_count(n, CHUNK), || (), chunk)?;
        Ok(Self(Sums::Memory(sums)))
    }

    /// The same sums in a file of the work directory, on one thread.
    pub fn in_file(mesh: &Mesh, context: Context<'_>) -> Result<Self> {
        let n = mesh.faces.len();
        let mut sums = ScratchArray::<[i32; 3]>::new("normals.tmp", mesh.positions.len(), context)?;
        for k in 0..chunk_count(n, CHUNK) {
            context.run.cancel.check()?;
            each_corner(mesh, chunk_range(n, CHUNK, k), |corner, normal, angle| {
                let Some(sum) = sums.get_mut(corner as usize) else { return };
                // As atomic numbers do.
                sum.iter_mut().zip(addend(normal, angle)).for_each(|(sum, x)| *sum = sum.wrapping_add(x));
            });
        }
        Ok(Self(Sums::Scratch(sums)))
    }

    /// Number of vertices.
    #[cfg(feature = "pictures")]
    pub fn len(&self) -> usize {
        match &self.0 {
            Sums::Memory(sums) => sums.len(),
            Sums::Scratch(sums) => sums.len(),
        }
    }

    /// The unit normal of `vertex`; of length 0 if its faces have none, or cancel out.
    #[inline]
    pub fn normal(&self, vertex: u32) -> Option<[f64; 3]> {
        let sum = match &self.0 {
            Sums::Memory(sums) => {
                let sum = sums.get(vertex as usize)?;
                [0, 1, 2].map_each(|axis| sum[axis].load(Relaxed))
            }
            Sums::Scratch(sums) => *sums.get(vertex as usize)?,
        };
        Some(unit(sum.map_each(f64::from)))
    }

    /// The share of the area whose faces are steep to the normal of a corner, 0 to 1: small for a scan, large for a
    /// box. On a large mesh only [`CREASE_CHUNKS`] chunks are sampled.
    pub fn creased(&self, mesh: &Mesh, run: &Run) -> Result<f64> {
        let n = mesh.faces.len();
        let step = (chunk_count(n, CHUNK) / CREASE_CHUNKS).max(1);
        let chunk = |k, (): &mut ()| {
            let (mut creased, mut all) = (0., 0.);
            mesh.faces.for_each(chunk_range(n, CHUNK, k * step), |_, corners| {
                mesh.triangles(corners, |corners, at| {
                    let normal = double_area(at);
                    let area = length(normal);
                    let steep = |&v: &u32| self.normal(v).is_some_and(|mean| dot(mean, normal) < SMOOTH * area);
                    all += area;
                    creased += if corners.iter().any(steep) { area } else { 0. };
                });
            });
            Ok((creased, all))
        };
        let sums = run.map_chunks(chunk_count(n, CHUNK) / step, || (), chunk)?;
        let (creased, all) = sums.into_iter().fold((0., 0.), |(a, b), (c, d)| (a + c, b + d));
        Ok(if all > 0. { creased / all } else { 1. })
    }
}

#[cfg(test)]
mod tests {
    use super::angle;

    #[test]
    fn angles_are_near_enough() {
        for k in 0..=200 {
            let expected = f64::from(k) * std::f64::consts::PI / 200.0;
            let found = angle(3.0 * expected.sin(), 3.0 * expected.cos());
            assert!((found - expected).abs() < 4e-3, "{found} {expected}");
        }
        assert_eq!(angle(0.0, 0.0), 0.0);
    }
}
