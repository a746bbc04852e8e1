//! Matches the half-edges of a block of nodes in place, in a core's cache.
//!
//! Within a block corners are counted from its first one, so a half-edge without its low vertex fits in one word: the
//! high vertex, the corner, the direction. Two passes over the faces count the words of each low vertex and store them,
//! and the half-dozen words of each low vertex are insertion-sorted. This gives the order of [`Sorter`] with a third of
//! its bytes. If a block's vertices lie far apart, as in a bad order, counting would cost more than it saves, and
//! [`Sorter`] is used.
//!
//! Cost: about 20 ns per triangle.

use super::half_edge_sort::{FaceSide, HalfEdge, Match, Sorter, chain, for_each, try_for_each};
use super::node_blocks::NodeBlocks;
use crate::base::Result;
use crate::base::random::splitmix_step;
use crate::mesh::Mesh;

/// Buffers for matching blocks, one after another.
#[derive(Default)]
pub(super) struct BlockMatcher {
    counts: Vec<u32>,
    /// By low vertex: high vertex in 32 bits, corner in the block, 1 where the half-edge ascends.
    words: Vec<u64>,
    sides: Vec<HalfEdge>,
    records: Vec<HalfEdge>,
    far_apart: Sorter,
}

impl BlockMatcher {
    /// Joins the half-edges that meet within block `block`. Passes each edge that does not have exactly two sides
    /// there, or that other blocks may share, to `edge`, with whether they may.
    pub fn match_block(
        &mut self,
        mesh: &Mesh,
        blocks: &NodeBlocks<'_>,
        block: usize,
        mut join: impl FnMut(Match) -> Result<()>,
        mut edge: impl FnMut(&[HalfEdge], bool) -> Result<()>,
    ) -> Result<()> {
        let nodes = blocks.nodes_of(block);
        let (mut low, mut high, mut count) = (u32::MAX, 0, 0);
        mesh.faces.for_each(nodes.clone(), |_, corners| {
            count += corners.len();
            (low, high) = corners.iter().fold((low, high), |(low, high), &v| (low.min(v), high.max(v)));
        });
        if count == 0 {
            return Ok(());
        }
        let (width, first_corner) = ((high - low) as usize + 1, mesh.faces.corner_range(nodes.start).start as u32);
        if width > 4 * count + 1024 || count > 1 << 31 {
            return self.match_far_apart(mesh, blocks, block, join, edge);
        }
        let Self { counts, words, sides, .. } = self;
        counts.clear();
        counts.resize(width + 1, 0);
        for_each(mesh, nodes.clone(), |h| counts[(h.low() - low) as usize + 1] += 1);
        (0..width).for_each(|v| counts[v + 1] += counts[v]);
        // Every word is overwritten below.
        words.resize(counts[width] as usize, 0);
        for_each(mesh, nodes, |h| {
            let slot = &mut counts[(h.low() - low) as usize];
            let rest = u64::from(h.corner - first_corner) << 1 | u64::from(h.from < h.to);
            words[*slot as usize] = u64::from(h.from.max(h.to)) << 32 | rest;
            *slot += 1;
        });
        let shared = blocks.shared();
        let shares = |v: u32| shared.is_some_and(|shared| shared.has(v));
        let mut start = 0;
        for (v, &end) in (low..).zip(&counts[..width]) {
            let words = &mut words[start..end as usize];
            start = end as usize;
            sort_few(words);
            for same in words.chunk_by(|a, b| a >> 32 == b >> 32) {
                let side = |word: u64| FaceSide { corner: first_corner + (word as u32 >> 1), ascending: word & 1 == 1 };
                if same.len() > 1 {
                    chain(mesh, same.iter().map(|word| side(*word)), |a, b| a != b, &mut join)?;
                }
                let other = (same[0] >> 32) as u32;
                let elsewhere = shares(v) && shares(other);
                if elsewhere || same.len() != 2 {
                    sides.clear();
                    sides.extend(same.iter().map(|word| match side(*word) {
                        FaceSide { corner, ascending: true } => HalfEdge { from: v, to: other, corner },
                        FaceSide { corner, ascending: false } => HalfEdge { from: other, to: v, corner },
                    }));
                    edge(sides, elsewhere)?;
                }
            }
        }
        Ok(())
    }

    /// The same if the vertices lie far apart.
    fn match_far_apart(
        &mut self,
        mesh: &Mesh,
        blocks: &NodeBlocks<'_>,
        block: usize,
        mut join: impl FnMut(Match) -> Result<()>,
        mut edge: impl FnMut(&[HalfEdge], bool) -> Result<()>,
    ) -> Result<()> {
        let Self { records, far_apart, .. } = self;
        records.clear();
        records.reserve(blocks.corners());
        for_each(mesh, blocks.nodes_of(block), |half_edge| records.push(half_edge));
        far_apart.sort(records);
        for sides in far_apart.edges() {
            if sides.len() > 1 {
                chain(mesh, sides.iter().map(HalfEdge::side), |a, b| a != b, &mut join)?;
            }
            let elsewhere = blocks.shared().is_some_and(|shared| shared.has(sides[0].from) && shared.has(sides[0].to));
            if elsewhere || sides.len() != 2 {
                edge(sides, elsewhere)?;
            }
        }
        Ok(())
    }
}

/// Passes the half-edges of block `block` whose edges other blocks may share to `elsewhere`. Returns whether each other
/// edge has two sides, in opposite directions, or several such pairs of them.
///
/// For that one number is summed up: a hash of the edge for each side in one direction, minus that for each in the
/// other. It is 0 if all come in pairs, and otherwise not, with a probability of 1 − 2⁻⁶⁴. About 10 ns per triangle.
pub(super) fn comes_in_pairs(
    mesh: &Mesh,
    blocks: &NodeBlocks<'_>,
    block: usize,
    mut elsewhere: impl FnMut(HalfEdge) -> Result<()>,
) -> Result<bool> {
    let shared = blocks.shared();
    let shares = |v: u32| shared.is_some_and(|shared| shared.has(v));
    let mut sum = 0u64;
    try_for_each(mesh, blocks.nodes_of(block), |half_edge| {
        let HalfEdge { from, to, .. } = half_edge;
        if shares(from) && shares(to) {
            return elsewhere(half_edge);
        }
        let hash = splitmix_step(u64::from(from.min(to)) << 32 | u64::from(from.max(to)));
        sum = if from < to { sum.wrapping_add(hash) } else { sum.wrapping_sub(hash) };
        Ok(())
    })?;
    Ok(sum == 0)
}

/// Sorts words, mostly half a dozen. Inlined, because a call would cost as much as the sort.
#[inline(always)]
fn sort_few(words: &mut [u64]) {
    if words.len() > 16 {
        words.sort_unstable();
        return;
    }
    for i in 1..words.len() {
        let word = words[i];
        let mut place = i;
        while place > 0 && words[place - 1] > word {
            words[place] = words[place - 1];
            place -= 1;
        }
        words[place] = word;
    }
}
