//! The links between matching and assembling: which node lies across which corner's edge.
//!
//! Where the budget has room for 4 bytes a corner, a link is written where it will be read: nearly every corner has one,
//! so a table by corner is the sorted list already. The second link of a corner (a middle face of an edge of three) goes
//! to a list beside. Otherwise links are shuffled by node, 8 bytes each, and sorted bucket by bucket. Both ways hand over
//! the same links in the same order.

use crate::base::Result;
use crate::mesh::Mesh;
use crate::store::Context;
use crate::store::budget::Grant;
use crate::store::shuffle::BudgetedShuffle;
use crate::store::shuffle::Producer;
use bytemuck::{Pod, Zeroable};
use std::ops::Range;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

/// The bit of [`HalfEdgePair::node`] that says that both faces run along the edge in the same direction: they are wound
/// against each other. Nodes have 31 bits to spare: there are at most 2³² corners.
pub const AGAINST: u32 = 1 << 31;
/// No link, in the table; no node has this number.
const NONE: u32 = u32::MAX;
/// Nodes handed over at a time from the table.
const CHUNK: usize = 1 << 14;

/// One direction of a match: across the edge that leaves `corner` lies `node`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
pub struct HalfEdgePair {
    /// Corner number in the mesh; its face is the link's origin.
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

/// All links of a mesh, being collected or read.
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

/// One thread's way to add links; close it with [`Adding::finish`].
pub(super) enum Adding<'a> {
    Table(&'a [AtomicU32], &'a Mutex<Vec<HalfEdgePair>>),
    Shuffled(Producer<'a, HalfEdgePair>, u64),
}

/// Whether the table of `corners` corners is made where `left` bytes of the budget are left. No corner has more than two
/// links, so the list beside it holds at most twice the table's bytes.
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

    /// A thread's way to add links.
    pub(super) fn adding(&self) -> Adding<'_> {
        match &self.kind {
            Kind::Table { across, more, .. } => Adding::Table(across, more),
            Kind::Shuffled { sized, scale } => Adding::Shuffled(sized.shuffle.producer(), *scale),
        }
    }

    /// Ends collecting: from here on links are taken.
    pub(super) fn seal(&mut self) {
        if let Kind::Table { more, .. } = &mut self.kind {
            more.get_mut().unwrap_or_else(|poison| poison.into_inner()).sort_unstable();
        }
    }

    /// Number of links at the most.
    pub(super) fn bound(&self) -> usize {
        match &self.kind {
            Kind::Table { across, more, .. } => {
                across.len() + more.lock().unwrap_or_else(|poison| poison.into_inner()).len()
            }
            Kind::Shuffled { sized, .. } => sized.shuffle.len() as usize,
        }
    }

    /// Ranges of nodes in which links are handed over.
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

    /// Takes the links of a part out, in the order of their corners.
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
                let mut links = Vec::with_capacity(corners.len());
                links.extend(corners.clone().zip(&across[corners.clone()]).filter_map(|(corner, node)| {
                    let node = node.load(Relaxed);
                    (node != NONE).then_some(HalfEdgePair { corner: corner as u32, node })
                }));
                let more = more.lock().unwrap_or_else(|poison| poison.into_inner());
                let place = |corner: usize| more.partition_point(|link| (link.corner as usize) < corner);
                let mine = &more[place(corners.start)..place(corners.end)];
                if !mine.is_empty() {
                    links.extend_from_slice(mine);
                    links.sort_unstable();
                }
                Ok(links)
            }
            Kind::Shuffled { sized, .. } => Ok(sorted(corners, &sized.shuffle.take(part)?)),
        }
    }
}

impl Adding<'_> {
    /// Adds the link from `corner` of `face` to `node`.
    #[inline]
    pub fn push(&mut self, corner: u32, face: usize, node: usize, against: bool) -> Result<()> {
        let link = HalfEdgePair { corner, node: node as u32 | if against { AGAINST } else { 0 } };
        match self {
            Self::Table(across, more) => {
                // All links of an edge come from one thread, so nobody else writes here.
                let place = &across[corner as usize];
                if place.load(Relaxed) == NONE {
                    place.store(link.node, Relaxed);
                } else {
                    more.lock().unwrap_or_else(|poison| poison.into_inner()).push(link);
                }
                Ok(())
            }
            // Nodes and buckets are few enough for 64 bits, and a product with the inverse is no division.
            Self::Shuffled(out, scale) => out.push(((face as u64 * *scale) >> 32) as usize, link),
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

/// Groups links by corner with a counting sort.
fn sorted(corners: Range<usize>, links: &[HalfEdgePair]) -> Vec<HalfEdgePair> {
    let mut starts = vec![0u32; corners.len() + 1];
    for link in links {
        starts[link.corner as usize - corners.start + 1] += 1;
    }
    for i in 0..corners.len() {
        starts[i + 1] += starts[i];
    }
    let mut sorted = vec![HalfEdgePair { corner: 0, node: 0 }; links.len()];
    for link in links {
        let slot = &mut starts[link.corner as usize - corners.start];
        sorted[*slot as usize] = *link;
        *slot += 1;
    }
    sorted
}
