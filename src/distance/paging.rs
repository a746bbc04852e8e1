//! Which parts of the graph a front needs next, told to the kernel: fronts over graphs larger than memory.
//!
//! A front crosses a mesh as a narrow band, so of a graph in a good order few pages are in use at a time; each has to
//! be read only once a row. Left to itself, the kernel spoils this twice: read-ahead around every fault brings in
//! megabytes for the sake of a page (8 MiB on some disks), and without read-ahead every page is waited for. So mappings
//! are read without read-ahead, and the nodes, in blocks of [`BLOCK_NODES`], are asked for when the front first pushes
//! a node of theirs, which is some buckets before it reads their rows. Values behind the band are sent to the disk
//! early: a control group that fills with changed pages stalls.
//!
//! A fresh field is filled with infinity block by block too, so that no row is written twice. Memory: 10 bytes a
//! block. The values are the same as without (tested); where everything fits, fronts run without [`Pages`].

use crate::graph::{Csr, RowStarts};
use crate::store::Run;
use crate::store::mapped::{Access, Writeback, advise, will_need};
use std::collections::VecDeque;
use std::ops::Range;
use std::sync::Arc;

/// Nodes a block, a power of two: some 400 KiB of graph, a read that a disk does at nearly full speed.
pub const BLOCK_NODES: usize = 1 << SHIFT;
pub(super) const SHIFT: u32 = 14;
/// Blocks met after a block before its values are sent to the disk: more than a band is long.
const LAG: usize = 256;

/// Hears from a front where it goes; `()` does not care.
pub(super) trait Pager {
    /// Called for every step, before the value of `to` in `field` is read.
    fn meet(&mut self, from: u32, to: u32, field: &mut [f32]);
}

impl Pager for () {
    #[inline(always)]
    fn meet(&mut self, _: u32, _: u32, _: &mut [f32]) {}
}

/// Pages of a graph; `met` sees the part of the field that lies in a block met for the first time.
pub(super) struct Paged<'a, 'g, F> {
    pub graph: Csr<'g>,
    pub pages: &'a mut Pages,
    pub met: F,
}

impl<F: Fn(&mut [f32])> Pager for Paged<'_, '_, F> {
    #[inline(always)]
    fn meet(&mut self, from: u32, to: u32, field: &mut [f32]) {
        if (from ^ to) >> SHIFT != 0
            && let Some(block) = self.pages.enter(self.graph, to)
        {
            (self.met)(&mut field[block]);
        }
    }
}

/// Asks the kernel to read the rows of `nodes`, without waiting for any but their starts.
pub(super) fn rows_needed(graph: Csr<'_>, nodes: Range<usize>) {
    entries_needed(graph, nodes.clone(), graph.starts.entries_of(nodes));
}

/// The same for `nodes` whose rows are known to be those `entries` of `graph`.
fn entries_needed(graph: Csr<'_>, nodes: Range<usize>, entries: Range<usize>) {
    graph.starts.will_need(nodes);
    will_need(&graph.indices[entries.clone()]);
    will_need(&graph.weights[entries]);
}

/// First entry of the rows of each block of `1 << shift` nodes, and the number of entries.
pub(super) fn block_starts(starts: RowStarts<'_>, shift: u32) -> Vec<u64> {
    let first = |block: usize| starts.span((block << shift) as u32).start as u64;
    (0..starts.len().div_ceil(1 << shift)).map(first).chain([starts.entries() as u64]).collect()
}

/// A graph in blocks, and which of them a front has met.
#[derive(Clone, Debug)]
pub struct Pages {
    nodes: usize,
    /// First entry of each block's rows (blocks + 1).
    starts: Arc<[u64]>,
    met: Vec<bool>,
    /// Blocks whose values may not be on their way to the disk yet, the one met first in front.
    unsent: VecDeque<u32>,
    values: Option<Writeback>,
}

impl Pages {
    /// The blocks of `graph`. Reads one row start a block.
    pub fn of(graph: Csr<'_>) -> Self {
        let starts = block_starts(graph.starts, SHIFT);
        let met = vec![false; starts.len() - 1];
        Self { nodes: graph.len(), starts: starts.into(), met, unsent: VecDeque::new(), values: None }
    }

    /// Whether `graph` and `bytes` of values are more than the kernel can keep in memory.
    pub(super) fn needed(graph: Csr<'_>, bytes: usize, run: &Run) -> bool {
        graph.bytes() + bytes as u64 > run.resident
    }

    /// Lends the blocks of `graph` to `work` where they are [needed](Pages::needed); the kernel then reads nothing
    /// ahead by itself meanwhile.
    pub(super) fn lend<R>(graph: Csr<'_>, bytes: usize, run: &Run, work: impl FnOnce(Option<Self>) -> R) -> R {
        if !Self::needed(graph, bytes, run) {
            return work(None);
        }
        Self::advise(graph, Access::Random);
        let result = work(Some(Self::of(graph)));
        Self::advise(graph, Access::Local);
        result
    }

    pub(super) fn advise(graph: Csr<'_>, access: Access) {
        graph.starts.advise(access);
        advise(graph.indices, access);
        advise(graph.weights, access);
    }

    /// The next fronts' values lie in the file of `values`.
    pub(super) fn values(&mut self, values: Option<Writeback>) {
        self.values = values;
    }

    /// Forgets what was met.
    pub(super) fn restart(&mut self) {
        self.met.fill(false);
        self.unsent.clear();
    }

    /// Nodes of the blocks that were not met.
    pub(super) fn unmet(&self) -> impl Iterator<Item = Range<usize>> + '_ {
        self.met.iter().enumerate().filter(|(_, met)| !**met).map(|(block, _)| self.block(block))
    }

    /// Enters the block of `node` if it was not met.
    pub(super) fn enter(&mut self, graph: Csr<'_>, node: u32) -> Option<Range<usize>> {
        let block = (node >> SHIFT) as usize;
        if std::mem::replace(&mut self.met[block], true) {
            return None;
        }
        let nodes = self.block(block);
        entries_needed(graph, nodes.clone(), self.starts[block] as usize..self.starts[block + 1] as usize);
        self.unsent.push_back(block as u32);
        if self.unsent.len() > LAG {
            self.send();
        }
        Some(nodes)
    }

    /// Starts writing the values of the block met first.
    fn send(&mut self) {
        if let (Some(block), Some(values)) = (self.unsent.pop_front(), &self.values) {
            values.start(self.block(block as usize));
        }
    }

    /// Starts writing all values that are not on their way.
    pub(super) fn send_all(&mut self) {
        while !self.unsent.is_empty() {
            self.send();
        }
    }

    fn block(&self, block: usize) -> Range<usize> {
        block * BLOCK_NODES..((block + 1) * BLOCK_NODES).min(self.nodes)
    }
}
