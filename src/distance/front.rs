//! A front: shortest distances from sources to every node, the program's innermost loop.
//!
//! Label-correcting Dijkstra on [`Queue`]'s buckets. The least fixed point of d(v) = min fl(d(u) + w) in
//! `f32` is unique, so any order of visits gives the same bits as a binary heap would
//! (tested). A field that already holds distances is only lowered where the new sources are nearer:
//! that is the *pruned* front of the landmark search, by the same code.
//!
//! What it costs is branches that cannot be foretold, and cache misses. Whether a step shortens a way is as good as
//! random, so the ways of [`GATHER`] entries are first gathered without a branch, and then taken, where nearly all are
//! shorter: 9–13 % less time on scans. And what entries need is fetched in steps, the farthest [`FAR`] entries ahead
//! ([`super::steps`]), across the end of a bucket too. Where the graph has [triples](crate::graph::triangle_adjacency) they are
//! walked instead of the matrix. Measured (`benches/records`): 14–20 ns a face on scans over triples on large pages, 27–31
//! over the matrix. Reading its 28 bytes once would take 1 ns a face at the 27 GB/s that a thread reads here (measured): what
//! is left is arithmetic, the queue, and visits in no order of memory.

use super::carry::{Carry, Owners, Within, disown};
use super::paging::{Pager, Pages};
use super::queue::{Entry, Queue};
use super::steps::{FAR, Packed, Steps, look_ahead, warm_up};
use crate::base::{Cancel, Result};
use crate::graph::dual::Csr;
use crate::store::mapped::{Access, Writeback, advise, will_need};

/// Entries whose shorter ways are gathered before any is taken.
const GATHER: usize = 32;
/// Bucket width in mean weights.
pub const WIDTH: f32 = 0.125;
/// Visits between looks at the stop flag.
const PATIENCE: usize = 1 << 16;

/// A shorter way to a node, and the node it comes from.
#[derive(Clone, Copy, Debug, Default)]
struct Way {
    to: Entry,
    from: u32,
}

/// A reusable front. Scratch memory is O(front), kept between runs.
#[derive(Debug)]
pub struct Front {
    queue: Queue,
    batch: Vec<Entry>,
    ways: Vec<Way>,
    pages: Option<Pages>,
}

/// What a front did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Visits {
    /// Entries taken from the queue.
    pub popped: u64,
    /// Nodes expanded, some of them more than once.
    pub expanded: u64,
}

/// The mean weight of a graph, from up to 65,536 evenly spread entries: a bucket width needs no more.
pub fn mean_weight(graph: Csr<'_>) -> f32 {
    let step = (graph.weights.len() / 65_536).max(1);
    let (mut sum, mut count) = (0f64, 0u32);
    for &w in graph.weights.iter().step_by(step) {
        sum += f64::from(w);
        count += 1;
    }
    if count == 0 { 1. } else { (sum / f64::from(count)) as f32 }
}

impl Front {
    /// A front for graphs whose weights have the given mean.
    pub fn new(mean_weight: f32) -> Self {
        Self::with_width(mean_weight * WIDTH)
    }

    /// A front with buckets of the given width.
    pub fn with_width(width: f32) -> Self {
        Self { queue: Queue::new(width), batch: Vec::new(), ways: Vec::new(), pages: None }
    }

    /// The same for a graph larger than memory: it tells the kernel by `pages` what it needs next.
    #[must_use]
    pub fn paged(self, pages: Option<Pages>) -> Self {
        Self { pages, ..self }
    }

    /// Whether the front has pages.
    pub fn is_paged(&self) -> bool {
        self.pages.is_some()
    }

    /// Tells the kernel how `field` will be used from now on, for fronts with pages.
    pub fn advise(&self, field: &[f32], access: Access) {
        if self.is_paged() {
            advise(field, access);
        }
    }

    /// Tells in which file the next fields lie, for fronts with pages.
    pub fn values(&mut self, values: Option<Writeback>) {
        if let Some(pages) = &mut self.pages {
            pages.values(values);
        }
    }

    /// Distances from one node: `field` (n) is overwritten, infinite where unreached.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn full(&mut self, graph: Csr<'_>, source: u32, field: &mut [f32], cancel: &Cancel) -> Result<Visits> {
        let Some(mut pages) = self.pages.take() else {
            field.fill(f32::INFINITY);
            return self.lower(graph, &[source], field, cancel);
        };
        pages.restart();
        let empty = |block: &mut [f32]| {
            // All pages at once: a fault each for pages never written costs more than the front.
            will_need(block);
            block.fill(f32::INFINITY);
        };
        if let Some(block) = pages.enter(graph, source) {
            empty(&mut field[block]);
        }
        self.start(&[source], field);
        let result = self.walk(graph, graph, field, &mut (), &mut pages, empty, cancel);
        pages.unmet().for_each(|block| empty(&mut field[block]));
        pages.send_all();
        self.pages = Some(pages);
        result
    }

    /// Lowers `field` (n) to the distances from `sources` where those are smaller; only nodes that are
    /// lowered are visited.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn lower(&mut self, graph: Csr<'_>, sources: &[u32], field: &mut [f32], cancel: &Cancel) -> Result<Visits> {
        self.lowered(graph, sources, field, &mut (), cancel)
    }

    /// Distances to the nearest of many sources, and which it is: `owner` (n) gets the index into
    /// `sources` of the nearest (the smaller one at a tie), `u32::MAX` where none is reached.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn owned(
        &mut self,
        graph: Csr<'_>,
        sources: &[u32],
        field: &mut [f32],
        owner: &mut [u32],
        cancel: &Cancel,
    ) -> Result<Visits> {
        field.fill(f32::INFINITY);
        let (visits, doubtful) = self.own(graph, sources, field, owner, cancel)?;
        if !doubtful {
            return Ok(visits);
        }
        // Once more over the final distances: owners alone move, and nothing can be stale.
        let (again, _) = self.own(graph, sources, field, owner, cancel)?;
        Ok(Visits { popped: visits.popped + again.popped, expanded: visits.expanded + again.expanded })
    }

    /// Owners from the start; also whether some may be stale.
    fn own(
        &mut self,
        graph: Csr<'_>,
        sources: &[u32],
        field: &mut [f32],
        owner: &mut [u32],
        cancel: &Cancel,
    ) -> Result<(Visits, bool)> {
        owner.fill(u32::MAX);
        for (k, &source) in sources.iter().enumerate().rev() {
            owner[source as usize] = k as u32;
        }
        self.start(sources, field);
        let mut owners = Owners::new(owner);
        let visits = self.spread(graph, field, &mut owners, cancel)?;
        Ok((visits, owners.doubtful))
    }

    /// Like [`Front::lower`], but nodes at `limit` or beyond are not visited: they keep what they had.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn within(
        &mut self,
        graph: Csr<'_>,
        sources: &[u32],
        limit: f32,
        field: &mut [f32],
        cancel: &Cancel,
    ) -> Result<Visits> {
        self.lowered(graph, sources, field, &mut Within(limit), cancel)
    }

    /// Spreads the owners of `sources` over the nodes that `field` (n) holds infinite; it is 0 at all others, of which
    /// the sources are the rim. At equal distances the smaller owner wins. Owners of nodes that are not reached stay.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn spread_owners(
        &mut self,
        graph: Csr<'_>,
        sources: &[u32],
        field: &mut [f32],
        owner: &mut [u32],
        cancel: &Cancel,
    ) -> Result<Visits> {
        let mut owners = Owners::new(owner);
        let mut visits = self.lowered(graph, sources, field, &mut owners, cancel)?;
        if owners.doubtful {
            // As in `owned`.
            disown(field, owner);
            let again = self.lowered(graph, sources, field, &mut Owners::new(owner), cancel)?;
            visits.popped += again.popped;
            visits.expanded += again.expanded;
        }
        Ok(visits)
    }

    /// A front over what `field` holds.
    fn lowered(
        &mut self,
        graph: Csr<'_>,
        sources: &[u32],
        field: &mut [f32],
        carry: &mut impl Carry,
        cancel: &Cancel,
    ) -> Result<Visits> {
        let Some(mut pages) = self.pages.take() else {
            self.start(sources, field);
            return self.spread(graph, field, carry, cancel);
        };
        pages.restart();
        for block in sources.iter().filter_map(|&source| pages.enter(graph, source)) {
            will_need(&field[block]);
        }
        self.start(sources, field);
        let result = self.walk(graph, graph, field, carry, &mut pages, |block| will_need(block), cancel);
        pages.send_all();
        self.pages = Some(pages);
        result
    }

    fn start(&mut self, sources: &[u32], field: &mut [f32]) {
        self.queue.restart(0.);
        for &node in sources {
            field[node as usize] = 0.;
            self.queue.push(Entry { node, distance: 0. });
        }
    }

    fn spread(&mut self, graph: Csr<'_>, field: &mut [f32], carry: &mut impl Carry, cancel: &Cancel) -> Result<Visits> {
        if graph.triples.is_empty() {
            return self.walk(graph, graph, field, carry, &mut (), |_| (), cancel);
        }
        let packed = Packed { csr: graph, triples: graph.triples };
        self.walk(graph, packed, field, carry, &mut (), |_| (), cancel)
    }

    /// The loop itself, over `graph` as `steps` walks it. `met` sees the part of the field that lies in a block of
    /// `pages` met for the first time, before it is read.
    fn walk(
        &mut self,
        graph: Csr<'_>,
        steps: impl Steps,
        field: &mut [f32],
        carry: &mut impl Carry,
        pages: &mut impl Pager,
        met: impl Fn(&mut [f32]),
        cancel: &Cancel,
    ) -> Result<Visits> {
        let Self { queue, batch, ways, .. } = self;
        let mut visits = Visits::default();
        let mut patience = PATIENCE;
        batch.clear();
        // The entry that is first in line behind the batch, so far as what it needs was fetched already.
        let mut fetched = None;
        while queue.pop_bucket(batch) {
            if patience <= batch.len() {
                patience = PATIENCE;
                if cancel.is_cancelled() {
                    batch.clear();
                    while queue.pop_bucket(batch) {
                        batch.clear();
                    }
                    cancel.check()?;
                }
            } else {
                patience -= batch.len();
            }
            visits.popped += batch.len() as u64;
            if fetched != Some(batch[0].node) {
                warm_up(batch, steps, field);
            }
            // What comes next is fetched behind the end of the batch, too.
            let len = batch.len();
            queue.peek(FAR, batch);
            fetched = batch.get(len).map(|entry| entry.node);
            for start in (0..len).step_by(GATHER) {
                let mut count = 0;
                for k in start..len.min(start + GATHER) {
                    look_ahead(batch, k, steps, field);
                    let Entry { node, distance } = batch[k];
                    // Lowered since it was pushed, it is of no use: a later entry does the work.
                    let useful = field[node as usize] >= distance;
                    visits.expanded += u64::from(useful);
                    let most = count + steps.count(node);
                    if most > ways.len() {
                        ways.resize(most + 4 * GATHER, Way::default());
                    }
                    steps.each(node, |next, weight| {
                        let there = distance + weight;
                        if let Some(block) = pages.meet(graph, node, next) {
                            met(&mut field[block]);
                        }
                        ways[count] = Way { to: Entry { node: next, distance: there }, from: node };
                        let known = field[next as usize];
                        let shorter = (there < known) | (carry.ties() & (there == known));
                        count += usize::from(useful & shorter & carry.admits(there));
                    });
                }
                for &Way { to, from } in &ways[..count] {
                    let known = &mut field[to.node as usize];
                    if to.distance < *known {
                        *known = to.distance;
                        carry.pass(from, to.node);
                        queue.push(to);
                    } else if to.distance == *known && carry.wins_tie(from, to.node) {
                        carry.pass(from, to.node);
                        queue.push(to);
                    }
                }
            }
            batch.clear();
        }
        Ok(visits)
    }

    /// Bytes of scratch memory held.
    pub fn bytes(&self) -> usize {
        self.queue.bytes() + self.batch.capacity() * size_of::<Entry>() + self.ways.capacity() * size_of::<Way>()
    }
}
