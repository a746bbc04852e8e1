//! Assembles the edges of the dual graph in place: in memory, on all threads at once.
//!
//! If the pairs of half-edges are a table and no corner has two, the degrees of rows are known before the rows. So a
//! first pass counts them, and each range of nodes has its place in the arrays: nothing is passed between threads, and
//! no thread waits while another copies. Rows are those of [`super::dual_edges`], to the bit.
//!
//! Nearly every face has three corners and three different neighbours. Such a row is computed with its three edges in
//! parallel lanes, and sorted by counting, without a branch: the order of three neighbours is nearly random. Cost:
//! about 15 ns per face and thread, a third of it for square roots.

use super::csr::INDICES;
use super::dual_edges::{CENTROID_DISTANCES, DualEdges, EDGES, Entry, RowScratch};
use super::half_edge_pairs::{AcrossCorner, HalfEdgePair, HalfEdgePairs, NO_NODE, OPPOSITE_WINDING};
use super::node_geometry::NodeGeometry;
use super::nodes::{Frame, Node};
use super::row_starts::StartsForm;
use super::row_starts::writer::{PackedPart, RowStartsWriter};
use crate::base::Result;
use crate::base::parallel::{chunk_count, chunk_range, parts_of};
use crate::base::simd::{SimdKernel, dispatch};
use crate::mesh::Mesh;
use crate::store::Context;
use std::ops::Range;

/// Nodes that a thread takes at a time; a multiple of the block size of row starts.
const NODES: usize = 1 << 14;

/// Assembles the rows of `nodes` (n). `None` if this method does not apply: geometry is computed, some corner has two
/// pairs, or there is no room.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub(super) fn assemble_in_memory(
    mesh: &Mesh,
    frame: &Frame,
    nodes: &NodeGeometry,
    pairs: &HalfEdgePairs<'_>,
    context: Context<'_>,
) -> Result<Option<DualEdges>> {
    let Context { work, run } = context;
    let (Some(across), false) = (pairs.table(), nodes.is_computed()) else { return Ok(None) };
    let nodes = nodes.array();
    let (n, chunks) = (nodes.len(), chunk_count(nodes.len(), NODES));
    let rows = |k: usize| chunk_range(n, NODES, k);
    // Half a byte per node, until the row starts are written.
    let packed = n as u64 / 2;
    let Ok(grant) = run.budget.take("row starts", packed, packed) else { return Ok(None) };
    let count =
        |k: usize, (): &mut ()| Ok(PackedPart::of(rows(k).map(|face| degree(&across[mesh.faces.corner_range(face)]))));
    let parts = run.map_chunks(chunks, || (), count)?;
    let mut starts = RowStartsWriter::create(StartsForm::Packed, n, work)?;
    let mut ends = Vec::with_capacity(chunks);
    for part in parts {
        ends.push(starts.push_part(part)?);
    }
    drop(grant);
    let entries = ends.last().map_or(0, |end| *end as usize);
    let (indices, lengths, edges) = (
        work.array_in_memory::<u32>(INDICES, &[entries]),
        work.array_in_memory::<f32>(CENTROID_DISTANCES, &[entries]),
        work.array_in_memory::<f32>(EDGES, &[entries]),
    );
    let (Some(mut indices), Some(mut lengths), Some(mut edges)) = (indices, lengths, edges) else { return Ok(None) };
    let ends = || ends.iter().map(|end| *end as usize);
    let places =
        parts_of(indices.data(), ends()).zip(parts_of(lengths.data(), ends())).zip(parts_of(edges.data(), ends()));
    let places = places.map(|((indices, lengths), edges)| Rows { indices, lengths, edges });
    let mixed = run.fill_pieces(places, RowScratch::default, |k, out, scratch| {
        run.progress.advance("graph", rows(k).len() as u64);
        let Rows { indices, lengths, edges } = out;
        let out = Rows { indices, lengths, edges };
        Ok(dispatch(Assembled { mesh, frame, nodes, across, range: rows(k), out, scratch }))
    })?;
    Ok(Some(DualEdges {
        starts: starts.finish()?,
        indices: indices.finish(false)?,
        centroid_distance: lengths.finish(false)?,
        edge: edges.finish(false)?,
        computed: None,
        mixed: mixed.contains(&true),
    }))
}

/// The slices for the entries of a range of rows.
struct Rows<'a> {
    indices: &'a mut [u32],
    lengths: &'a mut [f32],
    edges: &'a mut [f32],
}

/// The number of different nodes among those `across` the edges of a face.
#[inline]
fn degree(across: &[AcrossCorner]) -> u32 {
    let node = |k: usize| across[k].node() & !OPPOSITE_WINDING;
    if across.len() == 3 {
        let [a, b, c] = [node(0), node(1), node(2)];
        let none = NO_NODE & !OPPOSITE_WINDING;
        return u32::from(a != none) + u32::from((b != none) & (b != a)) + u32::from((c != none) & (c != a) & (c != b));
    }
    let mut all: Vec<u32> = (0..across.len()).map(node).filter(|node| *node != NO_NODE & !OPPOSITE_WINDING).collect();
    all.sort_unstable();
    all.dedup();
    all.len() as u32
}

/// Fills the rows of `range`, for [`dispatch`]; returns whether any length of a shared edge is negative.
struct Assembled<'a> {
    mesh: &'a Mesh,
    frame: &'a Frame,
    nodes: &'a [Node],
    /// The node across each corner's edge.
    across: &'a [AcrossCorner],
    range: Range<usize>,
    out: Rows<'a>,
    scratch: &'a mut RowScratch,
}

impl SimdKernel for Assembled<'_> {
    type Output = bool;

    #[inline(always)]
    fn run(self) -> bool {
        let Self { mesh, frame, nodes, across, range, out, scratch } = self;
        let (mut at, mut mixed) = (0, false);
        let (positions, frame) = (&mesh.positions, *frame);
        let triangle = |face| mesh.faces.with(face, |corners| <[u32; 3]>::try_from(corners).ok());
        // Not `for_each`: a closure that it calls in two places is not inlined, and would be compiled for the baseline
        // processor.
        for face in range {
            let span = mesh.faces.corner_range(face);
            if let (Some([a, b, c]), [x, y, z]) = (triangle(face), &across[span.clone()]) {
                let links = [x.node(), y.node(), z.node()];
                let near = [links[0] & !OPPOSITE_WINDING, links[1] & !OPPOSITE_WINDING, links[2] & !OPPOSITE_WINDING];
                let three = (near[0] != near[1]) & (near[1] != near[2]) & (near[0] != near[2]);
                let found = (nodes.get(near[0] as usize), nodes.get(near[1] as usize), nodes.get(near[2] as usize));
                if let (Some(x), Some(y), Some(z)) = found
                    && three
                {
                    let points =
                        [frame.place(positions.get(a)), frame.place(positions.get(b)), frame.place(positions.get(c))];
                    let [length, edge] = three_steps(points, &nodes[face], [x, y, z]);
                    if length[0].is_finite() & length[1].is_finite() & length[2].is_finite() {
                        let places = ranks(near);
                        for k in 0..3 {
                            let edge = if links[k] >= OPPOSITE_WINDING { -edge[k] } else { edge[k] };
                            mixed |= edge < 0.;
                            let e = at + places[k];
                            (out.indices[e], out.lengths[e], out.edges[e]) = (near[k], length[k], edge);
                        }
                        at += 3;
                        continue;
                    }
                }
            }
            let row = mesh.faces.with(face, |corners| {
                let links = across[span.clone()].iter().map(AcrossCorner::node);
                let pairs = span.clone().zip(links).filter(|(_, node)| *node != NO_NODE);
                let pairs = pairs.map(|(corner, node)| HalfEdgePair { corner: corner as u32, node });
                let points = corners.iter().map(|&v| frame.place(positions.get(v)));
                scratch.row(points, span.start, &nodes[face], pairs, |node| nodes[node as usize])
            });
            for &Entry { node, centroid_distance, edge } in row {
                mixed |= edge < 0.;
                (out.indices[at], out.lengths[at], out.edges[at]) = (node, centroid_distance, edge);
                at += 1;
            }
        }
        mixed
    }
}

/// The ranks of three different numbers in ascending order.
#[inline(always)]
fn ranks([a, b, c]: [u32; 3]) -> [usize; 3] {
    let less = |x: u32, y: u32| usize::from(x < y);
    [less(b, a) + less(c, a), less(a, b) + less(c, b), less(a, c) + less(b, c)]
}

/// Lengths of the steps from a triangle with the corners `points` to its neighbours, and of the edges that leave the
/// corners: what [`super::dual_edges`] computes one by one. In four lanes, the last of which is unused.
#[inline(always)]
fn three_steps(points: [[f64; 3]; 3], own: &Node, near: [&Node; 3]) -> [[f32; 3]; 2] {
    let (mut from, mut to, mut edge) = ([0f64; 4], [0f64; 4], [0f64; 4]);
    let [p, q, r] = points;
    let [x, y, z] = near;
    for axis in 0..3 {
        let start = [p[axis], q[axis], r[axis], r[axis]];
        let end = [q[axis], r[axis], p[axis], p[axis]];
        let own = f64::from(own.centroid[axis]);
        let [x, y, z] = [f64::from(x.centroid[axis]), f64::from(y.centroid[axis]), f64::from(z.centroid[axis])];
        let near = [x, y, z, z];
        for lane in 0..4 {
            let middle = (start[lane] + end[lane]) * 0.5;
            let (a, b, c) = (own - middle, near[lane] - middle, start[lane] - end[lane]);
            // The sum starts with the first square: adding it to 0 would change no bit.
            from[lane] += a * a;
            to[lane] += b * b;
            edge[lane] += c * c;
        }
    }
    let mut found = [[0f32; 4]; 2];
    for lane in 0..4 {
        found[0][lane] = (from[lane].sqrt() + to[lane].sqrt()) as f32;
        found[1][lane] = edge[lane].sqrt() as f32;
    }
    let [[a, b, c, _], [d, e, f, _]] = found;
    [[a, b, c], [d, e, f]]
}

#[cfg(test)]
mod tests {
    use super::super::dual_edges::assemble;
    use super::super::{half_edges, node_blocks::NodeBlocks, nodes};
    use super::*;
    use crate::base::random::{below, stream};
    use crate::store::{Budget, Run, WorkDir};

    /// Rows of quads, some of them as two triangles, some missing, some wound the other way or without area; and
    /// pillows, two triangles with three edges in common.
    fn mesh() -> Mesh {
        let (width, height) = (60u32, 300u32);
        let mut random = stream(5, "faces");
        let mut points: Vec<[f64; 3]> = Vec::new();
        for v in 0..width * height {
            let lift = below(&mut random, 3) as f64 / 7.;
            points.push([f64::from(v % width), f64::from(v / width), lift]);
        }
        let mut faces: Vec<Vec<u32>> = Vec::new();
        for v in (0..width * (height - 1)).filter(|v| v % width + 1 < width) {
            let (a, b, c, d) = (v, v + 1, v + width + 1, v + width);
            let kind = below(&mut random, 20);
            let turned = |mut face: Vec<u32>| {
                if kind == 0 {
                    face.reverse();
                }
                face
            };
            match kind {
                1 => {}
                2..5 => faces.push(vec![a, b, c, d]),
                _ => faces.extend([turned(vec![a, b, c]), vec![a, c, d]]),
            }
        }
        for _ in 0..10 {
            let v = points.len() as u32;
            points.extend([[0., 0., 9.], [1., 0., 9.], [0., 1., 9.]]);
            faces.extend([vec![v, v + 1, v + 2], vec![v, v + 2, v + 1]]);
        }
        points[7] = points[8];
        points[100] = [f64::NAN, 0., 0.];
        Mesh::from_slices(&points, &faces).unwrap()
    }

    #[test]
    fn rows_in_memory_are_those_that_are_handed_over() {
        let dir = tempfile::tempdir().unwrap();
        let mesh = mesh();
        for threads in [1, 3] {
            let run = Run { threads, budget: Budget::new(1 << 30), ..Run::new(&()) };
            let frame = Frame::of(&mesh, &run).unwrap();
            let edges = |work: &WorkDir| {
                let context = Context::new(work, &run);
                let array = work.array(nodes::FILE, &[mesh.faces.len(), 7]).unwrap();
                let nodes: NodeGeometry = nodes::build(&mesh, &frame, array, &run).unwrap().0.into();
                let blocks = NodeBlocks::of(&mesh, context).unwrap();
                let (pairs, _) = half_edges::matched(&mesh, "mesh".as_ref(), blocks, context).unwrap();
                assert!(pairs.table().is_some());
                let edges = match assemble_in_memory(&mesh, &frame, &nodes, &pairs, context).unwrap() {
                    Some(edges) => edges,
                    None => assemble(&mesh, &frame, &nodes, &pairs, context).unwrap().unwrap(),
                };
                let bits = |items: &[f32]| items.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
                let in_memory = edges.edge.place().is_none();
                let arrays = (edges.starts.view().plain(), edges.indices.to_vec(), edges.mixed);
                (in_memory, arrays, bits(&edges.centroid_distance), bits(&edges.edge))
            };
            let handed_over = edges(&WorkDir::temporary(dir.path()).unwrap());
            let held = edges(&WorkDir::temporary(dir.path()).unwrap().holding(&run.budget));
            assert!(!handed_over.0 && held.0);
            assert!(held.1 == handed_over.1 && held.2 == handed_over.2 && held.3 == handed_over.3);
        }
    }
}
