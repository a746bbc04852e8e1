//! Faces that lie exactly where another face lies, in either winding, as two-sided models have them.
//!
//! A mesh as opened knows of none: finding them takes a sort of all faces, which [`crate::graph`] does if edges or
//! components suggest that there are some. From then on the mesh tells of each face whether it is a duplicate.
//!
//! Cost: 4 bytes per face, mapped; some 50 ns for the place of a triangle.

use super::Mesh;
use crate::base::vector::finite;
use crate::store::MappedSlice;
use xxhash_rust::xxh3::xxh3_128;

/// Maximum number of corners that are hashed at each edge.
const LONG: usize = 32;

/// A hash of the positions of a face's corners, in whatever order.
pub(crate) type Place = [u32; 3];

impl Mesh {
    /// The same mesh, `count` faces of which are known as duplicates: `of` (n) has 1 + the face that each duplicates or
    /// hangs on, 0 for all others.
    pub(crate) fn with_duplicates(mut self, of: MappedSlice<u32>, count: u64) -> Self {
        self.duplicates = Some((of, count));
        self
    }

    /// For each face (n) 1 + the face that it is known to duplicate, 0 for all others; `None` for a mesh as opened.
    pub(crate) fn duplicates(&self) -> Option<&MappedSlice<u32>> {
        self.duplicates.as_ref().map(|(of, _)| of)
    }

    /// Number of known duplicates.
    pub(crate) fn duplicate_count(&self) -> u64 {
        self.duplicates.as_ref().map_or(0, |(_, count)| *count)
    }

    /// Whether `face` is known as a duplicate.
    #[inline]
    pub(crate) fn is_duplicate(&self, face: usize) -> bool {
        self.duplicates.as_ref().is_some_and(|(of, _)| of[face] != 0)
    }

    /// Whether the faces `a` and `b`, which lie in the same place, have the same winding.
    pub(crate) fn have_same_winding(&self, a: u32, b: u32) -> bool {
        let corner = |face: u32, slot: usize| {
            self.faces.with(face as usize, |corners| self.positions.get(corners[slot % corners.len()]))
        };
        let count = self.faces.corner_range(b as usize).len();
        let (start, next) = (corner(a, 0), corner(a, 1));
        (0..count).any(|slot| corner(b, slot) == start && corner(b, slot + 1) == next)
    }

    /// The place of face `face`: the same for all faces with corners at the same positions. `None` if two corners
    /// coincide or one is not finite.
    pub(crate) fn place_of(&self, face: usize) -> Option<Place> {
        self.faces.with(face, |corners| {
            // Adding zero turns −0 into 0.
            let at = |v: &u32| self.positions.get(*v).map(|x| x + 0.);
            match corners {
                [a, b, c] => hash(&mut [at(a), at(b), at(c)]),
                _ => hash(&mut corners.iter().map(at).collect::<Vec<_>>()),
            }
        })
    }

    /// The place of the face with this `corner`, or for a long polygon a stand-in: the same for all of as many corners
    /// that have the same positions at the edge that leaves `corner` and beside it. Hashing all corners at each edge
    /// would take time quadratic in their number.
    pub(crate) fn place_at_edge(&self, corner: usize) -> Option<Place> {
        let face = self.faces.face_of_corner(corner);
        let range = self.faces.corner_range(face);
        if range.len() <= LONG {
            return self.place_of(face);
        }
        let (slot, count) = (corner - range.start, range.len());
        let beside = [count - 1, 0, 1, 2].map(|step| (slot + step) % count);
        let mut at = self.faces.with(face, |corners| beside.map(|k| self.positions.get(corners[k]).map(|x| x + 0.)));
        hash(&mut at).map(|[a, b, c]| [a ^ count as u32, b, c])
    }

    /// Whether the triangles with the corners `a` and `b`, from which the same edge leaves, lie in the same place.
    pub(crate) fn is_same_triangle(&self, a: u32, b: u32) -> bool {
        let third = |corner: u32| {
            let face = self.faces.face_of_corner(corner as usize);
            let slot = corner as usize - self.faces.corner_range(face).start;
            let vertex = self.faces.with(face, |corners| (corners.len() == 3).then(|| corners[(slot + 2) % 3]));
            vertex.map(|v| self.positions.get(v))
        };
        third(a).is_some_and(|p| Some(p) == third(b))
    }
}

fn hash(corners: &mut [[f64; 3]]) -> Option<Place> {
    if corners.len() < 3 || !corners.iter().all(|p| finite(*p)) {
        return None;
    }
    corners.sort_unstable_by_key(|p| p.map(f64::to_bits));
    if corners.windows(2).any(|two| two[0] == two[1]) {
        return None;
    }
    let hash = xxh3_128(bytemuck::cast_slice(corners));
    Some([hash as u32, (hash >> 32) as u32, (hash >> 64) as u32])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_depends_on_positions_alone() {
        let points = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [-0., 0., 0.], [1., 1., 0.], [f64::NAN, 0., 0.]];
        let faces: [&[u32]; 9] = [
            &[0, 1, 2],
            &[2, 1, 3],
            &[1, 2, 0],
            &[0, 1, 4],
            &[0, 1, 4, 2],
            &[2, 4, 1, 3],
            &[0, 1, 3],
            &[0, 1, 5],
            &[0, 1],
        ];
        let mesh = Mesh::from_slices(&points, &faces).unwrap();
        let places: Vec<_> = (0..9).map(|face| mesh.place_of(face)).collect();
        assert!(places[0].is_some() && places[1] == places[0] && places[2] == places[0]);
        assert!(places[3].is_some() && places[3] != places[0]);
        assert!(places[4].is_some() && places[5] == places[4] && places[4] != places[3]);
        assert_eq!(places[6..], [None; 3]);
    }

    #[test]
    fn triangles_across_an_edge_lie_together_or_not() {
        let points = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [1., 1., 0.]];
        let mesh = Mesh::from_slices(&points, &[[0, 1, 2], [4, 3, 5], [1, 6, 2]]).unwrap();
        // The edge along x: corner 0 of the first face, corner 0 of its reverse.
        assert!(mesh.is_same_triangle(0, 3));
        // The diagonal, with the triangle beyond it.
        assert!(!mesh.is_same_triangle(1, 8));
    }
}
