//! Sums over the nodes of a component that tell whether it encloses a volume, and which of its faces point inwards.
//!
//! They are formed by chunks of [`CHUNK`] nodes, and chunks are added in order: so the result does not depend on who
//! computes a chunk. Cost: about 3 ns per node.

use super::node_geometry::ComputedGeometry;
use super::nodes::{CHUNK, Node, NodeSums, each_and_sums};
use crate::base::vector::length;
use crate::store::npy::Item;
use bytemuck::{Pod, Zeroable};
use std::ops::Range;

/// Minimum volume of a component that counts as enclosing one, relative to a sphere of equal area.
const MIN_VOLUME: f64 = 0.02;
/// Maximum length of the summed area vectors, relative to the area, of a surface that counts as closed: 0 for closed
/// surfaces, .2 for a cube without a lid, .3 to .5 for scans of rooms and bowls, which are seen from within.
const MAX_OPENING: f64 = 0.25;

/// Whether a surface is closed but for small holes, given the sum of its area vectors, area times normal, and its area.
pub fn is_closed(area_vectors: [f64; 3], area: f64) -> bool {
    length(area_vectors) <= MAX_OPENING * area
}

/// Sums over nodes of one component.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(super) struct OrientationSums {
    /// Area of the faces wound like the first face, and of the others.
    area: [f64; 2],
    /// Σ a n over the faces, oriented like the first face.
    vector: [f64; 3],
    /// Σ a c·n and Σ a c, for the volume relative to the centroid.
    flux: f64,
    moment: [f64; 3],
}

impl Item for OrientationSums {
    const DESCR: &'static str = "<f8";
    const WIDTH: usize = 9;
}

impl OrientationSums {
    #[inline(always)]
    pub fn add(&mut self, node: &Node, opposite_winding: bool) {
        let sign = if opposite_winding { -1. } else { 1. };
        let area = f64::from(node.area);
        // No indexing by `opposite_winding`: it would force the sums into memory and make each addition wait for the
        // previous store.
        self.area[0] += if opposite_winding { 0. } else { area };
        self.area[1] += if opposite_winding { area } else { 0. };
        for axis in 0..3 {
            let (c, n) = (f64::from(node.centroid[axis]), sign * f64::from(node.normal[axis]));
            self.vector[axis] += area * n;
            self.flux += area * c * n;
            self.moment[axis] += area * c;
        }
    }

    /// With those of further nodes.
    #[must_use]
    pub fn and(self, other: &Self) -> Self {
        let mut sum = self;
        (0..2).for_each(|side| sum.area[side] += other.area[side]);
        sum.flux += other.flux;
        for axis in 0..3 {
            sum.vector[axis] += other.vector[axis];
            sum.moment[axis] += other.moment[axis];
        }
        sum
    }

    /// Whether to flip the faces wound like the first one; otherwise the others are flipped.
    pub fn flips_first(&self) -> bool {
        let area = self.area[0] + self.area[1];
        let majority = self.area[1] > self.area[0];
        if area <= 0. {
            return majority;
        }
        let volume = (self.flux - (0..3).map(|axis| self.vector[axis] * self.moment[axis] / area).sum::<f64>()) / 3.;
        // A sphere of this area has the volume A^1.5 / (6 √π).
        let sphere = area * area.sqrt() / (6. * std::f64::consts::PI.sqrt());
        let inward = volume < 0.;
        if volume.abs() > MIN_VOLUME * sphere && is_closed(self.vector, area) { inward } else { majority }
    }
}

/// Sums over all nodes, as if they were one component whose faces are all wound alike.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct WholeSums {
    pub nodes: NodeSums,
    pub orientation: OrientationSums,
}

impl WholeSums {
    /// Fills `held` with the nodes of `range`, which starts with a chunk, and returns the sums of each chunk.
    pub fn of_chunks(mesh: &ComputedGeometry, range: Range<usize>, held: &mut Vec<Node>) -> Vec<Self> {
        held.clear();
        let chunk = |start: usize| {
            let mut orientation = OrientationSums::default();
            let chunk = start..range.end.min(start + CHUNK);
            let nodes = each_and_sums(&mesh.mesh, mesh.frame, chunk, |_, node| {
                orientation.add(node, false);
                held.push(*node);
            });
            Self { nodes, orientation }
        };
        range.clone().step_by(CHUNK).map(chunk).collect()
    }

    /// With those of the chunk that follows.
    #[must_use]
    pub fn and(self, chunk: &Self) -> Self {
        Self { nodes: self.nodes.and(chunk.nodes), orientation: self.orientation.and(&chunk.orientation) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::Frame;
    use crate::mesh::Mesh;
    use crate::store::{MappedSlice, Run};

    /// A unit cube without its top, far from the origin.
    fn cup() -> [Node; 5] {
        [[1., 0., 0.], [-1., 0., 0.], [0., 1., 0.], [0., -1., 0.], [0., 0., -1.]].map(|normal: [f32; 3]| {
            let centroid = std::array::from_fn(|axis| [3., -2., 5.][axis] + 0.5 * normal[axis]);
            Node { centroid, normal, area: 1. }
        })
    }

    fn flipped(node: &Node) -> Node {
        Node { normal: node.normal.map(|x| -x), ..*node }
    }

    /// Whether the first of these faces is flipped, each with whether it is wound against the first.
    fn flips_first(faces: impl IntoIterator<Item = (Node, bool)>) -> bool {
        let mut sums = OrientationSums::default();
        faces.into_iter().for_each(|(node, opposite_winding)| sums.add(&node, opposite_winding));
        sums.flips_first()
    }

    #[test]
    fn what_encloses_a_volume_is_wound_outward_wherever_it_lies() {
        assert!(!flips_first(cup().map(|node| (node, false))));
        assert!(flips_first(cup().map(|node| (flipped(&node), false))));
        // One face against the others, whose majority does not matter.
        for odd in 1..5 {
            let mut k = 0..5;
            let face = |node| if k.next() == Some(odd) { (flipped(&node), true) } else { (node, false) };
            assert!(!flips_first(cup().map(face)));
        }
        let mut k = 0..5;
        let most_against = |node| if k.next() == Some(0) { (node, false) } else { (flipped(&node), true) };
        assert!(!flips_first(cup().map(most_against)));
    }

    /// Regression: a room was turned inside out, so its walls were cut where they are convex, and furniture was joined
    /// to them.
    #[test]
    fn what_is_wide_open_keeps_the_direction_of_its_file() {
        // Floor and three walls, seen from within.
        let room: Vec<(Node, bool)> = cup()[1..].iter().map(|node| (flipped(node), false)).collect();
        assert!(!flips_first(room.clone()));
        // One wall against the others.
        let mut k = 0..4;
        assert!(!flips_first(room.into_iter().map(|(node, _)| if k.next() == Some(2) {
            (flipped(&node), true)
        } else {
            (node, false)
        })));
    }

    #[test]
    fn what_encloses_nothing_is_wound_as_most_of_its_area_is() {
        let face = |area| Node { centroid: [1., 2., 3.], normal: [0., 0., 1.], area };
        assert!(flips_first([(face(1.), false), (flipped(&face(2.)), true)]));
        assert!(!flips_first([(face(2.), false), (flipped(&face(1.)), true)]));
        assert!(!flips_first([(face(1.), false), (flipped(&face(1.)), true)]));
        assert!(!flips_first([(face(0.), false), (face(0.), true)]));
    }

    /// Sums do not depend on which chunks are computed together.
    #[test]
    fn chunks_add_up_to_the_whole() {
        let points: Vec<[f64; 3]> =
            (0..40_000).map(|v| [f64::from(v / 200), f64::from(v % 200), f64::from(v * 37 % 11)]).collect();
        let corners: Vec<[u32; 3]> =
            (0..39_800).filter(|v| v % 200 < 199).flat_map(|v| [[v, v + 1, v + 201], [v, v + 201, v + 200]]).collect();
        let mesh = Mesh::from_slices(&points, &corners).unwrap();
        let frame = Frame::of(&mesh, &Run::new(&())).unwrap();
        let mesh = ComputedGeometry { mesh, frame, flipped: MappedSlice::empty() };
        let sums = |size: usize| {
            let (mut whole, mut held, mut nodes) = (WholeSums::default(), Vec::new(), Vec::new());
            for start in (0..corners.len()).step_by(size) {
                let range = start..corners.len().min(start + size);
                let chunks = WholeSums::of_chunks(&mesh, range, &mut held);
                whole = chunks.iter().fold(whole, WholeSums::and);
                nodes.extend_from_slice(&held);
            }
            assert!((0..corners.len()).all(|face| mesh.node(face) == nodes[face]));
            (bytemuck::bytes_of(&whole.orientation).to_vec(), whole.nodes)
        };
        assert_eq!(sums(CHUNK), sums(3 * CHUNK));
        assert_eq!(sums(CHUNK), sums(corners.len()));
    }
}
