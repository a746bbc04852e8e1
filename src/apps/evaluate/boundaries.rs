//! Cut discrepancy: the distance along the surface between the boundaries of two labellings; and the mesh data for all
//! metrics.
//!
//! Chen et al. 2009, section 4.1: the mean geodesic distance from the points of one labelling's cuts to the nearest of
//! the other's, plus the same in the other direction, divided by the mean distance of the surface from its centroid. As
//! in the benchmark's program, geodesics follow mesh edges and the points are the vertices on cuts; here each is
//! weighted by the length of its cut edges. (That program averages both directions into one mean, which is about half
//! of this.) Two labellings without cuts have discrepancy 0, one with and one without have none (`None`). On a
//! component of the mesh where only one labelling has cuts, the distance is the straight line. Open edges at exactly
//! the same position are welded, as for segmentation: faces of an STL file share no vertices. A vertex without a
//! position is on no cut.
//!
//! Cost: for areas one pass over the faces, 8 bytes per face; for edges a counting sort of the half-edges, about 0.2 µs
//! and at most 90 bytes per face in memory; if open edges are welded, a sort of these, 16 bytes each, 4 bytes per
//! vertex, and the half-edges once more; then one multi-source Dijkstra per labelling, O(v log v), 8 bytes per vertex,
//! and O(cut) per pair.

use crate::base::dijkstra::shortest_paths;
use crate::base::union_find::Forest;
use crate::base::vector::{self, distance, finite, position_key};
use crate::base::{Cancel, Error, Result};
use crate::mesh::Mesh;
use rstar::RTree;
use std::sync::Arc;
use xxhash_rust::xxh3::xxh3_64;

/// Faces between two checks of the stop flag.
const STOP_CHECK: usize = 1 << 18;

/// The mesh data needed for comparisons.
#[derive(Clone, Debug)]
pub struct Evaluator {
    pub(super) faces: usize,
    /// Area per face; `None`: 1 each.
    pub(super) areas: Option<Vec<f64>>,
    pub(super) edges: Option<Edges>,
    /// Cancels long computations.
    pub(super) cancel: Cancel,
    /// What labels prepared by this evaluator refer to.
    pub(super) identity: Arc<()>,
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

/// The greatest power of two up to `x`, which is not negative: dividing by it changes no digit.
fn power_of_two_below(x: f64) -> f64 {
    f64::from_bits(x.to_bits() >> 52 << 52).max(f64::MIN_POSITIVE)
}

impl Evaluator {
    /// Only faces of equal weight, for labels without a mesh.
    pub fn of_faces(faces: usize) -> Self {
        Self { faces, areas: None, edges: None, cancel: Cancel::default(), identity: Arc::default() }
    }

    /// Faces weighted by area, without cut discrepancy. A face without a finite area counts as 0; if no face has an
    /// area, all count the same. The unit is such that the largest area is between 1 and 2: products of areas are
    /// finite.
    pub fn without_edges(mesh: &Mesh) -> Self {
        let mut areas = Vec::with_capacity(mesh.faces.len());
        mesh.faces.for_each(0..mesh.faces.len(), |_, corners| areas.push(area(mesh, corners)));
        let largest = areas.iter().copied().fold(0., f64::max);
        let unit = power_of_two_below(largest);
        areas.iter_mut().for_each(|area| *area /= unit);
        Self { areas: (largest > 0.).then_some(areas), ..Self::of_faces(mesh.faces.len()) }
    }

    /// The data for all metrics.
    ///
    /// ```
    /// use nystrom_stream::apps::evaluate::Evaluator;
    /// use nystrom_stream::mesh::Mesh;
    /// let corners = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]];
    /// let mesh = Mesh::from_slices(&corners, &[[0, 1, 2], [0, 2, 3]])?;
    /// let evaluator = Evaluator::of(&mesh)?;
    /// let people = evaluator.segmentations(&[[0, 1], [0, 0]])?;
    /// let scores = evaluator.compare_many(&evaluator.segmentation("mine", &[5, 6])?, &people)?;
    /// assert_eq!(scores.rand, 0.5);
    /// # Ok::<(), nystrom_stream::base::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Parameter`] for a mesh whose faces have more than 2³¹ corners.
    pub fn of(mesh: &Mesh) -> Result<Self> {
        Self::stopped_by(mesh, Cancel::default())
    }

    /// The same; `cancel` stops this and later computations.
    ///
    /// # Errors
    /// As [`Evaluator::of`]; [`Error::Cancelled`].
    pub fn stopped_by(mesh: &Mesh, cancel: Cancel) -> Result<Self> {
        let mut surface = Self { cancel, ..Self::without_edges(mesh) };
        surface.edges = Some(Edges::of(mesh, surface.areas.as_deref(), &surface.cancel)?);
        Ok(surface)
    }

    /// Number of faces.
    pub fn faces(&self) -> usize {
        self.faces
    }
}

/// Area of a polygon, the sum of its triangles, as in tables of parts; 0 if that is not finite.
fn area(mesh: &Mesh, corners: &[u32]) -> f64 {
    let mut sum = 0.;
    mesh.triangles(corners, |_, at| sum += vector::area(at));
    if sum.is_finite() { sum } else { 0. }
}

/// Mean distance of the surface from its centroid: face centres weighted by area.
///
/// # Errors
/// [`Error::Cancelled`].
fn radius(mesh: &Mesh, areas: Option<&[f64]>, cancel: &Cancel) -> Result<f64> {
    let weight = |face: usize| areas.map_or(1., |areas| areas[face]);
    let mean = |of: &dyn Fn([f64; 3]) -> [f64; 3]| {
        let (mut sum, mut total) = ([0f64; 3], 0f64);
        let mut add = |face: usize, corners: &[u32]| {
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
        };
        let n = mesh.faces.len();
        for start in (0..n).step_by(STOP_CHECK) {
            cancel.check()?;
            mesh.faces.for_each(start..n.min(start + STOP_CHECK), &mut add);
        }
        Ok(sum.map(|x| x / total))
    };
    let centroid = mean(&|centre| centre)?;
    Ok(mean(&|centre| [distance(centre, centroid), 0., 0.])?[0])
}

impl Edges {
    fn of(mesh: &Mesh, areas: Option<&[f64]>, cancel: &Cancel) -> Result<Self> {
        if mesh.faces.corner_count() > (u32::MAX / 2) as usize {
            return Err(Error::parameter(
                "cut discrepancy",
                format!("a mesh of {} faces has too many edges", mesh.faces.len()),
                "leave this metric out",
            ));
        }
        cancel.check()?;
        let positions: Vec<[f64; 3]> = (0..mesh.positions.len() as u32).map(|v| mesh.positions.get(v)).collect();
        let mut edges = Self {
            rows: vec![0; positions.len() + 1],
            positions,
            inner: Vec::new(),
            starts: vec![0],
            faces: Vec::new(),
            neighbours: Vec::new(),
            radius: radius(mesh, areas, cancel)?,
        };
        cancel.check()?;
        let (mut begins, mut halves) = edges.halves(mesh, |v| v);
        cancel.check()?;
        if let Some(first) = edges.welded(&begins, &halves) {
            cancel.check()?;
            drop((begins, halves));
            (begins, halves) = edges.halves(mesh, |v| first[v as usize]);
            cancel.check()?;
        }
        edges.join(&begins, &halves);
        cancel.check()?;
        Ok(edges)
    }

    /// Half-edges sorted by their smaller vertex: the start of each vertex's half-edges, and (larger vertex, face) of
    /// each, ascending. Half-edges from a vertex to itself or with a missing vertex are skipped. `first` maps a vertex
    /// to its representative.
    fn halves(&self, mesh: &Mesh, first: impl Fn(u32) -> u32) -> (Vec<u32>, Vec<(u32, u32)>) {
        let each = |visit: &mut dyn FnMut(usize, (u32, u32))| {
            mesh.faces.for_each(0..mesh.faces.len(), |face, corners| {
                for (k, &a) in corners.iter().enumerate() {
                    let b = corners[if k + 1 < corners.len() { k + 1 } else { 0 }];
                    if (a.max(b) as usize) >= self.positions.len() {
                        continue;
                    }
                    let (a, b) = (first(a), first(b));
                    if a != b {
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

    /// For each vertex the first of those welded to it because open edges between them lie at exactly the same
    /// position; `None` if there are no such edges.
    fn welded(&self, begins: &[u32], halves: &[(u32, u32)]) -> Option<Vec<u32>> {
        let place = |v: u32| position_key(self.positions[v as usize]);
        let mut open = Vec::new();
        for (a, span) in (0u32..).zip(begins.windows(2)) {
            for edge in halves[span[0] as usize..span[1] as usize].chunk_by(|a, b| a.0 == b.0) {
                let mut ends = [a, edge[0].0];
                if edge.len() == 1 && ends.iter().all(|&v| finite(self.positions[v as usize])) {
                    ends.sort_by_key(|&v| place(v));
                    open.push((xxh3_64(bytemuck::bytes_of(&ends.map(place))), ends));
                }
            }
        }
        // Positions are compared only if hashes are equal.
        open.sort_unstable_by(|(hash, one), (other, two)| {
            hash.cmp(other).then_with(|| (one.map(place), one).cmp(&(two.map(place), two)))
        });
        let mut welded = None;
        for edges in open.chunk_by(|(hash, one), (other, two)| hash == other && one.map(place) == two.map(place)) {
            for (_, ends) in &edges[1..] {
                let welded = welded.get_or_insert_with(|| Forest::new(self.positions.len()));
                edges[0].1.iter().zip(ends).for_each(|(&first, &other)| {
                    welded.join(first, other);
                });
            }
        }
        welded.map(Forest::labels)
    }

    /// Builds the graph from half-edges.
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
        distance(self.positions[a as usize], self.positions[b as usize])
    }
}

/// Converts counts at 1.. to the start of each group.
fn accumulate(counts: &mut [u32]) {
    let mut sum = 0;
    for count in counts {
        sum += *count;
        *count = sum;
    }
}

/// The cuts of one labelling.
#[derive(Clone, Debug)]
pub(super) struct BoundaryField {
    /// The vertices on cuts, each with the length of cut that it represents.
    points: Vec<(u32, f64)>,
    /// Distance of each vertex from the nearest point, infinite if no path leads to one; empty if there are no cuts.
    field: Vec<f64>,
}

impl BoundaryField {
    /// The edges whose faces have different labels, and the distances to them.
    ///
    /// # Errors
    /// [`Error::Cancelled`].
    pub(super) fn of(edges: &Edges, labels: &[u32], cancel: &Cancel) -> Result<Self> {
        let mut weights = std::collections::BTreeMap::<u32, f64>::new();
        for (ends, span) in edges.inner.iter().zip(edges.starts.windows(2)) {
            let faces = &edges.faces[span[0] as usize..span[1] as usize];
            if faces.windows(2).any(|pair| labels[pair[0] as usize] != labels[pair[1] as usize]) {
                let half = Some(edges.length(*ends) / 2.).filter(|half| half.is_finite()).unwrap_or(0.);
                ends.iter().for_each(|&v| *weights.entry(v).or_default() += half);
            }
        }
        // No path leads to a vertex without a position.
        weights.retain(|&v, _| finite(edges.positions[v as usize]));
        let points: Vec<(u32, f64)> = weights.into_iter().collect();
        let field = if points.is_empty() { Vec::new() } else { distances(edges, &points, cancel)? };
        Ok(Self { points, field })
    }

    /// Mean distance of the points of `self` from those of `other`, in units of the mesh.
    fn directed(&self, other: &Self, edges: &Edges) -> f64 {
        let mut tree = None;
        let (mut sum, mut plain, mut total) = (0., 0., 0.);
        for &(v, weight) in &self.points {
            let mut distance = other.field[v as usize];
            if distance.is_infinite() {
                let tree = tree.get_or_insert_with(|| other.tree(edges));
                let here = edges.positions[v as usize];
                let nearest = tree.nearest_neighbor(here);
                distance =
                    nearest.map_or(0., |there| here.iter().zip(there).map(|(a, b)| (a - b).powi(2)).sum::<f64>());
                distance = distance.sqrt();
            }
            sum += weight * distance;
            plain += distance;
            total += weight;
        }
        if total > 0. { sum / total } else { plain / self.points.len().max(1) as f64 }
    }

    /// A tree of the points, for straight-line distances.
    fn tree(&self, edges: &Edges) -> RTree<[f64; 3]> {
        let all = self.points.iter().map(|&(v, _)| edges.positions[v as usize]);
        RTree::bulk_load(all.filter(|point| point.iter().all(|x| x.is_finite())).collect())
    }
}

/// Cut discrepancy of two labellings; `None` if only one of them has cuts, or if the mesh has no extent.
pub(super) fn discrepancy(edges: &Edges, one: &BoundaryField, other: &BoundaryField) -> Option<f64> {
    match (one.points.is_empty(), other.points.is_empty()) {
        (true, true) => Some(0.),
        (false, false) => {
            let sum = one.directed(other, edges) + other.directed(one, edges);
            Some(sum / edges.radius).filter(|discrepancy| discrepancy.is_finite())
        }
        _ => None,
    }
}

/// Distance of every vertex from the nearest of `sources` along mesh edges.
fn distances(edges: &Edges, sources: &[(u32, f64)], cancel: &Cancel) -> Result<Vec<f64>> {
    let mut field = vec![f64::INFINITY; edges.positions.len()];
    let sources: Vec<u32> = sources.iter().map(|&(v, _)| v).collect();
    let steps = |v: u32| {
        let end = if cancel.is_cancelled() { edges.rows[v as usize] } else { edges.rows[v as usize + 1] };
        let row = edges.rows[v as usize] as usize..end as usize;
        edges.neighbours[row].iter().map(move |&to| (to, edges.length([v, to])))
    };
    shortest_paths(&sources, steps, f64::INFINITY, &mut field, |_| ());
    cancel.check()?;
    Ok(field)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;

    #[test]
    fn a_unit_square_has_its_area_radius_and_one_inner_edge() {
        let corners = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]];
        let mesh = Mesh::from_slices(&corners, &[[0u32, 1, 2], [0, 2, 3]]).unwrap();
        let surface = Evaluator::of(&mesh).unwrap();
        assert_eq!(surface.areas.as_deref(), Some(&[1., 1.][..]));
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
        let surface = Evaluator::of(&mesh).unwrap();
        assert_eq!(surface.areas.as_deref(), Some(&[1., 0., 0., 0.][..]));
        let flat = Mesh::from_slices(&corners, &faces[1..]).unwrap();
        assert_eq!(Evaluator::of(&flat).unwrap().areas, None);
    }

    /// A strip of unit squares along x, each two triangles, with a component for each of `starts`.
    fn strip(starts: &[f64], squares: usize) -> Mesh {
        let (mut vertices, mut faces) = (Vec::new(), Vec::new());
        for &x in starts {
            let first = vertices.len() as u32;
            vertices.extend((0..=squares).flat_map(|k| [[x + k as f64, 0., 0.], [x + k as f64, 1., 0.]]));
            faces.extend(
                (0..squares as u32).map(|k| first + 2 * k).flat_map(|v| [[v, v + 2, v + 3], [v, v + 3, v + 1]]),
            );
        }
        Mesh::from_slices(&vertices, &faces).unwrap()
    }

    fn field(edges: &Edges, labels: &[u32]) -> BoundaryField {
        BoundaryField::of(edges, labels, &Cancel::default()).unwrap()
    }

    fn halves(faces: u32, at: u32) -> Vec<u32> {
        (0..faces).map(|f| u32::from(f >= 2 * at)).collect()
    }

    #[test]
    fn cuts_across_a_strip_lie_as_far_apart_as_they_do() {
        let edges = Evaluator::of(&strip(&[0.], 10)).unwrap().edges.unwrap();
        let cut = |at| field(&edges, &halves(20, at));
        assert_eq!(cut(3).points, [(6, 0.5), (7, 0.5)]);
        assert_eq!(discrepancy(&edges, &cut(3), &cut(3)), Some(0.));
        assert_eq!(discrepancy(&edges, &cut(3), &cut(7)), Some(8. / edges.radius));
        assert_eq!(discrepancy(&edges, &cut(7), &cut(3)), Some(8. / edges.radius));
        // Two cuts at 2 and 8 against one at 3: (1 + 5) / 2 in one direction, 1 in the other.
        let two = field(&edges, &(0..20).map(|f| f / 2).map(|s| u32::from((2..8).contains(&s))).collect::<Vec<_>>());
        assert!((discrepancy(&edges, &two, &cut(3)).unwrap() * edges.radius - 4.).abs() < 1e-12);
    }

    #[test]
    fn without_cuts_there_is_nothing_to_measure() {
        let edges = Evaluator::of(&strip(&[0.], 4)).unwrap().edges.unwrap();
        let (none, some) = (field(&edges, &[5; 8]), field(&edges, &halves(8, 2)));
        assert_eq!(discrepancy(&edges, &none, &none), Some(0.));
        assert_eq!(discrepancy(&edges, &none, &some), None);
        assert_eq!(discrepancy(&edges, &some, &none), None);
    }

    #[test]
    fn between_components_the_line_is_straight() {
        let edges = Evaluator::of(&strip(&[0., 10.], 4)).unwrap().edges.unwrap();
        let cut = |at| field(&edges, &halves(16, at));
        // Cuts at x = 1 of the first strip and x = 12 of the second.
        assert_eq!(
            discrepancy(&edges, &cut(1), &{
                let labels: Vec<u32> = (0..16).map(|f| u32::from(f >= 12)).collect();
                field(&edges, &labels)
            }),
            Some(22. / edges.radius)
        );
        // A change of label between components is not a cut.
        assert!(cut(4).points.is_empty());
    }

    #[test]
    fn faces_that_share_no_vertices_are_cut_as_those_that_do() {
        // Regression: cuts were sought only between faces that share vertices, so that all labels of an STL file had
        // discrepancy 0.
        let shared = strip(&[0.], 10);
        let (mut corners, mut faces) = (Vec::new(), Vec::new());
        shared.faces.for_each(0..shared.faces.len(), |_, of_face| {
            faces.push([0, 1, 2].map(|k| corners.len() as u32 + k));
            corners.extend(of_face.iter().map(|&v| shared.positions.get(v)));
        });
        let own = Mesh::from_slices(&corners, &faces).unwrap();
        let scores = |mesh: &Mesh| {
            let edges = Evaluator::of(mesh).unwrap().edges.unwrap();
            discrepancy(&edges, &field(&edges, &halves(20, 3)), &field(&edges, &halves(20, 7))).unwrap() * edges.radius
        };
        assert_eq!((scores(&shared), scores(&own)), (8., 8.));
        // Two adjoining strips are welded, as for segmentation.
        let seam = Evaluator::of(&strip(&[0., 4.], 4)).unwrap().edges.unwrap();
        assert_eq!(field(&seam, &halves(16, 4)).points, [(8, 0.5), (9, 0.5)]);
    }

    #[test]
    fn a_cut_through_a_vertex_without_a_position_is_measured_by_its_others() {
        // Regression: the discrepancy was that of a labelling without cuts.
        for lost in [f64::NAN, f64::INFINITY] {
            let mesh = strip(&[0.], 10);
            let mut corners: Vec<[f64; 3]> = (0..22).map(|v| mesh.positions.get(v)).collect();
            corners[7][1] = lost;
            let mut faces = Vec::new();
            mesh.faces.for_each(0..20, |_, corners| faces.push([corners[0], corners[1], corners[2]]));
            let edges = Evaluator::of(&Mesh::from_slices(&corners, &faces).unwrap()).unwrap().edges.unwrap();
            let (one, other) = (field(&edges, &halves(20, 3)), field(&edges, &halves(20, 7)));
            assert_eq!(one.points.len(), 1);
            assert!(discrepancy(&edges, &one, &other).is_some_and(|found| found > 0.), "{lost}");
        }
    }
}
