//! Half-edge pairs, between matching and assembling: which node is across which corner's edge.
//!
//! If the budget has room for 4 bytes per corner, pairs go to a table indexed by corner. Nearly every corner has one
//! pair, so the table is already the sorted list. Further pairs of a corner (a middle face of an edge of three) go to a
//! separate list. Otherwise pairs within a block of faces are matched when the block is taken, and only those
//! between blocks are shuffled, 8 bytes each; without blocks all are. Every method delivers a part's pairs in the
//! form of the table.

use super::edge_links::Match;
use super::half_edge_block::BlockMatcher;
use super::half_edge_sort::HalfEdge;
use super::node_blocks::{self, NodeBlocks};
use super::nonmanifold::NonmanifoldEdges;
use crate::base::Result;
use crate::base::parallel::lock;
use crate::base::union_find::PARITY;
use crate::mesh::Mesh;
use crate::store::Context;
use crate::store::budget::Grant;
use crate::store::shuffle::{BLOCK_BYTES, BudgetedShuffle, Producer, RangeBuckets, Shuffle};
use bytemuck::allocation::try_zeroed_vec;
use bytemuck::{Pod, Zeroable};
use std::alloc::{Layout, handle_alloc_error};
use std::ops::Range;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

/// The bit of [`HalfEdgePair::node`] that marks contradicting winding: both faces traverse the edge in the same
/// direction. Nodes use the other 31 bits: see [`crate::mesh::geometry::MOST_FACES`].
pub const OPPOSITE_WINDING: u32 = PARITY;
/// No pair, in the table; never the number of a node, with or without [`OPPOSITE_WINDING`].
pub(super) const NO_NODE: u32 = u32::MAX;
/// The node across a corner's edge, or [`NO_NODE`]. Stored as its complement, so that zeroed memory means no node and
/// untouched pages stay untouched.
#[derive(Debug, Zeroable)]
#[repr(transparent)]
pub(super) struct AcrossCorner(AtomicU32);

impl AcrossCorner {
    #[inline(always)]
    pub fn node(&self) -> u32 {
        !self.0.load(Relaxed)
    }

    /// Enters `node` unless there is a node; returns whether it did. Only one thread at a time may.
    #[inline(always)]
    fn enter(&self, node: u32) -> bool {
        let is_free = self.node() == NO_NODE;
        if is_free {
            self.0.store(!node, Relaxed);
        }
        is_free
    }
}

/// No node across any of `corners` corners. If memory runs out, this ends as any allocation does, without a panic.
fn no_nodes(corners: usize) -> Vec<AcrossCorner> {
    let failed =
        |()| handle_alloc_error(Layout::array::<AcrossCorner>(corners).unwrap_or(Layout::new::<AcrossCorner>()));
    try_zeroed_vec(corners).unwrap_or_else(failed)
}

/// Nodes taken at a time from the table.
const CHUNK: usize = 1 << 14;

/// One direction of a match: `node` is across the edge that leaves `corner`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
pub struct HalfEdgePair {
    /// Corner number in the mesh; its face is where the step starts.
    pub corner: u32,
    /// The node on the other side, with [`OPPOSITE_WINDING`] if its winding contradicts.
    pub node: u32,
}

impl HalfEdgePair {
    /// One direction of a match.
    #[inline]
    fn of(found: Match) -> Self {
        Self { corner: found.corner, node: found.to as u32 | if found.opposite_winding { OPPOSITE_WINDING } else { 0 } }
    }

    /// The node on the other side.
    #[inline]
    pub fn to(&self) -> u32 {
        self.node & !OPPOSITE_WINDING
    }

    /// Whether the windings of the two faces contradict.
    #[inline]
    pub fn opposite_winding(&self) -> bool {
        self.node & OPPOSITE_WINDING != 0
    }
}

/// All half-edge pairs of a mesh, being collected or read.
#[derive(Debug)]
pub struct HalfEdgePairs<'a> {
    nodes: usize,
    kind: Kind<'a>,
}

#[derive(Debug)]
enum Kind<'a> {
    /// One node per corner, and the pairs that did not fit.
    Table { across: Vec<AcrossCorner>, more: Mutex<Vec<HalfEdgePair>>, _grant: Grant },
    /// Sorted by node, in buckets.
    Shuffled { sized: BudgetedShuffle<HalfEdgePair>, by_node: RangeBuckets },
    /// Pairs between blocks, sorted by block; the corners of the mesh; the edges of three faces or more that were found
    /// within blocks so far; the blocks, once [`HalfEdgePairs::keep`] was called.
    Within {
        between: Shuffle<HalfEdgePair>,
        corners: usize,
        nonmanifold: NonmanifoldEdges,
        blocks: Option<NodeBlocks<'a>>,
        size: usize,
        _grant: Grant,
    },
}

/// One thread's handle for adding pairs; close it with [`PairSink::finish`].
pub(super) enum PairSink<'a> {
    Table(&'a [AcrossCorner], &'a Mutex<Vec<HalfEdgePair>>),
    Shuffled(Producer<'a, HalfEdgePair>, RangeBuckets),
    /// Pairs between blocks; the number is the nodes per block.
    Between(Producer<'a, HalfEdgePair>, usize),
}

/// Whether a table for `corners` corners is used if `left` bytes of the budget are left. An edge of k faces has
/// 2 (k − 1) pairs, k of them in the table, so the separate list holds at most twice the table's bytes: half of what is
/// left, in all.
pub fn fit(corners: u64, left: u64) -> bool {
    4 * corners <= left / 6
}

/// Bytes of the smallest staging block of pairs between blocks.
const LEAST_STAGED: u64 = 256;

/// Memory for pairs within blocks.
pub(super) struct WithinNeeds {
    /// Bytes of a staging block of pairs between blocks.
    pub block: u64,
    /// Bytes for staging and matching.
    pub fixed: u64,
    /// Bytes taken from the budget.
    pub granted: u64,
}

impl WithinNeeds {
    /// For `blocks` blocks of `corners` corners, with `between` half-edges between blocks, if `left` bytes are left.
    pub fn new(blocks: u64, corners: u64, between: u64, threads: u64, left: u64) -> Self {
        let block = (left / 16 / (threads * blocks.max(1))).clamp(LEAST_STAGED, BLOCK_BYTES as u64);
        let fixed = block * threads * blocks + node_blocks::bytes(corners, threads);
        Self { block, fixed, granted: (fixed + 2 * between).min(left / 2).max(fixed) }
    }
}

impl<'a> HalfEdgePairs<'a> {
    /// An empty collection for `mesh`, whose half-edges are matched in `blocks` if there are any.
    ///
    /// # Errors
    /// [`crate::base::Error::Memory`].
    pub(super) fn new(mesh: &Mesh, blocks: Option<&NodeBlocks<'_>>, context: Context<'_>) -> Result<Self> {
        let (nodes, corners, threads) = (mesh.faces.len(), mesh.faces.corner_count(), context.run.threads as u64);
        let bytes = 4 * corners as u64;
        if fit(corners as u64, context.run.budget.left()) {
            let grant = context.run.budget.take("matching edges", bytes, bytes)?;
            let across = no_nodes(corners);
            return Ok(Self { nodes, kind: Kind::Table { across, more: Mutex::default(), _grant: grant } });
        }
        if let Some(blocks) = blocks {
            let (count, of_block) = (blocks.len() as u64, blocks.corners() as u64);
            let left = context.run.budget.left();
            let needs = WithinNeeds::new(count, of_block, blocks.shared_half_edges(), threads, left);
            let grant = context.run.budget.take("matching edges", needs.fixed, needs.granted)?;
            let file = context.work.spill("links.tmp");
            let between = Shuffle::new(file, blocks.len(), needs.block as usize, grant.bytes() - needs.fixed);
            let size = blocks.nodes_of(0).len();
            let nonmanifold = NonmanifoldEdges::default();
            let kind = Kind::Within { between, corners, nonmanifold, blocks: None, size, _grant: grant };
            return Ok(Self { nodes, kind });
        }
        // A bucket also waits in the form of finished rows.
        let copies = 12 * threads;
        let sized = BudgetedShuffle::<HalfEdgePair>::new(
            context.work.spill("links.tmp"),
            "matching edges",
            corners as u64,
            copies,
            2,
            context.run,
        )?;
        let by_node = RangeBuckets::new(nodes, sized.shuffle.buckets());
        Ok(Self { nodes, kind: Kind::Shuffled { sized, by_node } })
    }

    /// A handle for a thread to add pairs.
    pub(super) fn sink(&self) -> PairSink<'_> {
        match &self.kind {
            Kind::Table { across, more, .. } => PairSink::Table(across, more),
            Kind::Shuffled { sized, by_node } => PairSink::Shuffled(sized.shuffle.producer(), *by_node),
            Kind::Within { between, size, .. } => PairSink::Between(between.producer(), *size),
        }
    }

    /// Whether pairs within blocks are found when they are taken, instead of being added.
    pub(super) fn finds_within(&self) -> bool {
        matches!(self.kind, Kind::Within { .. })
    }

    /// Edges of three faces or more that were found within blocks, once all pairs were taken.
    pub(super) fn nonmanifold_within(&self) -> Option<&NonmanifoldEdges> {
        if let Kind::Within { nonmanifold, .. } = &self.kind { Some(nonmanifold) } else { None }
    }

    /// Keeps the blocks, if they are needed again.
    pub(super) fn keep(&mut self, of_mesh: Option<NodeBlocks<'a>>) {
        if let Kind::Within { blocks, .. } = &mut self.kind {
            *blocks = of_mesh;
        }
    }

    /// Ends collecting; from here on pairs are taken.
    pub(super) fn finish_collecting(&mut self) {
        if let Kind::Table { more, .. } = &mut self.kind {
            more.get_mut().unwrap_or_else(|poison| poison.into_inner()).sort_unstable();
        }
    }

    /// All pairs; `None` unless they are a table and no corner has two.
    pub(super) fn table(&self) -> Option<PartPairs<'_>> {
        let Kind::Table { across, more, .. } = &self.kind else { return None };
        let all = || PartPairs { first: 0, across: Table::Shared(across), more: Vec::new() };
        lock(more).is_empty().then(all)
    }

    /// Number of pairs to be expected: no fewer than there are, unless edges have more than two faces.
    pub(super) fn expected(&self) -> usize {
        match &self.kind {
            Kind::Table { across, more, .. } => across.len() + lock(more).len(),
            Kind::Shuffled { sized, .. } => sized.shuffle.len() as usize,
            Kind::Within { corners, .. } => *corners,
        }
    }

    /// Number of node ranges in which pairs are taken.
    pub(super) fn parts(&self) -> usize {
        match &self.kind {
            Kind::Table { .. } => self.nodes.div_ceil(CHUNK),
            Kind::Shuffled { sized, .. } => sized.shuffle.buckets(),
            Kind::Within { between, .. } => between.buckets(),
        }
    }

    /// The nodes of a part.
    pub(super) fn nodes_of(&self, part: usize) -> Range<usize> {
        match &self.kind {
            Kind::Table { .. } => part * CHUNK..self.nodes.min((part + 1) * CHUNK),
            Kind::Within { size, .. } => part * size..self.nodes.min((part + 1) * size),
            Kind::Shuffled { by_node, .. } => by_node.range(part),
        }
    }

    /// Removes and returns the pairs of a part.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`].
    pub(super) fn take(&self, part: usize, mesh: &Mesh) -> Result<PartPairs<'_>> {
        let corners = corners_of(mesh, self.nodes_of(part));
        match &self.kind {
            Kind::Table { across, more, .. } => {
                let more = at_corners(&lock(more), &corners).to_vec();
                Ok(PartPairs { first: corners.start, across: Table::Shared(&across[corners]), more })
            }
            Kind::Shuffled { sized, .. } => {
                let mut own = OwnTable::new(corners);
                sized.shuffle.take(part)?.into_iter().for_each(|pair| own.push(pair));
                Ok(own.finish())
            }
            Kind::Within { between, nonmanifold, blocks, .. } => {
                let mut own = OwnTable::new(corners);
                between.take(part)?.into_iter().for_each(|pair| own.push(pair));
                if let Some(blocks) = blocks {
                    let join = |pair: Match| {
                        own.push(HalfEdgePair::of(pair));
                        Ok(())
                    };
                    let count = |sides: &[HalfEdge], elsewhere: bool| {
                        if !elsewhere {
                            nonmanifold.count(mesh, sides.iter().map(|side| side.corner));
                        }
                        Ok(())
                    };
                    BlockMatcher::default().match_block(mesh, blocks, part, join, count)?;
                }
                Ok(own.finish())
            }
        }
    }
}

/// The corners of a range of nodes.
fn corners_of(mesh: &Mesh, nodes: Range<usize>) -> Range<usize> {
    if nodes.is_empty() {
        return 0..0;
    }
    mesh.faces.corner_range(nodes.start).start..mesh.faces.corner_range(nodes.end - 1).end
}

/// Those of `pairs`, which ascend, that are at `corners`.
fn at_corners<'a>(pairs: &'a [HalfEdgePair], corners: &Range<usize>) -> &'a [HalfEdgePair] {
    let place = |corner: usize| pairs.partition_point(|pair| (pair.corner as usize) < corner);
    &pairs[place(corners.start)..place(corners.end)]
}

/// The pairs of consecutive corners: a table with one node per corner, and a list of the others, as in a
/// [`HalfEdgePairs`] that is a table as a whole.
#[derive(Debug)]
pub(super) struct PartPairs<'a> {
    /// The first corner of the table.
    pub first: usize,
    across: Table<'a>,
    /// Pairs of corners that have several, besides those in the table; ascending.
    pub more: Vec<HalfEdgePair>,
}

#[derive(Debug)]
enum Table<'a> {
    Shared(&'a [AcrossCorner]),
    Own(Vec<AcrossCorner>),
}

impl PartPairs<'_> {
    /// The node across each corner's edge, or [`NO_NODE`].
    pub fn across(&self) -> &[AcrossCorner] {
        match &self.across {
            Table::Shared(across) => across,
            Table::Own(across) => across,
        }
    }

    /// The pairs of `corners` of the mesh, all of which are in the part; those in the table first.
    pub fn of(&self, corners: Range<usize>) -> impl Iterator<Item = HalfEdgePair> + '_ {
        let more = at_corners(&self.more, &corners);
        let nodes = self.across()[corners.start - self.first..corners.end - self.first].iter().map(AcrossCorner::node);
        let pairs = corners.zip(nodes).filter(|(_, node)| *node != NO_NODE);
        pairs.map(|(corner, node)| HalfEdgePair { corner: corner as u32, node }).chain(more.iter().copied())
    }

    /// Number of pairs.
    pub fn len(&self) -> usize {
        self.across().iter().filter(|across| across.node() != NO_NODE).count() + self.more.len()
    }
}

/// The table of a part under construction.
struct OwnTable {
    first: usize,
    across: Vec<AcrossCorner>,
    more: Vec<HalfEdgePair>,
}

impl OwnTable {
    fn new(corners: Range<usize>) -> Self {
        Self { first: corners.start, across: no_nodes(corners.len()), more: Vec::new() }
    }

    #[inline]
    fn push(&mut self, pair: HalfEdgePair) {
        if !self.across[pair.corner as usize - self.first].enter(pair.node) {
            self.more.push(pair);
        }
    }

    fn finish(mut self) -> PartPairs<'static> {
        self.more.sort_unstable();
        PartPairs { first: self.first, across: Table::Own(self.across), more: self.more }
    }
}

impl PairSink<'_> {
    /// Adds a pair.
    #[inline]
    pub fn push(&mut self, found: Match) -> Result<()> {
        let pair = HalfEdgePair::of(found);
        match self {
            Self::Table(across, more) => {
                // All pairs of an edge come from one thread, so nobody else writes here.
                if !across[pair.corner as usize].enter(pair.node) {
                    lock(more).push(pair);
                }
                Ok(())
            }
            Self::Shuffled(out, by_node) => out.push(by_node.bucket_of(found.from as u32), pair),
            Self::Between(out, size) => out.push(found.from / *size, pair),
        }
    }

    /// Flushes the remaining pairs.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`].
    pub fn finish(self) -> Result<()> {
        match self {
            Self::Table(..) => Ok(()),
            Self::Shuffled(out, _) => out.finish(),
            Self::Between(out, _) => out.finish(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_takes_a_sixth_of_the_budget_at_most() {
        assert!(fit(10, 240) && !fit(10, 239) && !fit(11, 240) && fit(0, 0));
    }
}
