//! Edges of three faces or more, and what they tell about faces that lie in the same place.
//!
//! Matching half-edges brings all sides of an edge together, so they are counted there; [`super::duplicates`] decides.
//!
//! Cost: a hash per face at an edge of three faces or more, a comparison of two vertices at a welded edge of two;
//! nothing at all others.

use crate::mesh::Mesh;
use crate::mesh::duplicates::Place;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Counts edges of three faces or more, and the sides of duplicates at edges.
#[derive(Debug, Default)]
pub(super) struct NonmanifoldEdges {
    edges: AtomicU64,
    inner: AtomicU64,
    mixed: AtomicU64,
    rim: AtomicU64,
}

/// Sides of duplicates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct DuplicateSides {
    /// At edges of three faces or more, where every face has a duplicate.
    pub inner: u64,
    /// At such edges where some face has none.
    pub mixed: u64,
    /// At edges of two faces, which are each other's duplicates and have vertices of their own.
    pub rim: u64,
}

impl NonmanifoldEdges {
    /// Counts the edge whose sides start at `corners`, if it has three or more.
    #[inline]
    pub fn count(&self, mesh: &Mesh, corners: impl ExactSizeIterator<Item = u32>) {
        if corners.len() > 2 {
            self.add(mesh, corners);
        }
    }

    /// The same for an edge that was welded, at which `corners` are ends of open edges.
    pub fn count_welded(&self, mesh: &Mesh, mut corners: impl ExactSizeIterator<Item = u32>) {
        if corners.len() != 2 {
            self.count(mesh, corners);
        } else if let (Some(a), Some(b)) = (corners.next(), corners.next())
            && mesh.is_same_triangle(a, b)
        {
            self.rim.fetch_add(1, Relaxed);
        }
    }

    #[cold]
    fn add(&self, mesh: &Mesh, corners: impl Iterator<Item = u32>) {
        self.edges.fetch_add(1, Relaxed);
        let mut corners: Vec<usize> = corners.map(|corner| corner as usize).collect();
        corners.dedup_by_key(|corner| mesh.faces.face_of_corner(*corner));
        let mut places: Vec<Option<Place>> = corners.into_iter().map(|corner| mesh.place_at_edge(corner)).collect();
        places.sort_unstable();
        let (mut sides, mut is_mixed) = (0, false);
        for same in places.chunk_by(|a, b| a.is_some() && a == b) {
            sides += same.len() as u64 - 1;
            is_mixed |= same.len() == 1;
        }
        let kind = if is_mixed { &self.mixed } else { &self.inner };
        kind.fetch_add(sides, Relaxed);
    }

    /// Number of edges of three faces or more so far.
    pub fn edges(&self) -> u64 {
        self.edges.load(Relaxed)
    }

    /// Sides of duplicates so far.
    pub fn duplicate_sides(&self) -> DuplicateSides {
        let [inner, mixed, rim] = [&self.inner, &self.mixed, &self.rim].map(|sides| sides.load(Relaxed));
        DuplicateSides { inner, mixed, rim }
    }
}

impl DuplicateSides {
    /// With those at other edges.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self { inner: self.inner + other.inner, mixed: self.mixed + other.mixed, rim: self.rim + other.rim }
    }

    /// Whether duplicates with `corners` corners in all are the other sides of two-sided pieces of surface: at most
    /// half of their border joins other faces. Around a contact of two bodies, all of it does.
    pub fn are_two_sided(self, corners: u64) -> bool {
        let border = corners.saturating_sub(self.inner);
        2 * self.mixed <= border
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sides_are_told_apart() {
        // Two triangles across the edge from 0 to 1, each twice; another face at that edge; one without an area.
        let points = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., -1., 0.], [0., 0., 1.], [0., 1., 0.]];
        let faces = [[0, 1, 2], [1, 0, 3], [1, 0, 2], [0, 1, 3], [0, 1, 4], [0, 1, 0], [0, 1, 5]];
        let mesh = Mesh::from_slices(&points, &faces).unwrap();
        let of = |edges: &[&[u32]]| {
            let counts = NonmanifoldEdges::default();
            edges.iter().for_each(|faces| counts.count(&mesh, faces.iter().map(|face| 3 * face)));
            (counts.edges(), counts.duplicate_sides())
        };
        let sides = |inner, mixed| DuplicateSides { inner, mixed, rim: 0 };
        assert_eq!(of(&[&[0, 1], &[0, 2]]), (0, sides(0, 0)));
        assert_eq!(of(&[&[0, 1, 4]]), (1, sides(0, 0)));
        assert_eq!(of(&[&[0, 1, 2, 3], &[0, 2, 6]]), (2, sides(4, 0)));
        assert_eq!(of(&[&[0, 1, 2], &[0, 1, 2, 3, 4], &[0, 2, 5]]), (3, sides(0, 4)));
        let welded = NonmanifoldEdges::default();
        [[0, 6], [0, 1], [1, 3]].iter().for_each(|[a, b]| welded.count_welded(&mesh, [3 * a, 3 * b].into_iter()));
        assert_eq!((welded.edges(), welded.duplicate_sides().rim), (0, 2));
    }

    /// Regression: at each edge of three faces all corners of polygons were hashed: a polygon of 20,000 corners within
    /// a tube took minutes.
    #[test]
    fn sides_of_long_polygons_are_told_apart_by_what_is_beside_the_edge() {
        let n = 50u32;
        let at = |k: u32| [f64::from(k % n), f64::from(k % n).powi(2), f64::from(k / n)];
        let points: Vec<[f64; 3]> = (0..2 * n).map(at).collect();
        let ring: Vec<u32> = (0..n).collect();
        let mut other = ring.clone();
        other[3] = n;
        let triangle = |a: u32, b: u32| vec![a, b, n + a];
        let faces = [ring.clone(), ring.iter().rev().copied().collect(), other, triangle(0, 1), triangle(2, 3)];
        let mesh = Mesh::from_slices(&points, &faces).unwrap();
        let of = |corners: &[u32]| {
            let counts = NonmanifoldEdges::default();
            counts.count(&mesh, corners.iter().copied());
            counts.duplicate_sides()
        };
        // The edge from 0 to 1: corner 0 of the first, n − 2 of the second, which runs backwards.
        let sides = |inner, mixed| DuplicateSides { inner, mixed, rim: 0 };
        assert_eq!(of(&[0, n + n - 2, 3 * n]), sides(0, 1));
        // From 2 to 3, which the third polygon lacks.
        assert_eq!(of(&[2, n + n - 4, 3 * n + 3]), sides(0, 1));
        assert_eq!(of(&[2, 2 * n + 2, 3 * n + 3]), sides(0, 0));
    }

    #[test]
    fn a_border_on_other_faces_is_a_contact() {
        // A square of 2 × 4² triangles: 96 corners, 80 of them inside, 16 at its border.
        let sides = |mixed| DuplicateSides { inner: 80, mixed, rim: 0 };
        assert!(sides(0).are_two_sided(96) && sides(4).are_two_sided(96) && sides(8).are_two_sided(96));
        assert!(!sides(9).are_two_sided(96) && !sides(16).are_two_sided(96));
        // A closed surface has no border, one with a sheet hardly any of others.
        assert!(DuplicateSides { inner: 96, mixed: 0, rim: 0 }.are_two_sided(96));
    }
}
