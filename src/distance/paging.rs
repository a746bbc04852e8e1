//! Tells the kernel which parts of the graph a front needs next: for fronts over graphs larger than memory.
//!
//! A front crosses a mesh as a narrow band, so if the order is good few pages are in use at a time; each has to be read
//! only once per row. The kernel's defaults prevent this: read-ahead around every fault reads megabytes for the sake of
//! a page (8 MiB on some disks), and without read-ahead every page is waited for. So mappings are read without
//! read-ahead, and blocks of [`BLOCK_NODES`] nodes are requested when the front first pushes one of their nodes, which
//! is some buckets before it reads their rows. Values behind the band are written back early: a control group full of
//! dirty pages stalls.
//!
//! A fresh field is filled with infinity block by block too, so that no row is written twice. Memory: 10 bytes per
//! block. The values are the same as without paging (tested); if everything fits in memory, fronts run without
//! [`Pages`].

use crate::graph::{Csr, RowStarts};
use crate::store::Run;
use crate::store::mapped::{Access, Writeback};
use std::collections::VecDeque;
use std::ops::Range;
use std::sync::Arc;

/// Nodes per block, a power of two: some 400 KiB of graph, a read that a disk does at nearly full speed.
pub const BLOCK_NODES: usize = 1 << SHIFT;
pub(super) const SHIFT: u32 = 14;
/// Blocks entered after a block before its values are written back: more than the length of a band.
const WRITEBACK_DELAY: usize = 256;

/// Is notified where a front goes; `()` ignores it.
pub(super) trait Pager {
    /// Called for every edge, before the value of `to` in `field` is read.
    fn follow_edge(&mut self, from: u32, to: u32, field: &mut [f32]);
}

impl Pager for () {
    #[inline(always)]
    fn follow_edge(&mut self, _: u32, _: u32, _: &mut [f32]) {}
}

/// Pages of a graph; `on_enter` is called with the part of the field in a block that is entered for the first time.
pub(super) struct Paged<'a, 'g, F> {
    pub graph: Csr<'g>,
    pub pages: &'a mut Pages,
    pub on_enter: F,
}

impl<F: Fn(&mut [f32])> Pager for Paged<'_, '_, F> {
    #[inline(always)]
    fn follow_edge(&mut self, from: u32, to: u32, field: &mut [f32]) {
        if (from ^ to) >> SHIFT != 0
            && let Some(block) = self.pages.enter(self.graph, to)
        {
            (self.on_enter)(&mut field[block]);
        }
    }
}

/// First entry of the rows of each block of `1 << shift` nodes, followed by the number of entries.
pub(super) fn block_starts(starts: RowStarts<'_>, shift: u32) -> Vec<u64> {
    let first = |block: usize| starts.span((block << shift) as u32).start as u64;
    (0..starts.len().div_ceil(1 << shift)).map(first).chain([starts.entries() as u64]).collect()
}

/// A graph in blocks, and which of them a front has entered.
#[derive(Clone, Debug)]
pub struct Pages {
    nodes: usize,
    /// First entry of each block's rows (blocks + 1).
    starts: Arc<[u64]>,
    entered: Vec<bool>,
    /// Blocks whose values may not be written back yet, in the order of entering.
    unsent: VecDeque<u32>,
    values: Option<Writeback>,
}

impl Pages {
    /// The blocks of `graph`. Reads one row start per block.
    pub fn of(graph: Csr<'_>) -> Self {
        let starts = block_starts(graph.starts, SHIFT);
        let entered = vec![false; starts.len() - 1];
        Self { nodes: graph.len(), starts: starts.into(), entered, unsent: VecDeque::new(), values: None }
    }

    /// Whether `graph` and `bytes` of values exceed what the kernel can keep in memory.
    pub(super) fn needed(graph: Csr<'_>, bytes: usize, run: &Run) -> bool {
        graph.bytes() + bytes as u64 > run.resident
    }

    /// Passes the blocks of `graph` to `work` if they are [needed](Pages::needed); meanwhile the kernel's own
    /// read-ahead is off.
    pub(super) fn with_pages<R>(graph: Csr<'_>, bytes: usize, run: &Run, work: impl FnOnce(Option<Self>) -> R) -> R {
        if !Self::needed(graph, bytes, run) {
            return work(None);
        }
        graph.advise(Access::Random);
        let result = work(Some(Self::of(graph)));
        graph.advise(Access::Local);
        result
    }

    /// Sets the file of the next fronts' values.
    pub(super) fn values(&mut self, values: Option<Writeback>) {
        self.values = values;
    }

    /// Marks all blocks as not entered.
    pub(super) fn restart(&mut self) {
        self.entered.fill(false);
        self.unsent.clear();
    }

    /// Nodes of the blocks that were not entered.
    pub(super) fn not_entered(&self) -> impl Iterator<Item = Range<usize>> + '_ {
        self.entered.iter().enumerate().filter(|(_, entered)| !**entered).map(|(block, _)| self.block(block))
    }

    /// Enters the block of `node`; returns its nodes if it was not entered before.
    pub(super) fn enter(&mut self, graph: Csr<'_>, node: u32) -> Option<Range<usize>> {
        let block = (node >> SHIFT) as usize;
        if std::mem::replace(&mut self.entered[block], true) {
            return None;
        }
        let nodes = self.block(block);
        graph.will_need_entries(nodes.clone(), self.starts[block] as usize..self.starts[block + 1] as usize);
        self.unsent.push_back(block as u32);
        if self.unsent.len() > WRITEBACK_DELAY {
            self.send();
        }
        Some(nodes)
    }

    /// Starts writing back the values of the block entered first.
    fn send(&mut self) {
        if let (Some(block), Some(values)) = (self.unsent.pop_front(), &self.values) {
            values.start(self.block(block as usize));
        }
    }

    /// Starts writing back all remaining values.
    pub(super) fn send_all(&mut self) {
        while !self.unsent.is_empty() {
            self.send();
        }
    }

    fn block(&self, block: usize) -> Range<usize> {
        block * BLOCK_NODES..((block + 1) * BLOCK_NODES).min(self.nodes)
    }
}
