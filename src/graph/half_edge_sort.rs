//! Sorts half-edges so that equal edges are adjacent.
//!
//! Time: two passes over a bucket and tiny sorts, linear in its half-edges as long as their low vertices are close
//! together. Memory: 12 bytes per half-edge of a bucket twice, unsorted and sorted, and 4 per low vertex, at most 16
//! per half-edge.

use super::edge_links::FaceSide;
use crate::mesh::Mesh;
use bytemuck::{Pod, Zeroable};
use std::convert::Infallible;
use std::ops::Range;

/// A half-edge: its vertices in the direction of its face's winding, and the corner where it starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct HalfEdge {
    pub from: u32,
    pub to: u32,
    pub corner: u32,
}

impl HalfEdge {
    #[inline]
    pub fn low(&self) -> u32 {
        self.from.min(self.to)
    }

    /// Equal edges agree in the first two, whatever their direction.
    #[inline]
    fn key(&self) -> (u32, u32, u32) {
        (self.low(), self.from.max(self.to), self.corner)
    }

    /// The rest of the key after the low vertex.
    #[inline]
    fn rest(&self) -> u64 {
        u64::from(self.from.max(self.to)) << 32 | u64::from(self.corner)
    }

    #[inline]
    pub fn side(&self) -> FaceSide {
        FaceSide { corner: self.corner, ascending: self.from < self.to }
    }
}

/// Sorts half-edges by (low, high, corner): a counting sort by low vertex, then tiny sorts.
#[derive(Default)]
pub(super) struct Sorter {
    counts: Vec<u32>,
    sorted: Vec<HalfEdge>,
}

impl Sorter {
    /// Sorts `records`; may remove some of them.
    pub fn sort(&mut self, records: &mut Vec<HalfEdge>) {
        self.sorted.clear();
        if records.is_empty() {
            return;
        }
        let bounds = records.iter().fold((u32::MAX, 0), |(low, high), r| (low.min(r.low()), high.max(r.low())));
        let (mut first, mut width) = (bounds.0, (bounds.1 - bounds.0) as usize + 1);
        let mut above = Vec::new();
        if width > 4 * records.len() + 1024 {
            // Vertices far apart: counting all of them would cost more than sorting. Most of a block's are close
            // together.
            let sample = records.iter().step_by(records.len().div_ceil(1024)).map(HalfEdge::low);
            (first, width) = around_the_median(sample.collect(), 2 * records.len());
            let end = u64::from(first) + width as u64;
            records.retain(|record| {
                let (is_below, is_above) = (record.low() < first, u64::from(record.low()) >= end);
                if is_below {
                    self.sorted.push(*record);
                }
                if is_above {
                    above.push(*record);
                }
                !(is_below || is_above)
            });
            self.sorted.sort_unstable_by_key(HalfEdge::key);
            above.sort_unstable_by_key(HalfEdge::key);
        }
        self.count(first, width, records);
        self.sorted.extend(above);
    }

    /// Appends `records`, whose low vertices are the `width` numbers from `first` on.
    fn count(&mut self, first: u32, width: usize, records: &[HalfEdge]) {
        self.counts.clear();
        self.counts.resize(width + 1, 0);
        for r in records {
            self.counts[(r.low() - first) as usize + 1] += 1;
        }
        for i in 0..width {
            self.counts[i + 1] += self.counts[i];
        }
        let before = self.sorted.len();
        self.sorted.resize(before + records.len(), HalfEdge::zeroed());
        let sorted = &mut self.sorted[before..];
        for r in records {
            let slot = &mut self.counts[(r.low() - first) as usize];
            sorted[*slot as usize] = *r;
            *slot += 1;
        }
        let mut start = 0;
        for &end in &self.counts[..width] {
            // All have the same low vertex: the rest of the key fits in one word.
            sorted[start..end as usize].sort_unstable_by_key(HalfEdge::rest);
            start = end as usize;
        }
    }

    /// The half-edges of each edge, in the order of their corners.
    pub fn edges(&self) -> impl Iterator<Item = &[HalfEdge]> {
        self.sorted.chunk_by(|a, b| (a.key().0, a.key().1) == (b.key().0, b.key().1))
    }
}

/// A window of low vertices around the median of a `sample`, which is not empty: the first, and their number, `width`
/// or less.
pub(super) fn around_the_median(mut sample: Vec<u32>, width: usize) -> (u32, usize) {
    let middle = sample.len() / 2;
    let median = *sample.select_nth_unstable(middle).1;
    let first = median.saturating_sub((width / 2) as u32);
    (first, width.min((u32::MAX - first) as usize))
}

/// Calls `visit` with the half-edges of the faces of `nodes`; those from a vertex to itself are skipped, and faces that
/// are known as duplicates.
pub(super) fn for_each(mesh: &Mesh, nodes: Range<usize>, mut visit: impl FnMut(HalfEdge)) {
    let Ok(()) = try_for_each(mesh, nodes, |half_edge| {
        visit(half_edge);
        Ok::<(), Infallible>(())
    });
}

/// The same, but stops when `visit` fails.
#[inline]
pub(super) fn try_for_each<E>(
    mesh: &Mesh,
    nodes: Range<usize>,
    mut visit: impl FnMut(HalfEdge) -> Result<(), E>,
) -> Result<(), E> {
    mesh.faces.try_for_each(nodes, |face, corners| {
        if mesh.is_duplicate(face) {
            return Ok(());
        }
        let first = mesh.faces.corner_range(face).start;
        for (slot, &a) in corners.iter().enumerate() {
            let b = corners[if slot + 1 == corners.len() { 0 } else { slot + 1 }];
            if a != b {
                visit(HalfEdge { from: a, to: b, corner: (first + slot) as u32 })?;
            }
        }
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_counting_sort_sorts() {
        let mut sorter = Sorter::default();
        for spread in [1u32, 50, 1_000_000, u32::MAX - 7] {
            // Spread over the whole range, or mostly close together at its beginning, middle or end.
            for together in [0, 1, spread / 2 + 1, spread] {
                let mut records: Vec<HalfEdge> = (0..5000u32)
                    .map(|i| {
                        let x = i.wrapping_mul(2_654_435_761);
                        let far = together == 0 || i % 40 == 0;
                        let from = if far { x % spread } else { together.saturating_sub(x % 300) };
                        HalfEdge { from: 7 + from, to: u32::MAX - (x >> 20), corner: i }
                    })
                    .collect();
                let mut expected = records.clone();
                expected.sort_unstable_by_key(HalfEdge::key);
                sorter.sort(&mut records);
                assert_eq!(sorter.sorted, expected, "{spread} {together}");
            }
        }
        sorter.sort(&mut Vec::new());
        assert!(sorter.sorted.is_empty() && sorter.edges().next().is_none());
    }
}
