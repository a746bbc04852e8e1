//! Which faces meet at an edge, by the positions of its ends.
//!
//! Adjacent faces come from the dual graph. It links the faces of an edge that has more than two in a chain, so an edge
//! as a whole is found by a walk. Cost: corners of a face times corners of its neighbours; faces of more than [`LONG`]
//! corners are looked up in sorted edges instead.

use super::sums::Unit;
use crate::base::sort::sort_by;
use crate::base::vector::{MapEach, finite, position_key};
use crate::graph::Csr;
use crate::mesh::Mesh;
use std::collections::hash_map::Entry;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use xxhash_rust::xxh3::xxh3_64;

/// Number of corners from which a face's edges are found by lookup.
const LONG: usize = 64;

/// The mesh with its adjacency.
pub(super) struct Faces<'a> {
    pub mesh: &'a Mesh,
    pub labels: Option<&'a [u32]>,
    pub neighbours: Csr<'a>,
    /// [`crate::graph::DualGraph::duplicates`].
    pub duplicates: Option<&'a [u32]>,
    pub unit: Unit,
    /// Whether no face is degenerate, so that faces need not be checked for finite positions.
    pub whole: bool,
}

/// Sorted edges around long faces, so that each corner is a lookup instead of a comparison with all others.
#[derive(Default)]
pub(super) struct LongFaces {
    /// The edges of the neighbours of long faces.
    around: HashMap<u32, Vec<EdgeOf>>,
    /// The edges of neighbours that are long.
    own: HashMap<u32, Vec<EdgeOf>>,
}

/// An edge of a face: the hash of its ends in either order, the face, and the number of the corner that it leads to.
type EdgeOf = (u64, u32, u32);

/// An edge of more than two sides.
pub(super) struct SharedEdge {
    /// For each label there, if there are several, the face that counts the edge: the first with a neighbour of another
    /// label.
    pub labels: BTreeMap<u32, u32>,
    /// Whether as many sides run one way as the other, as on a closed surface that is wound consistently.
    pub balanced: bool,
}

/// The edges of more than two sides, by their ends.
pub(super) type SharedEdges = HashMap<[[u64; 3]; 2], SharedEdge>;

/// The ends of an edge, the smaller first.
pub(super) fn ends([a, b]: [[u64; 3]; 2]) -> [[u64; 3]; 2] {
    if a < b { [a, b] } else { [b, a] }
}

/// A hash of the ends of an edge in either order. Other edges may have the same.
fn hash(edge: [[u64; 3]; 2]) -> u64 {
    xxh3_64(bytemuck::bytes_of(&ends(edge)))
}

impl Faces<'_> {
    pub fn label(&self, face: u32) -> u32 {
        self.labels.map_or(0, |labels| labels[face as usize])
    }

    /// Whether `face` lies exactly where an earlier face lies.
    pub fn is_duplicate(&self, face: u32) -> bool {
        self.duplicates.is_some_and(|first| first[face as usize] != 0)
    }

    /// Whether all `corners` of a face are finite: other faces have no area.
    pub fn is_in_space(&self, corners: &[u32]) -> bool {
        self.whole || corners.iter().all(|&v| finite(self.mesh.positions.get(v)))
    }

    /// The faces that share an edge with `face`. A bridge leads to another body, which may touch this one, but shares
    /// no edge.
    fn beside(&self, face: u32) -> impl Iterator<Item = u32> {
        let edges = self.neighbours.neighbours(face).filter(|(other, _)| !self.is_duplicate(*other));
        edges.filter(|(_, length)| *length != 0.).map(|(other, _)| other)
    }

    /// The ends of the edge that leads to corner number `k` of `face`.
    fn edge(&self, face: u32, k: u32) -> [[u64; 3]; 2] {
        self.mesh.faces.with(face as usize, |corners| {
            let before = if k == 0 { corners.len() - 1 } else { k as usize - 1 };
            [corners[before], corners[k as usize]].map_each(|v| position_key(self.mesh.positions.get(v)))
        })
    }

    /// The edges of `faces`, sorted by their hashes; equal ones in the order of the faces.
    fn edges_of(&self, faces: impl IntoIterator<Item = u32>) -> Vec<EdgeOf> {
        let corners = |face: u32| self.mesh.faces.with(face as usize, |corners| corners.len() as u32);
        let of_face = |face| (0..corners(face)).map(move |k| (hash(self.edge(face, k)), face, k));
        let mut edges: Vec<EdgeOf> = faces.into_iter().flat_map(of_face).collect();
        sort_by(&mut edges, |x, y| x.0.cmp(&y.0));
        edges
    }

    fn is_long(&self, face: u32) -> bool {
        self.mesh.faces.with(face as usize, |corners| corners.len() > LONG)
    }

    /// Passes to `look` each of sorted `edges` that lies between `a` and `b`: its face, and whether it runs from `a` to
    /// `b`.
    fn for_each_among(&self, edges: &[EdgeOf], [a, b]: [[u64; 3]; 2], look: &mut dyn FnMut(u32, bool)) {
        let sought = hash([a, b]);
        let first = edges.partition_point(|edge| edge.0 < sought);
        for &(_, face, k) in edges[first..].iter().take_while(|edge| edge.0 == sought) {
            let found = self.edge(face, k);
            if ends(found) == ends([a, b]) {
                look(face, found == [a, b]);
            }
        }
    }

    /// Passes to `look` each edge of `face` between `a` and `b`, as [`Faces::for_each_among`] does.
    pub fn for_each_pass(
        &self,
        face: u32,
        [a, b]: [[u64; 3]; 2],
        long: &mut LongFaces,
        look: &mut dyn FnMut(u32, bool),
    ) {
        if self.is_long(face) {
            return self.for_each_among(long.own.entry(face).or_insert_with(|| self.edges_of([face])), [a, b], look);
        }
        self.mesh.faces.with(face as usize, |corners| {
            let mut before = corners.last().map(|&v| position_key(self.mesh.positions.get(v)));
            for &v in corners {
                let at = position_key(self.mesh.positions.get(v));
                if let Some(before) = before
                    && (before == a && at == b || before == b && at == a)
                {
                    look(face, before == a);
                }
                before = Some(at);
            }
        });
    }

    /// Passes to `look` each edge between `a` and `b` of the neighbours of `face`, as [`Faces::for_each_among`] does.
    fn for_each_across(&self, face: u32, [a, b]: [[u64; 3]; 2], long: &mut LongFaces, look: &mut dyn FnMut(u32, bool)) {
        if self.is_long(face) {
            let around = long.around.entry(face).or_insert_with(|| self.edges_of(self.beside(face)));
            return self.for_each_among(around, [a, b], look);
        }
        self.beside(face).for_each(|other| self.for_each_pass(other, [a, b], long, look));
    }

    /// The neighbour across the edge between `a` and `b` of `face`, preferring one of another label, then one of
    /// consistent winding; also returns whether the winding contradicts, and whether there are several.
    pub fn across(&self, face: u32, [a, b]: [[u64; 3]; 2], long: &mut LongFaces) -> Option<(u32, bool, bool)> {
        let rank = |(other, along): (u32, bool)| (self.label(other) == self.label(face), along);
        let (mut found, mut count): (Option<(u32, bool)>, _) = (None, 0);
        self.for_each_across(face, [a, b], long, &mut |other, along| {
            let one = (other, along);
            found = Some(found.map_or(one, |known| if rank(one) < rank(known) { one } else { known }));
            count += 1;
        });
        found.map(|(other, along)| (other, along, count > 1))
    }

    /// The edge between `a` and `b` of `face`, if it has more than two sides. The graph links the faces of such an edge
    /// in a chain, so not all of them are neighbours of each other.
    pub fn shared_edge<'e>(
        &self,
        face: u32,
        [a, b]: [[u64; 3]; 2],
        long: &mut LongFaces,
        shared: &'e mut SharedEdges,
    ) -> Option<&'e SharedEdge> {
        let free = match shared.entry(ends([a, b])) {
            Entry::Occupied(known) => return Some(known.into_mut()),
            Entry::Vacant(free) => free,
        };
        let (mut seen, mut next, mut sides) = (BTreeSet::from([face]), vec![face], 0);
        let (mut labels, mut surplus) = (BTreeMap::new(), 0i64);
        while let Some(side) = next.pop() {
            let label = self.label(side);
            self.for_each_pass(side, [a, b], long, &mut |_, along| surplus += if along { 1 } else { -1 });
            self.for_each_across(side, [a, b], long, &mut |other, _| {
                sides += 1;
                if self.label(other) != label {
                    labels.entry(label).and_modify(|first| *first = side.min(*first)).or_insert(side);
                }
                if seen.insert(other) {
                    next.push(other);
                }
            });
        }
        (sides > 2).then(|| &*free.insert(SharedEdge { labels, balanced: surplus == 0 }))
    }
}
