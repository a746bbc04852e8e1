//! Weighted graphs as arrays: a sparse matrix over mapped files, its raw slices, and a compact copy for fronts.
//!
//! Rows are compressed ([`Csr`]): the edges from node i are consecutive entries of `indices` and `weights`, located by
//! [`RowStarts`]. Half a byte per node and 8 per directed edge; [`Csr::neighbours`] iterates over the edges from a
//! node.

use super::row_starts::{OwnedRowStarts, RowStarts, StartsForm};
use crate::base::{Error, Result};
use crate::store::direct::DirectArray;
use crate::store::mapped::{Access, AlignedBuffer, advise, prefetch, will_need};
use crate::store::{MappedSlice, Run, WorkDir};
use bytemuck::{Pod, Zeroable};
use std::ops::Range;
use std::path::Path;

/// The file of the neighbours.
pub(crate) const INDICES: &str = "graph_indices.npy";
/// The file of the weights.
pub(crate) const WEIGHTS: &str = "graph_weights.npy";
/// The stage that computes the weights.
pub(super) const WEIGHTS_STAGE: &str = "weights";

/// A weighted graph as a sparse matrix over mapped files. Always well formed: this program built it, or checked it when
/// opening it.
#[derive(Clone, Debug)]
pub struct WeightedGraph {
    starts: OwnedRowStarts,
    indices: MappedSlice<u32>,
    weights: MappedSlice<f32>,
    /// Key of the stage, for stages built on it.
    pub key: String,
}

impl WeightedGraph {
    /// Combines the arrays of a [`Csr`], which lie in the folder `path`, without scanning them.
    ///
    /// # Errors
    /// [`Error::WorkDir`] naming `path` when the lengths contradict each other.
    pub fn new(
        path: &Path,
        starts: OwnedRowStarts,
        indices: MappedSlice<u32>,
        weights: MappedSlice<f32>,
        key: String,
    ) -> Result<Self> {
        let steps = starts.view().entries();
        if indices.len() != steps || weights.len() != steps {
            return Err(Error::work_dir(path, "the graph's arrays contradict each other", "delete the work directory"));
        }
        Ok(Self { starts, indices, weights, key })
    }

    /// Opens the weighted graph of `nodes` nodes that another process left in `work`, its row starts in `form`, its
    /// weights under `key`.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Malformed`], [`Error::WorkDir`].
    pub fn open(key: String, nodes: usize, form: StartsForm, work: &WorkDir) -> Result<Self> {
        let steps = work.open_array::<u32>(INDICES)?.len();
        let starts = form.open(work, nodes, steps)?;
        let (indices, weights) = (work.indices(INDICES, steps, nodes)?, work.positive(WEIGHTS, steps)?);
        Self::new(work.path(), starts, indices, weights, key)
    }

    /// Deletes the weights in a temporary `work` once the rows are computed: 12 bytes of disk per triangle.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn release(self, work: &WorkDir) -> Result<()> {
        drop(self);
        work.release(WEIGHTS_STAGE, &[WEIGHTS])
    }

    /// The graph as a matrix of `sprs` over the same arrays, for other programs: row i has the neighbours of node i and
    /// the edge weights. Needs the feature `sprs`. Row starts are unpacked into memory, 8 bytes per node; one pass
    /// checks that rows ascend.
    ///
    /// # Errors
    /// [`Error::Unusable`] for arrays that are not a valid matrix.
    #[cfg(feature = "sprs")]
    pub fn matrix(&self) -> Result<sprs::CsMatBase<f32, u32, Vec<u64>, &[u32], &[f32], u64>> {
        let starts = self.starts.view();
        let n = starts.len();
        sprs::CsMatBase::try_new((n, n), starts.plain(), &self.indices[..], &self.weights[..])
            .map_err(|(.., problem)| Error::unusable("graph", problem.to_string(), "delete the work directory"))
    }

    /// The arrays of entries, to be read past the mapping; `None` if they are in memory.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn direct(&self) -> Result<Option<DirectGraph>> {
        let arrays = (DirectArray::of(&self.indices)?, DirectArray::of(&self.weights)?);
        let (Some(indices), Some(weights)) = arrays else { return Ok(None) };
        Ok(Some(DirectGraph { indices, weights }))
    }

    /// The matrix as raw slices for hot loops.
    pub fn csr(&self) -> Csr<'_> {
        Csr::new(self.starts.view(), &self.indices, &self.weights)
    }
}

/// The entries of a [`Csr`] as files.
#[derive(Debug)]
pub struct DirectGraph {
    /// Neighbours (nnz).
    pub indices: DirectArray,
    /// Weights (nnz).
    pub weights: DirectArray,
}

/// A graph as raw slices.
#[derive(Clone, Copy, Debug)]
pub struct Csr<'a> {
    /// Where rows begin (n).
    pub starts: RowStarts<'a>,
    /// Neighbours (nnz), all below n.
    pub indices: &'a [u32],
    /// Weights (nnz), positive.
    pub weights: &'a [f32],
    /// The same edges as triangle adjacency (n), for fronts; empty if it was not built.
    pub triangles: &'a [TriangleNeighbours],
}

/// A mean of weights from some of them: 65,536 to 131,071 evenly spread ones, or all if there are fewer.
pub(crate) struct SampledMean {
    step: usize,
}

impl SampledMean {
    /// For a graph of `entries` entries.
    pub fn of(entries: usize) -> Self {
        Self { step: (entries / 65_536).max(1) }
    }

    /// The sampled ones of `weights`, which begin with entry `first`.
    pub fn sample(&self, first: usize, weights: &[f32]) -> impl Iterator<Item = f32> {
        weights.iter().skip((self.step - first % self.step) % self.step).step_by(self.step).copied()
    }

    /// Their mean, given all of them in order; 1 if there are none.
    pub fn mean(sampled: impl Iterator<Item = f32>) -> f32 {
        let (sum, count) = sampled.fold((0f64, 0u32), |(sum, count), weight| (sum + f64::from(weight), count + 1));
        if count == 0 { 1. } else { (sum / f64::from(count)) as f32 }
    }
}

impl<'a> Csr<'a> {
    /// A graph of these arrays alone.
    pub fn new(starts: RowStarts<'a>, indices: &'a [u32], weights: &'a [f32]) -> Self {
        Self { starts, indices, weights, triangles: &[] }
    }

    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.starts.len()
    }

    /// The range of the edges from `node` in `indices` and `weights`.
    #[inline(always)]
    pub fn span(self, node: u32) -> Range<usize> {
        self.starts.span(node)
    }

    /// The edges from `node`: its neighbours, ascending, each with the weight of the edge.
    #[inline(always)]
    pub fn neighbours(self, node: u32) -> impl Iterator<Item = (u32, f32)> + Clone + 'a {
        let span = self.span(node);
        let (indices, weights) = (&self.indices[span.clone()], &self.weights[span]);
        (0..indices.len()).map(move |k| (indices[k], weights[k]))
    }

    /// Prefetches the first edges from `node`.
    #[inline(always)]
    pub fn prefetch(self, node: u32) {
        self.prefetch_from(self.span(node).start);
    }

    /// Prefetches the first entries of a row that starts at `start`.
    #[inline(always)]
    pub fn prefetch_from(self, start: usize) {
        prefetch(self.indices, start);
        prefetch(self.weights, start);
        prefetch(self.weights, start + 2);
    }

    /// Asks the kernel to read the rows of `nodes` soon ([`Run::will_need`]).
    pub fn will_need(self, nodes: Range<usize>, run: &Run) {
        let entries = self.starts.entries_of(nodes);
        run.will_need(self.indices, entries.clone());
        run.will_need(self.weights, entries);
    }

    /// Asks the kernel to read the rows of `nodes` soon, waiting only for their starts.
    pub fn will_need_rows(self, nodes: Range<usize>) {
        self.will_need_entries(nodes.clone(), self.starts.entries_of(nodes));
    }

    /// The same for `nodes` whose rows are known to be `entries`.
    pub fn will_need_entries(self, nodes: Range<usize>, entries: Range<usize>) {
        self.starts.will_need(nodes);
        will_need(&self.indices[entries.clone()]);
        will_need(&self.weights[entries]);
    }

    /// Advises the kernel how rows are read from now on.
    pub fn advise(self, access: Access) {
        self.starts.advise(access);
        advise(self.indices, access);
        advise(self.weights, access);
    }

    /// Bytes of the arrays.
    pub fn bytes(&self) -> u64 {
        self.starts.bytes() + (size_of_val(self.indices) + size_of_val(self.weights)) as u64
    }
}

/// Nodes this close to each other are requested together: rows of a few pages.
const NEAR: u32 = 512;

/// Ascending `nodes` grouped into ranges of nearby nodes.
pub fn near_ranges(nodes: &[u32]) -> impl Iterator<Item = Range<usize>> + '_ {
    nodes.chunk_by(|a, b| b - a <= NEAR).map(|near| near[0] as usize..near[near.len() - 1] as usize + 1)
}

/// Nodes per chunk of the pass that builds the records.
const CHUNK: usize = 1 << 14;
/// Replaces the first neighbour if there are more than three: look them up in the matrix.
const MORE: u32 = u32::MAX;

/// The edges from a node; if there are fewer than three, padded with infinite edges to the node itself.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub struct TriangleNeighbours {
    next: [u32; 3],
    weights: [f32; 3],
}

impl TriangleNeighbours {
    /// The edges, if there are no more than three.
    #[inline(always)]
    pub fn steps(&self) -> Option<(&[u32; 3], &[f32; 3])> {
        (self.next[0] != MORE).then_some((&self.next, &self.weights))
    }
}

/// The graph of a closed triangle mesh in records of three edges, for fronts (n).
///
/// Nearly every face has three neighbours. With their numbers and the weights in one record, a front reads one cache
/// line per node instead of three and no row start, and its inner loop has a fixed length: with large pages a row takes
/// about half the time (`benches/records`). It is a copy, 24 bytes per node beside the sparse matrix, so it is built
/// only if many rows will be computed and the budget has room; otherwise fronts use the matrix, with the same
/// result.
#[derive(Debug)]
pub struct TriangleAdjacency {
    words: AlignedBuffer,
    nodes: usize,
}

impl TriangleAdjacency {
    /// The triangle adjacency of `graph`; `None` if the budget has no room for it, and for plain row starts, whose
    /// graphs have more than three neighbours per node. One parallel pass.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn of(graph: Csr<'_>, run: &Run) -> Result<Option<Self>> {
        if let RowStarts::Plain(_) = graph.starts {
            return Ok(None);
        }
        let Some(mut words) = AlignedBuffer::try_new(&run.budget, graph.len() * size_of::<TriangleNeighbours>()) else {
            return Ok(None);
        };
        let all: &mut [TriangleNeighbours] = words.items_mut(graph.len());
        run.fill_chunks(
            all,
            CHUNK,
            || (),
            |k, out, ()| {
                for (node, record) in (k * CHUNK..).zip(out) {
                    let span = graph.span(node as u32);
                    let (next, weights) = (&graph.indices[span.clone()], &graph.weights[span]);
                    *record = TriangleNeighbours { next: [node as u32; 3], weights: [f32::INFINITY; 3] };
                    if next.len() > 3 {
                        record.next[0] = MORE;
                    } else {
                        record.next[..next.len()].copy_from_slice(next);
                        record.weights[..next.len()].copy_from_slice(weights);
                    }
                }
                Ok(())
            },
        )?;
        Ok(Some(Self { words, nodes: graph.len() }))
    }

    /// The records (n).
    pub fn all(&self) -> &[TriangleNeighbours] {
        self.words.items(self.nodes)
    }
}

#[cfg(all(test, feature = "sprs"))]
mod tests {
    use super::*;

    #[test]
    fn the_matrix_is_the_graph() {
        let dir = tempfile::tempdir().unwrap();
        let work = WorkDir::temporary(dir.path()).unwrap();
        let graph = |indices: &[u32]| {
            let weights = work.write("w.npy", &[1f32, 1., 2., 2.], 1).unwrap();
            let indices = work.write("i.npy", indices, 1).unwrap();
            WeightedGraph::new(dir.path(), OwnedRowStarts::of([1, 2, 1]), indices, weights, String::new()).unwrap()
        };
        let path = graph(&[1, 0, 2, 1]);
        let matrix = path.matrix().unwrap();
        for (i, row) in matrix.outer_iterator().enumerate() {
            let steps: Vec<(u32, f32)> = row.indices().iter().copied().zip(row.data().iter().copied()).collect();
            assert_eq!(steps, path.csr().neighbours(i as u32).collect::<Vec<_>>());
        }
        assert!(graph(&[1, 2, 0, 1]).matrix().is_err(), "a row that does not ascend");
        assert!(graph(&[1, 0, 3, 1]).matrix().is_err(), "no such node");
    }
}
