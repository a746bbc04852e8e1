//! The mesh as the metrics see it: areas, mean radius and the edges along which cuts run.
//!
//! Made once a mesh and shared by all comparisons on it. Cost: areas one pass over the faces,
//! 8 bytes a face; edges a counting sort of the half-edges, about 0.2 µs and at the most 90 bytes
//! a face in memory, so leave them out ([`Surface::without_edges`]) where cuts do not matter.

use crate::base::{Error, Result};
use crate::mesh::Mesh;

/// What comparisons need to know of a mesh.
#[derive(Clone, Debug)]
pub struct Surface {
    pub(super) faces: usize,
    /// Area a face; absent: 1 each.
    pub(super) areas: Option<Vec<f64>>,
    pub(super) edges: Option<Edges>,
}

/// The mesh as a graph of vertices and edges.
#[derive(Clone, Debug)]
pub(super) struct Edges {
    /// Vertex positions.
    pub(super) positions: Vec<[f64; 3]>,
    /// The two vertices of each edge between two or more faces, the smaller first.
    pub(super) inner: Vec<[u32; 2]>,
    /// Where each inner edge's faces begin in `faces`; one more than there are edges.
    pub(super) starts: Vec<u32>,
    /// Faces around inner edges.
    pub(super) faces: Vec<u32>,
    /// Where each vertex's neighbours begin; one more than there are vertices.
    pub(super) rows: Vec<u32>,
    /// The vertices at the other ends of each vertex's edges.
    pub(super) neighbours: Vec<u32>,
    /// Mean distance of the surface to its centroid.
    pub(super) radius: f64,
}

impl Surface {
    /// Faces of equal weight and nothing else, for labels without a mesh.
    pub fn of_faces(faces: usize) -> Self {
        Self { faces, areas: None, edges: None }
    }

    /// Faces by area, without cut discrepancy. A face without a finite area counts as 0; where no
    /// face has any, all count the same.
    pub fn without_edges(mesh: &Mesh) -> Self {
        let mut areas = Vec::with_capacity(mesh.faces.len());
        mesh.faces.for_each(0..mesh.faces.len(), |_, corners| areas.push(area(mesh, corners)));
        let any = areas.iter().any(|&area| area > 0.);
        Self { faces: mesh.faces.len(), areas: any.then_some(areas), edges: None }
    }

    /// Everything, for all metrics.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a mesh whose faces have more than 2³¹ corners.
    pub fn of(mesh: &Mesh) -> Result<Self> {
        let mut surface = Self::without_edges(mesh);
        surface.edges = Some(Edges::of(mesh, surface.areas.as_deref())?);
        Ok(surface)
    }

    /// Number of faces.
    pub fn faces(&self) -> usize {
        self.faces
    }
}

/// Area of a polygon (half the length of its vector area), 0 where that is not finite.
fn area(mesh: &Mesh, corners: &[u32]) -> f64 {
    let Some((&first, rest)) = corners.split_first() else { return 0. };
    let origin = mesh.positions.get(first);
    let mut sum = [0f64; 3];
    for pair in rest.windows(2) {
        let (a, b) = (minus(mesh.positions.get(pair[0]), origin), minus(mesh.positions.get(pair[1]), origin));
        sum[0] += a[1] * b[2] - a[2] * b[1];
        sum[1] += a[2] * b[0] - a[0] * b[2];
        sum[2] += a[0] * b[1] - a[1] * b[0];
    }
    let area = norm(sum) / 2.;
    if area.is_finite() { area } else { 0. }
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn norm(a: [f64; 3]) -> f64 {
    (a[0] * a[0] + a[1] * a[1] + a[2] * a[2]).sqrt()
}

/// Mean distance of the surface to its centroid: face centres weighted by area.
fn radius(mesh: &Mesh, areas: Option<&[f64]>) -> f64 {
    let weight = |face: usize| areas.map_or(1., |areas| areas[face]);
    let mean = |of: &dyn Fn([f64; 3]) -> [f64; 3]| {
        let (mut sum, mut total) = ([0f64; 3], 0f64);
        mesh.faces.for_each(0..mesh.faces.len(), |face, corners| {
            let mut centre = [0f64; 3];
            for &corner in corners {
                let position = mesh.positions.get(corner);
                (0..3).for_each(|axis| centre[axis] += position[axis] / corners.len() as f64);
            }
            let value = of(centre);
            if value.iter().all(|x| x.is_finite()) {
                (0..3).for_each(|axis| sum[axis] += weight(face) * value[axis]);
                total += weight(face);
            }
        });
        sum.map(|x| x / total)
    };
    let centroid = mean(&|centre| centre);
    mean(&|centre| [norm(minus(centre, centroid)), 0., 0.])[0]
}

impl Edges {
    fn of(mesh: &Mesh, areas: Option<&[f64]>) -> Result<Self> {
        if mesh.faces.corner_count() > (u32::MAX / 2) as usize {
            return Err(Error::parameter(
                "cut discrepancy",
                format!("a mesh of {} faces has too many edges", mesh.faces.len()),
                "leave this metric out",
            ));
        }
        let positions: Vec<[f64; 3]> = (0..mesh.positions.len() as u32).map(|v| mesh.positions.get(v)).collect();
        let mut edges = Self {
            rows: vec![0; positions.len() + 1],
            positions,
            inner: Vec::new(),
            starts: vec![0],
            faces: Vec::new(),
            neighbours: Vec::new(),
            radius: radius(mesh, areas),
        };
        let (begins, halves) = edges.halves(mesh);
        edges.join(&begins, &halves);
        Ok(edges)
    }

    /// Half-edges by their smaller vertex: where each vertex's begin, and (larger vertex, face)
    /// of each, ascending. Those from a vertex to itself or to none are left out.
    fn halves(&self, mesh: &Mesh) -> (Vec<u32>, Vec<(u32, u32)>) {
        let each = |visit: &mut dyn FnMut(usize, (u32, u32))| {
            mesh.faces.for_each(0..mesh.faces.len(), |face, corners| {
                for (k, &a) in corners.iter().enumerate() {
                    let b = corners[if k + 1 < corners.len() { k + 1 } else { 0 }];
                    if a != b && (a.max(b) as usize) < self.positions.len() {
                        visit(a.min(b) as usize, (a.max(b), face as u32));
                    }
                }
            });
        };
        let mut begins = vec![0u32; self.positions.len() + 1];
        each(&mut |v, _| begins[v + 1] += 1);
        accumulate(&mut begins);
        let mut next = begins.clone();
        let mut halves = vec![(0u32, 0u32); begins.last().map_or(0, |&count| count as usize)];
        each(&mut |v, half| {
            halves[next[v] as usize] = half;
            next[v] += 1;
        });
        for span in begins.windows(2) {
            halves[span[0] as usize..span[1] as usize].sort_unstable();
        }
        (begins, halves)
    }

    /// Fills the graph from half-edges.
    fn join(&mut self, begins: &[u32], halves: &[(u32, u32)]) {
        let spans = || (0u32..).zip(begins.windows(2));
        let around = |span: &[u32]| halves[span[0] as usize..span[1] as usize].chunk_by(|a, b| a.0 == b.0);
        for (a, span) in spans() {
            for group in around(span) {
                let b = group[0].0;
                self.rows[a as usize + 1] += 1;
                self.rows[b as usize + 1] += 1;
                if group.len() > 1 {
                    self.inner.push([a, b]);
                    self.faces.extend(group.iter().map(|(_, face)| face));
                    self.starts.push(self.faces.len() as u32);
                }
            }
        }
        accumulate(&mut self.rows);
        let mut next = self.rows.clone();
        self.neighbours = vec![0; self.rows.last().map_or(0, |&count| count as usize)];
        for (a, span) in spans() {
            for b in around(span).map(|group| group[0].0) {
                for (from, to) in [(a, b), (b, a)] {
                    self.neighbours[next[from as usize] as usize] = to;
                    next[from as usize] += 1;
                }
            }
        }
    }

    /// Length of the straight line between two vertices.
    pub(super) fn length(&self, [a, b]: [u32; 2]) -> f64 {
        norm(minus(self.positions[a as usize], self.positions[b as usize]))
    }
}

/// Counts at 1.. become the offsets at which each begins.
fn accumulate(counts: &mut [u32]) {
    let mut sum = 0;
    for count in counts {
        sum += *count;
        *count = sum;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_square_has_its_area_radius_and_one_inner_edge() {
        let corners = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]];
        let mesh = Mesh::from_slices(&corners, &[[0u32, 1, 2], [0, 2, 3]]).unwrap();
        let surface = Surface::of(&mesh).unwrap();
        assert_eq!(surface.areas.as_deref(), Some(&[0.5, 0.5][..]));
        let edges = surface.edges.unwrap();
        assert_eq!((edges.inner, edges.starts, edges.faces), (vec![[0, 2]], vec![0, 2], vec![0, 1]));
        assert_eq!(edges.rows, [0, 3, 5, 8, 10]);
        assert_eq!(edges.neighbours[..3], [1, 2, 3]);
        assert!((edges.radius - 2f64.sqrt() / 6.).abs() < 1e-15);
    }

    #[test]
    fn polygons_and_worthless_faces_have_areas() {
        let corners = [[0., 0., 0.], [2., 0., 0.], [2., 1., 0.], [0., 1., 0.], [f64::NAN, 0., 0.]];
        let faces = [vec![0u32, 1, 2, 3], vec![0, 1, 1], vec![0, 1, 4], vec![]];
        let mesh = Mesh::from_slices(&corners, &faces).unwrap();
        let surface = Surface::of(&mesh).unwrap();
        assert_eq!(surface.areas.as_deref(), Some(&[2., 0., 0., 0.][..]));
        let flat = Mesh::from_slices(&corners, &faces[1..]).unwrap();
        assert_eq!(Surface::of(&flat).unwrap().areas, None);
    }
}
