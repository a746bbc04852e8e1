//! Which faces touch: half-edges matched by their vertices, at any size and in any order.
//!
//! A face of c corners has c half-edges (low vertex, high vertex, corner). They are shuffled by
//! low vertex into buckets that fit the cache; in a bucket a counting sort by low vertex and small
//! sorts by high vertex bring equal edges together. Every match becomes two [half-edge pairs](super::half_edge_pairs)
//! for [`super::dual_edges`]. An edge of k > 2 faces joins them as a chain in the order of
//! the file: k − 1 matches keep the graph sparse where a soup hangs a million faces on one edge.
//!
//! Boundary edges at exactly the same position are one edge, too ([`weld`]). Exporters duplicate vertices along texture
//! seams, and STL-like soups give every face vertices of its own; by index alone such meshes fall to pieces. Only
//! half-edges that found no partner by index are looked at, so a mesh that is whole costs nothing, and an edge that is
//! matched is never changed. Positions are compared as numbers (−0 equals 0), by a 95-bit hash of both ends: at 3·10⁹
//! open half-edges a false match has a chance below 1e-9.
//!
//! Memory and disk: 12 B per half-edge, 4 or 8 B per pair (together 48 or 60 B per triangle) and 16 B per open half-edge,
//! in memory where the budget allows, else on disk once out and once in. About 50 ns per triangle and thread, of
//! 1.3 million.

use super::half_edge_pairs::{AGAINST, HalfEdgePairs, PairSink};
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::{Error, Result};
use crate::mesh::Mesh;
use crate::store::shuffle::{BudgetedShuffle, Producer, Shuffle};
use crate::store::{Context, Run};
use bytemuck::{Pod, Zeroable};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use xxhash_rust::xxh3::xxh3_128;

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
    fn side(&self) -> FaceSide {
        FaceSide { corner: self.corner, ascending: self.from < self.to }
    }
}

/// A face's side of an edge: the corner it leaves from, and its direction there.
#[derive(Clone, Copy, Debug)]
struct FaceSide {
    corner: u32,
    ascending: bool,
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
struct Counters {
    nonmanifold: AtomicU64,
}

/// Most corners, which half-edge records number in 32 bits.
const MOST_CORNERS: u64 = u32::MAX as u64;
/// Most faces: a bit of their number tells windings apart.
const MOST_FACES: u64 = AGAINST as u64 - 1;

/// Refuses a mesh in the file `path` whose corners and faces cannot be numbered. Takes no time, so that commands can ask
/// before they begin.
///
/// # Errors
/// [`Error::Unusable`].
pub fn check_size(faces: u64, corners: u64, path: &Path) -> Result<()> {
    if faces <= MOST_FACES && corners <= MOST_CORNERS {
        return Ok(());
    }
    let problem = format!(
        "has {faces} faces with {corners} corners; both are numbered in 32 bits, which ends at {MOST_FACES} faces and \
         {MOST_CORNERS} corners"
    );
    Err(Error::unusable(path, problem, "cut it into several meshes, or decimate it"))
}

/// Matches all half-edges of `mesh` (whose file `path` errors name); welds the boundary.
///
/// # Errors
/// [`Error::Unusable`] above 2³² − 1 corners, [`Error::Io`], [`Error::Memory`],
/// [`Error::Cancelled`].
pub fn matched(mesh: &Mesh, path: &Path, context: Context<'_>) -> Result<(HalfEdgePairs, EdgeCounts)> {
    let (nodes, corners) = (mesh.faces.len(), mesh.faces.corner_count() as u64);
    check_size(nodes as u64, corners, path)?;
    let threads = context.run.threads as u64;
    // A bucket of half-edges is there raw, sorted, and as counts.
    let (file, what) = (|name| context.work.file(name), "matching edges");
    let sized = BudgetedShuffle::<HalfEdge>::new(&file("half_edges.tmp"), what, corners, 3 * threads, 3, context.run)?;
    let half_edges = &sized.shuffle;
    let mut pairs = HalfEdgePairs::new(nodes, corners as usize, context)?;
    let border = BudgetedShuffle::<u32>::new(&file("boundary.tmp"), what, corners, threads, 4, context.run)?;
    let boundary = &border.shuffle;
    let (edge_buckets, border_buckets) = (half_edges.buckets(), boundary.buckets() as u64);
    scatter(mesh, half_edges, context.run)?;
    let border_bucket = |corner: u32| (u64::from(corner) * border_buckets / corners.max(1)) as usize;
    let counters = Counters::default();
    context.run.each_chunk(
        edge_buckets,
        || (pairs.sink(), boundary.producer(), Sorter::default()),
        |bucket, (out, border, sorter)| {
            sorter.sort(half_edges.take(bucket)?);
            match_sorted(mesh, &sorter.sorted, out, &counters, |corner| border.push(border_bucket(corner), corner))
        },
        |(out, border, _)| out.finish().and_then(|()| border.finish()),
    )?;
    let open = boundary.len();
    drop(sized);
    let welded = if open > 0 { weld(mesh, boundary, &pairs, &counters, context)? } else { 0 };
    pairs.seal();
    let counts = EdgeCounts { boundary: open - welded, nonmanifold: counters.nonmanifold.load(Relaxed), welded };
    Ok((pairs, counts))
}

/// Pushes the half-edges of every face into the buckets of their low vertices.
fn scatter(mesh: &Mesh, half_edges: &Shuffle<HalfEdge>, run: &Run) -> Result<()> {
    let n = mesh.faces.len();
    // Buckets a vertex, in units of 2^-32, rounded down, so that the last vertex stays inside.
    let scale = ((half_edges.buckets() as u64) << 32) / mesh.positions.len().max(1) as u64;
    run.each_chunk(
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

/// Joins the faces of every run of equal edges; the corners of runs of one go to `border`.
fn match_sorted(
    mesh: &Mesh,
    sorted: &[HalfEdge],
    out: &mut PairSink<'_>,
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

/// Joins consecutive sides' faces both ways, in ascending corner order.
fn chain(
    mesh: &Mesh,
    sides: impl ExactSizeIterator<Item = FaceSide>,
    out: &mut PairSink<'_>,
    counters: &Counters,
) -> Result<()> {
    if sides.len() > 2 {
        counters.nonmanifold.fetch_add(1, Relaxed);
    }
    let mut last: Option<(FaceSide, usize)> = None;
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

/// An open half-edge under the hash of its two end positions; the hash's last bit is its direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
struct OpenHalfEdge {
    hash: [u32; 3],
    corner: u32,
}

impl OpenHalfEdge {
    fn edge(&self) -> [u32; 3] {
        [self.hash[0], self.hash[1], self.hash[2] | 1]
    }

    fn side(&self) -> FaceSide {
        FaceSide { corner: self.corner, ascending: self.hash[2] & 1 != 0 }
    }
}

/// Joins the half-edges of `boundary` (corner numbers) that coincide; returns how many found a
/// partner.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Memory`], [`crate::base::Error::Cancelled`].
fn weld(
    mesh: &Mesh,
    boundary: &Shuffle<u32>,
    pairs: &HalfEdgePairs,
    counters: &Counters,
    context: Context<'_>,
) -> Result<u64> {
    let copies = 2 * context.run.threads as u64;
    let sized = BudgetedShuffle::<OpenHalfEdge>::new(
        &context.work.file("places.tmp"),
        "welding",
        boundary.len(),
        copies,
        2,
        context.run,
    )?;
    let (keyed, buckets) = (&sized.shuffle, sized.shuffle.buckets());
    context.run.each_chunk(
        boundary.buckets(),
        || keyed.producer(),
        |bucket, out| {
            boundary.take(bucket)?.into_iter().try_for_each(|corner| match keyed_by_position(mesh, corner) {
                Some(open) => out.push(((u64::from(open.hash[0]) * buckets as u64) >> 32) as usize, open),
                None => Ok(()),
            })
        },
        Producer::finish,
    )?;
    let welded = AtomicU64::new(0);
    context.run.each_chunk(
        buckets,
        || pairs.sink(),
        |bucket, out| {
            let mut sorted = keyed.take(bucket)?;
            sorted.sort_unstable_by_key(|open| (open.edge(), open.corner));
            for same in sorted.chunk_by(|a, b| a.edge() == b.edge()) {
                if same.len() > 1 {
                    welded.fetch_add(same.len() as u64, Relaxed);
                    chain(mesh, same.iter().map(OpenHalfEdge::side), out, counters)?;
                }
            }
            Ok(())
        },
        PairSink::finish,
    )?;
    Ok(welded.into_inner())
}

/// The hash of a half-edge's ends, in either direction; `None` where a coordinate is no number
/// or both ends coincide.
fn keyed_by_position(mesh: &Mesh, corner: u32) -> Option<OpenHalfEdge> {
    let face = mesh.faces.face_of_corner(corner as usize);
    let slot = corner as usize - mesh.faces.corner_range(face).start;
    let (a, b) = mesh.faces.with(face, |corners| (corners[slot], corners[(slot + 1) % corners.len()]));
    // PairSink zero turns −0 into 0.
    let ends = [mesh.positions.get(a), mesh.positions.get(b)].map(|p| p.map(|x| x + 0.));
    if ends.iter().flatten().any(|x| !x.is_finite()) || ends[0] == ends[1] {
        return None;
    }
    let mut bits = ends.map(|p| p.map(f64::to_bits));
    let ascending = u32::from(bits[0] < bits[1]);
    bits.sort_unstable();
    let hash = xxh3_128(bytemuck::bytes_of(&bits));
    Some(OpenHalfEdge { hash: [hash as u32, (hash >> 32) as u32, (hash >> 64) as u32 & !1 | ascending], corner })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_numbered_is_refused() {
        let refused = |faces, corners| check_size(faces, corners, "mesh.ply".as_ref()).is_err();
        assert!(!refused(MOST_CORNERS / 3, MOST_CORNERS) && !refused(MOST_FACES, 0));
        assert!(refused(1, MOST_CORNERS + 1) && refused(MOST_FACES + 1, 0));
    }

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
