//! Matches the half-edges of a block of nodes in place, in a core's cache.
//!
//! Within a block corners are counted from its first one, so a half-edge without its low vertex fits in one word: the
//! high vertex, the corner, the direction. Two passes over the faces count the words of each low vertex and store them,
//! and the half-dozen words of each low vertex are insertion-sorted. This gives the order of [`Sorter`] with a third of
//! its bytes. Low vertices are counted in a window of numbers. It holds all of a block's, or, where these lie far
//! apart, those around their median: the faces at the border of a block of a grid have vertices of another block, far
//! away. Half-edges outside the window go to [`Sorter`].
//!
//! Cost: about 20 ns per triangle.

use super::edge_links::{FaceSide, Match, link_sides};
use super::half_edge_sort::{HalfEdge, Sorter, around_the_median, for_each, try_for_each};
use super::node_blocks::NodeBlocks;
use crate::base::Result;
use crate::base::random::splitmix_step;
use crate::mesh::Mesh;
use std::ops::Range;

/// Buffers for matching blocks, one after another.
#[derive(Default)]
pub(super) struct BlockMatcher {
    counts: Vec<u32>,
    /// By low vertex: high vertex in 32 bits, corner in the block, 1 where the half-edge ascends.
    words: Vec<u64>,
    sides: Vec<HalfEdge>,
    /// Half-edges whose low vertices are outside the window.
    outside: Vec<HalfEdge>,
    far_apart: Sorter,
}

impl BlockMatcher {
    /// Joins the half-edges that meet within block `block`. Passes each edge that does not have exactly two sides
    /// there to `edge`, and instead of joining it each edge that other blocks may share, with whether they may.
    pub fn match_block(
        &mut self,
        mesh: &Mesh,
        blocks: &NodeBlocks<'_>,
        block: usize,
        mut join: impl FnMut(Match) -> Result<()>,
        mut edge: impl FnMut(&[HalfEdge], bool) -> Result<()>,
    ) -> Result<()> {
        let nodes = blocks.nodes_of(block);
        if nodes.is_empty() {
            return Ok(());
        }
        let first_corner = mesh.faces.corner_range(nodes.start).start as u32;
        let (low, width) = low_vertices(mesh, nodes.clone());
        let Self { counts, words, sides, outside, far_apart } = self;
        counts.clear();
        counts.resize(width + 1, 0);
        outside.clear();
        for_each(mesh, nodes.clone(), |h| match counts.get_mut(h.low().wrapping_sub(low) as usize + 1) {
            Some(count) => *count += 1,
            None => outside.push(h),
        });
        (0..width).for_each(|v| counts[v + 1] += counts[v]);
        // Every word is overwritten below.
        words.resize(counts[width] as usize, 0);
        for_each(mesh, nodes, |h| {
            let v = h.low().wrapping_sub(low) as usize;
            if v < width {
                let slot = &mut counts[v];
                let rest = u64::from(h.corner - first_corner) << 1 | u64::from(h.from < h.to);
                words[*slot as usize] = u64::from(h.from.max(h.to)) << 32 | rest;
                *slot += 1;
            }
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
                let other = (same[0] >> 32) as u32;
                let elsewhere = shares(v) && shares(other);
                if !elsewhere {
                    link_sides(mesh, same.iter().map(|word| side(*word)), &mut join)?;
                }
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
        far_apart.sort(outside);
        for sides in far_apart.edges() {
            let elsewhere = shares(sides[0].from) && shares(sides[0].to);
            if !elsewhere {
                link_sides(mesh, sides.iter().map(HalfEdge::side), &mut join)?;
            }
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
/// other. It is 0 if all come in pairs, and otherwise not, with a probability of 1 − 2⁻⁶⁴. From a disk it costs no more
/// than reading the faces.
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

/// The window of low vertices that are counted in a block of `nodes`: the first of them, and their number.
fn low_vertices(mesh: &Mesh, nodes: Range<usize>) -> (u32, usize) {
    let (mut low, mut high, mut corners) = (u32::MAX, 0, 0);
    mesh.faces.for_each(nodes.clone(), |_, face| {
        corners += face.len();
        (low, high) = face.iter().fold((low, high), |(low, high), &v| (low.min(v), high.max(v)));
    });
    // A corner's number has 31 bits of a word.
    if corners == 0 || corners > 1 << 31 {
        return (0, 0);
    }
    let width = (high - low) as usize + 1;
    if width <= 4 * corners + 1024 {
        return (low, width);
    }
    // A compact block has a vertex for six corners.
    let sample = nodes.clone().step_by(nodes.len().div_ceil(1024));
    let lows = sample.filter_map(|face| mesh.faces.with(face, |corners| corners.iter().copied().min()));
    let lows: Vec<u32> = lows.collect();
    if lows.is_empty() { (0, 0) } else { around_the_median(lows, corners / 2) }
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
