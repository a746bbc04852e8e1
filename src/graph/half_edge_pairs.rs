//! Half-edge pairs, between matching and assembling: which node lies across which corner's edge.
//!
//! Where the budget has room for 4 bytes a corner, a pair is written where it will be read: nearly every corner has one,
//! so a table by corner is the sorted list already. The second pair of a corner (a middle face of an edge of three) goes
//! to a list beside. Otherwise pairs are shuffled by node, 8 bytes each, and sorted bucket by bucket. Both ways hand over
//! the same pairs in the same order.

use crate::base::Result;
use crate::base::union_find::PARITY;
use crate::mesh::Mesh;
use crate::store::Context;
use crate::store::budget::Grant;
use crate::store::shuffle::{BudgetedShuffle, Producer};
use bytemuck::{Pod, Zeroable};
use std::ops::Range;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

/// The bit of [`HalfEdgePair::node`] that says that both faces run along the edge in the same direction: they are wound
/// against each other. Nodes have 31 bits to spare: there are at most 2³² corners.
pub const AGAINST: u32 = PARITY;
/// No pair, in the table; no node has this number.
const NONE: u32 = u32::MAX;
/// Nodes handed over at a time from the table.
const CHUNK: usize = 1 << 14;

/// One direction of a match: across the edge that leaves `corner` lies `node`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
pub struct HalfEdgePair {
    /// Corner number in the mesh; its face is where the step starts.
    pub corner: u32,
    /// The node on the other side, with [`AGAINST`] where its winding contradicts.
    pub node: u32,
}

impl HalfEdgePair {
    /// The node on the other side.
    #[inline]
    pub fn to(&self) -> u32 {
        self.node & !AGAINST
    }

    /// Whether the two faces are wound against each other.
    #[inline]
    pub fn against(&self) -> bool {
        self.node & AGAINST != 0
    }
}

/// All half-edge pairs of a mesh, being collected or read.
#[derive(Debug)]
pub struct HalfEdgePairs {
    nodes: usize,
    kind: Kind,
}

#[derive(Debug)]
enum Kind {
    /// A node a corner, and what did not fit.
    Table { across: Vec<AtomicU32>, more: Mutex<Vec<HalfEdgePair>>, _grant: Grant },
    /// By node, in buckets; buckets a node in units of 2^-32, rounded down.
    Shuffled { sized: BudgetedShuffle<HalfEdgePair>, scale: u64 },
}

/// Where one thread adds pairs; close it with [`PairSink::finish`].
pub(super) enum PairSink<'a> {
    Table(&'a [AtomicU32], &'a Mutex<Vec<HalfEdgePair>>),
    Shuffled(Producer<'a, HalfEdgePair>, u64),
}

/// Whether the table of `corners` corners is made where `left` bytes of the budget are left. No corner has more than two
/// pairs, so the list beside it holds at most twice the table's bytes.
pub fn fit(corners: u64, left: u64) -> bool {
    4 * corners <= left / 8
}

impl HalfEdgePairs {
    /// None yet, of a mesh of `nodes` faces and `corners` corners.
    ///
    /// # Errors
    /// [`crate::base::Error::Memory`].
    pub(super) fn new(nodes: usize, corners: usize, context: Context<'_>) -> Result<Self> {
        let bytes = 4 * corners as u64;
        if fit(corners as u64, context.run.budget.left()) {
            let grant = context.run.budget.take("matching edges", bytes, bytes)?;
            let across = (0..corners).map(|_| AtomicU32::new(NONE)).collect();
            return Ok(Self { nodes, kind: Kind::Table { across, more: Mutex::default(), _grant: grant } });
        }
        // A bucket waits as finished rows besides.
        let copies = 12 * context.run.threads as u64;
        let sized = BudgetedShuffle::<HalfEdgePair>::new(
            &context.work.file("links.tmp"),
            "matching edges",
            corners as u64,
            copies,
            2,
            context.run,
        )?;
        let scale = ((sized.shuffle.buckets() as u64) << 32) / nodes.max(1) as u64;
        Ok(Self { nodes, kind: Kind::Shuffled { sized, scale } })
    }

    /// Where a thread adds pairs.
    pub(super) fn sink(&self) -> PairSink<'_> {
        match &self.kind {
            Kind::Table { across, more, .. } => PairSink::Table(across, more),
            Kind::Shuffled { sized, scale } => PairSink::Shuffled(sized.shuffle.producer(), *scale),
        }
    }

    /// Ends collecting: from here on pairs are taken.
    pub(super) fn seal(&mut self) {
        if let Kind::Table { more, .. } = &mut self.kind {
            more.get_mut().unwrap_or_else(|poison| poison.into_inner()).sort_unstable();
        }
    }

    /// Number of pairs at the most.
    pub(super) fn bound(&self) -> usize {
        match &self.kind {
            Kind::Table { across, more, .. } => {
                across.len() + more.lock().unwrap_or_else(|poison| poison.into_inner()).len()
            }
            Kind::Shuffled { sized, .. } => sized.shuffle.len() as usize,
        }
    }

    /// Ranges of nodes in which pairs are handed over.
    pub(super) fn parts(&self) -> usize {
        match &self.kind {
            Kind::Table { .. } => self.nodes.div_ceil(CHUNK),
            Kind::Shuffled { sized, .. } => sized.shuffle.buckets(),
        }
    }

    /// The nodes of a part.
    pub(super) fn nodes_of(&self, part: usize) -> Range<usize> {
        match &self.kind {
            Kind::Table { .. } => part * CHUNK..self.nodes.min((part + 1) * CHUNK),
            Kind::Shuffled { scale, .. } => {
                let first = |b: usize| (((b as u64) << 32).div_ceil(*scale) as usize).min(self.nodes);
                first(part)..if part + 1 == self.parts() { self.nodes } else { first(part + 1) }
            }
        }
    }

    /// Takes the pairs of a part out, in the order of their corners.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`].
    pub(super) fn take(&self, part: usize, mesh: &Mesh) -> Result<Vec<HalfEdgePair>> {
        let range = self.nodes_of(part);
        if range.is_empty() {
            return Ok(Vec::new());
        }
        let first = mesh.faces.corner_range(range.start).start;
        let corners = first..mesh.faces.corner_range(range.end - 1).end;
        match &self.kind {
            Kind::Table { across, more, .. } => {
                let mut pairs = Vec::with_capacity(corners.len());
                pairs.extend(corners.clone().zip(&across[corners.clone()]).filter_map(|(corner, node)| {
                    let node = node.load(Relaxed);
                    (node != NONE).then_some(HalfEdgePair { corner: corner as u32, node })
                }));
                let more = more.lock().unwrap_or_else(|poison| poison.into_inner());
                let place = |corner: usize| more.partition_point(|pair| (pair.corner as usize) < corner);
                let mine = &more[place(corners.start)..place(corners.end)];
                if !mine.is_empty() {
                    pairs.extend_from_slice(mine);
                    pairs.sort_unstable();
                }
                Ok(pairs)
            }
            Kind::Shuffled { sized, .. } => Ok(sorted(corners, &sized.shuffle.take(part)?)),
        }
    }
}

impl PairSink<'_> {
    /// Adds the pair from `corner` of `face` to `node`.
    #[inline]
    pub fn push(&mut self, corner: u32, face: usize, node: usize, against: bool) -> Result<()> {
        let pair = HalfEdgePair { corner, node: node as u32 | if against { AGAINST } else { 0 } };
        match self {
            Self::Table(across, more) => {
                // All pairs of an edge come from one thread, so nobody else writes here.
                let place = &across[corner as usize];
                if place.load(Relaxed) == NONE {
                    place.store(pair.node, Relaxed);
                } else {
                    more.lock().unwrap_or_else(|poison| poison.into_inner()).push(pair);
                }
                Ok(())
            }
            // Nodes and buckets are few enough for 64 bits, and a product with the inverse is no division.
            Self::Shuffled(out, scale) => out.push(((face as u64 * *scale) >> 32) as usize, pair),
        }
    }

    /// Hands over what is left.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`].
    pub fn finish(self) -> Result<()> {
        match self {
            Self::Table(..) => Ok(()),
            Self::Shuffled(out, _) => out.finish(),
        }
    }
}

/// Groups pairs by corner with a counting sort.
fn sorted(corners: Range<usize>, pairs: &[HalfEdgePair]) -> Vec<HalfEdgePair> {
    let mut starts = vec![0u32; corners.len() + 1];
    for pair in pairs {
        starts[pair.corner as usize - corners.start + 1] += 1;
    }
    for i in 0..corners.len() {
        starts[i + 1] += starts[i];
    }
    let mut sorted = vec![HalfEdgePair { corner: 0, node: 0 }; pairs.len()];
    for pair in pairs {
        let slot = &mut starts[pair.corner as usize - corners.start];
        sorted[*slot as usize] = *pair;
        *slot += 1;
    }
    sorted
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_takes_an_eighth_of_the_budget_at_most() {
        assert!(fit(10, 320) && !fit(10, 319) && !fit(11, 320) && fit(0, 0));
    }
}
