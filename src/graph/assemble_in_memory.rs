//! Assembles the edges of the dual graph in place: in memory, on all threads at once.
//!
//! If the pairs of half-edges are a table and no corner has two, the degrees of rows are known before the rows. So a
//! first pass counts them, and each range of nodes has its place in the arrays: nothing is passed between threads, and
//! no thread waits while another copies. Rows are those of [`super::dual_edges`], to the bit, by the same loop
//! ([`super::face_rows`]).

use super::csr::INDICES;
use super::dual_edges::{CENTROID_DISTANCES, DualEdges, EDGES};
use super::face_rows::{FaceRows, RowScratch, Rows};
use super::frame::Frame;
use super::half_edge_pairs::{AcrossCorner, HalfEdgePairs, NO_NODE, OPPOSITE_WINDING};
use super::node_geometry::NodeGeometry;
use super::row_starts::StartsForm;
use super::row_starts::writer::{PackedPart, RowStartsWriter};
use crate::base::Result;
use crate::base::parallel::{chunk_count, chunk_range, parts_of};
use crate::base::simd::dispatch;
use crate::mesh::Mesh;
use crate::store::Context;
use std::sync::Arc;

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
    let (Some(pairs), false) = (pairs.table(), nodes.is_computed()) else { return Ok(None) };
    let (n, chunks) = (nodes.len(), chunk_count(nodes.len(), NODES));
    let rows = |k: usize| chunk_range(n, NODES, k);
    // Half a byte per node, until the row starts are written.
    let packed = n as u64 / 2;
    let Ok(grant) = run.budget.take("row starts", packed, packed) else { return Ok(None) };
    let count = |k: usize, (): &mut ()| {
        Ok(PackedPart::of(rows(k).map(|face| degree(&pairs.across()[mesh.faces.corner_range(face)]))))
    };
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
    let places = places.map(|((indices, lengths), edges)| Rows { indices, centroid_distance: lengths, edge: edges });
    let mixed = run.fill_pieces(places, RowScratch::default, |k, out, scratch| {
        run.progress.advance("graph", rows(k).len() as u64);
        let (mut held, range) = (Vec::new(), rows(k));
        let rows = FaceRows {
            mesh,
            frame,
            nodes: nodes.window(range.clone(), &mut held),
            pairs: &pairs,
            range,
            out: Rows { indices: out.indices, centroid_distance: out.centroid_distance, edge: out.edge },
            degrees: &mut [],
            listing: None,
            scratch,
        };
        Ok(dispatch(rows).mixed)
    })?;
    Ok(Some(DualEdges {
        starts: starts.finish()?,
        indices: indices.finish(false)?,
        centroid_distance: lengths.finish(false)?,
        edge: edges.finish(false)?,
        computed: None,
        mixed: mixed.contains(&true),
        mean: Arc::default(),
    }))
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
                    None => assemble(&mesh, &frame, &nodes, &pairs, context).unwrap().unwrap().edges,
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
