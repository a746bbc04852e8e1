//! Decimates a mesh to a size that a browser can draw, by merging the vertices in each cell of a grid.
//!
//! One pass over the faces gives the box, one the area and with it the size of the grid cells, a third merges: vertices
//! in a grid cell become their mean; faces that still have three different corners are kept, once each. Memory is
//! proportional to the result, so any size is possible. A mesh that is small enough is not changed, except that
//! vertices along open edges are welded as in the dual graph: STL has three per triangle, and parts would have no
//! neighbours.

use crate::apps::edits::bounds;
use crate::base::Result;
use crate::base::vector::{self, finite, position_key};
use crate::mesh::{Mesh, polygon};
use crate::store::Run;
use std::collections::{HashMap, HashSet};

/// Maximum number of grid cells along the longest side, so that a cell's index fits in 64 bits.
const FINEST: f64 = 2_000_000.;
/// Bytes per triangle during merging and welding, and for each of the vertices.
const BYTES: [u64; 2] = [125, 65];

/// Bytes that decimating `mesh` to `target` triangles takes: vertices, triangles and their lookup tables.
pub fn bytes(mesh: &Mesh, target: usize) -> u64 {
    let (triangles, target) = (mesh.faces.triangle_count(), target as u64);
    let vertices = match triangles > target {
        true => target / 2,
        false => (mesh.positions.len() as u64).min(3 * triangles),
    };
    BYTES[0] * triangles.min(target) + BYTES[1] * vertices
}

/// A decimated mesh.
#[derive(Clone, Debug, Default)]
pub struct Decimated {
    /// Positions in the file's units.
    pub positions: Vec<[f64; 3]>,
    /// Corners.
    pub triangles: Vec<[u32; 3]>,
    /// For each triangle a face of the mesh that it represents.
    pub faces: Vec<u32>,
    /// Least and greatest corner of the box of the mesh ([`bounds`]); 0 if no face is finite.
    pub bounds: [[f64; 3]; 2],
}

impl Decimated {
    /// Decimates `mesh` to about `target` triangles.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn of(mesh: &Mesh, target: usize, run: &Run) -> Result<Self> {
        let triangles = mesh.faces.triangle_count();
        let bounds = bounds(mesh, run)?;
        let bounds = if bounds[0][0] <= bounds[1][0] { bounds } else { [[0.; 3]; 2] };
        let [low, high] = bounds;
        let side = (0..3).map(|k| high[k] - low[k]).fold(0., f64::max);
        let area = area(mesh, run)?;
        // A surface of area A gives some 2 A / h² triangles with grid cells of size h.
        let size = match triangles <= target as u64 {
            true => 0.,
            // Triangles without area along a curve occupy as many cells as the curve does; those at one position occupy
            // one.
            false => (2.2 * area / target as f64).sqrt().max(side / FINEST.min(target as f64)).max(f64::MIN_POSITIVE),
        };
        let mut merged = Merged { low, size, ..Merged::default() };
        let mut seen: HashSet<[u32; 3]> = HashSet::new();
        let mut decimated = Self { bounds, ..Self::default() };
        for_faces(mesh, run, |face, corners, positions| {
            let at: Vec<u32> = corners.iter().zip(positions).map(|(&v, &p)| merged.vertex(v, p)).collect();
            polygon::triangles(positions, |triangle| {
                let triangle = triangle.map(|k| at[k]);
                let mut sorted = triangle;
                sorted.sort_unstable();
                let flat = sorted[0] == sorted[1] || sorted[1] == sorted[2];
                if !flat && (size == 0. || seen.insert(sorted)) {
                    decimated.triangles.push(triangle);
                    decimated.faces.push(face as u32);
                }
            });
        })?;
        decimated.positions = merged.sums.iter().map(|sum| [0, 1, 2].map(|k| sum[k] / sum[3])).collect();
        if size == 0. {
            decimated.weld();
        }
        Ok(decimated)
    }

    /// Makes vertices of open edges one if they are at exactly the same position.
    fn weld(&mut self) {
        let side = |a: u32, b: u32| [a.min(b), a.max(b)];
        let mut sides: Vec<[u32; 2]> =
            self.triangles.iter().flat_map(|&[a, b, c]| [side(a, b), side(b, c), side(c, a)]).collect();
        sides.sort_unstable();
        let mut open: Vec<u32> =
            sides.chunk_by(|a, b| a == b).filter(|same| same.len() == 1).flat_map(|same| same[0]).collect();
        drop(sides);
        open.sort_unstable();
        open.dedup();
        let place = |v: u32| position_key(self.positions[v as usize]);
        let mut places: Vec<([u64; 3], u32)> = open.into_iter().map(|v| (place(v), v)).collect();
        places.sort_unstable();
        let mut first: Vec<u32> = (0..self.positions.len() as u32).collect();
        for same in places.chunk_by(|a, b| a.0 == b.0) {
            same.iter().for_each(|&(_, v)| first[v as usize] = same[0].1);
        }
        // The first of them comes before the others, so its new number is known.
        let (before, mut number) = (std::mem::take(&mut self.positions), Vec::with_capacity(first.len()));
        for (v, &first) in first.iter().enumerate() {
            number.push(number.get(first as usize).copied().unwrap_or(self.positions.len() as u32));
            if v == first as usize {
                self.positions.push(before[v]);
            }
        }
        self.triangles.iter_mut().flatten().for_each(|v| *v = number[*v as usize]);
    }
}

/// Vertices merged by grid cell.
#[derive(Debug, Default)]
struct Merged {
    low: [f64; 3],
    size: f64,
    number: HashMap<u64, u32>,
    /// Sums of positions, and the number of vertices.
    sums: Vec<[f64; 4]>,
}

impl Merged {
    fn vertex(&mut self, v: u32, position: [f64; 3]) -> u32 {
        let key = if self.size > 0. {
            (0..3).fold(0, |key, k| key << 21 | ((position[k] - self.low[k]) / self.size) as u64 & 0x1f_ffff)
        } else {
            u64::from(v)
        };
        let new = self.sums.len() as u32;
        let number = *self.number.entry(key).or_insert(new);
        if number == new {
            self.sums.push([0.; 4]);
        } else if self.size == 0. {
            // Of its mean, the last bits might differ from the position.
            return number;
        }
        let sum = &mut self.sums[number as usize];
        (0..3).for_each(|k| sum[k] += position[k]);
        sum[3] += 1.;
        number
    }
}

/// Calls `visit` with every face that has triangles and finite corners.
fn for_faces(mesh: &Mesh, run: &Run, mut visit: impl FnMut(usize, &[u32], &[[f64; 3]])) -> Result<()> {
    let mut positions = Vec::new();
    for start in (0..mesh.faces.len()).step_by(1 << 16) {
        run.cancel.check()?;
        mesh.faces.for_each(start..mesh.faces.len().min(start + (1 << 16)), |face, corners| {
            positions.clear();
            positions.extend(corners.iter().map(|&v| mesh.positions.get(v)));
            if corners.len() > 2 && positions.iter().all(|&p| finite(p)) {
                visit(face, corners, &positions);
            }
        });
    }
    Ok(())
}

/// The area of the faces.
fn area(mesh: &Mesh, run: &Run) -> Result<f64> {
    let mut area = 0.;
    for_faces(mesh, run, |_, _, at| {
        polygon::triangles(at, |triangle| area += vector::area(triangle.map(|k| at[k])));
    })?;
    Ok(area)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faces_without_corners_do_not_keep_a_mesh_from_being_thinned() {
        const WIDTH: u32 = 60;
        let points: Vec<[f64; 3]> =
            (0..WIDTH * WIDTH).map(|v| [f64::from(v % WIDTH), f64::from(v / WIDTH), 0.]).collect();
        let corners = (0..WIDTH * (WIDTH - 1)).filter(|v| v % WIDTH + 1 < WIDTH);
        let mut faces: Vec<Vec<u32>> =
            corners.flat_map(|v| [vec![v, v + 1, v + WIDTH], vec![v + 1, v + WIDTH + 1, v + WIDTH]]).collect();
        let triangles = |faces: &[Vec<u32>]| {
            let mesh = Mesh::from_slices(&points, faces).unwrap();
            Decimated::of(&mesh, 1_000, &Run::new(&())).unwrap().triangles
        };
        let expected = triangles(&faces);
        assert!(expected.len() < 2_000);
        faces.resize(2 * faces.len(), Vec::new());
        assert!(triangles(&faces) == expected);
    }

    /// Regression: in pages of STL no triangle had a neighbour, so parts had no boundaries.
    #[test]
    fn vertices_of_open_edges_are_welded() {
        let corners = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]];
        let sides = [[0u32, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        let decimated = |points: &[[f64; 3]], faces: &[[u32; 3]]| {
            Decimated::of(&Mesh::from_slices(points, faces).unwrap(), 1_000, &Run::new(&())).unwrap()
        };
        // Zeros of either sign are the same.
        let zero = |k: usize, x: f64| if k.is_multiple_of(2) && x == 0. { -0. } else { x };
        let soup: Vec<[f64; 3]> =
            sides.iter().flatten().enumerate().map(|(k, &v)| corners[v as usize].map(|x| zero(k, x))).collect();
        let faces: Vec<[u32; 3]> = (0..4).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let one = decimated(&soup, &faces);
        assert_eq!((one.positions.len(), &one.faces[..]), (4, &[0, 1, 2, 3][..]));
        assert_eq!(one.triangles, [[0, 1, 2], [0, 2, 3], [2, 1, 3], [1, 0, 3]]);
        // Closed pieces that touch have no open edge. A triangle whose corners coincide keeps its place.
        let twice: Vec<[f64; 3]> = corners.iter().chain(&corners).copied().chain([[5.; 3], [5.; 3], [6.; 3]]).collect();
        let faces: Vec<[u32; 3]> =
            sides.iter().copied().chain(sides.map(|side| side.map(|v| v + 4))).chain([[8, 9, 10]]).collect();
        let apart = decimated(&twice, &faces);
        assert_eq!((apart.positions.len(), apart.triangles[4], apart.triangles[8]), (10, [4, 5, 6], [8, 8, 9]));
    }

    #[test]
    fn faces_of_two_corners_bring_no_vertices() {
        let points: Vec<[f64; 3]> = (0..3_000).map(|v| [f64::from(v), f64::from(v % 2), 0.]).collect();
        let mut faces: Vec<Vec<u32>> = (0..2_999).map(|v| vec![v, v + 1]).collect();
        faces.push(vec![0, 1, 2]);
        let mesh = Mesh::from_slices(&points, &faces).unwrap();
        let decimated = Decimated::of(&mesh, 1_000, &Run::new(&())).unwrap();
        assert_eq!(
            (decimated.positions.len(), decimated.triangles, decimated.faces),
            (3, vec![[0, 1, 2]], vec![2_999])
        );
    }

    #[test]
    fn triangles_without_area_are_thinned() {
        for step in [1., 0.] {
            let points: Vec<[f64; 3]> = (0..20_000).map(|v| [step * f64::from(v), 0., 0.]).collect();
            let faces: Vec<[u32; 3]> = (0..19_998).map(|v| [v, v + 1, v + 2]).collect();
            let decimated = Decimated::of(&Mesh::from_slices(&points, &faces).unwrap(), 1_000, &Run::new(&())).unwrap();
            let size = (decimated.triangles.len(), decimated.positions.len());
            assert!(size.0 <= 2_000 && size.1 <= 2_000, "{step}: {size:?}");
        }
    }
}
