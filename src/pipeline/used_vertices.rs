//! Removes vertices that no triangle uses before meshes are matched.
//!
//! Crops and exporters leave such vertices, and they may lie anywhere: they would become landmarks, samples and matches
//! like all others. A mesh that has some is matched without them. Afterwards its vertices get their file numbers back,
//! and the removed ones have no match. A triangle is one of [`triangles`]: with three different vertices that have
//! positions.
//!
//! Cost: a check of every corner; if there are some, positions and triangles once more on disk, and 8 bytes per vertex.

use super::sides::{Correspondence, FunctionalMap, Guidance};
use crate::apps::correspond::SurfacePoint;
use crate::apps::correspond::matches::Match;
use crate::base::{Error, Result};
use crate::graph::vertex_graph::triangles;
use crate::mesh::{Faces, Mesh, Positions, StridedLayout};
use crate::spectral::local::LocalBasis;
use crate::store::{Context, MappedSlice, Run};

/// Vertices per chunk, and faces between checks of the stop flag.
const CHUNK: usize = 1 << 14;
/// A vertex without a number.
const UNUSED: u32 = u32::MAX;

/// The vertices of a mesh that its triangles use.
struct UsedVertices {
    /// The mesh restricted to them.
    mesh: Mesh,
    /// Their numbers in the file, ascending.
    of_file: MappedSlice<u32>,
    /// Number of vertices in the file.
    all: usize,
}

/// Calls `visit` for the triangles of all faces in order.
fn each_triangle(mesh: &Mesh, run: &Run, mut visit: impl FnMut([u32; 3]) -> Result<()>) -> Result<()> {
    for start in (0..mesh.faces.len()).step_by(CHUNK) {
        run.cancel.check()?;
        mesh.faces.try_for_each(start..mesh.faces.len().min(start + CHUNK), |_, corners| {
            let mut visited = Ok(());
            triangles(mesh, corners, |triangle, _| {
                if visited.is_ok() {
                    visited = visit(triangle);
                }
            });
            visited
        })?;
    }
    Ok(())
}

impl UsedVertices {
    /// The used vertices of `mesh`; `name` prefixes the files. `None` if all are used, or none.
    fn of(mesh: &Mesh, name: &str, context: Context<'_>) -> Result<Option<Self>> {
        let (work, all) = (context.work, mesh.positions.len());
        let names = ["number", "used", "positions", "triangles"].map(|array| format!("{name}_{array}.tmp"));
        // There, strays without a finite neighbour have no position.
        let seen = mesh.without_strays(context.run)?;
        let mut numbers = work.array::<u32>(&names[0], &[all])?;
        let number = &mut numbers.data()[..];
        number.fill(UNUSED);
        each_triangle(&seen, context.run, |triangle| {
            triangle.into_iter().for_each(|v| number[v as usize] = 0);
            Ok(())
        })?;
        let used = number.iter().filter(|number| **number != UNUSED).count();
        if used == all || used == 0 {
            return Ok(None);
        }
        let unused = all - used;
        let verb = if unused == 1 { "vertex that no triangle uses is" } else { "vertices that no triangle uses are" };
        context.run.progress.note(&format!("{}: {unused} {verb} left out", mesh.path().display()));
        let mut of_file = work.array::<u32>(&names[1], &[used])?;
        let mut positions = work.array::<f64>(&names[2], &[used, 3])?;
        let kept = number.iter_mut().zip(0u32..).filter(|(number, _)| **number != UNUSED);
        let slots = of_file.data().iter_mut().zip(positions.data().chunks_exact_mut(3));
        for (((number, v), (old, position)), at) in kept.zip(slots).zip(0..) {
            (*number, *old) = (at, v);
            position.copy_from_slice(&mesh.positions.get(v));
        }
        let mut writer = work.writer::<u32>(&names[3], 3)?;
        let mut buffer = Vec::with_capacity(3 * CHUNK);
        each_triangle(&seen, context.run, |triangle| {
            buffer.extend(triangle.map(|v| number[v as usize]));
            if buffer.len() == 3 * CHUNK {
                writer.push(&buffer)?;
                buffer.clear();
            }
            Ok(())
        })?;
        writer.push(&buffer)?;
        let (of_file, _, corners) = (of_file.finish(false)?, positions.finish(false)?, writer.finish(false)?);
        let (bytes, start) = work.array_bytes(&names[2])?;
        let positions = Positions::strided(mesh.path(), bytes, StridedLayout::packed(start, true, used))?;
        let (bytes, start) = work.array_bytes(&names[3])?;
        let faces = Faces::triangles(mesh.path(), bytes, start, 12, corners.len() / 3)?;
        // Mapped arrays outlive their file names.
        names.iter().for_each(|name| work.remove(name));
        Ok(Some(Self { mesh: mesh.with_arrays(positions, faces), of_file, all }))
    }

    /// The index among them of the file's vertex `v`.
    fn at(&self, v: usize) -> Option<usize> {
        self.of_file.binary_search(&(v as u32)).ok()
    }
}

/// The used vertices of two meshes; `None` if a mesh uses all.
pub(super) struct UsedVerticesOfTwo([Option<UsedVertices>; 2]);

impl UsedVerticesOfTwo {
    /// The used vertices of `meshes`, A and B.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Cancelled`].
    pub fn of([a, b]: [&Mesh; 2], context: Context<'_>) -> Result<Self> {
        Ok(Self([UsedVertices::of(a, "a", context)?, UsedVertices::of(b, "b", context)?]))
    }

    /// The meshes to match instead of `meshes`.
    pub fn meshes<'a>(&'a self, meshes: [&'a Mesh; 2]) -> [&'a Mesh; 2] {
        [0, 1].map(|side| self.0[side].as_ref().map_or(meshes[side], |used| &used.mesh))
    }

    /// The index, among the used vertices of a side, of the file's vertex `v`.
    fn at(&self, side: usize, v: u32) -> Option<u32> {
        self.0[side].as_ref().map_or(Some(v), |used| used.at(v as usize).map(|at| at as u32))
    }

    /// The file number of the vertex `v` on a side; −1 for −1.
    fn in_file(&self, side: usize, v: i64) -> i64 {
        let used = self.0[side].as_ref();
        used.map_or(v, |used| usize::try_from(v).map_or(-1, |at| i64::from(used.of_file[at])))
    }

    /// `guidance` in terms of the meshes to be matched.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a landmark that no triangle uses.
    pub fn guidance(&self, guidance: &Guidance) -> Result<Guidance> {
        let pairs = guidance.pairs.iter().map(|&(a, b)| {
            self.at(0, a).zip(self.at(1, b)).ok_or_else(|| {
                let problem = format!("{a} and {b}: no triangle uses one of them");
                Error::parameter("pairs", problem, "give vertices of triangles")
            })
        });
        let image = |v: u32| -> Option<u32> { self.at(1, guidance.map.as_ref()?[v as usize]?) };
        let map = guidance.map.as_ref().map(|map| match &self.0[0] {
            None => (0..map.len() as u32).map(image).collect(),
            Some(used) => used.of_file.iter().map(|&v| image(v)).collect(),
        });
        Ok(Guidance { pairs: pairs.collect::<Result<_>>()?, map })
    }

    /// `found` in terms of the vertices of the files. Removed vertices have no match, and functions are 0 there.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Cancelled`].
    pub fn in_file_numbering(&self, found: Correspondence, context: Context<'_>) -> Result<Correspondence> {
        if self.0.iter().all(Option::is_none) {
            return Ok(found);
        }
        let Correspondence { matches, points, functional, mut sides, .. } = found;
        let (run, n) = (context.run, self.0[0].as_ref().map_or(matches.len(), |used| used.all));
        let at = |v: usize| self.0[0].as_ref().map_or(Some(v), |used| used.at(v));
        let mut array = context.work.array::<Match>("all_matches.npy", &[n])?;
        run.fill_each(array.data(), CHUNK, |v, _| {
            at(v).map_or(Match::NONE, |at| Match { target: self.in_file(1, matches[at].target), ..matches[at] })
        })?;
        let matches = array.finish(false)?;
        let all_points = |points: MappedSlice<SurfacePoint>| {
            let mut array = context.work.array::<SurfacePoint>("all_points.npy", &[n])?;
            run.fill_each(array.data(), CHUNK, |v, _| {
                at(v).map_or(SurfacePoint::NONE, |at| {
                    let corners = points[at].corners.map(|corner| self.in_file(1, corner.into()) as i32);
                    SurfacePoint { corners, ..points[at] }
                })
            })?;
            array.finish(false)
        };
        let points = points.map(all_points).transpose()?;
        let all_functions = |FunctionalMap { map, bases: [a, b] }: FunctionalMap| -> Result<FunctionalMap> {
            Ok(FunctionalMap { map, bases: [self.values(0, a, context)?, self.values(1, b, context)?] })
        };
        let functional = functional.map(all_functions).transpose()?;
        for (side, facts) in sides.iter_mut().enumerate() {
            facts.landmarks.iter_mut().for_each(|v| *v = self.in_file(side, (*v).into()) as u32);
        }
        Ok(Correspondence { matches, points, functional, sides, ..found })
    }

    /// The values of `basis` at all vertices of the file on a side.
    fn values(&self, side: usize, basis: LocalBasis, context: Context<'_>) -> Result<LocalBasis> {
        let Some(used) = &self.0[side] else { return Ok(basis) };
        let count = basis.count;
        let mut array = context.work.array::<f32>(&format!("all_functions_{side}.npy"), &[used.all, count])?;
        for (row, &v) in basis.values.chunks_exact(count.max(1)).zip(used.of_file.iter()) {
            array.data()[v as usize * count..][..count].copy_from_slice(row);
        }
        Ok(LocalBasis { values: array.finish(false)?, ..basis })
    }
}
