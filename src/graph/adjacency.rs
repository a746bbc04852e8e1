//! Which faces touch: half-edges matched by their vertices, at any size and in any order.
//!
//! A face of c corners has c half-edges (low vertex, high vertex, corner). They are shuffled by
//! low vertex into buckets that fit the cache; in a bucket a counting sort by low vertex and small
//! sorts by high vertex bring equal edges together. Every match becomes two [links](super::half_edge_pairs)
//! for [`super::assemble`]. An edge of k > 2 faces links them as a chain in the order of
//! the file: k − 1 links keep the graph sparse where a soup hangs a million faces on one edge.
//!
//! Memory and disk: 12 B a half-edge and 4 or 8 B a link (together 48 or 60 B a triangle), in memory
//! where the budget allows, else on disk once out and once in. About 50 ns a triangle and thread, of 1.3 million.

use super::half_edge_pairs::{AGAINST, Adding, HalfEdgePairs};
use super::weld;
use crate::base::parallel::{chunk_count, chunk_range, each_chunk};
use crate::base::{Error, Result};
use crate::mesh::Mesh;
use crate::store::shuffle::BudgetedShuffle;
use crate::store::shuffle::{Producer, Shuffle};
use crate::store::{Context, Run};
use bytemuck::{Pod, Zeroable};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

const CHUNK: usize = 1 << 14;

/// A half-edge: its vertices in the direction of its face's winding, and the corner it leaves from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
struct HalfEdge {
    from: u32,
    to: u32,
    corner: u32,
}

impl HalfEdge {
    #[inline]
    fn low(&self) -> u32 {
        self.from.min(self.to)
    }

    /// Equal edges compare equal in the first two, whatever their direction.
    #[inline]
    fn key(&self) -> (u32, u32, u32) {
        (self.low(), self.from.max(self.to), self.corner)
    }

    /// The rest of the key behind the low vertex.
    #[inline]
    fn rest(&self) -> u64 {
        u64::from(self.from.max(self.to)) << 32 | u64::from(self.corner)
    }

    #[inline]
    fn side(&self) -> Side {
        Side { corner: self.corner, ascending: self.from < self.to }
    }
}

/// A face's side of an edge: the corner it leaves from, and its direction there.
#[derive(Clone, Copy, Debug)]
pub(super) struct Side {
    pub corner: u32,
    pub ascending: bool,
}

/// What matching found.
#[derive(Clone, Copy, Debug, Default)]
pub struct EdgeCounts {
    /// Edges with one face, after welding.
    pub boundary: u64,
    /// Edges with three faces or more.
    pub nonmanifold: u64,
    /// Boundary edges joined to others at exactly the same position.
    pub welded: u64,
}

/// Counters shared by the matching threads.
#[derive(Debug, Default)]
pub(super) struct Counters {
    pub nonmanifold: AtomicU64,
}

/// Refuses meshes whose corners cannot be numbered in 32 bits.
fn check_size(mesh: &Mesh, path: &Path) -> Result<()> {
    if mesh.faces.corner_count() as u64 > u64::from(u32::MAX) || mesh.faces.len() >= AGAINST as usize {
        return Err(Error::unusable(
            path,
            format!("has {} corners of {} faces, more than 2^32 of 2^31", mesh.faces.corner_count(), mesh.faces.len()),
            "split the mesh",
        ));
    }
    Ok(())
}

/// Matches all half-edges of `mesh` (whose file `path` errors name); welds the boundary.
///
/// # Errors
/// [`Error::Unusable`] above 2³² − 1 corners, [`Error::Io`], [`Error::Memory`],
/// [`Error::Cancelled`].
pub fn matched(mesh: &Mesh, path: &Path, context: Context<'_>) -> Result<(HalfEdgePairs, EdgeCounts)> {
    check_size(mesh, path)?;
    let (nodes, corners) = (mesh.faces.len(), mesh.faces.corner_count() as u64);
    let threads = context.run.threads as u64;
    // A bucket of half-edges is there raw, sorted, and as counts.
    let (file, what) = (|name| context.work.file(name), "matching edges");
    let sized = BudgetedShuffle::<HalfEdge>::new(&file("half_edges.tmp"), what, corners, 3 * threads, 3, context.run)?;
    let half_edges = &sized.shuffle;
    let mut links = HalfEdgePairs::new(nodes, corners as usize, context)?;
    let border = BudgetedShuffle::<u32>::new(&file("boundary.tmp"), what, corners, threads, 4, context.run)?;
    let boundary = &border.shuffle;
    let (edge_buckets, border_buckets) = (half_edges.buckets(), boundary.buckets() as u64);
    scatter(mesh, half_edges, context.run)?;
    let border_bucket = |corner: u32| (u64::from(corner) * border_buckets / corners.max(1)) as usize;
    let counters = Counters::default();
    each_chunk(
        context.run.threads,
        &context.run.cancel,
        edge_buckets,
        || (links.adding(), boundary.producer(), Sorter::default()),
        |bucket, (out, border, sorter)| {
            sorter.sort(half_edges.take(bucket)?);
            match_sorted(mesh, &sorter.sorted, out, &counters, |corner| border.push(border_bucket(corner), corner))
        },
        |(out, border, _)| out.finish().and_then(|()| border.finish()),
    )?;
    let open = boundary.len();
    drop(sized);
    let welded = if open > 0 { weld::weld(mesh, boundary, &links, &counters, context)? } else { 0 };
    links.seal();
    let counts = EdgeCounts { boundary: open - welded, nonmanifold: counters.nonmanifold.load(Relaxed), welded };
    Ok((links, counts))
}

/// Pushes the half-edges of every face into the buckets of their low vertices.
fn scatter(mesh: &Mesh, half_edges: &Shuffle<HalfEdge>, run: &Run) -> Result<()> {
    let n = mesh.faces.len();
    // Buckets a vertex, in units of 2^-32, rounded down, so that the last vertex stays inside.
    let scale = ((half_edges.buckets() as u64) << 32) / mesh.positions.len().max(1) as u64;
    each_chunk(
        run.threads,
        &run.cancel,
        chunk_count(n, CHUNK),
        || half_edges.producer(),
        |k, out| {
            let mut result = Ok(());
            mesh.faces.for_each(chunk_range(n, CHUNK, k), |face, corners| {
                let first = mesh.faces.corner_range(face).start;
                for (slot, &a) in corners.iter().enumerate() {
                    let b = corners[if slot + 1 == corners.len() { 0 } else { slot + 1 }];
                    if a != b && result.is_ok() {
                        let bucket = (u64::from(a.min(b)) * scale) >> 32;
                        let half_edge = HalfEdge { from: a, to: b, corner: (first + slot) as u32 };
                        result = out.push(bucket as usize, half_edge);
                    }
                }
            });
            run.progress.advance("graph", 0);
            result
        },
        Producer::finish,
    )
}

/// Sorts a bucket by (low, high, corner): a counting sort by low vertex, then tiny sorts.
#[derive(Default)]
struct Sorter {
    counts: Vec<u32>,
    sorted: Vec<HalfEdge>,
}

impl Sorter {
    fn sort(&mut self, records: Vec<HalfEdge>) {
        self.sorted.clear();
        let bounds = records.iter().fold((u32::MAX, 0), |(low, high), r| (low.min(r.low()), high.max(r.low())));
        if records.is_empty() {
            return;
        }
        let width = (bounds.1 - bounds.0) as usize + 1;
        if width > 4 * records.len() + 1024 {
            // Vertices far apart: counting them would cost more than sorting.
            self.sorted = records;
            self.sorted.sort_unstable_by_key(HalfEdge::key);
            return;
        }
        self.counts.clear();
        self.counts.resize(width + 1, 0);
        for r in &records {
            self.counts[(r.low() - bounds.0) as usize + 1] += 1;
        }
        for i in 0..width {
            self.counts[i + 1] += self.counts[i];
        }
        self.sorted.resize(records.len(), HalfEdge::zeroed());
        for r in &records {
            let slot = &mut self.counts[(r.low() - bounds.0) as usize];
            self.sorted[*slot as usize] = *r;
            *slot += 1;
        }
        let mut start = 0;
        for &end in &self.counts[..width] {
            // All of one low vertex: what is left to compare fits one word.
            self.sorted[start..end as usize].sort_unstable_by_key(HalfEdge::rest);
            start = end as usize;
        }
    }
}

/// Links the faces of every run of equal edges; the corners of runs of one go to `border`.
fn match_sorted(
    mesh: &Mesh,
    sorted: &[HalfEdge],
    out: &mut Adding<'_>,
    counters: &Counters,
    mut border: impl FnMut(u32) -> Result<()>,
) -> Result<()> {
    for edge in sorted.chunk_by(|a, b| (a.key().0, a.key().1) == (b.key().0, b.key().1)) {
        match edge {
            [single] => border(single.corner)?,
            several => chain(mesh, several.iter().map(HalfEdge::side), out, counters)?,
        }
    }
    Ok(())
}

/// Links consecutive sides' faces both ways, in ascending corner order.
pub(super) fn chain(
    mesh: &Mesh,
    sides: impl ExactSizeIterator<Item = Side>,
    out: &mut Adding<'_>,
    counters: &Counters,
) -> Result<()> {
    if sides.len() > 2 {
        counters.nonmanifold.fetch_add(1, Relaxed);
    }
    let mut last: Option<(Side, usize)> = None;
    for side in sides {
        let face = mesh.faces.face_of_corner(side.corner as usize);
        if let Some((before, other)) = last
            && face != other
        {
            let against = before.ascending == side.ascending;
            out.push(before.corner, other, face, against)?;
            out.push(side.corner, face, other, against)?;
        }
        last = Some((side, face));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_counting_sort_sorts() {
        let mut sorter = Sorter::default();
        for spread in [1u32, 50, 1_000_000] {
            let records: Vec<HalfEdge> = (0..5000u32)
                .map(|i| {
                    let x = i.wrapping_mul(2_654_435_761);
                    HalfEdge { from: 7 + x % spread, to: u32::MAX - (x >> 20), corner: i }
                })
                .collect();
            let mut expected = records.clone();
            expected.sort_unstable_by_key(HalfEdge::key);
            sorter.sort(records);
            assert_eq!(sorter.sorted, expected);
        }
        sorter.sort(Vec::new());
        assert!(sorter.sorted.is_empty());
    }
}
