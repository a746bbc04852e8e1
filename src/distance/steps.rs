//! The steps from a node as a front walks them, and what it fetches ahead.

use super::queue::Entry;
use crate::graph::Csr;
use crate::graph::csr::TriangleNeighbours;
use crate::store::mapped::prefetch;

/// Entries ahead at which row start and distance are fetched.
pub const FAR: usize = 48;
/// Entries ahead at which neighbours and weights are fetched.
pub const MID: usize = 32;
/// Entries ahead at which the neighbours' distances are fetched.
pub const NEAR: usize = 16;

/// A graph as a front walks it.
pub(super) trait Steps: Copy {
    /// Fetches what [`Steps::sooner`] reads.
    fn soon(self, node: u32);
    /// Fetches what [`Steps::each`] reads.
    fn sooner(self, node: u32);
    /// The number of steps from a node, or a bound on it.
    fn count(self, node: u32) -> usize;
    /// Calls `visit` with neighbours and weights.
    fn each(self, node: u32, visit: impl FnMut(u32, f32));
}

impl Steps for Csr<'_> {
    #[inline(always)]
    fn soon(self, node: u32) {
        prefetch(self.indptr, node as usize);
    }

    #[inline(always)]
    fn sooner(self, node: u32) {
        let start = self.indptr[node as usize] as usize;
        prefetch(self.indices, start);
        prefetch(self.weights, start);
        prefetch(self.weights, start + 2);
    }

    #[inline(always)]
    fn count(self, node: u32) -> usize {
        self.span(node).len()
    }

    #[inline(always)]
    fn each(self, node: u32, mut visit: impl FnMut(u32, f32)) {
        for (next, weight) in self.neighbours(node) {
            visit(next, weight);
        }
    }
}

/// A graph with its triangle adjacency.
#[derive(Clone, Copy)]
pub(super) struct Packed<'a> {
    pub csr: Csr<'a>,
    pub triangles: &'a [TriangleNeighbours],
}

impl Steps for Packed<'_> {
    #[inline(always)]
    fn soon(self, node: u32) {
        prefetch(self.triangles, node as usize);
        // A record may lie across two lines; where it does, the next one begins in the second.
        prefetch(self.triangles, node as usize + 1);
    }

    #[inline(always)]
    fn sooner(self, _: u32) {}

    #[inline(always)]
    fn count(self, node: u32) -> usize {
        if self.triangles[node as usize].steps().is_some() { 3 } else { self.csr.count(node) }
    }

    #[inline(always)]
    fn each(self, node: u32, mut visit: impl FnMut(u32, f32)) {
        match self.triangles[node as usize].steps() {
            Some((next, weights)) => {
                visit(next[0], weights[0]);
                visit(next[1], weights[1]);
                visit(next[2], weights[2]);
            }
            None => self.csr.each(node, visit),
        }
    }
}

/// Fetches for the first entries of a batch what [`look_ahead`] would have fetched before them.
#[inline(always)]
pub(super) fn warm_up(batch: &[Entry], graph: impl Steps, field: &[f32]) {
    for entry in batch.iter().take(FAR) {
        graph.soon(entry.node);
        prefetch(field, entry.node as usize);
    }
    for entry in batch.iter().take(MID) {
        graph.sooner(entry.node);
    }
}

/// The three steps of fetching, for the entries after the `k`-th.
#[inline(always)]
pub(super) fn look_ahead(batch: &[Entry], k: usize, graph: impl Steps, field: &[f32]) {
    if let Some(entry) = batch.get(k + FAR) {
        graph.soon(entry.node);
        prefetch(field, entry.node as usize);
    }
    if let Some(entry) = batch.get(k + MID) {
        graph.sooner(entry.node);
    }
    if let Some(entry) = batch.get(k + NEAR) {
        graph.each(entry.node, |next, _| prefetch(field, next as usize));
    }
}
