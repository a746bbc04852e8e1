//! Splits long edges: the same surface in triangles that are short everywhere.
//!
//! Exports of CAD consist of few triangles, as long as the features they belong to. Whatever walks along faces sees
//! little of such a shape. Every edge that is too long is split at its midpoint for all of its faces at once, and faces
//! with sides of equal length are divided alike, whatever their winding. So no gaps open, along shared edges or along
//! open ones at the same positions, and faces that occur twice still do.
//!
//! Cost: a pass over all triangles for each halving. 50 bytes per triangle, and 32 per edge that is split in a pass.

use super::Mesh;
use crate::base::vector::{area, distance, finite, middle};
use std::collections::HashMap;

/// Triangles on the faces of a mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FineTriangles {
    /// Positions of vertices.
    pub positions: Vec<[f64; 3]>,
    /// The corners of each triangle (t).
    pub corners: Vec<[u32; 3]>,
    /// The face of the mesh that each triangle lies on (t), ascending; every face has one at least.
    pub face: Vec<u32>,
    /// Which vertices of the mesh the first vertices are: a face, and the corner of it.
    pub originals: Vec<[u32; 2]>,
    /// The ends, which are earlier vertices, of the edges whose midpoints the other vertices are.
    pub midpoints: Vec<[u32; 2]>,
}

impl FineTriangles {
    /// The triangles of `mesh`, whose positions are transformed by `place`.
    pub fn of(mesh: &Mesh, place: impl Fn([f64; 3]) -> [f64; 3]) -> Self {
        let (mut all, mut number) = (Self::default(), HashMap::new());
        mesh.faces.for_each(0..mesh.faces.len(), |face, corners| {
            let before = all.corners.len();
            let mut vertex = |v: u32| {
                *number.entry(v).or_insert_with(|| {
                    let corner = corners.iter().position(|&own| own == v).unwrap_or_default();
                    all.originals.push([face as u32, corner as u32]);
                    all.positions.push(place(mesh.positions.get(v)));
                    all.positions.len() as u32 - 1
                })
            };
            mesh.triangles(corners, |triangle, _| all.corners.push(triangle.map(&mut vertex)));
            if all.corners.len() == before {
                // It has no area, but its edges connect others.
                let corner = |k: usize| corners.get(k).or(corners.last()).copied();
                match [0, 1, 2].map(corner) {
                    [Some(a), Some(b), Some(c)] => all.corners.push([a, b, c].map(&mut vertex)),
                    _ => {
                        all.originals.push([face as u32, 0]);
                        all.positions.push([f64::NAN; 3]);
                        all.corners.push([all.positions.len() as u32 - 1; 3]);
                    }
                }
            }
            all.face.resize(all.corners.len(), face as u32);
        });
        all
    }

    fn places(&self, triangle: usize) -> [[f64; 3]; 3] {
        self.corners[triangle].map(|v| self.positions[v as usize])
    }

    /// The area of all triangles, and their mean length.
    pub fn area_and_length(&self) -> (f64, f64) {
        let mut lengths = Lengths::default();
        (0..self.corners.len()).for_each(|triangle| lengths.add(self.places(triangle)));
        lengths.area_and_mean()
    }

    /// Splits edges until none is longer than `limit`; returns false, and leaves the rest as it is, if there would be
    /// more than `most` triangles.
    pub fn split_longer(&mut self, limit: f64, most: usize) -> bool {
        loop {
            let long: Vec<[bool; 3]> = (0..self.corners.len()).map(|k| self.longer(k, limit)).collect();
            let more = long.iter().flatten().filter(|long| **long).count();
            if more == 0 {
                return true;
            }
            if self.corners.len() + more > most {
                return false;
            }
            self.split(&long, more);
        }
    }

    /// Whether each edge of a triangle, from its first, second and third corner, is longer than `limit`.
    fn longer(&self, triangle: usize, limit: f64) -> [bool; 3] {
        let [a, b, c] = self.places(triangle);
        [[a, b], [b, c], [c, a]].map(|[p, q]| finite(p) && finite(q) && distance(p, q) > limit)
    }

    /// Splits all edges: four triangles for each.
    #[cfg(feature = "correspondence")]
    pub fn quarter(&mut self) {
        self.split(&vec![[true; 3]; self.corners.len()], 3 * self.corners.len());
    }

    /// Splits the edges that are `long`, which makes as many triangles `more`.
    fn split(&mut self, long: &[[bool; 3]], more: usize) {
        let Self { mut positions, corners, face, originals, mut midpoints } = std::mem::take(self);
        let mut middles = HashMap::new();
        let mut all = Self {
            corners: Vec::with_capacity(corners.len() + more),
            face: Vec::with_capacity(corners.len() + more),
            ..Self::default()
        };
        for ((corner, long), &face) in corners.iter().zip(long).zip(&face) {
            let mut split = |a: u32, b: u32| {
                *middles.entry([a.min(b), a.max(b)]).or_insert_with(|| {
                    midpoints.push([a.min(b), a.max(b)]);
                    positions.push(middle(positions[a as usize], positions[b as usize]));
                    positions.len() as u32 - 1
                })
            };
            // Turned so that the edge unlike the other two comes first.
            let odd = long.iter().filter(|long| **long).count() == 1;
            let turn = long.iter().position(|long| *long == odd).unwrap_or(0);
            let [a, b, c] = [0, 1, 2].map(|k| corner[(k + turn) % 3]);
            match [0, 1, 2].map(|k| long[(k + turn) % 3]) {
                [false, false, false] => all.corners.push([a, b, c]),
                [true, true, true] => {
                    let [ab, bc, ca] = [split(a, b), split(b, c), split(c, a)];
                    all.corners.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
                }
                [true, ..] => all.corners.extend(halves([a, b, c], split(a, b))),
                [false, ..] => {
                    let new = [split(b, c), split(c, a)];
                    all.corners.extend(thirds([a, b, c], new, &positions));
                }
            }
            all.face.resize(all.corners.len(), face);
        }
        *self = Self { positions, originals, midpoints, ..all };
    }
}

/// The area of the triangles of `mesh`, whose positions are transformed by `place`, and their mean length.
pub fn area_and_length(mesh: &Mesh, place: impl Fn([f64; 3]) -> [f64; 3]) -> (f64, f64) {
    let mut lengths = Lengths::default();
    mesh.faces.for_each(0..mesh.faces.len(), |_, corners| {
        mesh.triangles(corners, |_, places| lengths.add(places.map(&place)));
    });
    lengths.area_and_mean()
}

/// Sums over triangles.
#[derive(Default)]
struct Lengths {
    area: f64,
    /// Σ area times the longest edge.
    lengths: f64,
}

impl Lengths {
    fn add(&mut self, triangle: [[f64; 3]; 3]) {
        let ([a, b, c], area) = (triangle, area(triangle));
        if area > 0. && area.is_finite() {
            self.area += area;
            self.lengths += area * distance(a, b).max(distance(b, c)).max(distance(c, a));
        }
    }

    /// The area, and the mean of longest edges, weighted by area.
    fn area_and_mean(&self) -> (f64, f64) {
        (self.area, if self.area > 0. { self.lengths / self.area } else { 0. })
    }
}

/// The triangle, whose first edge has the midpoint `ab`, in two.
fn halves([a, b, c]: [u32; 3], ab: u32) -> [[u32; 3]; 2] {
    [[a, ab, c], [ab, b, c]]
}

/// The triangle, whose second and third edge have the midpoints `bc` and `ca`, in three: the remaining quadrangle is
/// divided along its shorter diagonal, or the one from the corner with the smaller coordinates.
fn thirds([a, b, c]: [u32; 3], [bc, ca]: [u32; 2], positions: &[[f64; 3]]) -> [[u32; 3]; 3] {
    let at = |v: u32| positions[v as usize];
    let (from_a, from_b) = (distance(at(a), at(bc)), distance(at(b), at(ca)));
    if from_a < from_b || (from_a == from_b && at(a) < at(b)) {
        [[a, b, bc], [a, bc, ca], [ca, bc, c]]
    } else {
        [[a, b, ca], [b, bc, ca], [ca, bc, c]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    /// A box of the size 8 × 2 × 1, and its triangles.
    fn block() -> Mesh {
        let positions: Vec<[f64; 3]> =
            (0..8u32).map(|v| [8. * f64::from(v & 1), f64::from(v & 2), f64::from(v >> 2)]).collect();
        let squares = [[0u32, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let faces: Vec<[u32; 3]> = squares.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        Mesh::from_vecs(positions, faces).unwrap()
    }

    #[test]
    fn the_surface_stays_closed_and_as_large() {
        let mut fine = FineTriangles::of(&block(), |p| p);
        let (before, long) = fine.area_and_length();
        assert_eq!(area_and_length(&block(), |p| p), (before, long));
        assert!(fine.split_longer(0.3, 100_000));
        let (after, short) = fine.area_and_length();
        assert!((before - after).abs() < 1e-9 && (before - 52.).abs() < 1e-9);
        assert!(long > 5. && short <= 0.3, "{long} {short}");
        let mut edges: BTreeMap<[u32; 2], (u32, u32)> = BTreeMap::new();
        for &[a, b, c] in &fine.corners {
            for [a, b] in [[a, b], [b, c], [c, a]] {
                let sides = edges.entry([a.min(b), a.max(b)]).or_default();
                if a < b { sides.0 += 1 } else { sides.1 += 1 }
            }
        }
        assert!(edges.values().all(|sides| *sides == (1, 1)));
        assert!(fine.face.is_sorted() && fine.face.first() == Some(&0) && fine.face.last() == Some(&11));
        for face in 0..12 {
            let own = (0..fine.face.len()).filter(|&k| fine.face[k] == face).map(|k| area(fine.places(k))).sum::<f64>();
            let whole = block().faces.with(face as usize, |c| area([0, 1, 2].map(|k| block().positions.get(c[k]))));
            assert!((own - whole).abs() < 1e-9, "{own} {whole}");
        }
    }

    /// A face that occurs twice, or is wound the other way, is divided into the same triangles.
    #[test]
    fn faces_are_divided_alike_in_any_winding() {
        let positions = vec![[0f64, 0., 0.], [4., 0., 0.], [2., 3., 1.]];
        let divided = |face: [u32; 3]| {
            let mut fine = FineTriangles::of(&Mesh::from_vecs(positions.clone(), vec![face]).unwrap(), |p| p);
            assert!(fine.split_longer(0.7, 1000));
            let key = |corners: &[u32; 3]| {
                let mut places = corners.map(|v| fine.positions[v as usize].map(f64::to_bits));
                places.sort_unstable();
                places
            };
            let mut all: Vec<_> = fine.corners.iter().map(key).collect();
            all.sort_unstable();
            all
        };
        let first = divided([0, 1, 2]);
        assert!(first.len() > 20);
        for other in [[1, 2, 0], [2, 1, 0], [0, 2, 1]] {
            assert_eq!(divided(other), first);
        }
    }

    #[test]
    fn faces_without_area_keep_one_triangle_and_the_number_is_bounded() {
        let positions = vec![[0f64, 0., 0.], [4., 0., 0.], [2., 3., 1.], [f64::NAN, 0., 0.], [f64::INFINITY, 0., 0.]];
        let (starts, corners) = (vec![0, 3, 5, 8, 11, 12, 12], vec![0, 1, 2, 0, 1, 0, 1, 3, 0, 1, 4, 2]);
        let mesh = Mesh::from_polygons(positions, starts, corners).unwrap();
        let mut fine = FineTriangles::of(&mesh, |p| p);
        assert_eq!(fine.face, [0, 1, 2, 3, 4, 5]);
        let kept = fine.clone();
        assert!(!fine.split_longer(1e-3, 8));
        assert_eq!((&fine.corners, &fine.face), (&kept.corners, &kept.face));
        assert!(fine.split_longer(1., 1000) && fine.face.len() > 20 && fine.face.contains(&5));
    }
}
