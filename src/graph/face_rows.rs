//! Rows of the dual graph from the nodes across the edges of faces: neighbours, lengths of steps and of shared edges.
//!
//! The length of a step is |c_i − mid| + |c_j − mid| over the midpoint of the shared edge (in the frame; |c_i − c_j| if
//! the midpoint is not finite). Two faces that share several edges get one entry: the shortest step, the summed edge
//! length. Both directions are computed from the same numbers by a symmetric formula, so they agree to the bit.
//!
//! Nearly every face has three corners and three different neighbours. Such a row is computed with its three edges in
//! parallel lanes, and sorted by counting, without a branch: the order of three neighbours is nearly random. Cost:
//! about 15 ns per face and thread, a third of it for square roots. The others go through [`RowScratch`], which takes
//! any row, to the same bits.
//!
//! If geometry is computed from the mesh, edges that cannot be computed from their two faces alone are listed
//! ([`super::node_geometry`]): another 10 ns, since the corners of the three neighbours have to be looked at.

use super::frame::Frame;
use super::half_edge_pairs::{HalfEdgePair, OPPOSITE_WINDING, PartPairs};
use super::node_geometry::{ComputedGeometry, ListedEdge, NodeWindow};
use super::nodes::Node;
use crate::base::simd::SimdKernel;
use crate::base::vector::{distance, middle, wide};
use crate::mesh::Mesh;
use std::ops::Range;

/// An entry of a row under construction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Entry {
    pub node: u32,
    pub centroid_distance: f32,
    pub edge: f32,
}

/// The slices for the entries of a range of rows.
pub(super) struct Rows<'a> {
    pub indices: &'a mut [u32],
    pub centroid_distance: &'a mut [f32],
    pub edge: &'a mut [f32],
}

/// Where edges go whose length computing does not give.
pub(super) struct Listing<'a> {
    /// What computes them.
    pub mesh: &'a ComputedGeometry,
    /// These edges, ascending.
    pub listed: &'a mut Vec<ListedEdge>,
}

/// What [`FaceRows`] filled in.
pub(super) struct Filled {
    /// Number of entries.
    pub entries: usize,
    /// Whether any length of a shared edge is negative.
    pub mixed: bool,
}

/// Fills the rows of the faces `range`, for [`crate::base::simd::dispatch`].
pub(super) struct FaceRows<'a> {
    pub mesh: &'a Mesh,
    pub frame: &'a Frame,
    /// Geometry of the faces and most of their neighbours.
    pub nodes: NodeWindow<'a>,
    /// The nodes across the edges of these faces.
    pub pairs: &'a PartPairs<'a>,
    pub range: Range<usize>,
    pub out: Rows<'a>,
    /// The degree of each face; empty if they are known.
    pub degrees: &'a mut [u32],
    /// If geometry is computed.
    pub listing: Option<Listing<'a>>,
    pub scratch: &'a mut RowScratch,
}

impl SimdKernel for FaceRows<'_> {
    type Output = Filled;

    #[inline(always)]
    fn run(self) -> Filled {
        let Self { mesh, frame, nodes, pairs, range, out, degrees, mut listing, scratch } = self;
        let (mut at, mut mixed) = (0, false);
        let (positions, frame, across) = (&mesh.positions, *frame, pairs.across());
        let triangle = |face| mesh.faces.with(face, |corners| <[u32; 3]>::try_from(corners).ok());
        let (start, mut more) = (range.start, &pairs.more[..]);
        // Not `for_each`: a closure that it calls in two places is not inlined, and would be compiled for the baseline
        // processor.
        for face in range {
            let span = mesh.faces.corner_range(face);
            let mut is_simple = true;
            while let [pair, rest @ ..] = more
                && (pair.corner as usize) < span.end
            {
                more = rest;
                is_simple = false;
            }
            if is_simple
                && let (Some([a, b, c]), [x, y, z]) =
                    (triangle(face), &across[span.start - pairs.first..span.end - pairs.first])
            {
                let links = [x.node(), y.node(), z.node()];
                let near = [links[0] & !OPPOSITE_WINDING, links[1] & !OPPOSITE_WINDING, links[2] & !OPPOSITE_WINDING];
                let three = (near[0] != near[1]) & (near[1] != near[2]) & (near[0] != near[2]);
                let held = [nodes.held(near[0] as usize), nodes.held(near[1] as usize), nodes.held(near[2] as usize)];
                if let ([Some(x), Some(y), Some(z)], Some(own)) = (held, nodes.held(face))
                    && three
                {
                    let points =
                        [frame.place(positions.get(a)), frame.place(positions.get(b)), frame.place(positions.get(c))];
                    let [length, edge] = three_steps(points, own, [x, y, z]);
                    if length[0].is_finite() & length[1].is_finite() & length[2].is_finite() {
                        let (places, first) = (ranks(near), at);
                        for k in 0..3 {
                            let edge = if links[k] >= OPPOSITE_WINDING { -edge[k] } else { edge[k] };
                            mixed |= edge < 0.;
                            let e = at + places[k];
                            (out.indices[e], out.centroid_distance[e], out.edge[e]) = (near[k], length[k], edge);
                        }
                        at += 3;
                        if let Some(degree) = degrees.get_mut(face - start) {
                            *degree = 3;
                        }
                        if let Some(listing) = &mut listing
                            && !(is_alone([a, b, c], triangle(near[0] as usize), links[0])
                                & is_alone([b, c, a], triangle(near[1] as usize), links[1])
                                & is_alone([c, a, b], triangle(near[2] as usize), links[2]))
                        {
                            listing.row(face, &out.indices[first..at], &out.edge[first..at]);
                        }
                        continue;
                    }
                }
            }
            let row = mesh.faces.with(face, |corners| {
                let points = corners.iter().map(|&v| frame.place(positions.get(v)));
                scratch.row(points, span.start, &nodes.at(face), pairs.of(span.clone()), |node| nodes.at(node as usize))
            });
            let first = at;
            for &Entry { node, centroid_distance, edge } in row {
                mixed |= edge < 0.;
                (out.indices[at], out.centroid_distance[at], out.edge[at]) = (node, centroid_distance, edge);
                at += 1;
            }
            if let Some(degree) = degrees.get_mut(face - start) {
                *degree = row.len() as u32;
            }
            if let Some(listing) = &mut listing {
                listing.row(face, &out.indices[first..at], &out.edge[first..at]);
            }
        }
        Filled { entries: at, mixed }
    }
}

impl Listing<'_> {
    /// Lists the entries of the row of `face` that computing gives another length.
    #[inline(never)]
    fn row(&mut self, face: usize, indices: &[u32], edge: &[f32]) {
        let own = self.mesh.row(face);
        for (&to, &edge) in indices.iter().zip(edge) {
            if self.mesh.shared(&own, to as usize).to_bits() != edge.to_bits() {
                self.listed.push((face as u32, to, edge));
            }
        }
    }
}

/// Whether a triangle with the corners `other` shares the edge from `u` to `v`, and no other edge, with the triangle
/// (u, v, w), in the direction that `link` tells: then [`ComputedGeometry::shared`] gives the length of that edge.
#[inline(always)]
fn is_alone([u, v, w]: [u32; 3], other: Option<[u32; 3]>, link: u32) -> bool {
    let Some([x, y, z]) = other else { return false };
    let same = ((x == u) & (y == v)) | ((y == u) & (z == v)) | ((z == u) & (x == v));
    let opposite = ((x == v) & (y == u)) | ((y == v) & (z == u)) | ((z == v) & (x == u));
    let has_third = (x == w) | (y == w) | (z == w);
    (same != opposite) & !has_third & (same == (link >= OPPOSITE_WINDING))
}

/// The ranks of three different numbers in ascending order.
#[inline(always)]
fn ranks([a, b, c]: [u32; 3]) -> [usize; 3] {
    let less = |x: u32, y: u32| usize::from(x < y);
    [less(b, a) + less(c, a), less(a, b) + less(c, b), less(a, c) + less(b, c)]
}

/// Lengths of the steps from a triangle with the corners `points` to its neighbours, and of the edges that leave the
/// corners: what [`step`] computes one by one. In four lanes, the last of which is unused.
#[inline(always)]
fn three_steps(points: [[f64; 3]; 3], own: &Node, near: [&Node; 3]) -> [[f32; 3]; 2] {
    let (mut from, mut to, mut edge) = ([0f64; 4], [0f64; 4], [0f64; 4]);
    let [p, q, r] = points;
    let [x, y, z] = near;
    for axis in 0..3 {
        let start = [p[axis], q[axis], r[axis], r[axis]];
        let end = [q[axis], r[axis], p[axis], p[axis]];
        let own = f64::from(own.centroid[axis]);
        let [x, y, z] = [f64::from(x.centroid[axis]), f64::from(y.centroid[axis]), f64::from(z.centroid[axis])];
        let near = [x, y, z, z];
        for lane in 0..4 {
            let middle = (start[lane] + end[lane]) * 0.5;
            let (a, b, c) = (own - middle, near[lane] - middle, start[lane] - end[lane]);
            // The sum starts with the first square: adding it to 0 would change no bit.
            from[lane] += a * a;
            to[lane] += b * b;
            edge[lane] += c * c;
        }
    }
    let mut found = [[0f32; 4]; 2];
    for lane in 0..4 {
        found[0][lane] = (from[lane].sqrt() + to[lane].sqrt()) as f32;
        found[1][lane] = edge[lane].sqrt() as f32;
    }
    let [[a, b, c, _], [d, e, f, _]] = found;
    [[a, b, c], [d, e, f]]
}
/// Buffers for a row under construction.
#[derive(Default)]
pub(super) struct RowScratch {
    points: Vec<[f64; 3]>,
    row: Vec<Entry>,
}

impl RowScratch {
    /// The row of the face `own`, whose corners lie at `points` and are numbered from `first` on: one entry for each
    /// neighbour in its `pairs`, ascending. `node` returns a neighbour's node.
    #[inline]
    pub fn row(
        &mut self,
        points: impl Iterator<Item = [f64; 3]>,
        first: usize,
        own: &Node,
        pairs: impl Iterator<Item = HalfEdgePair>,
        node: impl Fn(u32) -> Node,
    ) -> &[Entry] {
        let Self { points: held, row } = self;
        held.clear();
        held.extend(points);
        row.clear();
        row.extend(pairs.map(|pair| {
            let slot = pair.corner as usize - first;
            let end = if slot + 1 == held.len() { 0 } else { slot + 1 };
            let mut entry = step(own, &node(pair.to()), pair.to(), [held[slot], held[end]]);
            if pair.opposite_winding() {
                entry.edge = -entry.edge;
            }
            entry
        }));
        if let [a, b, c] = &mut row[..]
            && a.node != b.node
            && b.node != c.node
            && a.node != c.node
        {
            // Nearly every row: three different neighbours.
            for (x, y) in [(0, 1), (1, 2), (0, 1)] {
                if row[x].node > row[y].node {
                    row.swap(x, y);
                }
            }
            return row;
        }
        merge_row(row);
        row
    }
}

/// Sorts a row by neighbour and merges entries for the same neighbour.
fn merge_row(row: &mut Vec<Entry>) {
    // Ties are broken by value, so the order of pairs does not matter.
    row.sort_unstable_by(|a, b| {
        a.node.cmp(&b.node).then(a.centroid_distance.total_cmp(&b.centroid_distance)).then(a.edge.total_cmp(&b.edge))
    });
    row.dedup_by(|entry, kept| {
        let same = entry.node == kept.node;
        if same {
            merge(kept, entry);
        }
        same
    });
}

/// Merges a second edge between two faces into the first: the shorter finite step, the summed edge length.
fn merge(kept: &mut Entry, entry: &Entry) {
    kept.centroid_distance = kept.centroid_distance.min(entry.centroid_distance);
    kept.edge = (kept.edge.abs() + entry.edge.abs()).copysign(kept.edge);
}

/// The entry for the step from `from` to `to` over the edge between `ends` (in the frame).
#[inline]
fn step(from: &Node, to: &Node, node: u32, ends: [[f64; 3]; 2]) -> Entry {
    let mid = middle(ends[0], ends[1]);
    let (from, to) = (wide(from.centroid), wide(to.centroid));
    let centroid_distance = (distance(from, mid) + distance(to, mid)) as f32;
    let edge = distance(ends[0], ends[1]) as f32;
    if centroid_distance.is_finite() {
        Entry { node, centroid_distance, edge }
    } else {
        Entry { node, centroid_distance: distance(from, to) as f32, edge: 0. }
    }
}
