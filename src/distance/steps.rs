//! The edges of a node as a front iterates over them, and its prefetching.
//!
//! A front visits nodes in random order, so it prefetches in three stages, each of which reads what the previous one
//! has fetched. Memory: none. Time: a few instructions per entry, against a cache miss of some 100 ns each.

use super::queue::Entry;
use crate::graph::Csr;
use crate::graph::csr::TriangleNeighbours;
use crate::store::mapped::prefetch;
use std::ops::Range;

/// Entries ahead at which row start and distance are prefetched.
pub const FAR: usize = 48;
/// Entries ahead at which neighbours and weights are prefetched.
pub const MID: usize = 32;
/// Entries ahead at which the neighbours' distances are prefetched.
pub const NEAR: usize = 16;

/// A graph as seen by a front.
pub(super) trait Steps: Copy {
    /// Prefetches the row start of a node, which [`Steps::prefetch_entries`] reads.
    fn prefetch_row_start(self, node: u32);
    /// Prefetches the entries of a node's row, which [`Steps::each`] reads.
    fn prefetch_entries(self, node: u32);
    /// The number of edges of a node, or an upper bound.
    fn count(self, node: u32) -> usize;
    /// Calls `visit` with neighbours and weights.
    #[inline(always)]
    fn each(self, node: u32, visit: impl FnMut(u32, f32)) {
        self.first(node, usize::MAX, visit);
    }
    /// The same for the first `most` of a row of more than three.
    fn first(self, node: u32, most: usize, visit: impl FnMut(u32, f32));
}

impl Steps for Csr<'_> {
    #[inline(always)]
    fn prefetch_row_start(self, node: u32) {
        self.starts.prefetch(node);
    }

    #[inline(always)]
    fn prefetch_entries(self, node: u32) {
        self.prefetch(node);
    }

    #[inline(always)]
    fn count(self, node: u32) -> usize {
        self.span(node).len()
    }

    #[inline(always)]
    fn first(self, node: u32, most: usize, mut visit: impl FnMut(u32, f32)) {
        for (next, weight) in self.neighbours(node).take(most) {
            visit(next, weight);
        }
    }
}

/// A graph with plain row starts.
#[derive(Clone, Copy)]
pub(super) struct Plain<'a> {
    pub starts: &'a [u64],
    pub csr: Csr<'a>,
}

impl Plain<'_> {
    #[inline(always)]
    fn span(self, node: u32) -> Range<usize> {
        self.starts[node as usize] as usize..self.starts[node as usize + 1] as usize
    }
}

impl Steps for Plain<'_> {
    #[inline(always)]
    fn prefetch_row_start(self, node: u32) {
        prefetch(self.starts, node as usize);
    }

    #[inline(always)]
    fn prefetch_entries(self, node: u32) {
        self.csr.prefetch_from(self.span(node).start);
    }

    #[inline(always)]
    fn count(self, node: u32) -> usize {
        self.span(node).len()
    }

    #[inline(always)]
    fn first(self, node: u32, most: usize, mut visit: impl FnMut(u32, f32)) {
        let span = self.span(node);
        let (next, weights) = (&self.csr.indices[span.clone()], &self.csr.weights[span]);
        for k in 0..next.len().min(most) {
            visit(next[k], weights[k]);
        }
    }
}

/// A graph with its triangle adjacency.
#[derive(Clone, Copy)]
pub(super) struct Packed<'a> {
    pub csr: &'a Csr<'a>,
    pub triangles: &'a [TriangleNeighbours],
}

impl Steps for Packed<'_> {
    #[inline(always)]
    fn prefetch_row_start(self, node: u32) {
        prefetch(self.triangles, node as usize);
        // A record may straddle two cache lines; then the next record starts in the second.
        prefetch(self.triangles, node as usize + 1);
    }

    #[inline(always)]
    fn prefetch_entries(self, _: u32) {}

    #[inline(always)]
    fn count(self, node: u32) -> usize {
        if self.triangles[node as usize].steps().is_some() { 3 } else { many(self.csr, node).0.len() }
    }

    #[inline(always)]
    fn first(self, node: u32, most: usize, mut visit: impl FnMut(u32, f32)) {
        match self.triangles[node as usize].steps() {
            Some((next, weights)) => {
                visit(next[0], weights[0]);
                visit(next[1], weights[1]);
                visit(next[2], weights[2]);
            }
            None => {
                let (next, weights) = many(self.csr, node);
                for k in 0..next.len().min(most) {
                    visit(next[k], weights[k]);
                }
            }
        }
    }
}

/// The edges of a node that has more than three, which is rare. Kept out of the loop over records, whose variables then
/// stay in registers.
#[cold]
#[inline(never)]
fn many<'a>(graph: &Csr<'a>, node: u32) -> (&'a [u32], &'a [f32]) {
    let span = graph.span(node);
    (&graph.indices[span.clone()], &graph.weights[span])
}

/// Prefetches for the first entries of a batch what [`look_ahead`] would have prefetched earlier.
#[inline(always)]
pub(super) fn warm_up(batch: &[Entry], graph: impl Steps, field: &[f32]) {
    for entry in batch.iter().take(FAR) {
        graph.prefetch_row_start(entry.node);
        prefetch(field, entry.node as usize);
    }
    for entry in batch.iter().take(MID) {
        graph.prefetch_entries(entry.node);
    }
}

/// Neighbours of a node that are prefetched, and from which on its row is not walked for a stale entry: a polygon among
/// many small faces is lowered as often as it has neighbours, which took time quadratic in their number.
pub(super) const LONG_ROW: usize = 16;

/// The three stages of prefetching, for the entries after the `k`-th.
#[inline(always)]
pub(super) fn look_ahead(batch: &[Entry], k: usize, graph: impl Steps, field: &[f32]) {
    if let Some(entry) = batch.get(k + FAR) {
        graph.prefetch_row_start(entry.node);
        prefetch(field, entry.node as usize);
    }
    if let Some(entry) = batch.get(k + MID) {
        graph.prefetch_entries(entry.node);
    }
    if let Some(entry) = batch.get(k + NEAR) {
        graph.first(entry.node, LONG_ROW, |next, _| prefetch(field, next as usize));
    }
}
