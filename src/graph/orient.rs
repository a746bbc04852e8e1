//! Makes the winding consistent before any sign of turning is used.
//!
//! Published meshes are not always wound consistently. In each component the faces whose winding contradicts its first
//! face are known from the union-find's parities ([`super::components`]); the group with the smaller area is flipped.
//! Then a component that encloses a volume is flipped as a whole if the volume is negative (normals point inwards); one
//! that does not (a range scan, a relief, a room seen from within) keeps the direction of its file. Flipping changes
//! only the normals in the node geometry; faces are written unchanged. Edges whose faces still contradict keep their
//! negative length: no orientation exists there.
//!
//! Time: one pass over nodes, in which computed ones are summed up too; none if a mesh is one component and its nodes
//! were summed up while its rows were assembled. The rest only if something has to be flipped. Memory: a chunk of nodes
//! for each thread, and up to 80 bytes per node of it if each is a component of its own; 73 bytes per component in the
//! work directory, in memory where the budget has room.
//!
//! The components' array then tells which faces were flipped ([`FLIPPED`]), so that a cavity, wound against what
//! surrounds it, can be told from a body within it (`cluster/parts/interior`). It is written again only if something
//! was flipped: 4 bytes per node.

use super::components::{self, Components, FLIPPED};
use super::dual_edges::{DualEdges, EDGES};
use super::half_edge_pairs::OPPOSITE_WINDING;
use super::node_geometry::{ComputedEdges, ComputedGeometry, NodeGeometry};
use super::nodes::{self, Node, NodeSums};
use super::orientation_sums::{OrientationSums, WholeSums};
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::{Error, Result};
use crate::store::npy::{ArrayMut, Item};
use crate::store::{Context, MappedSlice};
use std::sync::Arc;

/// The file of the sums of the components.
const SUMS: &str = "component_sums.tmp";

/// Counts from orienting.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OrientationFacts {
    /// Faces whose normals were flipped.
    pub flipped: u64,
    /// Directed entries whose faces still have contradicting winding.
    pub unsatisfied: u64,
}

/// What [`orient`] returns: what to use from now on, and what was learned from the pass over the nodes.
pub(super) struct Oriented {
    pub edges: DualEdges,
    pub nodes: NodeGeometry,
    /// Their roots with [`FLIPPED`].
    pub components: Components,
    pub facts: OrientationFacts,
    pub sums: NodeSums,
}

/// Flips normals to make winding consistent and outward. `sums` are those of the nodes, if they are known; otherwise
/// they are computed in the same pass. `whole` are those of all nodes as one component, if they are known: then a mesh
/// that is one needs no pass.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub(super) fn orient(
    edges: DualEdges,
    nodes: NodeGeometry,
    sums: Option<NodeSums>,
    whole: Option<WholeSums>,
    components: Components,
    context: Context<'_>,
) -> Result<Oriented> {
    let (of_components, of_computed) = match whole {
        Some(whole) if components.count() == 1 && !components.mixed => {
            let mut sums = context.work.array(SUMS, &[1, OrientationSums::WIDTH])?;
            sums.data()[0] = whole.orientation;
            (sums, whole.nodes)
        }
        _ => component_sums(&nodes, &components, context)?,
    };
    let sums = sums.unwrap_or(of_computed);
    let mut flips_first: ArrayMut<u8> = context.work.array("component_turn.tmp", &[components.count()])?;
    flips_first.data().iter_mut().zip(of_components.items()).for_each(|(slot, of)| *slot = u8::from(of.flips_first()));
    drop(of_components);
    if !components.mixed && !flips_first.items().contains(&1) {
        return Ok(Oriented { edges, nodes, components, facts: OrientationFacts::default(), sums });
    }
    let components = with_flipped(components, flips_first.items(), context)?;
    let (edges, nodes, facts) = flip(edges, nodes, &components, context)?;
    Ok(Oriented { edges, nodes, components, facts, sums })
}

/// `components` with [`FLIPPED`] instead of contradicting windings; `flips_first` is 1 for those whose first node is
/// flipped. Nodes that contradict it are flipped exactly if it is not.
fn with_flipped(components: Components, flips_first: &[u8], context: Context<'_>) -> Result<Components> {
    let Some(links) = &components.root else { return Ok(components) };
    let mut array = context.work.array::<u32>(components::FILE, &[links.len()])?;
    let fill = |k: usize, out: &mut [u32], (): &mut ()| {
        let mut number = 0;
        for (slot, &link) in out.iter_mut().zip(&links[chunk_range(links.len(), nodes::CHUNK, k)]) {
            number = components.number(link, number);
            *slot = if flips_first[number] == 0 { link } else { link ^ FLIPPED };
        }
        Ok(())
    };
    context.run.fill_chunks(array.data(), nodes::CHUNK, || (), fill)?;
    Ok(Components { root: Some(array.finish(false)?), ..components })
}

/// Flips the nodes that `components` mark; all of them if there is but one, whose windings agree.
fn flip(
    edges: DualEdges,
    nodes: NodeGeometry,
    components: &Components,
    context: Context<'_>,
) -> Result<(DualEdges, NodeGeometry, OrientationFacts)> {
    let is_flipped = |node: usize| components.root.as_ref().is_none_or(|root| root[node] & FLIPPED != 0);
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
) -> Result<(ArrayMut<OrientationSums>, NodeSums)> {
    let links = components.root.as_deref();
    let mut sums: ArrayMut<OrientationSums> =
        context.work.array(SUMS, &[components.count(), OrientationSums::WIDTH])?;
    let of_components = sums.data();
    let compute = |k: usize, held: &mut Vec<Node>| {
        let chunk = chunk_range(nodes.len(), nodes::CHUNK, k);
        let (some, of_all) = match nodes.mesh() {
            Some(mesh) => {
                held.clear();
                let sums = nodes::each_and_sums(&mesh.mesh, mesh.frame, chunk.clone(), |_, node| held.push(*node));
                (&held[..], sums)
            }
            None => (&nodes.array()[chunk.clone()], NodeSums::default()),
        };
        Ok((sums_of_runs(links.map(|links| &links[chunk]), some), of_all))
    };
    let (mut number, mut all) = (0, NodeSums::default());
    let add = |_: usize, (runs, of_all): (Vec<(u32, OrientationSums)>, NodeSums)| {
        for (root, run) in runs {
            number = components.number(root, number);
            of_components[number] = of_components[number].and(&run);
        }
        all = all.and(of_all);
        Ok(())
    };
    context.run.in_order(chunk_count(nodes.len(), nodes::CHUNK), Vec::new, compute, add)?;
    Ok((sums, all))
}

/// The sums of each run of `nodes` in one component, and its root; `links` are [`Components::root`] of these nodes.
fn sums_of_runs(links: Option<&[u32]>, nodes: &[Node]) -> Vec<(u32, OrientationSums)> {
    let Some(links) = links else {
        let mut sums = OrientationSums::default();
        nodes.iter().for_each(|node| sums.add(node, false));
        return vec![(0, sums)];
    };
    let (mut runs, mut done) = (Vec::new(), 0);
    for links in links.chunk_by(|a, b| a & !OPPOSITE_WINDING == b & !OPPOSITE_WINDING) {
        // A local variable, which stays in registers.
        let mut sums = OrientationSums::default();
        for (link, node) in links.iter().zip(&nodes[done..]) {
            sums.add(node, link & OPPOSITE_WINDING != 0);
        }
        runs.push((links[0] & !OPPOSITE_WINDING, sums));
        done += links.len();
    }
    runs
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
const FLIPPED_BITS: &str = "flipped_faces.npy";

/// The same if nodes and edges are computed from `mesh`: one bit per face.
fn flip_computed(
    edges: DualEdges,
    mesh: &ComputedGeometry,
    is_flipped: impl Fn(usize) -> bool + Sync,
    context: Context<'_>,
) -> Result<(DualEdges, NodeGeometry, OrientationFacts)> {
    let n = mesh.mesh.faces.len();
    let mut bits = context.work.array::<u64>(FLIPPED_BITS, &[n.div_ceil(64)])?;
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
