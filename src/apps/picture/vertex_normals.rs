//! Smooth vertex normals, for meshes whose faces are larger than samples.
//!
//! If a face is steeper to the [mean normal](crate::apps::vertex_sums) of its vertex than [`SMOOTH`], the surface has a
//! crease at the vertex; each corner there gets the sum of only those faces that are within [`SAME`] of its own. So a
//! box has flat sides and sharp edges, and a cylinder a smooth side and a sharp rim. 12 bytes per vertex; 12 per corner
//! at creases and 4 per vertex there, in a file of the work directory where memory is short.

use super::camera::Vec3;
use crate::apps::vertex_sums::{CHUNK, SMOOTH, VertexSums, each_corner};
use crate::base::Result;
use crate::base::bit_set::RankedSet;
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::vector::{MapEach, add_scaled, dot, is_zero, unit};
use crate::mesh::Mesh;
use crate::store::{Context, ScratchArray};
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Minimum cosine (60°) for two faces at a crease to be on the same side.
const SAME: f64 = 0.5;

/// Number of corners at a crease above which each is flat: comparing all of them with each other would be too slow at
/// the tip of a cone with a million.
const MOST: usize = 1 << 10;

/// Faces whose corners at creases are collected at a time.
const COLLECTED: usize = 1 << 11;

/// Normals of vertices.
pub(super) struct VertexNormals {
    sums: VertexSums,
    /// None if no vertex has a crease.
    creases: Option<Creases>,
}

/// The corners at vertices where the surface has a crease.
struct Creases {
    vertices: RankedSet,
    /// First corner of each vertex with a crease, followed by the end.
    starts: ScratchArray<u32>,
    /// Normals of the corners' faces, scaled by their angles.
    corners: ScratchArray<[f32; 3]>,
}

impl VertexNormals {
    /// Sums the normals of all faces, and finds the creases.
    pub(super) fn of(mesh: &Mesh, context: Context<'_>) -> Result<Self> {
        let sums = VertexSums::of(mesh, context.run)?;
        let creases = Creases::of(mesh, &sums, context)?;
        Ok(Self { sums, creases })
    }

    /// The normal at a corner of a face whose own unit normal is `face`.
    #[inline]
    pub(super) fn at(&self, corner: u32, face: Vec3) -> Vec3 {
        let Some(smooth) = self.sums.normal(corner) else { return face };
        match self.creases.as_ref().and_then(|creases| creases.at(corner)) {
            None if dot(smooth, face) < SMOOTH => face,
            None => smooth,
            Some(corners) if corners.len() > MOST => face,
            Some(corners) => {
                let mut sum = [0.0; 3];
                for corner in corners {
                    let normal = corner.map_each(f64::from);
                    let sure = dot(normal, normal).sqrt();
                    // A face of opposite winding still belongs to the same surface.
                    let along = dot(normal, face);
                    if along.abs() > SAME * sure {
                        sum = add_scaled(sum, along.signum(), normal);
                    }
                }
                if is_zero(sum) { face } else { unit(sum) }
            }
        }
    }
}

impl Creases {
    /// Those of `mesh`, whose normals have these `sums`.
    fn of(mesh: &Mesh, sums: &VertexSums, context: Context<'_>) -> Result<Option<Self>> {
        let run = context.run;
        let n = mesh.faces.len();
        let marks: Vec<AtomicU64> = (0..sums.len().div_ceil(64)).map(|_| AtomicU64::new(0)).collect();
        let mark = |k, (): &mut ()| {
            each_corner(mesh, chunk_range(n, CHUNK, k), |vertex, normal, _| {
                if sums.normal(vertex).is_some_and(|smooth| normal != [0.0; 3] && dot(smooth, normal) < SMOOTH) {
                    marks[vertex as usize / 64].fetch_or(1 << (vertex % 64), Relaxed);
                }
            });
            Ok(())
        };
        run.map_chunks(chunk_count(n, CHUNK), || (), mark)?;
        let marks = marks.into_iter().map(AtomicU64::into_inner).collect::<Vec<u64>>();
        let vertices = RankedSet::of(marks.into());
        if vertices.count() == 0 {
            return Ok(None);
        }
        let each = |take: &mut dyn FnMut(u32, [f32; 3])| {
            let find = |k, (): &mut ()| {
                let mut found = Vec::new();
                each_corner(mesh, chunk_range(n, COLLECTED, k), |vertex, normal, angle| {
                    found.extend(vertices.rank(vertex).map(|rank| (rank, normal.map_each(|x| (x * angle) as f32))));
                });
                Ok(found)
            };
            run.in_order(
                chunk_count(n, COLLECTED),
                || (),
                find,
                |_, found| {
                    found.into_iter().for_each(|(rank, normal)| take(rank, normal));
                    Ok(())
                },
            )
        };
        // One place ahead: each start moves to the next one's place while its corners are filled in.
        let mut starts = ScratchArray::<u32>::new("crease_starts.tmp", vertices.count() as usize + 2, context)?;
        each(&mut |rank, _| starts[rank as usize + 2] += 1)?;
        for k in 1..starts.len() {
            starts[k] += starts[k - 1];
        }
        let all = starts[starts.len() - 1] as usize;
        let mut corners = ScratchArray::<[f32; 3]>::new("crease_corners.tmp", all, context)?;
        each(&mut |rank, normal| {
            let next = &mut starts[rank as usize + 1];
            corners[*next as usize] = normal;
            *next += 1;
        })?;
        Ok(Some(Self { vertices, starts, corners }))
    }

    /// The corners at `vertex`, if it has a crease.
    #[inline]
    fn at(&self, vertex: u32) -> Option<&[[f32; 3]]> {
        let rank = self.vertices.rank(vertex)? as usize;
        self.corners.get(*self.starts.get(rank)? as usize..*self.starts.get(rank + 1)? as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::super::raster::each_triangle;
    use super::*;
    use crate::base::vector::double_area;
    use crate::store::{Budget, Run, WorkDir};

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
        let (run, folder) = (Run::new(&()), tempfile::tempdir().unwrap());
        let work = WorkDir::in_memory(folder.path(), &run.budget);
        let normals = VertexNormals::of(mesh, Context::new(&work, &run)).unwrap();
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

    /// Regressions: corners at creases were flat where memory was short; later their files were in the system's
    /// temporary folder, whatever folder was given.
    #[test]
    fn normals_are_the_same_whatever_the_memory() {
        let mesh = prism(24);
        let all = |budget: u64, threads: usize| {
            let run = Run { budget: Budget::new(budget), threads, ..Run::new(&()) };
            let folder = tempfile::tempdir().unwrap();
            let work = WorkDir::in_memory(folder.path(), &run.budget);
            let normals = VertexNormals::of(&mesh, Context::new(&work, &run)).unwrap();
            assert_eq!(std::fs::read_dir(folder.path()).unwrap().next().is_some(), budget == 0);
            let mut all = Vec::new();
            each_triangle(&mesh, 0..mesh.faces.len(), |_, corners, at| {
                all.extend(corners.map(|corner| normals.at(corner, unit(double_area(at)))));
            });
            all
        };
        assert_eq!(all(0, 1), all(1 << 30, 3));
    }
}
