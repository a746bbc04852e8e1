//! The front within one block of nodes: [`super::voronoi`] runs one per block, and collects its messages to other
//! blocks.
//!
//! A front over at most [`PIECE_NODES`] nodes, whose rows and values stay close to the processor. An edge that leaves
//! them becomes a [`Message`]. As in [`super::front`], edges that shorten a path are gathered without branching before
//! any is followed: 6 % less time. If the graph is larger than memory, rows and values are requested as the front
//! reaches them.
//!
//! Memory: the queue, and 12 bytes for each gathered edge and each message.

use super::front::GATHER;
use super::paging::SHIFT;
use super::queue::{Entry, Queue};
use super::steps::LONG_ROW;
use super::ties::Ties;
use crate::graph::Csr;
use crate::store::mapped::will_need;
use std::sync::atomic::{AtomicBool, Ordering};

/// Maximum number of nodes of one front, and minimum of a block: with rows and values 2.5 MB, an efficient read.
pub const PIECE_NODES: usize = 1 << 16;

/// A label that travels with distances: a number, or `()` for none.
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

/// The result of a block's front.
pub(super) struct Outcome<O> {
    pub messages: Vec<Message<O>>,
    pub ties: Ties,
}

/// Which pieces of a graph, runs of some 2¹⁶ nodes, a front has visited. Its field is initialised only there.
#[derive(Debug)]
pub struct VisitedPieces {
    piece: usize,
    pieces: Vec<AtomicBool>,
}

impl VisitedPieces {
    pub(super) fn new(n: usize, piece: usize, visited: bool) -> Self {
        Self { piece, pieces: (0..n.div_ceil(piece)).map(|_| AtomicBool::new(visited)).collect() }
    }

    /// All pieces of `n` nodes.
    pub fn everything(n: usize) -> Self {
        Self::new(n, PIECE_NODES, true)
    }

    /// Whether the piece of `node` was visited.
    #[inline]
    pub fn has(&self, node: usize) -> bool {
        self.pieces[node / self.piece].load(Ordering::Relaxed)
    }

    /// Marks the piece of `node` as visited. Returns whether it was not before.
    fn enter(&self, node: usize) -> bool {
        !self.pieces[node / self.piece].swap(true, Ordering::Relaxed)
    }
}

/// The initial content of field and labels.
#[derive(Clone, Copy)]
pub(super) enum Initial<'v, O> {
    /// As passed in.
    Given,
    /// Infinity and this label, filled in block by block, so that nothing is written twice.
    Fresh(O),
    /// Infinity, filled in only where the front goes. Labels as passed in.
    FreshWhere(&'v VisitedPieces),
}

/// The limit of a front, the initial content of its values, and how they are read.
#[derive(Clone, Copy)]
pub(super) struct Reach<'v, O> {
    /// Nodes at this distance or beyond are not visited.
    pub limit: f32,
    pub initial: Initial<'v, O>,
    /// Whether rows and values are requested from the kernel as the front reaches them.
    pub paged: bool,
}

/// The values of consecutive nodes.
pub(super) struct Values<'a, O> {
    /// The first of the nodes.
    pub first: usize,
    pub field: &'a mut [f32],
    pub label: &'a mut [O],
}

/// Buffers for fronts, one after another.
pub(super) struct Scratch {
    pub queue: Queue,
    pub batch: Vec<Entry>,
}

/// Runs the front inside the nodes whose values are passed, starting from the messages of `inbox`, nearest first.
pub(super) fn front<O: Label>(
    graph: Csr<'_>,
    Reach { limit, initial, paged }: Reach<'_, O>,
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
    let (mut has_values, mut has_rows) = (vec![false; pages], vec![false; pages]);
    let mut block = Block { field, label, ties: Vec::new() };
    let mut request_values = |to: usize, block: &Block<'_, O>| {
        if let Some(requested @ false) = has_values.get_mut(to >> SHIFT) {
            *requested = true;
            block.values_needed(to >> SHIFT << SHIFT);
        }
    };
    // Most edges between blocks improve nothing, and then the rows are not needed.
    let mut request_rows = |to: usize| {
        if let Some(requested @ false) = has_rows.get_mut(to >> SHIFT) {
            *requested = true;
            let from = to >> SHIFT << SHIFT;
            graph.will_need_rows(first + from..first + (from + (1 << SHIFT)).min(len));
        }
    };
    let (mut messages, mut shorter) = (Vec::new(), Vec::<Message<O>>::new());
    let Some(nearest) = inbox.first() else { return Outcome { messages, ties: Ties::default() } };
    queue.restart(nearest.distance);
    for message in inbox {
        let to = message.node as usize - first;
        request_values(to, &block);
        if block.reach(to, message.distance, message.label) {
            request_rows(to);
            queue.push(Entry { node: to as u32, distance: message.distance });
        }
    }
    while queue.pop_bucket(batch) {
        for entries in batch.chunks(GATHER) {
            let mut count = 0;
            for &Entry { node, distance } in entries {
                // A stale entry, lowered since it was pushed, is useless: a later entry does the work.
                let useful = block.field[node as usize] >= distance;
                let (row, own) = (first as u32 + node, block.label[node as usize]);
                let edges = graph.span(row).len();
                if edges > LONG_ROW && !useful {
                    continue;
                }
                let most = count + edges;
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
                    request_values(to, &block);
                    shorter[count] = Message { node: to as u32, distance: there, label: own };
                    count += usize::from(useful & (there <= block.field[to]));
                }
            }
            for &Message { node, distance, label } in &shorter[..count] {
                if block.reach(node as usize, distance, label) {
                    request_rows(node as usize);
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
    /// Nodes that met a tie which they had already won.
    ties: Vec<u32>,
}

impl<O: Label> Block<'_, O> {
    /// Asks the kernel to read the values of this block's 2¹⁴ nodes from `from` on.
    #[cold]
    fn values_needed(&self, from: usize) {
        let end = (from + (1 << SHIFT)).min(self.field.len());
        will_need(&self.field[from..end]);
        if size_of::<O>() > 0 {
            will_need(&self.label[from..end]);
        }
    }

    /// Enters the node `to` of the block if it is nearer on this path, or equally near with a smaller label; returns
    /// whether it did.
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
