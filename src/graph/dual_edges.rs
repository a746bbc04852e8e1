//! The edges of the dual graph from half-edge pairs: sorted, without duplicates, with the length of each step.
//!
//! Parts of the pairs arrive in node order, and each becomes rows (`face_rows.rs`): neighbours, lengths of steps
//! (`graph_centroid_distances`), lengths of shared edges.
//!
//! Workers assemble buckets, one thread appends them in order: ½ + 12 + 12 + 12 bytes per triangle, written
//! sequentially; the last 12 are omitted if geometry is computed ([`super::node_geometry`]). If everything fits in
//! memory, workers write the rows in place instead (`assemble_in_memory.rs`).

use super::component_blocks::{BlockRoots, Joined, RootsWriter};
use super::csr::{Csr, INDICES, SampledMean};
use super::face_rows::{FaceRows, Filled, Listing, RowScratch, Rows};
use super::frame::Frame;
use super::half_edge_pairs::{HalfEdgePairs, PartPairs};
use super::node_geometry::{ComputedEdges, ListedEdge, MOST_LISTED, NodeGeometry, SharedEdges};
use super::nodes;
use super::orientation_sums::WholeSums;
use super::row_starts::writer::RowStartsWriter;
use super::row_starts::{OwnedRowStarts, StartsForm};
use crate::base::Result;
use crate::base::simd::dispatch;
use crate::mesh::Mesh;
use crate::store::npy::ArrayWriter;
use crate::store::{Context, MappedSlice, WorkDir};
use std::ops::Range;
use std::sync::{Arc, OnceLock};

/// The file of the centroid distances.
pub(crate) const CENTROID_DISTANCES: &str = "graph_centroid_distances.npy";
/// The file of the lengths of shared edges.
pub(crate) const EDGES: &str = "graph_shared_edge_lengths.npy";

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
    /// The mean step, once it is known.
    pub(super) mean: Arc<OnceLock<f32>>,
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
            mean: Arc::default(),
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
        Self { starts, indices, centroid_distance, edge, computed: None, mixed, mean: Arc::default() }
    }

    /// The mean step, from evenly spread entries: known where steps were weighted before, since sampling them reads the
    /// whole file of a mapped graph.
    pub fn mean_step(&self) -> f32 {
        let steps = &self.centroid_distance[..];
        *self.mean.get_or_init(|| SampledMean::mean(SampledMean::of(steps.len()).sample(0, steps)))
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
    /// For `nodes` rows of some `entries` entries in all. Lengths of shared edges are written if `kept`.
    pub fn create(nodes: usize, entries: usize, form: StartsForm, kept: bool, work: &WorkDir) -> Result<Self> {
        Ok(Self {
            starts: RowStartsWriter::create(form, nodes, work)?,
            indices: work.writer_of(INDICES, 1, entries)?,
            centroid_distance: work.writer_of(CENTROID_DISTANCES, 1, entries)?,
            edge: kept.then(|| work.writer_of(EDGES, 1, entries)).transpose()?,
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
            mean: Arc::default(),
        })
    }
}

/// The assembled edges, and what was learned on the way.
pub(super) struct Assembled {
    pub edges: DualEdges,
    /// The sums of the nodes, if these are computed from the mesh and parts consist of whole chunks.
    pub whole: Option<WholeSums>,
    /// The components, unless windings disagree.
    pub joined: Option<Joined>,
}

/// Assembles the rows and writes row starts, `graph_indices`, `graph_centroid_distances`, `graph_shared_edge_lengths`;
/// joins components and sums up nodes while they are in the cache.
///
/// If `nodes` are computed from the mesh, so are the lengths of shared edges, except for those in a list; `None` if
/// that list would be too long.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub(super) fn assemble(
    mesh: &Mesh,
    frame: &Frame,
    nodes: &NodeGeometry,
    pairs: &HalfEdgePairs<'_>,
    context: Context<'_>,
) -> Result<Option<Assembled>> {
    let kept = !nodes.is_computed();
    let mut writer = EdgesWriter::create(nodes.len(), pairs.expected(), StartsForm::Packed, kept, context.work)?;
    let mut listed: Vec<ListedEdge> = Vec::new();
    let mut roots = RootsWriter::create(nodes.len(), context.work)?;
    let mut whole = Some(WholeSums::default());
    context.run.in_order(
        pairs.parts(),
        || (),
        |part, ()| Ok(assemble_part(mesh, frame, nodes, pairs.nodes_of(part), &pairs.take(part, mesh)?)),
        |_, part| {
            context.run.progress.advance("graph", part.degrees.len() as u64);
            let room = MOST_LISTED.saturating_sub(listed.len());
            listed.extend(part.listed.iter().take(room + 1));
            whole = whole.zip(part.whole).map(|(whole, chunks)| chunks.iter().fold(whole, WholeSums::and));
            roots.push(part.roots);
            writer.push(&part.degrees, &part.indices, &part.centroid_distance, &part.edges)
        },
    )?;
    if listed.len() > MOST_LISTED {
        return Ok(None);
    }
    let listed: Arc<[ListedEdge]> = listed.into();
    let computed = nodes.mesh().map(|mesh| Arc::new(ComputedEdges { mesh: mesh.clone(), listed }));
    let edges = DualEdges { computed, ..writer.finish()? };
    Ok(Some(Assembled { edges, whole, joined: roots.finish() }))
}

/// The rows of a range of nodes.
struct NodeRange {
    degrees: Vec<u32>,
    indices: Vec<u32>,
    centroid_distance: Vec<f32>,
    edges: Vec<f32>,
    /// Edges whose length must be listed, as computing gives another one.
    listed: Vec<ListedEdge>,
    /// The sums of each chunk of nodes; `None` if they are stored or the range does not start with a chunk.
    whole: Option<Vec<WholeSums>>,
    /// `None` if windings disagree.
    roots: Option<BlockRoots>,
}

/// Assembles the rows of the nodes of `range`, which have these `pairs`.
fn assemble_part(
    mesh: &Mesh,
    frame: &Frame,
    nodes: &NodeGeometry,
    range: Range<usize>,
    pairs: &PartPairs<'_>,
) -> NodeRange {
    let most = pairs.len();
    let mut degrees = vec![0; range.len()];
    let (mut indices, mut centroid_distance, mut edges) = (vec![0; most], vec![0.; most], vec![0.; most]);
    let (mut listed, mut held, mut scratch) = (Vec::new(), Vec::new(), RowScratch::default());
    let whole = nodes
        .mesh()
        .filter(|_| range.start.is_multiple_of(nodes::CHUNK))
        .map(|mesh| WholeSums::of_chunks(mesh, range.clone(), &mut held));
    let window = match whole {
        Some(_) => nodes.view().window_of(range.start, &held),
        None => nodes.window(range.clone(), &mut held),
    };
    let rows = FaceRows {
        mesh,
        frame,
        nodes: window,
        pairs,
        range: range.clone(),
        out: Rows { indices: &mut indices, centroid_distance: &mut centroid_distance, edge: &mut edges },
        degrees: &mut degrees,
        listing: nodes.mesh().map(|mesh| Listing { mesh, listed: &mut listed }),
        scratch: &mut scratch,
    };
    let Filled { entries, mixed } = dispatch(rows);
    indices.truncate(entries);
    centroid_distance.truncate(entries);
    edges.truncate(entries);
    let roots = (!mixed).then(|| BlockRoots::of(range.start, &degrees, &indices));
    NodeRange { degrees, indices, centroid_distance, edges, listed, whole, roots }
}
