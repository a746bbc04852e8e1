//! Fronts from many sources: which source is nearest to each node, and how far away it is.
//!
//! Over a small mesh this is one front from all sources. It moves over the whole mesh at once, which is fast in caches,
//! but hopeless if the graph is larger than memory, and it uses only one thread. So on large meshes [`BlockDijkstra`]
//! divides the nodes into blocks. In each round, every block that has messages runs its own front, on all threads. An
//! edge that leaves a block becomes a message to the other block, which handles it in the same round unless it has
//! already started. A few rounds suffice, all but the first only at the boundaries of blocks.
//!
//! The result is the fixed point that one front reaches: the least d(v) = min fl(d(u) + w), and the smallest label at
//! equal distances. Both are unique, so the result depends neither on blocks, nor on threads, nor on the order of
//! messages (tested against a binary heap). Labels at ties are checked again using the final distances
//! ([`super::ties`]).
//!
//! Time: in processor time, blocks cost as much as they save (default runs: 2.30 s with them and 2.32 s without over
//! 1.3 M faces, 11.1 and 11.4 s over 10 M); from four million nodes on, their parallelism is a gain. If sources are as
//! dense as those of a contraction, blocks hardly wait for each other, and half a million nodes are enough: over 1.3 M
//! faces two threads take 35 ms by blocks, and one takes 85. Meshes whose neighbours lie far apart in the file would
//! need too many messages: they use the single front, unless they are larger than memory.
//!
//! Memory: the messages, 12 bytes for every edge between blocks: a quarter byte per node or less.

use super::block_front::{Initial, Label, Message, Outcome, Reach, Scratch, Values, front};
use super::front::{Front, clear_labels, typical_weight};
use super::paging::Pages;
use super::queue::Queue;
use super::ties::Ties;
use crate::base::parallel::{fill_two, lock};
use crate::base::{Cancel, Result};
use crate::graph::Csr;
use crate::store::Run;
use crate::store::access::reads_large_pages;
use crate::store::mapped::{Access, advise, prefetch};
use std::ops::Range;
use std::sync::Mutex;

pub use super::block_front::{PIECE_NODES, VisitedPieces};

/// Number of blocks from which on they save time: 26 of a rough mesh cost a fifth more, 150 of a smooth one save a
/// fifth.
const MANY: usize = 64;
/// Maximum number of edges that leave a block, out of [`SAMPLE`], for rounds to be as fast as one front.
const FEW: usize = SAMPLE / 25;
/// Number of edges sampled.
const SAMPLE: usize = 1 << 14;
/// Maximum number of nodes per source for sources to count as dense: the region of one is then narrow compared with a
/// block.
const DENSE: usize = PIECE_NODES / 64;
/// [`MANY`] if sources are dense.
const MANY_IF_DENSE: usize = 8;
/// [`FEW`] if sources are dense.
const FEW_IF_DENSE: usize = SAMPLE / 10;

/// Whether fronts from many sources over `graph` use blocks: if the graph and two values per node exceed what the
/// kernel can keep in memory, or if several threads can share the blocks.
pub fn is_by_blocks(graph: Csr<'_>, run: &Run) -> bool {
    Pages::needed(graph, 8 * graph.len(), run) || are_shared(graph, MANY, FEW, run)
}

/// Whether there are at least `many` blocks, several threads, and at most `few` of [`SAMPLE`] edges that leave a block.
fn are_shared(graph: Csr<'_>, many: usize, few: usize, run: &Run) -> bool {
    run.threads > 1 && graph.len() >= many * PIECE_NODES && edges_between_blocks(graph) <= few
}

/// How many of [`SAMPLE`] evenly spread edges lead from one block to another.
fn edges_between_blocks(graph: Csr<'_>) -> usize {
    let nodes = (0..SAMPLE / 3).map(|k| (k as u64 * graph.len() as u64 / (SAMPLE as u64 / 3)) as u32);
    nodes
        .map(|node| {
            graph.neighbours(node).filter(|(to, _)| *to as usize / PIECE_NODES != node as usize / PIECE_NODES).count()
        })
        .sum()
}

/// Dijkstra by blocks for `graph`; `None` if a single front is better.
fn by_blocks<'a>(graph: Csr<'a>, run: &Run) -> Option<BlockDijkstra<'a>> {
    is_by_blocks(graph, run).then(|| BlockDijkstra::within_budget(graph, run))
}

/// The same for `sources` sources: if they are dense, blocks hardly wait for each other, and fewer of them pay off.
fn by_blocks_from<'a>(graph: Csr<'a>, sources: usize, run: &Run) -> Option<BlockDijkstra<'a>> {
    let dense = || sources >= graph.len() / DENSE && are_shared(graph, MANY_IF_DENSE, FEW_IF_DENSE, run);
    (is_by_blocks(graph, run) || dense()).then(|| BlockDijkstra::within_budget(graph, run))
}

/// The result of [`Front::nearest_source`], by a single front or by blocks.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn nearest_source(graph: Csr<'_>, sources: &[u32], field: &mut [f32], label: &mut [u32], run: &Run) -> Result<()> {
    match by_blocks_from(graph, sources.len(), run) {
        None => Front::over(graph).nearest_source(graph, sources, field, label, &run.cancel).map(drop),
        Some(blocks) => blocks.nearest_source(sources, field, label),
    }
}

/// The result of [`Front::within`], by a single front or by blocks.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn within(graph: Csr<'_>, sources: &[u32], limit: f32, field: &mut [f32], run: &Run) -> Result<()> {
    match by_blocks(graph, run) {
        None => Front::over(graph).within(graph, sources, limit, field, &run.cancel).map(drop),
        Some(blocks) => blocks.within(sources, limit, field),
    }
}

/// The same over a field (n) with any content: pieces that the front does not reach keep it. Returns which pieces were
/// visited. So large fields in files are neither written nor read where the front does not go.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn within_fresh(
    graph: Csr<'_>,
    sources: &[u32],
    limit: f32,
    field: &mut [f32],
    run: &Run,
) -> Result<VisitedPieces> {
    match by_blocks(graph, run) {
        None => {
            run.fill_each(field, PIECE_NODES, |_, _| f32::INFINITY)?;
            Front::over(graph).within(graph, sources, limit, field, &run.cancel)?;
            Ok(VisitedPieces::everything(graph.len()))
        }
        Some(blocks) => blocks.within_fresh(sources, limit, field),
    }
}

/// The result of [`Front::propagate_labels`], by a single front or by blocks.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn propagate_labels(
    graph: Csr<'_>,
    sources: &[u32],
    field: &mut [f32],
    label: &mut [u32],
    run: &Run,
) -> Result<()> {
    match by_blocks(graph, run) {
        None => Front::over(graph).propagate_labels(graph, sources, field, label, &run.cancel).map(drop),
        Some(blocks) => blocks.propagate_labels(sources, field, label),
    }
}

/// Bytes of a cache line.
const CACHE_LINE: usize = 64;
/// Bucket width of these fronts, relative to the mean weight.
const BUCKET_WIDTH: f32 = 0.5;

/// Dijkstra from many sources, block by block in rounds.
#[derive(Clone, Debug)]
pub struct BlockDijkstra<'a> {
    graph: Csr<'a>,
    block: usize,
    threads: usize,
    cancel: Cancel,
    width: f32,
    /// Whether the graph exceeds what the kernel can keep in memory.
    paged: bool,
}

impl<'a> BlockDijkstra<'a> {
    /// For `graph` in blocks of `block` nodes, rounded up to a multiple of [`PIECE_NODES`] if they are larger than
    /// that.
    pub fn new(graph: Csr<'a>, block: usize, threads: usize, cancel: &Cancel) -> Self {
        let block = if block > PIECE_NODES { block.next_multiple_of(PIECE_NODES) } else { block };
        Self {
            graph,
            block,
            threads,
            cancel: cancel.clone(),
            width: typical_weight(graph) * BUCKET_WIDTH,
            paged: false,
        }
    }

    /// For `graph` in blocks that suit the budget.
    pub(super) fn within_budget(graph: Csr<'a>, run: &Run) -> Self {
        // The boundary of a block of B nodes has some 4 √B edges; messages exist twice while they are sorted.
        let bytes_for = |block: usize| 100. * graph.len() as f64 / (block as f64).sqrt();
        let mut block = PIECE_NODES;
        // If paged, prefer larger blocks: a front crosses fewer of them, so there are fewer rounds, each of which reads
        // all that is not in memory.
        let paged = Pages::needed(graph, 8 * graph.len(), run);
        if paged {
            let held = |block: usize| run.threads as u64 * block as u64 * (graph.bytes() / graph.len() as u64 + 8);
            while held(2 * block) <= run.resident / 4 && block < graph.len() / (4 * run.threads) {
                block *= 2;
            }
        }
        while block < graph.len() && bytes_for(block) > run.budget.left() as f64 / 4. {
            block *= 2;
        }
        Self { paged, ..Self::new(graph, block, run.threads, &run.cancel) }
    }

    /// The result of [`Front::nearest_source`].
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn nearest_source(&self, sources: &[u32], field: &mut [f32], label: &mut [u32]) -> Result<()> {
        let seeds = || {
            let message = |(label, &node)| Message { node, distance: 0., label: label as u32 };
            sources.iter().enumerate().map(message).collect::<Vec<_>>()
        };
        let ties = self.propagate(seeds(), f32::INFINITY, Initial::Fresh(u32::MAX), field, label)?;
        if !ties.correct_labels(self.graph, field, label, self.paged, &self.cancel)? {
            // A second front over the final distances: only labels change, and none can become stale.
            label.fill(u32::MAX);
            self.propagate(seeds(), f32::INFINITY, Initial::Given, field, label)?;
        }
        Ok(())
    }

    /// The result of [`Front::within`].
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn within(&self, sources: &[u32], limit: f32, field: &mut [f32]) -> Result<()> {
        sources.iter().for_each(|&node| field[node as usize] = f32::INFINITY);
        self.distances(sources, limit, Initial::Given, field)
    }

    /// The result of [`within_fresh`].
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn within_fresh(&self, sources: &[u32], limit: f32, field: &mut [f32]) -> Result<VisitedPieces> {
        let visited = VisitedPieces::new(self.graph.len(), self.piece(), false);
        self.distances(sources, limit, Initial::FreshWhere(&visited), field)?;
        Ok(visited)
    }

    fn distances(&self, sources: &[u32], limit: f32, initial: Initial<'_, ()>, field: &mut [f32]) -> Result<()> {
        let messages = sources.iter().map(|&node| Message { node, distance: 0., label: () }).collect();
        // Labels of size zero.
        self.propagate(messages, limit, initial, field, &mut vec![(); self.graph.len()]).map(drop)
    }

    /// Number of nodes covered by one front.
    fn piece(&self) -> usize {
        self.block.min(PIECE_NODES)
    }

    /// The result of [`Front::propagate_labels`].
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn propagate_labels(&self, sources: &[u32], field: &mut [f32], label: &mut [u32]) -> Result<()> {
        let once = |field: &mut [f32], label: &mut [u32]| {
            let message = |&node: &u32| Message { node, distance: 0., label: label[node as usize] };
            let messages = sources.iter().map(message).collect();
            sources.iter().for_each(|&node| field[node as usize] = f32::INFINITY);
            self.propagate(messages, f32::INFINITY, Initial::Given, field, label)
        };
        let ties = once(field, label)?;
        if !ties.correct_labels(self.graph, field, label, self.paged, &self.cancel)? {
            clear_labels(field, label);
            once(field, label)?;
        }
        Ok(())
    }

    /// Propagates `messages` and their consequences, to nodes nearer than `limit`, until there are no more; returns the
    /// nodes whose labels may be stale.
    pub(super) fn propagate<O: Label>(
        &self,
        messages: Vec<Message<O>>,
        limit: f32,
        initial: Initial<'_, O>,
        field: &mut [f32],
        label: &mut [O],
    ) -> Result<Ties> {
        let mailboxes: Vec<_> = (0..field.len().div_ceil(self.block)).map(|_| Mutex::new(Vec::new())).collect();
        self.deliver(messages, &mailboxes);
        let mut ties = Ties::default();
        for round in 0.. {
            // The first front from dense sources visits everything, later ones only boundaries of blocks.
            let everything = round == 0 && matches!(initial, Initial::Fresh(_)) && reads_large_pages();
            if !everything {
                self.advise(Access::Random, field, label);
            }
            let paged = self.paged && !everything;
            let front = |k: usize, field: &mut [f32], label: &mut [O], scratch: &mut Scratch| {
                if let (0, Initial::Fresh(none)) = (round, initial) {
                    field.fill(f32::INFINITY);
                    label.fill(none);
                    if paged {
                        self.will_need(k);
                    }
                    self.fetch(k * self.block..k * self.block + field.len());
                }
                let inbox = std::mem::take(&mut *lock(&mailboxes[k]));
                let values = Values { first: k * self.block, field, label };
                let outcome = self.rounds_within(Reach { limit, initial, paged }, values, inbox, scratch)?;
                self.deliver(outcome.messages, &mailboxes);
                Ok(outcome.ties)
            };
            let scratch = || Scratch { queue: Queue::new(self.width), batch: Vec::new() };
            for more in fill_two(self.threads, &self.cancel, (&mut *field, &mut *label), self.block, scratch, front)? {
                ties.add(more, Ties::most(self.graph));
            }
            if mailboxes.iter().all(|mail| lock(mail).is_empty()) {
                break;
            }
        }
        self.advise(Access::Local, field, label);
        Ok(ties)
    }

    /// Puts `messages` into the mailboxes of their blocks.
    fn deliver<O: Label>(&self, mut messages: Vec<Message<O>>, mailboxes: &[Mutex<Vec<Message<O>>>]) {
        let block = |message: &Message<O>| message.node as usize / self.block;
        messages.sort_unstable_by_key(block);
        for group in messages.chunk_by(|a, b| block(a) == block(b)) {
            lock(&mailboxes[block(&group[0])]).extend_from_slice(group);
        }
    }

    /// Asks the kernel to read the rows of block `k` + threads, which some thread will start soon; at the first block,
    /// of all blocks up to that one.
    fn will_need(&self, k: usize) {
        let ahead = if k == 0 { 0..self.threads + 1 } else { k + self.threads..k + self.threads + 1 };
        for nodes in ahead
            .map(|k| k * self.block..((k + 1) * self.block).min(self.graph.len()))
            .filter(|nodes| nodes.start < nodes.end)
        {
            self.graph.will_need_rows(nodes);
        }
    }

    /// Prefetches the rows of `nodes`, all of which a front is about to visit, in memory order; otherwise it would wait
    /// for each of them. Does nothing if the kernel reads them, or if they exceed the cache.
    fn fetch(&self, nodes: Range<usize>) {
        if self.paged || nodes.len() > PIECE_NODES {
            return;
        }
        for entry in self.graph.starts.entries_of(nodes).step_by(CACHE_LINE / size_of::<u32>()) {
            prefetch(self.graph.indices, entry);
            prefetch(self.graph.weights, entry);
        }
    }

    /// Turns the kernel's read-ahead off or on again.
    fn advise<O: Label>(&self, access: Access, field: &[f32], label: &[O]) {
        if self.paged {
            self.graph.advise(access);
            advise(field, access);
            if size_of::<O>() > 0 {
                advise(label, access);
            }
        }
    }

    /// Rounds of fronts inside the block of nodes whose values are passed, over pieces of [`PIECE_NODES`] nodes, until
    /// only messages to other blocks are left.
    fn rounds_within<O: Label>(
        &self,
        reach: Reach<'_, O>,
        values: Values<'_, O>,
        mut messages: Vec<Message<O>>,
        scratch: &mut Scratch,
    ) -> Result<Outcome<O>> {
        let Values { first, .. } = values;
        let piece = |message: &Message<O>| (message.node as usize - first) / PIECE_NODES;
        // By distance within a piece, so that a front starts at the nearest. At equal distances the smaller label
        // first: it may come from a node that was lowered later, and when the larger label meets it, a tie is listed.
        let sort = |messages: &mut [Message<O>]| {
            messages.sort_unstable_by_key(|message| (piece(message), message.distance.to_bits(), message.label));
        };
        if self.block <= PIECE_NODES {
            sort(&mut messages);
            return Ok(front(self.graph, reach, values, &messages, scratch));
        }
        let Values { field, label, .. } = values;
        let mut all = Outcome { messages: Vec::new(), ties: Ties::default() };
        let nodes = first..first + field.len();
        while !messages.is_empty() {
            sort(&mut messages);
            let mut next = Vec::new();
            for group in messages.chunk_by(|a, b| piece(a) == piece(b)) {
                // A block can take seconds.
                self.cancel.check()?;
                let start = piece(&group[0]) * PIECE_NODES;
                let end = (start + PIECE_NODES).min(field.len());
                let (field, label) = (&mut field[start..end], &mut label[start..end]);
                let outcome = front(self.graph, reach, Values { first: first + start, field, label }, group, scratch);
                all.ties.add(outcome.ties, Ties::most(self.graph));
                for message in outcome.messages {
                    let inside = nodes.contains(&(message.node as usize));
                    if inside { next.push(message) } else { all.messages.push(message) }
                }
            }
            messages = next;
        }
        Ok(all)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::OwnedRowStarts;
    use crate::store::Budget;

    /// A ring of `n` nodes, or several, with an edge of length 1 between nodes whose numbers are `step` apart.
    fn ring(n: usize, step: usize) -> (OwnedRowStarts, Vec<u32>, Vec<f32>) {
        let both = |i: usize| {
            let mut next = [(i + step) % n, (i + n - step) % n].map(|j| j as u32);
            next.sort_unstable();
            next
        };
        (OwnedRowStarts::of(std::iter::repeat_n(2, n)), (0..n).flat_map(both).collect(), vec![1.; 2 * n])
    }

    #[test]
    fn fields_are_filled_where_the_front_comes_to() {
        let n = 5 * PIECE_NODES + 77;
        let (starts, indices, weights) = ring(n, 1);
        let graph = Csr::new(starts.view(), &indices, &weights);
        let (sources, limit) = ([10, 3 * PIECE_NODES as u32 + 5_000], 1_000.);
        let mut expected = vec![f32::INFINITY; n];
        Front::new(1.).within(graph, &sources, limit, &mut expected, &Cancel::default()).unwrap();
        // Blocks of several pieces, and pieces that are blocks.
        for block in [2 * PIECE_NODES, PIECE_NODES + 1, PIECE_NODES] {
            let mut field = vec![-7.; n];
            let blocks = BlockDijkstra::new(graph, block, 2, &Cancel::default());
            let visited = blocks.within_fresh(&sources, limit, &mut field).unwrap();
            let pieces: Vec<bool> = (0..n).step_by(PIECE_NODES).map(|node| visited.has(node)).collect();
            assert_eq!(pieces, [true, false, false, true, true, true], "blocks of {block}");
            for node in 0..n {
                let told = if visited.has(node) { expected[node] } else { -7. };
                assert!(field[node] == told && (told >= 0. || expected[node] == f32::INFINITY), "{block}, node {node}");
            }
        }
    }

    /// A node is lowered after it has sent its label to many nodes of another block, by so little that rounding hides
    /// it there. Of its two messages to a node, the later one was handled first where they were sorted by distance
    /// alone, and the stale label won the tie without a trace.
    #[test]
    fn a_label_that_was_sent_before_its_node_was_lowered_does_not_stay() {
        const BLOCK: usize = 64;
        let n = 2 * BLOCK;
        // Node 2 is at .2 from source 0, and at .1 from source 1 by way of node 3.
        let mut rows = vec![Vec::new(); n];
        let far = (BLOCK..n).map(|node| (2, node, 1e7 + (node * 37 % BLOCK) as f32));
        for (a, b, weight) in [(0, 2, 0.2), (1, 3, 0.05), (2, 3, 0.05)].into_iter().chain(far) {
            rows[a].push((b as u32, weight));
            rows[b].push((a as u32, weight));
        }
        let starts = OwnedRowStarts::of(rows.iter().map(Vec::len));
        let (indices, weights): (Vec<u32>, Vec<f32>) = rows.into_iter().flatten().unzip();
        let graph = Csr::new(starts.view(), &indices, &weights);
        let (mut field, mut label) = (vec![0.; n], vec![0; n]);
        let blocks = BlockDijkstra::new(graph, BLOCK, 1, &Cancel::default());
        blocks.nearest_source(&[0, 1], &mut field, &mut label).unwrap();
        assert_eq!(label[..4], [0, 1, 1, 1]);
        assert_eq!(label[BLOCK..], [1; BLOCK]);
    }

    #[test]
    fn blocks_are_for_several_threads_and_near_neighbours() {
        let n = MANY * PIECE_NODES;
        // Neighbours are near or far in number.
        for (step, near) in [(1, true), (PIECE_NODES + 1, false)] {
            let (starts, indices, weights) = ring(n, step);
            let graph = Csr::new(starts.view(), &indices, &weights);
            let sources: Vec<u32> = (0..n as u32).step_by(5_001).collect();
            let (mut fields, mut labels) = ([vec![0f32; n], vec![0f32; n]], [vec![0u32; n], vec![0u32; n]]);
            for (k, threads) in [1, 2].into_iter().enumerate() {
                let run = Run { threads, budget: Budget::new(1 << 30), resident: 1 << 40, ..Run::new(&()) };
                assert_eq!(is_by_blocks(graph, &run), near && threads > 1);
                nearest_source(graph, &sources, &mut fields[k], &mut labels[k], &run).unwrap();
            }
            assert!(fields[0] == fields[1] && labels[0] == labels[1], "step {step}");
        }
    }

    #[test]
    fn fewer_blocks_are_enough_where_sources_are_dense() {
        let n = MANY_IF_DENSE * PIECE_NODES + 1_000;
        for (step, every, dense) in [(1, 50, true), (1, 7_001, false), (PIECE_NODES + 1, 50, false)] {
            let (starts, indices, weights) = ring(n, step);
            let graph = Csr::new(starts.view(), &indices, &weights);
            let sources: Vec<u32> = (0..n as u32).step_by(every).collect();
            let (mut fields, mut labels) = ([vec![0f32; n], vec![0f32; n]], [vec![0u32; n], vec![0u32; n]]);
            for (k, threads) in [1, 2].into_iter().enumerate() {
                let run = Run { threads, budget: Budget::new(1 << 30), resident: 1 << 40, ..Run::new(&()) };
                assert!(!is_by_blocks(graph, &run));
                let by_blocks = by_blocks_from(graph, sources.len(), &run).is_some();
                assert_eq!(by_blocks, dense && threads > 1, "{step} {every} {threads}");
                nearest_source(graph, &sources, &mut fields[k], &mut labels[k], &run).unwrap();
            }
            assert!(fields[0] == fields[1] && labels[0] == labels[1], "{step} {every}");
        }
    }
}
