//! Fronts from sources everywhere, over graphs larger than memory: block by block, in rounds.
//!
//! One front from sources all over a mesh is all over it at once: fine in memory, hopeless where the graph is larger.
//! So nodes are taken in blocks. A round runs a front of its own inside every block that has mail, on all threads; what
//! would leave the block is mail for the next round. Half a dozen rounds, all but the first at the rims of blocks only,
//! reach the same fixed point as one front: the least d(v) = min fl(d(u) + w), and the smallest owner at equal
//! distances. Both are unique, so neither blocks nor threads show in the result (tested against a binary heap).
//! In memory the single front is quicker: what blocks correct outweighs their second thread (1.75 s against 1.55 s
//! of processor time for a default run at 1.3 M faces).
//!
//! Memory: the mail, 12 bytes for every edge between blocks: a quarter byte a node, or less, since blocks grow where
//! the budget is small for the mesh.

use super::front::mean_weight;
use super::queue::{Entry, Queue};
use crate::base::parallel::fill_two;
use crate::base::{Cancel, Result};
use crate::graph::dual::Csr;
use crate::store::Run;

/// Nodes a block, at least: with rows and values 2.5 MB, a good read.
pub const BLOCK: usize = 1 << 16;
/// Bucket width in mean weights.
const WIDTH: f32 = 0.5;

/// What a node belongs to: a number, or nothing at all.
pub trait Owner: Copy + PartialOrd + Send + Sync {}
impl Owner for u32 {}
impl Owner for () {}

/// A shorter way to `node`: from a source, or from a neighbour in another block.
#[derive(Clone, Copy, Debug)]
pub(super) struct Letter<O> {
    pub node: u32,
    pub distance: f32,
    pub owner: O,
}

/// What a block's front left.
struct Outcome<O> {
    letters: Vec<Letter<O>>,
    /// Whether a tie was met that the node reached had won before. Its owner may be stale then: passed on by a
    /// node that was lowered since, by so little that rounding hides it here.
    doubtful: bool,
}

/// What all rounds share.
#[derive(Clone, Debug)]
pub struct Rounds<'a> {
    graph: Csr<'a>,
    block: usize,
    threads: usize,
    cancel: Cancel,
    width: f32,
}

impl<'a> Rounds<'a> {
    /// Rounds over `graph` in blocks of `block` nodes.
    pub fn new(graph: Csr<'a>, block: usize, threads: usize, cancel: &Cancel) -> Self {
        Self { graph, block, threads, cancel: cancel.clone(), width: mean_weight(graph) * WIDTH }
    }

    /// Rounds over `graph` in blocks that suit the budget.
    pub(super) fn within_budget(graph: Csr<'a>, run: &Run) -> Self {
        // The rim of a block of B nodes is some 4 √B edges; mail is held twice while it is sorted out.
        let mail_for = |block: usize| 100. * graph.len() as f64 / (block as f64).sqrt();
        let mut block = BLOCK;
        while block < graph.len() && mail_for(block) > run.budget.left() as f64 / 4. {
            block *= 2;
        }
        Self::new(graph, block, run.threads, &run.cancel)
    }

    /// The graph.
    pub(super) fn graph(&self) -> Csr<'a> {
        self.graph
    }

    /// Delivers `letters` and what follows from them to nodes nearer than `limit`, until there is no more mail; whether
    /// owners may be stale.
    pub(super) fn deliver<O: Owner>(
        &self,
        mut letters: Vec<Letter<O>>,
        limit: f32,
        field: &mut [f32],
        owner: &mut [O],
    ) -> Result<bool> {
        let mut doubtful = false;
        while !letters.is_empty() {
            // The nearest first, so that a block's front starts where it should.
            letters.sort_unstable_by_key(|letter| (letter.node as usize / self.block, letter.distance.to_bits()));
            let mail = &letters[..];
            let queue = || (Queue::new(self.width), Vec::new());
            let outcomes = fill_two(self.threads, &self.cancel, (&mut *field, &mut *owner), self.block, queue, {
                |k, field: &mut [f32], owner: &mut [O], (queue, batch): &mut (Queue, Vec<Entry>)| {
                    let start = mail.partition_point(|letter| (letter.node as usize) / self.block < k);
                    let end = start + mail[start..].partition_point(|letter| (letter.node as usize) / self.block == k);
                    Ok(self.front(k * self.block, limit, field, owner, &mail[start..end], queue, batch))
                }
            })?;
            letters = Vec::with_capacity(outcomes.iter().map(|outcome| outcome.letters.len()).sum());
            for outcome in outcomes {
                doubtful |= outcome.doubtful;
                letters.extend(outcome.letters);
            }
        }
        Ok(doubtful)
    }

    /// The front inside the block of nodes from `first` on, whose values `field` and `owner` are.
    fn front<O: Owner>(
        &self,
        first: usize,
        limit: f32,
        field: &mut [f32],
        owner: &mut [O],
        mail: &[Letter<O>],
        queue: &mut Queue,
        batch: &mut Vec<Entry>,
    ) -> Outcome<O> {
        let mut outcome = Outcome { letters: Vec::new(), doubtful: false };
        let Some(nearest) = mail.first() else { return outcome };
        let Csr { indptr, indices, weights, .. } = self.graph;
        let starts = &indptr[first..=first + field.len()];
        queue.restart(nearest.distance);
        for letter in mail {
            let to = letter.node as usize - first;
            if reach(field, owner, to, letter.distance, letter.owner, &mut outcome.doubtful) {
                queue.push(Entry { node: to as u32, distance: letter.distance });
            }
        }
        while queue.pop_bucket(batch) {
            for &Entry { node, distance } in batch.iter() {
                let node = node as usize;
                if field[node] < distance {
                    continue;
                }
                let own = owner[node];
                let span = starts[node] as usize..starts[node + 1] as usize;
                for (&next, &weight) in indices[span.clone()].iter().zip(&weights[span]) {
                    let there = distance + weight;
                    let to = (next as usize).wrapping_sub(first);
                    if there >= limit {
                        continue;
                    }
                    if to >= field.len() {
                        outcome.letters.push(Letter { node: next, distance: there, owner: own });
                    } else if reach(field, owner, to, there, own, &mut outcome.doubtful) {
                        queue.push(Entry { node: to as u32, distance: there });
                    }
                }
            }
            batch.clear();
        }
        outcome
    }
}

/// Whether the node `to` is nearer this way, or as near and won by a smaller owner; if so, it is entered.
#[inline(always)]
fn reach<O: Owner>(field: &mut [f32], owner: &mut [O], to: usize, distance: f32, own: O, doubtful: &mut bool) -> bool {
    let nearer = distance < field[to];
    if nearer || (distance == field[to] && own < owner[to]) {
        field[to] = distance;
        owner[to] = own;
        return true;
    }
    *doubtful |= distance == field[to] && own > owner[to];
    false
}
