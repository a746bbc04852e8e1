//! Makes the winding consistent before any sign of turning is used.
//!
//! Published meshes are not always wound consistently. In each component the faces whose winding contradicts its first
//! face are known from the union-find's parities ([`super::components`]); the group with the smaller area is flipped.
//! Then a component that encloses a volume is flipped as a whole if the volume is negative (normals point inwards); one
//! that does not (a range scan, a relief, a room seen from within) keeps the direction of its file. Flipping changes
//! only the normals in the node geometry; faces are written unchanged. Edges whose faces still contradict keep their
//! negative length: no orientation exists there.
//!
//! Time: one sequential pass over nodes, in which computed ones are summed up too; the rest only if something has to be
//! flipped. Memory: a chunk of nodes; 73 bytes per component in the work directory, in memory where the budget has
//! room.

use super::components::Components;
use super::dual_edges::{DualEdges, EDGES};
use super::half_edge_pairs::OPPOSITE_WINDING;
use super::node_geometry::{ComputedEdges, ComputedGeometry, NodeGeometry};
use super::nodes::{self, Node, NodeSums};
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::vector::length;
use crate::base::{Error, Result};
use crate::store::npy::{ArrayMut, Item};
use crate::store::{Context, MappedSlice};
use bytemuck::{Pod, Zeroable};
use std::sync::Arc;

/// Minimum volume of a component that counts as enclosing one, relative to a sphere of equal area.
const ENCLOSES: f64 = 0.02;
/// Maximum length of the summed area vectors, relative to the area, for such a component: 0 for closed surfaces, .2 for
/// a cube without a lid, .3 to .5 for scans of rooms and bowls, which are seen from within.
const OPEN: f64 = 0.25;

/// Counts from orienting.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OrientationFacts {
    /// Faces whose normals were flipped.
    pub flipped: u64,
    /// Directed entries whose faces still have contradicting winding.
    pub unsatisfied: u64,
}

/// Sums over a component.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
struct Sums {
    /// Area of the faces wound like the first face, and of the others.
    area: [f64; 2],
    /// Σ a n over the faces, oriented like the first face.
    vector: [f64; 3],
    /// Σ a c·n and Σ a c, for the volume relative to the centroid.
    flux: f64,
    moment: [f64; 3],
}

impl Item for Sums {
    const DESCR: &'static str = "<f8";
    const WIDTH: usize = 9;
}

impl Sums {
    #[inline(always)]
    fn add(&mut self, node: &Node, opposite_winding: bool) {
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

    /// Whether to flip the faces wound like the first one; otherwise the others are flipped.
    fn flips_first(&self) -> bool {
        let area = self.area[0] + self.area[1];
        let majority = self.area[1] > self.area[0];
        if area <= 0. {
            return majority;
        }
        let volume = (self.flux - (0..3).map(|axis| self.vector[axis] * self.moment[axis] / area).sum::<f64>()) / 3.;
        // A sphere of this area has the volume A^1.5 / (6 √π).
        let sphere = area * area.sqrt() / (6. * std::f64::consts::PI.sqrt());
        let inward = volume < 0.;
        let is_open = length(self.vector) > OPEN * area;
        if volume.abs() > ENCLOSES * sphere && !is_open { inward } else { majority }
    }
}

/// What [`orient`] returns: the edges and nodes to use from now on, and what was learned from the pass over them.
pub(super) struct Oriented {
    pub edges: DualEdges,
    pub nodes: NodeGeometry,
    pub facts: OrientationFacts,
    pub sums: NodeSums,
}

/// Flips normals to make winding consistent and outward. `sums` are those of the nodes, if they are known; otherwise
/// they are computed in the same pass.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub(super) fn orient(
    edges: DualEdges,
    nodes: NodeGeometry,
    sums: Option<NodeSums>,
    components: &Components,
    context: Context<'_>,
) -> Result<Oriented> {
    let (of_components, of_computed) = component_sums(&nodes, components, context)?;
    let (edges, nodes, facts) = flip(edges, nodes, of_components, components, context)?;
    Ok(Oriented { edges, nodes, facts, sums: sums.unwrap_or(of_computed) })
}

/// Flips what the `sums` of the components tell.
fn flip(
    edges: DualEdges,
    nodes: NodeGeometry,
    sums: ArrayMut<Sums>,
    components: &Components,
    context: Context<'_>,
) -> Result<(DualEdges, NodeGeometry, OrientationFacts)> {
    let mut flips_first: ArrayMut<u8> = context.work.array("component_turn.tmp", &[components.count()])?;
    flips_first.data().iter_mut().zip(sums.items()).for_each(|(slot, sums)| *slot = u8::from(sums.flips_first()));
    drop(sums);
    let flips_first = flips_first.items();
    if !components.mixed && !flips_first.contains(&1) {
        return Ok((edges, nodes, OrientationFacts::default()));
    }
    // Faces that contradict the first one are flipped exactly if the first one is not.
    let is_flipped = |node: usize| {
        let link = components.root[node];
        (flips_first[components.number(link, 0)] != 0) != (link & OPPOSITE_WINDING != 0)
    };
    if let Some(mesh) = nodes.mesh() {
        return flip_computed(edges, mesh, is_flipped, context);
    }
    let (flipped_nodes, flipped) = flip_nodes(&nodes, is_flipped, context)?;
    if !components.mixed {
        return Ok((edges, flipped_nodes, OrientationFacts { flipped, unsatisfied: 0 }));
    }
    let (edge, unsatisfied) = flip_edges(&edges, is_flipped, context)?;
    let edges = DualEdges { edge, mixed: unsatisfied > 0, ..edges };
    Ok((edges, flipped_nodes, OrientationFacts { flipped, unsatisfied }))
}

/// The sums of each component; and of all nodes, if they are computed.
fn component_sums(
    nodes: &NodeGeometry,
    components: &Components,
    context: Context<'_>,
) -> Result<(ArrayMut<Sums>, NodeSums)> {
    let (root, run) = (&components.root[..], context.run);
    let mut sums: ArrayMut<Sums> = context.work.array("component_sums.tmp", &[components.count(), Sums::WIDTH])?;
    let of_components = sums.data();
    let (mut number, mut all) = (0, NodeSums::default());
    let mut add = |links: &[u32], some: &[Node]| {
        let mut done = 0;
        for links in links.chunk_by(|a, b| a & !OPPOSITE_WINDING == b & !OPPOSITE_WINDING) {
            number = components.number(links[0], number);
            // A local copy, which stays in registers.
            let mut sums = of_components[number];
            for (link, node) in links.iter().zip(&some[done..]) {
                sums.add(node, link & OPPOSITE_WINDING != 0);
            }
            of_components[number] = sums;
            done += links.len();
        }
    };
    let chunk = |k: usize| chunk_range(nodes.len(), nodes::CHUNK, k);
    let chunks = chunk_count(nodes.len(), nodes::CHUNK);
    if let Some(mesh) = nodes.mesh() {
        let compute = |k: usize, (): &mut ()| {
            let mut held = Vec::with_capacity(chunk(k).len());
            let sums = nodes::each_and_sums(&mesh.mesh, mesh.frame, chunk(k), |_, node| held.push(*node));
            Ok((held, sums))
        };
        let each = |k: usize, (held, sums): (Vec<Node>, NodeSums)| {
            add(&root[chunk(k)], &held);
            all = all.and(sums);
            Ok(())
        };
        run.in_order(chunks, || (), compute, each)?;
    } else {
        for k in 0..chunks {
            run.cancel.check()?;
            add(&root[chunk(k)], &nodes.array()[chunk(k)]);
        }
    }
    Ok((sums, all))
}

/// The nodes, with normals flipped where `is_flipped` holds; also how many were flipped.
fn flip_nodes(
    nodes: &NodeGeometry,
    is_flipped: impl Fn(usize) -> bool + Sync,
    context: Context<'_>,
) -> Result<(NodeGeometry, u64)> {
    let mut array = context.work.array::<Node>(nodes::FILE, &[nodes.len(), 7])?;
    let fill = |k: usize, out: &mut [Node], (): &mut ()| {
        let mut count = 0u64;
        for (slot, i) in out.iter_mut().zip(chunk_range(nodes.len(), nodes::CHUNK, k)) {
            *slot = nodes.at(i);
            if is_flipped(i) {
                slot.normal = slot.normal.map(|x| 0. - x);
                count += 1;
            }
        }
        Ok(count)
    };
    let counts = context.run.fill_chunks(array.data(), nodes::CHUNK, || (), fill)?;
    Ok((array.finish(false)?.into(), counts.into_iter().sum()))
}

/// The lengths of shared edges, negative if the faces still contradict; also how many do. Edge by edge: flipping one of
/// two faces changes whether they contradict.
fn flip_edges(
    edges: &DualEdges,
    is_flipped: impl Fn(usize) -> bool + Sync,
    context: Context<'_>,
) -> Result<(MappedSlice<f32>, u64)> {
    let mut lengths = context.work.array::<f32>(EDGES, &[edges.edge.len()])?;
    let fill = |k: usize, out: &mut [f32], (): &mut ()| {
        let mut count = 0u64;
        let first = k * nodes::CHUNK;
        let (mut row, mut span) = edges.starts.view().row_of(first);
        for (i, slot) in out.iter_mut().enumerate() {
            let e = first + i;
            while span.end <= e {
                row += 1;
                span = edges.starts.view().span(row as u32);
            }
            let edge = edges.edge[e];
            let flip = is_flipped(row) != is_flipped(edges.indices[e] as usize);
            *slot = if flip { -edge } else { edge };
            count += u64::from(*slot < 0.);
        }
        Ok(count)
    };
    let counts = context.run.fill_chunks(lengths.data(), nodes::CHUNK, || (), fill)?;
    Ok((lengths.finish(false)?, counts.into_iter().sum()))
}

/// File of the bits of flipped faces.
const FLIPPED: &str = "flipped_faces.npy";

/// The same if nodes and edges are computed from `mesh`: one bit per face.
fn flip_computed(
    edges: DualEdges,
    mesh: &ComputedGeometry,
    is_flipped: impl Fn(usize) -> bool + Sync,
    context: Context<'_>,
) -> Result<(DualEdges, NodeGeometry, OrientationFacts)> {
    let n = mesh.mesh.faces.len();
    let mut bits = context.work.array::<u64>(FLIPPED, &[n.div_ceil(64)])?;
    let counts = context.run.fill_chunks(
        bits.data(),
        nodes::CHUNK / 64,
        || (),
        |k, out, ()| {
            let first = k * nodes::CHUNK;
            for (at, word) in out.iter_mut().enumerate() {
                let faces = first + 64 * at..(first + 64 * at + 64).min(n);
                *word = faces
                    .clone()
                    .filter(|&face| is_flipped(face))
                    .fold(0, |word, face| word | 1 << (face - faces.start));
            }
            Ok(out.iter().map(|word| u64::from(word.count_ones())).sum::<u64>())
        },
    )?;
    let nodes = NodeGeometry::computed(ComputedGeometry { flipped: bits.finish(false)?, ..mesh.clone() });
    let (Some(mesh), Some(computed)) = (nodes.mesh().cloned(), &edges.computed) else {
        return Err(Error::internal("edges and nodes of different kinds"));
    };
    let edges =
        DualEdges { computed: Some(Arc::new(ComputedEdges { mesh, ..ComputedEdges::clone(computed) })), ..edges };
    let shared = edges.shared();
    let unsatisfied = context.run.map_ranges(n, nodes::CHUNK, |range| {
        let contradicting = |node: usize| shared.neighbours(node as u32).filter(|(_, edge)| *edge < 0.).count() as u64;
        Ok(range.map(contradicting).sum::<u64>())
    })?;
    let facts = OrientationFacts { flipped: counts.into_iter().sum(), unsatisfied: unsatisfied.into_iter().sum() };
    Ok((edges, nodes, facts))
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let mut sums = Sums::default();
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
}
