//! Which faces are adjacent: half-edges matched by their vertices, at any size and in any order.
//!
//! A face of c corners has c half-edges (low vertex, high vertex, corner). Equal ones are brought together by a
//! counting sort by low vertex and small sorts by high vertex (`half_edge_sort.rs`): first block by block
//! (`node_blocks.rs`) of consecutive faces, in the cache; then those of edges that several blocks may share, shuffled
//! by low vertex into buckets. If faces are scattered, all half-edges are shuffled. Every match becomes two [half-edge
//! pairs](super::half_edge_pairs) for [`super::dual_edges`]; [`super::edge_links`] decides at edges of three faces or
//! more.
//!
//! Boundary edges at exactly the same position are welded ([`weld`]). Exporters duplicate vertices along texture seams,
//! and STL-like soups give every face vertices of its own; by index alone such meshes fall to pieces. Only half-edges
//! without a partner by index are considered, so a mesh without seams costs nothing, and a matched edge is never
//! changed. Positions are compared as numbers (−0 equals 0), by a 95-bit hash of both ends: at 3·10⁹ open half-edges
//! the probability of a false match is below 1e-9.
//!
//! Memory and disk: 2 B per vertex, 12 B per half-edge that is shuffled, and 16 B per open half-edge, in memory where
//! the budget allows, else written to disk and read once; and the pairs: 4 B per corner in memory or, if that is too
//! much, none for those within blocks, which are matched when they are needed.

use super::edge_links::{FaceSide, Match, link_sides};
use super::half_edge_block::{BlockMatcher, comes_in_pairs};
use super::half_edge_pairs::{HalfEdgePairs, PairSink};
use super::half_edge_sort::{self, HalfEdge, Sorter};
use super::node_blocks::NodeBlocks;
use super::nonmanifold::{DuplicateSides, NonmanifoldEdges};
use crate::base::Result;
use crate::base::parallel::{chunk_count, chunk_range};
use crate::mesh::Mesh;
use crate::mesh::geometry::check_size;
use crate::store::shuffle::{BudgetedShuffle, Producer, RangeBuckets, Shuffle};
use crate::store::{Context, Run};
use bytemuck::{Pod, Zeroable};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use xxhash_rust::xxh3::xxh3_128;

const CHUNK: usize = 1 << 14;

/// Counts from matching.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct EdgeCounts {
    /// Edges with one face, after welding.
    pub boundary: u64,
    /// Edges with three faces or more, without those of [`HalfEdgePairs::nonmanifold_within`].
    pub nonmanifold: u64,
    /// Sides of duplicates at these.
    pub duplicates: DuplicateSides,
    /// Boundary edges welded to others at exactly the same position.
    pub welded: u64,
}

/// Shared state of the threads that match half-edges.
struct Matching<'a> {
    mesh: &'a Mesh,
    /// Half-edges whose partners may be in any block, by low vertex.
    half_edges: &'a Shuffle<HalfEdge>,
    by_vertex: RangeBuckets,
    /// Corners of half-edges without a partner.
    boundary: &'a Shuffle<u32>,
    by_corner: RangeBuckets,
    /// Edges with three faces or more.
    nonmanifold: NonmanifoldEdges,
    run: &'a Run<'a>,
}

/// Matches all half-edges of `mesh` (from the file `path`, for errors), in its `blocks` if there are any; welds the
/// boundary.
///
/// # Errors
/// [`Error::Unusable`] above 2³² − 1 corners, [`Error::Io`], [`Error::Memory`],
/// [`Error::Cancelled`].
pub(super) fn matched<'a>(
    mesh: &Mesh,
    path: &Path,
    blocks: Option<NodeBlocks<'a>>,
    context: Context<'a>,
) -> Result<(HalfEdgePairs<'a>, EdgeCounts)> {
    let (nodes, corners) = (mesh.faces.len(), mesh.faces.corner_count() as u64);
    check_size(nodes as u64, corners, path)?;
    let threads = context.run.threads as u64;
    let (file, what) = (|name| context.work.spill(name), "matching edges");
    // A bucket of half-edges takes memory unsorted, sorted, and as counts.
    let records = blocks.as_ref().map_or(corners, |blocks| blocks.shared_half_edges().min(corners));
    let sized = BudgetedShuffle::<HalfEdge>::new(file("half_edges.tmp"), what, records, 3 * threads, 3, context.run)?;
    let half_edges = &sized.shuffle;
    let mut pairs = HalfEdgePairs::new(mesh, blocks.as_ref(), context)?;
    let border = BudgetedShuffle::<u32>::new(file("boundary.tmp"), what, corners, threads, 4, context.run)?;
    let boundary = &border.shuffle;
    let matching = Matching {
        mesh,
        half_edges,
        by_vertex: RangeBuckets::new(mesh.positions.len(), half_edges.buckets()),
        boundary,
        by_corner: RangeBuckets::new(corners as usize, boundary.buckets()),
        nonmanifold: NonmanifoldEdges::default(),
        run: context.run,
    };
    match &blocks {
        Some(blocks) if pairs.finds_within() => matching.divide_blocks(blocks)?,
        Some(blocks) => matching.match_blocks(blocks, &pairs)?,
        None => matching.scatter()?,
    }
    context.run.each_chunk(
        half_edges.buckets(),
        || (pairs.sink(), boundary.producer(), Sorter::default()),
        |bucket, (out, open, sorter)| {
            sorter.sort(&mut half_edges.take(bucket)?);
            for edge in sorter.edges() {
                if let [single] = edge {
                    open.push(matching.by_corner.bucket_of(single.corner), single.corner)?;
                } else {
                    matching.nonmanifold.count(mesh, edge.iter().map(|side| side.corner));
                    link_sides(mesh, edge.iter().map(HalfEdge::side), |pair| out.push(pair))?;
                }
            }
            Ok(())
        },
        |(out, open, _)| out.finish().and_then(|()| open.finish()),
    )?;
    let (open, nonmanifold) = (boundary.len(), matching.nonmanifold);
    drop(sized);
    pairs.keep(blocks);
    let welded = if open > 0 { weld(mesh, boundary, &pairs, &nonmanifold, context)? } else { 0 };
    link_duplicates(mesh, &pairs, context.run)?;
    pairs.finish_collecting();
    let counts = EdgeCounts {
        boundary: open - welded,
        nonmanifold: nonmanifold.edges(),
        duplicates: nonmanifold.duplicate_sides(),
        welded,
    };
    Ok((pairs, counts))
}

impl Matching<'_> {
    /// Pushes the half-edges of every face into the buckets of their low vertices.
    fn scatter(&self) -> Result<()> {
        let n = self.mesh.faces.len();
        self.run.each_chunk(
            chunk_count(n, CHUNK),
            || self.half_edges.producer(),
            |k, out| {
                self.run.progress.advance("graph", 0);
                half_edge_sort::try_for_each(self.mesh, chunk_range(n, CHUNK, k), |half_edge| {
                    out.push(self.by_vertex.bucket_of(half_edge.low()), half_edge)
                })
            },
            Producer::finish,
        )
    }

    /// Matches block by block. Edges that cannot continue in other blocks are finished; the rest is pushed to the
    /// half-edges whose partners may be in any block.
    fn match_blocks(&self, blocks: &NodeBlocks<'_>, pairs: &HalfEdgePairs<'_>) -> Result<()> {
        let sinks = || (pairs.sink(), self.half_edges.producer(), self.boundary.producer());
        self.run.each_chunk(
            blocks.len(),
            || (sinks(), BlockMatcher::default()),
            |block, ((out, across, open), matcher)| {
                let edge = |sides: &[HalfEdge], shared: bool| match sides {
                    _ if shared => {
                        sides.iter().try_for_each(|side| across.push(self.by_vertex.bucket_of(side.low()), *side))
                    }
                    [single] => open.push(self.by_corner.bucket_of(single.corner), single.corner),
                    several => {
                        self.nonmanifold.count(self.mesh, several.iter().map(|side| side.corner));
                        Ok(())
                    }
                };
                self.run.progress.advance("graph", 0);
                matcher.match_block(self.mesh, blocks, block, |pair| out.push(pair), edge)
            },
            |((out, across, open), _)| out.finish().and_then(|()| across.finish()).and_then(|()| open.finish()),
        )
    }

    /// The same if pairs within blocks are found later: only half-edges whose partners may be in any block are pushed,
    /// and the boundary. Blocks have none, mostly, which shows without matching them.
    fn divide_blocks(&self, blocks: &NodeBlocks<'_>) -> Result<()> {
        self.run.each_chunk(
            blocks.len(),
            || (self.half_edges.producer(), self.boundary.producer(), BlockMatcher::default()),
            |block, (across, open, matcher)| {
                self.run.progress.advance("graph", 0);
                let push = |side: HalfEdge| across.push(self.by_vertex.bucket_of(side.low()), side);
                if comes_in_pairs(self.mesh, blocks, block, push)? {
                    return Ok(());
                }
                let edge = |sides: &[HalfEdge], elsewhere: bool| match sides {
                    [single] if !elsewhere => open.push(self.by_corner.bucket_of(single.corner), single.corner),
                    _ => Ok(()),
                };
                matcher.match_block(self.mesh, blocks, block, |_| Ok(()), edge)
            },
            |(across, open, _)| across.finish().and_then(|()| open.finish()),
        )
    }
}

/// Links each known duplicate to the face that it is known by. On one thread: several duplicates of one face are
/// entered at the same corner.
fn link_duplicates(mesh: &Mesh, pairs: &HalfEdgePairs<'_>, run: &Run) -> Result<()> {
    let Some(known) = mesh.duplicates() else { return Ok(()) };
    let mut out = pairs.sink();
    for (face, &of) in known.iter().enumerate() {
        if face % CHUNK == 0 {
            run.cancel.check()?;
        }
        if let Some(first) = (of as usize).checked_sub(1) {
            link(mesh, face, first).into_iter().flatten().try_for_each(|pair| out.push(pair))?;
        }
    }
    out.finish()
}

/// The edge that links duplicate `face` to `first`: a common edge, both ways. If both faces lie in the same place, the
/// windings contradict if the faces traverse it in opposite directions, since they are the same piece of surface; else
/// if they traverse it in the same one. `None` if polygons with the same corners have no common edge.
fn link(mesh: &Mesh, face: usize, first: usize) -> Option<[Match; 2]> {
    let is_same_place = mesh.place_of(face) == mesh.place_of(first);
    let ends = |face: usize, slot: usize| {
        mesh.faces.with(face, |corners| {
            let at = |slot: usize| mesh.positions.get(corners[slot % corners.len()]);
            [at(slot), at(slot + 1)]
        })
    };
    let start = |face: usize| mesh.faces.corner_range(face).start;
    for own_slot in 0..mesh.faces.corner_range(face).len() {
        let own = ends(face, own_slot);
        for slot in 0..mesh.faces.corner_range(first).len() {
            let other = ends(first, slot);
            let is_same = other == own;
            if is_same || [other[1], other[0]] == own {
                let (corner, there) = ((start(face) + own_slot) as u32, (start(first) + slot) as u32);
                let opposite_winding = is_same != is_same_place;
                return Some([
                    Match { corner, from: face, to: first, opposite_winding },
                    Match { corner: there, from: first, to: face, opposite_winding },
                ]);
            }
        }
    }
    None
}

/// An open half-edge with the hash of its two end positions; the hash's last bit is its direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct OpenHalfEdge {
    hash: [u32; 3],
    corner: u32,
}

impl OpenHalfEdge {
    /// The hash of the edge, in either direction.
    pub fn edge(&self) -> [u32; 3] {
        [self.hash[0], self.hash[1], self.hash[2] | 1]
    }

    /// Its direction.
    pub fn ascending(&self) -> bool {
        self.hash[2] & 1 != 0
    }

    fn side(&self) -> FaceSide {
        FaceSide { corner: self.corner, ascending: self.ascending() }
    }
}

/// Welds the half-edges of `boundary` (corner numbers) that coincide; returns how many found a partner.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Memory`], [`crate::base::Error::Cancelled`].
fn weld(
    mesh: &Mesh,
    boundary: &Shuffle<u32>,
    pairs: &HalfEdgePairs<'_>,
    nonmanifold: &NonmanifoldEdges,
    context: Context<'_>,
) -> Result<u64> {
    let copies = 2 * context.run.threads as u64;
    let sized = BudgetedShuffle::<OpenHalfEdge>::new(
        context.work.spill("places.tmp"),
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
                    nonmanifold.count_welded(mesh, same.iter().map(|open| open.corner));
                    link_sides(mesh, same.iter().map(OpenHalfEdge::side), |pair| out.push(pair))?;
                }
            }
            Ok(())
        },
        PairSink::finish,
    )?;
    Ok(welded.into_inner())
}

/// The hash of a half-edge's ends, independent of direction; `None` if a coordinate is not finite or both ends
/// coincide.
pub(super) fn keyed_by_position(mesh: &Mesh, corner: u32) -> Option<OpenHalfEdge> {
    let face = mesh.faces.face_of_corner(corner as usize);
    let slot = corner as usize - mesh.faces.corner_range(face).start;
    let (a, b) = mesh.faces.with(face, |corners| (corners[slot], corners[(slot + 1) % corners.len()]));
    // Adding zero turns −0 into 0.
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
    use crate::base::random::{Random, below, stream};
    use crate::graph::half_edge_pairs::OPPOSITE_WINDING;
    use crate::store::{Budget, WorkDir};
    use std::collections::BTreeMap;

    /// Corner, face, and whether it ascends.
    type Side = (u32, usize, bool);

    /// All pairs of `mesh`, matched edge by edge from one map, with boundary and non-manifold edges. Positions are all
    /// different, so nothing is welded.
    fn oracle(mesh: &Mesh) -> (Vec<(u32, u32)>, u64, u64) {
        let mut edges: BTreeMap<(u32, u32), Vec<Side>> = BTreeMap::new();
        half_edge_sort::for_each(mesh, 0..mesh.faces.len(), |h| {
            let side = (h.corner, mesh.faces.face_of_corner(h.corner as usize), h.from < h.to);
            edges.entry((h.from.min(h.to), h.from.max(h.to))).or_default().push(side);
        });
        let mut pairs = Vec::new();
        for sides in edges.values() {
            let side = |&(corner, _, ascending): &Side| FaceSide { corner, ascending };
            let push = |Match { corner, to, opposite_winding, .. }: Match| {
                pairs.push((corner, to as u32 | if opposite_winding { OPPOSITE_WINDING } else { 0 }));
                Ok(())
            };
            link_sides(mesh, sides.iter().map(side), push).unwrap();
        }
        pairs.sort_unstable();
        let of = |count: fn(usize) -> bool| edges.values().filter(|sides| count(sides.len())).count() as u64;
        (pairs, of(|sides| sides == 1), of(|sides| sides > 2))
    }

    /// Polygons of nearby vertices, in the order of the faces: edges of one, two and more faces, within and across
    /// blocks, in both directions; some edges are long, and some polygons have an edge twice.
    fn random_polygons(faces: usize, spread: usize, random: &mut Random) -> (usize, Vec<Vec<u32>>) {
        let polygons = (0..faces).map(|face| {
            let far = below(random, 400) == 0;
            let mut corner = |_| (if far { 0 } else { face / 2 } + below(random, spread)) as u32;
            (0..2 + face % 4).map(&mut corner).collect()
        });
        (faces / 2 + spread, polygons.collect())
    }

    /// A torus of 2 · 10,000 triangles, each `copies` times.
    fn torus(copies: usize) -> (usize, Vec<Vec<u32>>) {
        let at = |x: usize, y: usize| (y % 100 * 100 + x % 100) as u32;
        let square = |k: usize| {
            let (x, y) = (k % 100, k / 100);
            [vec![at(x, y), at(x + 1, y), at(x, y + 1)], vec![at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)]]
        };
        let triangles = (0..10_000).flat_map(square);
        (10_000, triangles.flat_map(|triangle| std::iter::repeat_n(triangle, copies)).collect())
    }

    #[test]
    fn blocks_match_what_one_map_matches() {
        let dir = tempfile::tempdir().unwrap();
        let mut random = stream(3, "blocks");
        let scattered = [(40usize, 12), (20_000, 12), (20_000, 90), (12_000, 20_000)];
        let mut meshes: Vec<_> = scattered.map(|(faces, spread)| random_polygons(faces, spread, &mut random)).into();
        // All sides come in pairs of opposite directions: one pair per edge, and two.
        meshes.extend([torus(1), torus(2)]);
        for (vertices, polygons) in meshes {
            let faces = polygons.len();
            let is_scattered = vertices > faces;
            let vertices: Vec<[f64; 3]> = (0..vertices).map(|v| [v as f64, 0., 1.]).collect();
            let mesh = Mesh::from_slices(&vertices, &polygons).unwrap();
            let (expected, open, nonmanifold) = oracle(&mesh);
            for (threads, budget) in [(1, 1 << 30), (3, 3 << 20), (2, 1 << 20), (1, 700_000)] {
                let run = Run { threads, budget: Budget::new(budget), ..Run::new(&()) };
                let work = WorkDir::temporary(dir.path()).unwrap();
                let context = Context::new(&work, &run);
                let blocks = NodeBlocks::of(&mesh, context).unwrap();
                assert_eq!(blocks.is_none(), is_scattered && budget <= 3 << 20, "{faces} {budget}");
                let many = faces > 1000 && budget <= 3 << 20;
                assert!(blocks.as_ref().is_none_or(|blocks| (blocks.len() > 4) == many), "{blocks:?}");
                let (pairs, counts) = matched(&mesh, "mesh".as_ref(), blocks, context).unwrap();
                let mut found = Vec::new();
                for part in 0..pairs.parts() {
                    let (nodes, taken) = (pairs.nodes_of(part), pairs.take(part, &mesh).unwrap());
                    let of_face = |face| taken.of(mesh.faces.corner_range(face)).map(|pair| (pair.corner, pair.node));
                    let mut some: Vec<(u32, u32)> = nodes.flat_map(of_face).collect();
                    assert_eq!(some.len(), taken.len());
                    assert!(some.is_sorted_by_key(|pair| mesh.faces.face_of_corner(pair.0 as usize)));
                    some.sort_unstable();
                    found.extend(some);
                }
                assert!(found == expected, "{faces} {budget}: {} of {}", found.len(), expected.len());
                // Only within blocks, edges of more than two faces can have more pairs than are expected.
                assert!(pairs.expected() >= found.len() || pairs.finds_within() && nonmanifold > 0);
                let all = counts.nonmanifold + pairs.nonmanifold_within().map_or(0, NonmanifoldEdges::edges);
                assert_eq!((counts.boundary, all), (open, nonmanifold));
                drop(pairs);
                for name in ["vertex_blocks.tmp", "half_edges.tmp", "links.tmp", "boundary.tmp"] {
                    assert!(!work.file(name).exists(), "{name} is left");
                }
            }
        }
    }
}
