//! The edges of the dual graph from half-edge pairs: sorted, without duplicates, with the length of each step.
//!
//! Buckets of pairs arrive in node order; a counting sort by corner groups them by node, and each row is sorted by
//! neighbour. The length of a step is |c_i − mid| + |c_j − mid| over the midpoint of the shared edge
//! (`graph_centroid_distances`, in the frame; |c_i − c_j| if the midpoint is not finite); the edge's own length is
//! stored beside it. Two faces that share several edges get one entry: the shortest step, the summed edge length. Both
//! directions are computed from the same numbers by a symmetric formula, so they agree to the bit.
//!
//! Workers assemble buckets, one thread appends them in order: ½ + 12 + 12 + 12 bytes per triangle, written
//! sequentially; the last 12 are omitted if geometry is computed ([`super::node_geometry`]). If everything fits in
//! memory, workers write the rows in place instead (`assemble_in_memory.rs`).

use super::csr::{Csr, INDICES};
use super::half_edge_pairs::{HalfEdgePair, HalfEdgePairs};
use super::node_geometry::{ComputedEdges, ListedEdge, MOST_LISTED, NodeGeometry, SharedEdges};
use super::nodes::{Frame, Node};
use super::row_starts::writer::RowStartsWriter;
use super::row_starts::{OwnedRowStarts, StartsForm};
use crate::base::Result;
use crate::base::vector::{distance, middle, wide};
use crate::mesh::Mesh;
use crate::store::npy::ArrayWriter;
use crate::store::{Context, MappedSlice, WorkDir};
use std::sync::Arc;

/// The file of the centroid distances.
pub(super) const CENTROID_DISTANCES: &str = "graph_centroid_distances.npy";
/// The file of the lengths of shared edges.
pub(super) const EDGES: &str = "graph_shared_edge_lengths.npy";

/// The edges of a graph before they are weighted, as compressed rows.
#[derive(Clone, Debug)]
pub struct DualEdges {
    /// Where rows begin (n).
    pub starts: OwnedRowStarts,
    /// Neighbours, ascending in a row (nnz).
    pub indices: MappedSlice<u32>,
    /// Step lengths in the frame (nnz), finite.
    pub centroid_distance: MappedSlice<f32>,
    /// Lengths of the shared edges in the frame (nnz); negative if the windings of the two faces contradict and could
    /// not be made consistent (see [`super::orient`]); 0 for bridges. Empty if they are computed from the mesh
    /// ([`DualEdges::shared`] covers both cases), and if steps are the edges, as in a [`super::vertex_graph`].
    pub edge: MappedSlice<f32>,
    /// The source of computed lengths.
    pub(super) computed: Option<Arc<ComputedEdges>>,
    /// Whether any length of a shared edge may be negative.
    pub(super) mixed: bool,
}

impl DualEdges {
    /// Opens the edges of `nodes` nodes of an earlier run in `work`, with row starts in `form` and the rest in the
    /// named files: neighbours, step lengths, and lengths of shared edges if there are any.
    ///
    /// # Errors
    /// [`crate::base::Error::WorkDir`] if they contradict each other; [`crate::base::Error::Io`].
    pub(super) fn open(
        work: &WorkDir,
        nodes: usize,
        form: StartsForm,
        [indices, centroid_distance]: [&str; 2],
        edge: Option<&str>,
    ) -> Result<Self> {
        let entries = work.open_array::<u32>(indices)?.len();
        Ok(Self {
            starts: form.open(work, nodes, entries)?,
            indices: work.indices(indices, entries, nodes)?,
            centroid_distance: work.array_of(centroid_distance, entries)?,
            edge: edge.map_or(Ok(MappedSlice::empty()), |edge| work.array_of(edge, entries))?,
            computed: None,
            mixed: edge.is_some(),
        })
    }

    /// Whether lengths of shared edges are stored.
    pub(super) fn keeps_edges(&self) -> bool {
        self.computed.is_none() && self.edge.len() == self.indices.len()
    }

    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.starts.view().len()
    }

    /// Whether there are no nodes.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The graph weighted by step lengths, in the frame.
    pub fn by_distance(&self) -> Csr<'_> {
        Csr::new(self.starts.view(), &self.indices, &self.centroid_distance)
    }

    /// Edges consisting of exactly these arrays.
    pub(crate) fn of_arrays(
        starts: OwnedRowStarts,
        indices: MappedSlice<u32>,
        centroid_distance: MappedSlice<f32>,
        edge: MappedSlice<f32>,
    ) -> Self {
        let mixed = edge.iter().any(|length| *length < 0.);
        Self { starts, indices, centroid_distance, edge, computed: None, mixed }
    }

    /// The graph with the lengths of the shared edges: for passes over neighbours.
    pub fn shared(&self) -> SharedEdges<'_> {
        SharedEdges { graph: self.by_shared_edge(), computed: self.computed.as_deref(), mixed: self.mixed }
    }

    /// The graph with the lengths of the shared edges as weights, some of them negative: for passes over neighbours,
    /// not for fronts. Only if they are stored.
    pub fn by_shared_edge(&self) -> Csr<'_> {
        Csr::new(self.starts.view(), &self.indices, &self.edge)
    }
}

/// An entry of a row under construction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Entry {
    pub node: u32,
    pub centroid_distance: f32,
    pub edge: f32,
}

/// Writes the arrays of [`DualEdges`] from front to back.
pub(super) struct EdgesWriter {
    starts: RowStartsWriter,
    indices: ArrayWriter<u32>,
    centroid_distance: ArrayWriter<f32>,
    /// `None` if lengths are computed from the mesh, or equal those of steps.
    edge: Option<ArrayWriter<f32>>,
    /// Whether any length was negative.
    mixed: bool,
}

impl EdgesWriter {
    /// For `nodes` rows of at most `entries` entries in all. Lengths of shared edges are written if `kept`.
    pub fn create(nodes: usize, entries: usize, form: StartsForm, kept: bool, work: &WorkDir) -> Result<Self> {
        Ok(Self {
            starts: RowStartsWriter::create(form, nodes, work)?,
            indices: work.writer_of(INDICES, 1, entries)?,
            centroid_distance: work.writer(CENTROID_DISTANCES, 1)?,
            edge: kept.then(|| work.writer(EDGES, 1)).transpose()?,
            mixed: false,
        })
    }

    /// Appends rows of the given degrees, whose entries are concatenated; `edge` is used only if it is kept.
    pub fn push(&mut self, degrees: &[u32], indices: &[u32], centroid_distance: &[f32], edge: &[f32]) -> Result<()> {
        self.starts.push(degrees)?;
        self.indices.push(indices)?;
        self.centroid_distance.push(centroid_distance)?;
        self.mixed |= edge.iter().any(|length| *length < 0.);
        self.edge.as_mut().map_or(Ok(()), |writer| writer.push(edge))
    }

    pub fn finish(self) -> Result<DualEdges> {
        Ok(DualEdges {
            starts: self.starts.finish()?,
            indices: self.indices.finish(false)?,
            centroid_distance: self.centroid_distance.finish(false)?,
            edge: self.edge.map_or(Ok(MappedSlice::empty()), |writer| writer.finish(false))?,
            computed: None,
            mixed: self.mixed,
        })
    }
}

/// Assembles the rows and writes row starts, `graph_indices`, `graph_centroid_distances`, `graph_shared_edge_lengths`.
///
/// If `nodes` are computed from the mesh, so are the lengths of shared edges, except for those in a list; `None` if
/// that list would be too long.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub fn assemble(
    mesh: &Mesh,
    frame: &Frame,
    nodes: &NodeGeometry,
    pairs: &HalfEdgePairs<'_>,
    context: Context<'_>,
) -> Result<Option<DualEdges>> {
    let kept = !nodes.is_computed();
    let mut writer = EdgesWriter::create(nodes.len(), pairs.bound(), StartsForm::Packed, kept, context.work)?;
    let mut listed: Vec<ListedEdge> = Vec::new();
    context.run.in_order(
        pairs.parts(),
        || (),
        |part, ()| {
            let mut part = assemble_part(mesh, frame, nodes, pairs.nodes_of(part), &pairs.take(part, mesh)?);
            part.list_edges(nodes);
            Ok(part)
        },
        |_, part| {
            context.run.progress.advance("graph", part.degrees.len() as u64);
            let room = MOST_LISTED.saturating_sub(listed.len());
            listed.extend(part.listed.iter().take(room + 1));
            writer.push(&part.degrees, &part.indices, &part.centroid_distance, &part.edges)
        },
    )?;
    if listed.len() > MOST_LISTED {
        return Ok(None);
    }
    let listed: Arc<[ListedEdge]> = listed.into();
    let computed = nodes.mesh().map(|mesh| Arc::new(ComputedEdges { mesh: mesh.clone(), listed }));
    Ok(Some(DualEdges { computed, ..writer.finish()? }))
}

/// The rows of a range of nodes.
struct NodeRange {
    first: usize,
    degrees: Vec<u32>,
    indices: Vec<u32>,
    centroid_distance: Vec<f32>,
    edges: Vec<f32>,
    /// Edges whose length must be listed, as computing gives another one.
    listed: Vec<ListedEdge>,
}

impl NodeRange {
    /// Lists the edges whose lengths cannot be computed from `nodes`.
    fn list_edges(&mut self, nodes: &NodeGeometry) {
        let Some(mesh) = nodes.mesh() else { return };
        let mut entry = 0;
        for (from, &degree) in (self.first..).zip(&self.degrees) {
            let own = mesh.row(from);
            for _ in 0..degree {
                let (to, edge) = (self.indices[entry], self.edges[entry]);
                if mesh.shared(&own, to as usize).to_bits() != edge.to_bits() {
                    self.listed.push((from as u32, to, edge));
                }
                entry += 1;
            }
        }
    }
}

/// Assembles the rows of the nodes of `range`, whose `pairs` come in the order of their corners.
fn assemble_part(
    mesh: &Mesh,
    frame: &Frame,
    nodes: &NodeGeometry,
    range: std::ops::Range<usize>,
    pairs: &[HalfEdgePair],
) -> NodeRange {
    let mut part = NodeRange {
        first: range.start,
        listed: Vec::new(),
        degrees: Vec::with_capacity(range.len()),
        indices: Vec::with_capacity(pairs.len()),
        centroid_distance: Vec::with_capacity(pairs.len()),
        edges: Vec::with_capacity(pairs.len()),
    };
    let mut held = Vec::new();
    let window = nodes.window(range.clone(), &mut held);
    let (mut rest, mut scratch) = (pairs, RowScratch::default());
    mesh.faces.for_each(range, |face, corners| {
        let span = mesh.faces.corner_range(face);
        let count = rest.iter().take_while(|pair| (pair.corner as usize) < span.end).count();
        let (mine, after) = rest.split_at(count);
        rest = after;
        let points = corners.iter().map(|&v| frame.place(mesh.positions.get(v)));
        let row =
            scratch.row(points, span.start, &window.at(face), mine.iter().copied(), |node| window.at(node as usize));
        part.indices.extend(row.iter().map(|entry| entry.node));
        part.centroid_distance.extend(row.iter().map(|entry| entry.centroid_distance));
        part.edges.extend(row.iter().map(|entry| entry.edge));
        part.degrees.push(row.len() as u32);
    });
    part
}

/// Buffers for a row under construction.
#[derive(Default)]
pub(super) struct RowScratch {
    points: Vec<[f64; 3]>,
    row: Vec<Entry>,
}

impl RowScratch {
    /// The row of the face `own`, whose corners lie at `points` and are numbered from `first` on: one entry for each
    /// neighbour in its `pairs`, ascending. `node` returns a neighbour's node.
    #[inline]
    pub fn row(
        &mut self,
        points: impl Iterator<Item = [f64; 3]>,
        first: usize,
        own: &Node,
        pairs: impl Iterator<Item = HalfEdgePair>,
        node: impl Fn(u32) -> Node,
    ) -> &[Entry] {
        let Self { points: held, row } = self;
        held.clear();
        held.extend(points);
        row.clear();
        row.extend(pairs.map(|pair| {
            let slot = pair.corner as usize - first;
            let end = if slot + 1 == held.len() { 0 } else { slot + 1 };
            let mut entry = step(own, &node(pair.to()), pair.to(), [held[slot], held[end]]);
            if pair.opposite_winding() {
                entry.edge = -entry.edge;
            }
            entry
        }));
        if let [a, b, c] = &mut row[..]
            && a.node != b.node
            && b.node != c.node
            && a.node != c.node
        {
            // Nearly every row: three different neighbours.
            for (x, y) in [(0, 1), (1, 2), (0, 1)] {
                if row[x].node > row[y].node {
                    row.swap(x, y);
                }
            }
            return row;
        }
        merge_row(row);
        row
    }
}

/// Sorts a row by neighbour and merges entries for the same neighbour.
fn merge_row(row: &mut Vec<Entry>) {
    // Ties are broken by value, so the order of pairs does not matter.
    row.sort_unstable_by(|a, b| {
        a.node.cmp(&b.node).then(a.centroid_distance.total_cmp(&b.centroid_distance)).then(a.edge.total_cmp(&b.edge))
    });
    row.dedup_by(|entry, kept| {
        let same = entry.node == kept.node;
        if same {
            merge(kept, entry);
        }
        same
    });
}

/// Merges a second edge between two faces into the first: the shorter finite step, the summed edge length.
fn merge(kept: &mut Entry, entry: &Entry) {
    kept.centroid_distance = kept.centroid_distance.min(entry.centroid_distance);
    kept.edge = (kept.edge.abs() + entry.edge.abs()).copysign(kept.edge);
}

/// The entry for the step from `from` to `to` over the edge between `ends` (in the frame).
#[inline]
fn step(from: &Node, to: &Node, node: u32, ends: [[f64; 3]; 2]) -> Entry {
    let mid = middle(ends[0], ends[1]);
    let (from, to) = (wide(from.centroid), wide(to.centroid));
    let centroid_distance = (distance(from, mid) + distance(to, mid)) as f32;
    let edge = distance(ends[0], ends[1]) as f32;
    if centroid_distance.is_finite() {
        Entry { node, centroid_distance, edge }
    } else {
        Entry { node, centroid_distance: distance(from, to) as f32, edge: 0. }
    }
}
