//! Cut discrepancy: how far the boundaries of two labellings lie apart along the surface.
//!
//! Chen et al. 2009, section 4.1: the mean geodesic distance from the points of one labelling's
//! cuts to the nearest of the other's, plus the same the other way round, over the mean distance
//! of the surface to its centroid. As in the benchmark's program, geodesics follow mesh edges and
//! the points are the vertices on cuts; here each weighs the length of its cut edges. (That program
//! averages both directions into one mean, which is about half of this.) Cost: a multi-source
//! Dijkstra a labelling, O(v log v), 8 bytes a vertex; then O(cut) a pair.
//!
//! Two labellings without cuts have discrepancy 0, one with and one without have none (`None`).
//! Where a component of the mesh has cuts of the one only, the distance is the straight line.

use super::surface::Edges;
use rstar::RTree;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// The cuts of one labelling.
#[derive(Clone, Debug)]
pub(super) struct Cut {
    /// The vertices on cuts with the length of cut that each stands for.
    points: Vec<(u32, f64)>,
    /// Distance of each vertex to the nearest point, infinite where no path leads to one; empty
    /// where there are no cuts.
    field: Vec<f64>,
}

impl Cut {
    /// The edges whose faces have different labels, and the distances to them.
    pub(super) fn of(edges: &Edges, labels: &[u32]) -> Self {
        let mut weights = std::collections::BTreeMap::<u32, f64>::new();
        for (ends, span) in edges.inner.iter().zip(edges.starts.windows(2)) {
            let faces = &edges.faces[span[0] as usize..span[1] as usize];
            if faces.windows(2).any(|pair| labels[pair[0] as usize] != labels[pair[1] as usize]) {
                let half = Some(edges.length(*ends) / 2.).filter(|half| half.is_finite()).unwrap_or(0.);
                ends.iter().for_each(|&v| *weights.entry(v).or_default() += half);
            }
        }
        let points: Vec<(u32, f64)> = weights.into_iter().collect();
        let field = if points.is_empty() { Vec::new() } else { distances(edges, &points) };
        Self { points, field }
    }

    /// Mean distance of the points of `self` to those of `other`, in units of the mesh.
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

    /// The points for straight lines to them.
    fn tree(&self, edges: &Edges) -> RTree<[f64; 3]> {
        let all = self.points.iter().map(|&(v, _)| edges.positions[v as usize]);
        RTree::bulk_load(all.filter(|point| point.iter().all(|x| x.is_finite())).collect())
    }
}

/// Cut discrepancy of two labellings; `None` where only one of them has cuts, or where the mesh
/// has no extent.
pub(super) fn discrepancy(edges: &Edges, one: &Cut, other: &Cut) -> Option<f64> {
    match (one.points.is_empty(), other.points.is_empty()) {
        (true, true) => Some(0.),
        (false, false) => {
            let sum = one.directed(other, edges) + other.directed(one, edges);
            Some(sum / edges.radius).filter(|discrepancy| discrepancy.is_finite())
        }
        _ => None,
    }
}

/// Distance of every vertex to the nearest of `sources` along mesh edges.
fn distances(edges: &Edges, sources: &[(u32, f64)]) -> Vec<f64> {
    let mut field = vec![f64::INFINITY; edges.positions.len()];
    // The bits of floats that are not negative order as they do.
    let mut heap: BinaryHeap<Reverse<(u64, u32)>> = BinaryHeap::new();
    for &(v, _) in sources {
        field[v as usize] = 0.;
        heap.push(Reverse((0, v)));
    }
    while let Some(Reverse((bits, v))) = heap.pop() {
        let distance = f64::from_bits(bits);
        if distance > field[v as usize] {
            continue;
        }
        let row = edges.rows[v as usize] as usize..edges.rows[v as usize + 1] as usize;
        for &to in &edges.neighbours[row] {
            let through = distance + edges.length([v, to]);
            if through < field[to as usize] {
                field[to as usize] = through;
                heap.push(Reverse((through.to_bits(), to)));
            }
        }
    }
    field
}

#[cfg(test)]
mod tests {
    use super::super::surface::Surface;
    use super::*;
    use crate::mesh::Mesh;

    /// A strip of unit squares along x, each two triangles, in as many components as `starts`.
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

    fn halves(faces: u32, at: u32) -> Vec<u32> {
        (0..faces).map(|f| u32::from(f >= 2 * at)).collect()
    }

    #[test]
    fn cuts_across_a_strip_lie_as_far_apart_as_they_do() {
        let edges = Surface::of(&strip(&[0.], 10)).unwrap().edges.unwrap();
        let cut = |at| Cut::of(&edges, &halves(20, at));
        assert_eq!(cut(3).points, [(6, 0.5), (7, 0.5)]);
        assert_eq!(discrepancy(&edges, &cut(3), &cut(3)), Some(0.));
        assert_eq!(discrepancy(&edges, &cut(3), &cut(7)), Some(8. / edges.radius));
        assert_eq!(discrepancy(&edges, &cut(7), &cut(3)), Some(8. / edges.radius));
        // Two cuts at 2 and 8 against one at 3: (1 + 5) / 2 one way, 1 the other.
        let two = Cut::of(&edges, &(0..20).map(|f| f / 2).map(|s| u32::from((2..8).contains(&s))).collect::<Vec<_>>());
        assert!((discrepancy(&edges, &two, &cut(3)).unwrap() * edges.radius - 4.).abs() < 1e-12);
    }

    #[test]
    fn without_cuts_there_is_nothing_to_measure() {
        let edges = Surface::of(&strip(&[0.], 4)).unwrap().edges.unwrap();
        let (none, some) = (Cut::of(&edges, &[5; 8]), Cut::of(&edges, &halves(8, 2)));
        assert_eq!(discrepancy(&edges, &none, &none), Some(0.));
        assert_eq!(discrepancy(&edges, &none, &some), None);
        assert_eq!(discrepancy(&edges, &some, &none), None);
    }

    #[test]
    fn between_components_the_line_is_straight() {
        let edges = Surface::of(&strip(&[0., 10.], 4)).unwrap().edges.unwrap();
        let cut = |at| Cut::of(&edges, &halves(16, at));
        // Cuts at x = 1 of the first strip and x = 12 of the second.
        assert_eq!(
            discrepancy(&edges, &cut(1), &{
                let labels: Vec<u32> = (0..16).map(|f| u32::from(f >= 12)).collect();
                Cut::of(&edges, &labels)
            }),
            Some(22. / edges.radius)
        );
        // A change of label between components is no cut.
        assert!(cut(4).points.is_empty());
    }
}
