//! Finds faces of one body that lie in the same place, and takes them out of its surface.
//!
//! Decimation and boolean operations leave flaps: two faces back to back, closed in themselves, which hang on the
//! surface by edges of four faces. If a surface has many, links to and from them tear it, and its parts are those of
//! what is left between flaps. So both faces are set aside. A flap is a piece of surface that lies twice in the same
//! place, with opposite windings, without which the surface around it is closed; and most of its border is on other
//! faces, or it is small. If small pieces that are mostly free have much area in all, they are leaves or feathers.
//!
//! Of these, and of any other faces in one place, one remains: sheets with two sides, and faces that were exported
//! twice. Contacts of two bodies stay as they are: each body needs its face.
//!
//! A face that is set aside takes part in the graph by one link to a face that shares an edge with it, like the
//! duplicates of two-sided models ([`super::duplicates`]), and has no area.
//!
//! Cost, where edges of three faces or more suggest such faces: 20 bytes per face are shuffled; if there are some, one
//! pass over all faces, 180 bytes in memory for each face in such a place, and the graph is built a second time.

use super::components::Components;
use super::duplicates::{FacePlaces, Writer};
use super::half_edge_pairs::OPPOSITE_WINDING;
use super::half_edges::keyed_by_position;
use crate::base::Result;
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::union_find::Forest;
use crate::base::vector::area;
use crate::mesh::Mesh;
use crate::store::budget::Grant;
use crate::store::{Context, Run};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicI32, AtomicU32, Ordering::Relaxed};
use xxhash_rust::xxh3::xxh3_64;

const CHUNK: usize = 1 << 14;
/// Share of the mesh's area up to which a piece is small.
const SMALL: f64 = 1e-3;
/// Share of the mesh's area up to which all small pieces are flaps, not leaves.
const ALL_SMALL: f64 = 0.1;
const NONE: u32 = u32::MAX;
/// Bytes per face that lies in one place with others.
const BYTES: u64 = 180;
/// Faces whose memory is taken from the budget at a time.
const GRANTED: usize = 1 << 12;

/// The same mesh, in which faces of the same one of `components` in one place are known as duplicates: all of a flap,
/// of others all but one. `None` if there are none.
///
/// # Errors
/// [`crate::base::Error::Memory`] for more than there is room for; [`crate::base::Error::Io`],
/// [`crate::base::Error::Cancelled`].
pub(super) fn without_flaps(mesh: &Mesh, components: &Components, context: Context<'_>) -> Result<Option<Mesh>> {
    let body = |face: usize| components.link(face) & !OPPOSITE_WINDING;
    let mut twins = Twins::default();
    FacePlaces::of(mesh, body, context)?.each(context.run, |all| {
        for same in all.chunk_by(|a, b| a.0 == b.0).filter(|same| same.len() > 1) {
            twins.make_room(same.len(), context.run)?;
            twins.add(mesh, same.iter().map(|(_, face)| *face));
        }
        Ok(())
    })?;
    twins.faces.sort_unstable();
    twins.further.sort_unstable();
    let mut set_aside = Edges::of(mesh, &twins.faces).resolved(mesh, &twins, context.run)?;
    set_aside.append(&mut twins.further);
    set_aside.sort_unstable();
    let mut writer = Writer::new(mesh.faces.len(), context.work)?;
    set_aside.into_iter().try_for_each(|[face, to]| writer.push(face, to))?;
    writer.finish(mesh, context.work)
}

/// Faces that lie in one place.
#[derive(Default)]
struct Twins {
    /// Those with as many of the opposite winding there, each with the first of all; ascending.
    faces: Vec<[u32; 2]>,
    /// All others but the first of the more frequent winding in each place, with that; ascending. One face remains of
    /// these whatever is around them.
    further: Vec<[u32; 2]>,
    /// All faces in places with others.
    count: usize,
    grants: Vec<Grant>,
}

impl Twins {
    /// Adds faces in one place, ascending.
    fn add(&mut self, mesh: &Mesh, all: impl Iterator<Item = u32> + Clone) {
        let Some(first) = all.clone().next() else { return };
        let (mut ahead, mut count) = (0, 0);
        for face in all.clone() {
            ahead += usize::from(mesh.have_same_winding(face, first));
            count += 1;
        }
        if 2 * ahead == count {
            self.faces.extend(all.map(|face| [face, first]));
            return;
        }
        let is_frequent = |face: &u32| mesh.have_same_winding(*face, first) == (2 * ahead > count);
        if let Some(kept) = all.clone().find(is_frequent) {
            self.further.extend(all.filter(|face| *face != kept).map(|face| [face, kept]));
        }
    }

    /// Whether `face` is one of them, and not one that remains.
    fn has(&self, face: u32) -> bool {
        let is_among = |all: &[[u32; 2]]| all.binary_search_by_key(&face, |[face, _]| *face).is_ok();
        is_among(&self.faces) || is_among(&self.further)
    }

    fn make_room(&mut self, more: usize, run: &Run) -> Result<()> {
        self.count += more;
        while self.count > self.grants.len() * GRANTED {
            let remedy = "remove faces that lie where others do";
            self.grants.push(run.budget.take_or("faces in one place", BYTES * GRANTED as u64, remedy)?);
        }
        Ok(())
    }
}

/// The faces at an edge besides twins.
#[derive(Clone, Copy)]
struct Others {
    /// Ascending ones minus descending ones.
    net: i32,
    /// The first descending and the first ascending one.
    first: [u32; 2],
}

/// The edges of twins.
struct Edges {
    /// The edges, ascending by the hash of their ends.
    keys: Vec<[u32; 3]>,
    /// Edge, direction and index of the twin; ascending.
    by_edge: Vec<[u32; 3]>,
    /// Index, edge and direction; ascending.
    by_twin: Vec<[u32; 3]>,
    ends: Filter,
}

impl Edges {
    /// Those of `twins`.
    fn of(mesh: &Mesh, twins: &[[u32; 2]]) -> Self {
        let mut sides = Vec::new();
        let mut ends = Filter::new(3 * twins.len());
        for (k, [face, _]) in (0u32..).zip(twins) {
            for corner in mesh.faces.corner_range(*face as usize) {
                if let Some(open) = keyed_by_position(mesh, corner as u32) {
                    sides.push((open.edge(), u32::from(open.ascending()), k));
                }
            }
            mesh.faces.with(*face as usize, |corners| corners.iter().for_each(|&v| ends.add(mesh, v)));
        }
        sides.sort_unstable();
        let (mut keys, mut by_edge) = (Vec::new(), Vec::with_capacity(sides.len()));
        for same in sides.chunk_by(|a, b| a.0 == b.0) {
            by_edge.extend(same.iter().map(|(_, ascending, k)| [keys.len() as u32, *ascending, *k]));
            keys.push(same[0].0);
        }
        let mut by_twin: Vec<[u32; 3]> = by_edge.iter().map(|&[edge, ascending, k]| [k, edge, ascending]).collect();
        by_twin.sort_unstable();
        Self { keys, by_edge, by_twin, ends }
    }

    /// The faces at each edge besides `twins`, and the area of all faces.
    fn others(&self, mesh: &Mesh, twins: &Twins, run: &Run) -> Result<(Vec<Others>, f64)> {
        let none = || (AtomicI32::new(0), [AtomicU32::new(NONE), AtomicU32::new(NONE)]);
        let found: Vec<_> = self.keys.iter().map(|_| none()).collect();
        let n = mesh.faces.len();
        let look = |k: usize, hits: &mut Vec<bool>| {
            run.progress.advance("graph", 0);
            let mut sum = 0.;
            mesh.faces.for_each(chunk_range(n, CHUNK, k), |face, corners| {
                sum += area_of(mesh, corners);
                hits.clear();
                hits.extend(corners.iter().map(|&v| self.ends.has(mesh, v)));
                let start = mesh.faces.corner_range(face).start;
                for slot in (0..hits.len()).filter(|&slot| hits[slot] && hits[(slot + 1) % hits.len()]) {
                    if let Some(open) = keyed_by_position(mesh, (start + slot) as u32)
                        && let Ok(edge) = self.keys.binary_search(&open.edge())
                        && !twins.has(face as u32)
                    {
                        found[edge].0.fetch_add(if open.ascending() { 1 } else { -1 }, Relaxed);
                        found[edge].1[usize::from(open.ascending())].fetch_min(face as u32, Relaxed);
                    }
                }
            });
            Ok(sum)
        };
        let sums = run.map_chunks(chunk_count(n, CHUNK), Vec::new, look)?;
        let others = |(net, first): (AtomicI32, [AtomicU32; 2])| Others {
            net: net.into_inner(),
            first: first.map(AtomicU32::into_inner),
        };
        let found = found.into_iter().map(others);
        Ok((found.collect(), sums.into_iter().sum()))
    }

    /// For each of `all` with as many of the opposite winding that is set aside, the face that it is linked to.
    fn resolved(&self, mesh: &Mesh, all: &Twins, run: &Run) -> Result<Vec<[u32; 2]>> {
        let twins = &all.faces[..];
        if twins.is_empty() {
            return Ok(Vec::new());
        }
        let (others, area) = self.others(mesh, all, run)?;
        let index = |face: u32| twins.partition_point(|twin| twin[0] < face) as u32;
        // Pieces: faces in one place, and those that share an edge.
        let mut pieces = Forest::new(twins.len());
        for (k, [_, first]) in (0u32..).zip(twins) {
            pieces.join(k, index(*first));
        }
        let at_edges = || self.by_edge.chunk_by(|a, b| a[0] == b[0]);
        for same in at_edges() {
            same.iter().for_each(|[.., k]| _ = pieces.join(same[0][2], *k));
        }
        let piece = pieces.labels();
        let mut pieces = vec![Piece { is_closed: true, border: 0, area: 0. }; twins.len()];
        for (&piece, [face, _]) in piece.iter().zip(twins) {
            mesh.faces.with(*face as usize, |corners| pieces[piece as usize].area += area_of(mesh, corners));
        }
        for same in at_edges() {
            let Others { net, first } = others[same[0][0] as usize];
            let piece = &mut pieces[piece[same[0][2] as usize] as usize];
            let is_rim = same.iter().all(|side| twins[side[2] as usize][1] == twins[same[0][2] as usize][1]);
            piece.is_closed &= net == 0;
            piece.border += if first != [NONE; 2] { 1 } else { -i64::from(is_rim) };
        }
        let is_small = |piece: &Piece| piece.is_closed && piece.border <= 0 && piece.area <= SMALL * area;
        let all_small: f64 = pieces.iter().filter(|piece| is_small(piece)).map(|piece| piece.area).sum();
        let is_flap = |k: u32| {
            let piece = &pieces[piece[k as usize] as usize];
            piece.is_closed && piece.border > 0 || is_small(piece) && all_small <= ALL_SMALL * area
        };
        let mut to = vec![NONE; twins.len()];
        let mut queue = VecDeque::new();
        let edges_of = |k: u32| {
            let start = self.by_twin.partition_point(|side| side[0] < k);
            self.by_twin[start..]
                .iter()
                .take_while(move |side| side[0] == k)
                .map(|&[_, edge, ascending]| (edge, ascending))
        };
        // Linked to faces of the other direction, whose winding agrees.
        for k in (0..twins.len() as u32).filter(|&k| is_flap(k)) {
            let across = |(edge, ascending): (u32, u32)| others[edge as usize].first[1 - ascending as usize];
            let nearest = edges_of(k).map(across).min().unwrap_or(NONE);
            if nearest != NONE {
                to[k as usize] = nearest;
                queue.push_back(k);
            }
        }
        while let Some(k) = queue.pop_front() {
            for (edge, ascending) in edges_of(k) {
                let across = [edge, 1 - ascending];
                let start = self.by_edge.partition_point(|side| side[..2] < across[..]);
                for &[.., near] in self.by_edge[start..].iter().take_while(|side| side[..2] == across) {
                    if to[near as usize] == NONE && is_flap(near) {
                        to[near as usize] = twins[k as usize][0];
                        queue.push_back(near);
                    }
                }
            }
        }
        let of = |(&to, &[face, first]): (&u32, &[u32; 2])| match to {
            NONE => (face != first).then_some([face, first]),
            to => Some([face, to]),
        };
        Ok(to.iter().zip(twins).filter_map(of).collect())
    }
}

/// A piece of surface that lies twice in the same place.
#[derive(Clone, Copy)]
struct Piece {
    /// Whether the surface around it is closed without it.
    is_closed: bool,
    /// Edges of its border that other faces have, minus those that none has.
    border: i64,
    /// The area of all its faces.
    area: f64,
}

/// The area of a face, the sum of its triangles; 0 if that is not finite.
fn area_of(mesh: &Mesh, corners: &[u32]) -> f64 {
    let mut sum = 0.;
    mesh.triangles(corners, |_, at| sum += area(at));
    if sum.is_finite() { sum } else { 0. }
}

/// Vertices that may be ends of the edges sought, by their positions.
struct Filter {
    bits: Vec<u64>,
}

impl Filter {
    /// For `count` vertices: one in 16 of all others passes.
    fn new(count: usize) -> Self {
        Self { bits: vec![0; (16 * count / 64).next_power_of_two()] }
    }

    /// The word and the bit of a vertex.
    #[inline]
    fn place(&self, mesh: &Mesh, vertex: u32) -> (usize, u64) {
        // Adding zero turns −0 into 0.
        let hash = xxh3_64(bytemuck::bytes_of(&mesh.positions.get(vertex).map(|x| x + 0.)));
        ((hash >> 6) as usize & (self.bits.len() - 1), 1 << (hash & 63))
    }

    fn add(&mut self, mesh: &Mesh, vertex: u32) {
        let (word, bit) = self.place(mesh, vertex);
        self.bits[word] |= bit;
    }

    #[inline]
    fn has(&self, mesh: &Mesh, vertex: u32) -> bool {
        let (word, bit) = self.place(mesh, vertex);
        self.bits[word] & bit != 0
    }
}
