//! The strip of faces along the boundaries of parts, with local numbers of its vertices and edges.
//!
//! A vertex is on a boundary if its faces have several labels; every face of such a vertex belongs to the strip. Two
//! passes over the faces find them. While they run, memory is one bit per vertex, and four bytes per vertex for as many
//! vertices at a time as the budget allows. In a soup, where each face has vertices of its own and those at one
//! position count as one, it is 32 bytes. The result grows only with the strip; up to 40 MB of it are not counted.

use crate::base::bit_set::BitSet;
use crate::base::groups::Groups;
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::vector::{finite, position_key};
use crate::base::{Error, Result};
use crate::mesh::geometry::Mesh;
use crate::store::Run;
use crate::store::budget::Grant;
use crate::store::needs::BESIDE_BUDGET;
use xxhash_rust::xxh3::xxh3_64;

/// Faces between two checks of the stop flag.
const CHUNK: usize = 1 << 14;
/// Minimum number of vertices in a block, if there are as many.
const LEAST: usize = 1 << 12;
/// Bytes per corner of the strip, for all of its data.
const BYTES: u64 = 250;
/// The first label of a vertex without a face.
const NONE: u32 = u32::MAX;

/// The strip. Its faces, vertices and edges are numbered locally, in mesh order.
pub(super) struct Strip {
    /// The mesh faces (f), ascending.
    pub faces: Vec<u32>,
    /// Their labels (f).
    pub labels: Vec<u32>,
    /// First corner of each (f + 1).
    pub starts: Vec<u32>,
    /// The vertices of all corners.
    pub corners: Vec<u32>,
    /// The mesh vertex at each corner; in a soup it may differ from that of [`Strip::vertices`] at the same position.
    pub own: Vec<u32>,
    /// The edge from each corner to the next one of its face.
    pub edge_of: Vec<u32>,
    /// The mesh vertices (v), ascending.
    pub vertices: Vec<u32>,
    /// Their positions (v).
    pub at: Vec<[f64; 3]>,
    /// The label of vertices whose faces all have the same one (v); `None` on a boundary.
    pub inner: Vec<Option<u32>>,
    /// The ends of each edge, ascending (e).
    pub edges: Vec<[u32; 2]>,
    /// The faces of each edge.
    pub sides: Groups<u32>,
    /// The faces of each vertex.
    pub stars: Groups<u32>,
    _grant: Grant,
}

/// Which vertices lie on a boundary, one bit each.
struct Bits(BitSet);

impl Bits {
    fn of(mesh: &Mesh, labels: &[u32], run: &Run) -> Result<(Self, Grant)> {
        if !is_soup(mesh) {
            return boundary_vertices(mesh, labels, run).map(|(bits, kept)| (Self(bits), kept));
        }
        let (set, kept) = no_vertices(mesh, run)?;
        let mut bits = Self(set);
        bits.mark_places(mesh, labels, run)?;
        Ok((bits, kept))
    }

    /// For a soup: vertices at one position count as one; as many positions at a time as the budget has room for.
    fn mark_places(&mut self, mesh: &Mesh, labels: &[u32], run: &Run) -> Result<()> {
        let size = size_of::<Place>() as u64;
        // At most half full.
        let wanted = 2 * size * mesh.positions.len() as u64;
        let grant = run.budget.take("places of vertices", size * (LEAST as u64).min(wanted / size), wanted)?;
        let blocks = wanted.div_ceil(grant.bytes().max(1));
        let mut places = vec![Place::default(); (grant.bytes() / size).max(1) as usize];
        for block in 0..blocks {
            places.fill(Place::default());
            let in_block = |key: &u64| (u128::from(*key) * u128::from(blocks)) >> 64 == u128::from(block);
            let key_in_block = |v: u32| key(mesh.positions.get(v)).filter(in_block);
            each_face(mesh, run, |face, corners| {
                for key in corners.iter().filter_map(|&v| key_in_block(v)) {
                    find(&mut places, key).meet(key, labels[face]);
                }
            })?;
            each_face(mesh, run, |_, corners| {
                for &v in corners {
                    if key_in_block(v).is_some_and(|key| find(&mut places, key).several) {
                        self.0.add(v);
                    }
                }
            })?;
        }
        Ok(())
    }
}

/// An empty set of vertices, and what the budget grants for it.
fn no_vertices(mesh: &Mesh, run: &Run) -> Result<(BitSet, Grant)> {
    let bytes = BitSet::bytes(mesh.positions.len());
    let grant = run.budget.take("boundary vertices", bytes, bytes)?;
    Ok((BitSet::new(mesh.positions.len()), grant))
}

/// The vertices whose faces have several labels, and what the budget grants for the set. Vertices at the same position
/// count as several.
///
/// # Errors
/// [`Error::Memory`] without room for a bit per vertex; [`Error::Cancelled`].
pub(crate) fn boundary_vertices(mesh: &Mesh, labels: &[u32], run: &Run) -> Result<(BitSet, Grant)> {
    let vertices = mesh.positions.len();
    let (mut set, kept) = no_vertices(mesh, run)?;
    let grant = run.budget.take("labels of vertices", 4 * vertices.min(LEAST) as u64, 4 * vertices as u64)?;
    let width = ((grant.bytes() / 4) as usize).max(1);
    let mut first = Vec::new();
    for start in (0..vertices).step_by(width) {
        first.clear();
        first.resize(width.min(vertices - start), NONE);
        each_face(mesh, run, |face, corners| {
            for &v in corners {
                match (v as usize).checked_sub(start).and_then(|at| first.get_mut(at)) {
                    Some(own) if *own == NONE => *own = labels[face],
                    Some(own) if *own != labels[face] => _ = set.add(v),
                    _ => {}
                }
            }
        })?;
    }
    Ok((set, kept))
}

/// Calls `visit(face, its corners)` for every face, and checks the stop flag.
fn each_face(mesh: &Mesh, run: &Run, mut visit: impl FnMut(usize, &[u32])) -> Result<()> {
    let n = mesh.faces.len();
    for chunk in 0..chunk_count(n, CHUNK) {
        run.cancel.check()?;
        mesh.faces.for_each(chunk_range(n, CHUNK, chunk), &mut visit);
    }
    Ok(())
}

/// Whether hardly any vertex has two faces, as in an STL file: then positions identify vertices, not numbers.
pub(super) fn is_soup(mesh: &Mesh) -> bool {
    mesh.faces.corner_count() < 2 * mesh.positions.len()
}

/// The labels at a position.
#[derive(Clone, Copy, Default)]
struct Place {
    /// The hash of its position; 0 for none.
    key: u64,
    label: u32,
    several: bool,
}

impl Place {
    /// Records that a face with `label` has a corner at the position with hash `key`.
    fn meet(&mut self, key: u64, label: u32) {
        self.several |= self.key != 0 && (self.key != key || self.label != label);
        (self.key, self.label) = (key, label);
    }
}

/// The slot of `key`, or the empty one where it belongs; another key's slot if all are taken.
fn find(places: &mut [Place], key: u64) -> &mut Place {
    let n = places.len();
    let first = (key % n as u64) as usize;
    let slot = (0..n).map(|k| (first + k) % n).find(|&k| places[k].key == key || places[k].key == 0);
    &mut places[slot.unwrap_or(first)]
}

/// A hash that hardly any two positions share, never 0; `None` without a finite position.
fn key(at: [f64; 3]) -> Option<u64> {
    finite(at).then(|| xxh3_64(bytemuck::bytes_of(&position_key(at))).max(1))
}

/// The faces with a vertex of `bits`, ascending, and what the budget grants for them.
fn faces_of(mesh: &Mesh, bits: &Bits, run: &Run) -> Result<(Vec<u32>, Grant)> {
    let n = mesh.faces.len();
    let each = |k: usize, visit: &mut dyn FnMut(usize, &[u32])| {
        mesh.faces.for_each(chunk_range(n, CHUNK, k), |face, corners| {
            if corners.iter().any(|&v| bits.0.has(v)) {
                visit(face, corners);
            }
        });
    };
    let count = |k, (): &mut ()| {
        let mut mine = 0;
        each(k, &mut |_, corners| mine += corners.len() as u64);
        Ok(mine)
    };
    let corners: u64 = run.map_chunks(chunk_count(n, CHUNK), || (), count)?.into_iter().sum();
    // What the decision about parts may take beside the budget is free by now. Without it, an output was refused after
    // all work where the budget is a few megabytes.
    let bytes = (BYTES * corners).saturating_sub(BESIDE_BUDGET);
    let grant = run.budget.take_or("faces along boundaries", bytes, "leave out `split_faces`")?;
    if u32::try_from(corners).is_err() {
        return Err(Error::unusable(
            mesh.path(),
            "has more than 2^32 corners along boundaries",
            "cut it into fewer parts",
        ));
    }
    let find = |k, (): &mut ()| {
        let mut mine = Vec::new();
        each(k, &mut |face, _| mine.push(face as u32));
        Ok(mine)
    };
    Ok((run.map_chunks(chunk_count(n, CHUNK), || (), find)?.concat(), grant))
}

/// The distinct vertices of `corners`, ascending, and the index of each corner's vertex among them; in a soup one
/// vertex per position.
fn numbered(mesh: &Mesh, corners: &[u32]) -> (Vec<u32>, Vec<u32>) {
    let sorted = |mut vertices: Vec<u32>| {
        vertices.sort_unstable();
        vertices.dedup();
        vertices
    };
    let number = |vertices: &[u32], v: u32| vertices.partition_point(|&other| other < v) as u32;
    let vertices = sorted(corners.to_vec());
    let numbers = corners.iter().map(|&v| number(&vertices, v));
    if !is_soup(mesh) {
        let numbers = numbers.collect();
        return (vertices, numbers);
    }
    let first = first_at_place(mesh, &vertices);
    let places = sorted(first.clone());
    let numbers = numbers.map(|k| number(&places, first[k as usize])).collect();
    (places, numbers)
}

/// For each of `vertices`, ascending, the first one at the same position.
fn first_at_place(mesh: &Mesh, vertices: &[u32]) -> Vec<u32> {
    let place = |&v: &u32| position_key(mesh.positions.get(v));
    let mut placed: Vec<([u64; 3], usize)> = vertices.iter().map(place).zip(0..).collect();
    placed.sort_unstable();
    let mut first = vertices.to_vec();
    for group in placed.chunk_by(|a, b| a.0 == b.0 && finite(a.0.map(f64::from_bits))) {
        group.iter().for_each(|&(_, k)| first[k] = vertices[group[0].1]);
    }
    first
}

/// The ends of all edges, ascending, and the edge from each corner to the next one of its face.
fn edges_of(starts: &[u32], corners: &[u32]) -> (Vec<[u32; 2]>, Vec<u32>) {
    let mut halves: Vec<([u32; 2], u32)> = Vec::with_capacity(corners.len());
    for face in starts.windows(2) {
        let own = &corners[face[0] as usize..face[1] as usize];
        for (k, &a) in own.iter().enumerate() {
            let b = own[(k + 1) % own.len()];
            halves.push(([a.min(b), a.max(b)], face[0] + k as u32));
        }
    }
    halves.sort_unstable();
    let (mut edges, mut edge_of): (Vec<[u32; 2]>, _) = (Vec::new(), vec![0; corners.len()]);
    for (ends, corner) in halves {
        if edges.last() != Some(&ends) {
            edges.push(ends);
        }
        edge_of[corner as usize] = edges.len() as u32 - 1;
    }
    (edges, edge_of)
}

impl Strip {
    /// The strip of `mesh` whose faces have `labels`.
    ///
    /// # Errors
    /// [`Error::Memory`], [`Error::Cancelled`].
    pub fn of(mesh: &Mesh, labels: &[u32], run: &Run) -> Result<Self> {
        let (bits, _bits) = Bits::of(mesh, labels, run)?;
        let (faces, grant) = faces_of(mesh, &bits, run)?;
        let (mut starts, mut own) = (vec![0], Vec::new());
        for &face in &faces {
            mesh.faces.with(face as usize, |corners| own.extend_from_slice(corners));
            starts.push(own.len() as u32);
        }
        let (vertices, corners) = numbered(mesh, &own);
        let labels: Vec<u32> = faces.iter().map(|&face| labels[face as usize]).collect();
        let owners = || (0..faces.len()).flat_map(|f| (starts[f]..starts[f + 1]).map(move |c| (c as usize, f as u32)));
        let mut inner = vec![None; vertices.len()];
        for (c, f) in owners() {
            let v = corners[c] as usize;
            if !bits.0.has(vertices[v]) {
                inner[v] = Some(labels[f as usize]);
            }
        }
        let (edges, edge_of) = edges_of(&starts, &corners);
        let sides = Groups::of(edges.len(), owners().map(|(c, f)| (edge_of[c], f)));
        let stars = Groups::of(vertices.len(), owners().map(|(c, f)| (corners[c], f)));
        let at = vertices.iter().map(|&v| mesh.positions.get(v)).collect();
        Ok(Self {
            faces,
            labels,
            starts,
            corners,
            own,
            edge_of,
            vertices,
            at,
            inner,
            edges,
            sides,
            stars,
            _grant: grant,
        })
    }

    /// The range of corners of face `f`.
    pub fn range(&self, f: u32) -> std::ops::Range<usize> {
        self.starts[f as usize] as usize..self.starts[f as usize + 1] as usize
    }

    /// The vertices of face `f`.
    pub fn face(&self, f: u32) -> &[u32] {
        &self.corners[self.range(f)]
    }

    /// The vertices of face `f` if it is a triangle of three different ones with positions.
    pub fn triangle(&self, f: u32) -> Option<[u32; 3]> {
        let [a, b, c] = *self.face(f).first_chunk::<3>().filter(|_| self.range(f).len() == 3)?;
        let sound = a != b && b != c && c != a && [a, b, c].iter().all(|&v| finite(self.at[v as usize]));
        sound.then_some([a, b, c])
    }

    /// The number of faces.
    pub fn len(&self) -> u32 {
        self.faces.len() as u32
    }
}
