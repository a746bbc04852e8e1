//! The front within one block of nodes: what [`super::voronoi`] runs side by side, and what it leaves for other blocks.
//!
//! A front over at most [`PIECE_NODES`] nodes, whose rows and values stay near the processor. A step that leaves them
//! becomes a [`Message`]. As in [`super::front`], steps that shorten a path are gathered without a branch before any is
//! taken: 6 % less time. Where the graph is larger than memory, rows and values are asked for as the front comes to
//! them.
//!
//! Memory: the queue, and 12 bytes for each step that is gathered or leaves.

use super::front::GATHER;
use super::paging::{SHIFT, rows_needed};
use super::queue::{Entry, Queue};
use super::ties::Ties;
use crate::graph::Csr;
use crate::store::mapped::will_need;
use std::sync::atomic::{AtomicBool, Ordering};

/// Nodes that one front goes over at the most, and nodes of a block at the least: with rows and
/// values 2.5 MB, a good read.
pub const PIECE_NODES: usize = 1 << 16;

/// A label that travels with distances: a number, or nothing at all.
pub trait Label: Copy + Ord + Send + Sync {}
impl Label for u32 {}
impl Label for () {}

/// A shorter path to `node`: from a source, or from a neighbour in another block.
#[derive(Clone, Copy, Debug)]
pub(super) struct Message<O> {
    pub node: u32,
    pub distance: f32,
    pub label: O,
}

/// What a block's front left.
pub(super) struct Outcome<O> {
    pub messages: Vec<Message<O>>,
    pub ties: Ties,
}

/// Which pieces of a graph, runs of some 2¹⁶ nodes, a front has visited: only there its field has been filled.
#[derive(Debug)]
pub struct VisitedPieces {
    piece: usize,
    pieces: Vec<AtomicBool>,
}

impl VisitedPieces {
    pub(super) fn new(n: usize, piece: usize, visited: bool) -> Self {
        Self { piece, pieces: (0..n.div_ceil(piece)).map(|_| AtomicBool::new(visited)).collect() }
    }

    /// All of `n` nodes.
    pub fn everything(n: usize) -> Self {
        Self::new(n, PIECE_NODES, true)
    }

    /// Whether the piece with `node` was visited.
    #[inline]
    pub fn has(&self, node: usize) -> bool {
        self.pieces[node / self.piece].load(Ordering::Relaxed)
    }

    /// Marks the piece with `node` as visited. Returns whether it was not before.
    fn enter(&self, node: usize) -> bool {
        !self.pieces[node / self.piece].swap(true, Ordering::Relaxed)
    }
}

/// What field and labels hold where a front begins.
#[derive(Clone, Copy)]
pub(super) enum Initial<'v, O> {
    /// What they are given with.
    Given,
    /// Infinity and this label, filled in block by block, so that nothing is written twice.
    Fresh(O),
    /// Infinity, filled in where the front comes to. Labels are as given.
    FreshWhere(&'v VisitedPieces),
}

/// How far fronts go, and what they find there.
#[derive(Clone, Copy)]
pub(super) struct Reach<'v, O> {
    /// Nodes at this distance or beyond are not visited.
    pub limit: f32,
    pub initial: Initial<'v, O>,
}

/// The values of consecutive nodes.
pub(super) struct Values<'a, O> {
    /// The first of the nodes.
    pub first: usize,
    pub field: &'a mut [f32],
    pub label: &'a mut [O],
}

/// Memory for fronts, one after another.
pub(super) struct Scratch {
    pub queue: Queue,
    pub batch: Vec<Entry>,
}

/// The front inside the nodes whose values are given, from the messages of `inbox`, the
/// nearest of which is the first.
pub(super) fn front<O: Label>(
    graph: Csr<'_>,
    paged: bool,
    Reach { limit, initial }: Reach<'_, O>,
    Values { first, field, label }: Values<'_, O>,
    inbox: &[Message<O>],
    Scratch { queue, batch }: &mut Scratch,
) -> Outcome<O> {
    let len = field.len();
    if let (Initial::FreshWhere(visited), false) = (initial, inbox.is_empty())
        && visited.enter(first)
    {
        field.fill(f32::INFINITY);
    }
    let pages = if paged { len.div_ceil(1 << SHIFT) } else { 0 };
    let (mut met, mut entered) = (vec![false; pages], vec![false; pages]);
    let mut block = Block { field, label, ties: Vec::new() };
    let mut meet = |to: usize, block: &Block<'_, O>| {
        if let Some(met @ false) = met.get_mut(to >> SHIFT) {
            *met = true;
            block.values_needed(to >> SHIFT << SHIFT);
        }
    };
    // Most steps from one block to another reach nothing, and need no rows.
    let mut enter = |to: usize| {
        if let Some(entered @ false) = entered.get_mut(to >> SHIFT) {
            *entered = true;
            let from = to >> SHIFT << SHIFT;
            rows_needed(graph, first + from..first + (from + (1 << SHIFT)).min(len));
        }
    };
    let (mut messages, mut shorter) = (Vec::new(), Vec::<Message<O>>::new());
    let Some(nearest) = inbox.first() else { return Outcome { messages, ties: Ties::default() } };
    queue.restart(nearest.distance);
    for message in inbox {
        let to = message.node as usize - first;
        meet(to, &block);
        if block.reach(to, message.distance, message.label) {
            enter(to);
            queue.push(Entry { node: to as u32, distance: message.distance });
        }
    }
    while queue.pop_bucket(batch) {
        for entries in batch.chunks(GATHER) {
            let mut count = 0;
            for &Entry { node, distance } in entries {
                // Lowered since it was pushed, it is of no use: a later entry does the work.
                let useful = block.field[node as usize] >= distance;
                let (row, own) = (first as u32 + node, block.label[node as usize]);
                let most = count + graph.span(row).len();
                if most > shorter.len() {
                    shorter.resize(most + 4 * GATHER, Message { node: 0, distance: 0., label: own });
                }
                for (next, weight) in graph.neighbours(row) {
                    let there = distance + weight;
                    let useful = useful & (there < limit);
                    let to = (next as usize).wrapping_sub(first);
                    if to >= block.field.len() {
                        if useful {
                            messages.push(Message { node: next, distance: there, label: own });
                        }
                        continue;
                    }
                    meet(to, &block);
                    shorter[count] = Message { node: to as u32, distance: there, label: own };
                    count += usize::from(useful & (there <= block.field[to]));
                }
            }
            for &Message { node, distance, label } in &shorter[..count] {
                if block.reach(node as usize, distance, label) {
                    enter(node as usize);
                    queue.push(Entry { node, distance });
                }
            }
        }
        batch.clear();
    }
    let ties = block.ties.into_iter().map(|node| first as u32 + node).collect();
    let ties = Ties::of(ties, Ties::most(graph));
    Outcome { messages, ties }
}

/// The values of a block of nodes.
struct Block<'a, O> {
    field: &'a mut [f32],
    label: &'a mut [O],
    /// Nodes that met a tie which they had won.
    ties: Vec<u32>,
}

impl<O: Label> Block<'_, O> {
    /// Asks the kernel to read the values of a front's next 2¹⁴ nodes, from `from` on, of this block.
    #[cold]
    fn values_needed(&self, from: usize) {
        let end = (from + (1 << SHIFT)).min(self.field.len());
        will_need(&self.field[from..end]);
        if size_of::<O>() > 0 {
            will_need(&self.label[from..end]);
        }
    }

    /// Whether the node `to` of the block is nearer on this path, or as near and won by a smaller label; if so, it is
    /// entered.
    #[inline(always)]
    fn reach(&mut self, to: usize, distance: f32, own: O) -> bool {
        let nearer = distance < self.field[to];
        if nearer || (distance == self.field[to] && own < self.label[to]) {
            self.field[to] = distance;
            self.label[to] = own;
            return true;
        }
        if distance == self.field[to] && own > self.label[to] {
            self.ties.push(to as u32);
        }
        false
    }
}
