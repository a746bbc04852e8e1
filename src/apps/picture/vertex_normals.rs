//! Smooth vertex normals, for meshes whose faces are larger than samples.
//!
//! If a face is steeper to the [mean normal](crate::apps::vertex_sums) of its vertex than [`SMOOTH`], the surface has a
//! crease at the vertex; each corner there gets the sum of only those faces that are within [`SAME`] of its own. So a
//! box has flat sides and sharp edges, and a cylinder a smooth side and a sharp rim. 12 bytes per vertex, and 16 per
//! corner at creases, as far as the budget allows: beyond that, corners at creases are flat.

use super::camera::Vec3;
use crate::apps::vertex_sums::{CHUNK, SMOOTH, VertexSums, each_corner};
use crate::base::Result;
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::vector::{add_scaled, dot, unit};
use crate::mesh::Mesh;
use crate::store::Run;
use crate::store::budget::Grant;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Minimum cosine (60°) for two faces at a crease to be on the same side.
const SAME: f64 = 0.5;

/// Number of corners at a crease above which each is flat: comparing all of them with each other would be too slow at
/// the tip of a cone with a million.
const MOST: usize = 1 << 10;

/// Normals of vertices.
pub(super) struct VertexNormals {
    sums: VertexSums,
    creases: Creases,
}

/// The corners at vertices where the surface has a crease.
#[derive(Default)]
struct Creases {
    /// One bit per vertex, and the number of set bits before each word.
    bits: Vec<u64>,
    before: Vec<u32>,
    /// First corner of each vertex with a crease, followed by the end.
    starts: Vec<u32>,
    /// Normals of the corners' faces, scaled by their angles.
    corners: Vec<[f32; 3]>,
    _grant: Option<Grant>,
}

impl VertexNormals {
    /// Sums the normals of all faces, and finds the creases.
    pub(super) fn of(mesh: &Mesh, run: &Run) -> Result<Self> {
        let mut all = Self { sums: VertexSums::of(mesh, run)?, creases: Creases::default() };
        all.creases = all.creases(mesh, run)?;
        Ok(all)
    }

    fn creases(&self, mesh: &Mesh, run: &Run) -> Result<Creases> {
        let n = mesh.faces.len();
        let marks: Vec<AtomicU64> = (0..self.sums.len().div_ceil(64)).map(|_| AtomicU64::new(0)).collect();
        let mark = |k, (): &mut ()| {
            each_corner(mesh, chunk_range(n, CHUNK, k), |vertex, normal, _| {
                if self.sums.normal(vertex).is_some_and(|smooth| normal != [0.0; 3] && dot(smooth, normal) < SMOOTH) {
                    marks[vertex as usize / 64].fetch_or(1 << (vertex % 64), Relaxed);
                }
            });
            Ok(())
        };
        run.map_chunks(chunk_count(n, CHUNK), || (), mark)?;
        let bits: Vec<u64> = marks.into_iter().map(AtomicU64::into_inner).collect();
        let (mut before, mut creased) = (Vec::with_capacity(bits.len()), 0u32);
        for word in &bits {
            before.push(creased);
            creased += word.count_ones();
        }
        if creased == 0 {
            return Ok(Creases::default());
        }
        let mut all = Creases { bits, before, ..Creases::default() };
        let count = |k, (): &mut ()| {
            let mut mine = 0u64;
            each_corner(mesh, chunk_range(n, CHUNK, k), |vertex, _, _| mine += u64::from(all.rank(vertex).is_some()));
            Ok(mine)
        };
        let corners: u64 = run.map_chunks(chunk_count(n, CHUNK), || (), count)?.into_iter().sum();
        // They are collected in order, then grouped: both copies exist at the same time.
        let bytes = 28 * corners + 4 * u64::from(creased);
        let Ok(grant) = run.budget.take("creases of the picture", bytes, bytes) else { return Ok(Creases::default()) };
        let found = |k, (): &mut ()| {
            let mut mine = Vec::new();
            each_corner(mesh, chunk_range(n, CHUNK, k), |vertex, normal, angle| {
                if let Some(rank) = all.rank(vertex) {
                    mine.push((rank, normal.map(|x| (x * angle) as f32)));
                }
            });
            Ok(mine)
        };
        let found: Vec<Vec<(u32, [f32; 3])>> = run.map_chunks(chunk_count(n, CHUNK), || (), found)?;
        let mut starts = vec![0u32; creased as usize + 1];
        found.iter().flatten().for_each(|(rank, _)| starts[*rank as usize + 1] += 1);
        for k in 0..creased as usize {
            starts[k + 1] += starts[k];
        }
        let (mut next, mut normals) = (starts.clone(), vec![[0.0; 3]; corners as usize]);
        for (rank, normal) in found.into_iter().flatten() {
            let slot = &mut next[rank as usize];
            normals[*slot as usize] = normal;
            *slot += 1;
        }
        (all.starts, all.corners, all._grant) = (starts, normals, Some(grant));
        Ok(all)
    }

    /// The normal at a corner of a face whose own unit normal is `face`.
    pub(super) fn at(&self, corner: u32, face: Vec3) -> Vec3 {
        let Some(smooth) = self.sums.normal(corner) else { return face };
        match self.creases.of(corner) {
            None if dot(smooth, face) < SMOOTH => face,
            None => smooth,
            Some(corners) if corners.len() > MOST => face,
            Some(corners) => {
                let mut sum = [0.0; 3];
                for corner in corners {
                    let normal = corner.map(f64::from);
                    let sure = dot(normal, normal).sqrt();
                    // A face of opposite winding still belongs to the same surface.
                    let along = dot(normal, face);
                    if along.abs() > SAME * sure {
                        sum = add_scaled(sum, along.signum(), normal);
                    }
                }
                if sum == [0.0; 3] { face } else { unit(sum) }
            }
        }
    }
}

impl Creases {
    /// The index of `vertex` among those with a crease.
    fn rank(&self, vertex: u32) -> Option<u32> {
        let word = self.bits.get(vertex as usize / 64)?;
        let bit = vertex % 64;
        (word >> bit & 1 == 1).then(|| self.before[vertex as usize / 64] + (word & ((1 << bit) - 1)).count_ones())
    }

    /// The corners at `vertex`, if it has a crease.
    fn of(&self, vertex: u32) -> Option<&[[f32; 3]]> {
        let rank = self.rank(vertex)? as usize;
        self.corners.get(*self.starts.get(rank)? as usize..*self.starts.get(rank + 1)? as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::super::raster::each_triangle;
    use super::*;
    use crate::base::vector::double_area;

    /// A closed prism with `sides` sides and two lids.
    fn prism(sides: usize) -> Mesh {
        let mut points = vec![[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
        for k in 0..sides {
            let angle = std::f64::consts::TAU * (k as f64 + 0.5) / sides as f64;
            points.extend([0.0, 1.0].map(|z| [angle.cos(), angle.sin(), z]));
        }
        let mut faces = Vec::new();
        for k in 0..sides as u32 {
            let (a, b) = (2 + 2 * k, 2 + 2 * ((k + 1) % sides as u32));
            faces.extend([[a, b, b + 1], [a, b + 1, a + 1], [0, b, a], [1, a + 1, b + 1]]);
        }
        Mesh::from_slices(&points, &faces).unwrap()
    }

    fn each(mesh: &Mesh, mut visit: impl FnMut(Vec3, Vec3, Vec3)) {
        let normals = VertexNormals::of(mesh, &Run::new(&())).unwrap();
        each_triangle(mesh, 0..mesh.faces.len(), |_, corners, at| {
            let own = unit(double_area(at));
            (0..3).for_each(|k| visit(at[k], own, normals.at(corners[k], own)));
        });
    }

    #[test]
    fn a_box_is_flat_however_its_sides_are_cut() {
        each(&prism(4), |_, own, normal| assert!(dot(own, normal) > 1.0 - 1e-6, "{own:?} {normal:?}"));
    }

    #[test]
    fn a_cylinder_is_smooth_with_a_sharp_rim() {
        each(&prism(24), |at, own, normal| {
            let outwards = unit([at[0], at[1], 0.0]);
            let expected = if own[2].abs() > 0.5 { own } else { outwards };
            assert!(dot(expected, normal) > 0.999, "{at:?} {own:?} {normal:?}");
        });
    }
}
