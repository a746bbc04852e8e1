//! The faces along the boundaries of parts, with their own numbers of vertices and edges.
//!
//! A vertex is on a boundary if its faces have several labels; every face of such a vertex belongs to the strip. Two passes over the
//! faces find them. What is held while they run is a bit per vertex, and four bytes per vertex for as many vertices at a time as
//! the budget allows; what is kept grows with the strip alone.

use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::{Error, Result};
use crate::mesh::geometry::Mesh;
use crate::store::Run;
use crate::store::budget::Grant;

/// Faces looked at between two looks at the stop flag.
const CHUNK: usize = 1 << 14;
/// Vertices of a block at the least, where there are as many.
const LEAST: usize = 1 << 12;
/// Bytes granted per corner of the strip, for all that is made of it.
const BYTES: u64 = 250;
/// The first label of a vertex that no face has.
const NONE: u32 = u32::MAX;

/// The strip. Faces, vertices and edges have numbers of their own in it, in the order of the mesh.
pub(super) struct Strip {
    /// The faces in the mesh (f), ascending.
    pub faces: Vec<u32>,
    /// Their labels (f).
    pub labels: Vec<u32>,
    /// First corner of each (f + 1).
    pub starts: Vec<u32>,
    /// The vertices of all corners.
    pub corners: Vec<u32>,
    /// The edge from each corner to the next one of its face.
    pub edge_of: Vec<u32>,
    /// The vertices in the mesh (v), ascending.
    pub vertices: Vec<u32>,
    /// Their positions (v).
    pub at: Vec<[f64; 3]>,
    /// The label of vertices whose faces have one only (v); none on a boundary.
    pub inner: Vec<Option<u32>>,
    /// The ends of each edge, ascending (e).
    pub edges: Vec<[u32; 2]>,
    /// The faces of each edge.
    pub sides: Groups,
    /// The faces of each vertex.
    pub stars: Groups,
    _grant: Grant,
}

/// Lists of faces, one after the other.
pub(super) struct Groups {
    starts: Vec<u32>,
    faces: Vec<u32>,
}

impl Groups {
    /// The faces of `pairs` (owner, face), sorted by owner, of which there are `count`.
    fn of(count: usize, pairs: impl Iterator<Item = (u32, u32)> + Clone) -> Self {
        let mut starts = vec![0u32; count + 1];
        pairs.clone().for_each(|(owner, _)| starts[owner as usize + 1] += 1);
        for k in 0..count {
            starts[k + 1] += starts[k];
        }
        let mut next = starts.clone();
        let mut faces = vec![0; starts[count] as usize];
        for (owner, face) in pairs {
            faces[next[owner as usize] as usize] = face;
            next[owner as usize] += 1;
        }
        Self { starts, faces }
    }

    /// The faces of `owner`, ascending.
    pub fn of_owner(&self, owner: u32) -> &[u32] {
        &self.faces[self.starts[owner as usize] as usize..self.starts[owner as usize + 1] as usize]
    }
}

/// Which vertices lie on a boundary: a bit each.
struct Bits(Vec<u64>);

impl Bits {
    fn of(mesh: &Mesh, labels: &[u32], run: &Run) -> Result<(Self, Grant)> {
        let vertices = mesh.positions.len();
        let words = vertices.div_ceil(64);
        let kept = run.budget.take("boundary vertices", 8 * words as u64, 8 * words as u64)?;
        let mut bits = Self(vec![0; words]);
        let grant = run.budget.take("labels of vertices", 4 * vertices.min(LEAST) as u64, 4 * vertices as u64)?;
        let width = ((grant.bytes() / 4) as usize).max(1);
        let mut first = Vec::new();
        for start in (0..vertices).step_by(width) {
            first.clear();
            first.resize(width.min(vertices - start), NONE);
            for chunk in 0..chunk_count(labels.len(), CHUNK) {
                run.cancel.check()?;
                mesh.faces.for_each(chunk_range(labels.len(), CHUNK, chunk), |face, corners| {
                    for &v in corners {
                        match (v as usize).checked_sub(start).and_then(|at| first.get_mut(at)) {
                            Some(own) if *own == NONE => *own = labels[face],
                            Some(own) if *own != labels[face] => bits.0[v as usize / 64] |= 1 << (v % 64),
                            _ => {}
                        }
                    }
                });
            }
        }
        Ok((bits, kept))
    }

    fn has(&self, v: u32) -> bool {
        self.0.get(v as usize / 64).is_some_and(|word| word >> (v % 64) & 1 == 1)
    }
}

impl Strip {
    /// The strip of `mesh` whose faces have `labels`.
    ///
    /// # Errors
    /// [`Error::Memory`], [`Error::Cancelled`].
    pub fn of(mesh: &Mesh, labels: &[u32], run: &Run) -> Result<Self> {
        let (bits, _bits) = Bits::of(mesh, labels, run)?;
        let n = labels.len();
        let each = |k: usize, visit: &mut dyn FnMut(usize, &[u32])| {
            mesh.faces.for_each(chunk_range(n, CHUNK, k), |face, corners| {
                if corners.iter().any(|&v| bits.has(v)) {
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
        let grant = run.budget.take("faces along boundaries", BYTES * corners, BYTES * corners)?;
        if u32::try_from(corners).is_err() {
            return Err(Error::unusable(mesh.path(), "has more than 2^32 corners along boundaries", "cut it coarser"));
        }
        let find = |k, (): &mut ()| {
            let mut mine = Vec::new();
            each(k, &mut |face, _| mine.push(face as u32));
            Ok(mine)
        };
        let faces = run.map_chunks(chunk_count(n, CHUNK), || (), find)?.concat();
        let (mut starts, mut all) = (vec![0], Vec::with_capacity(corners as usize));
        for &face in &faces {
            mesh.faces.with(face as usize, |corners| all.extend_from_slice(corners));
            starts.push(all.len() as u32);
        }
        let mut vertices = all.clone();
        vertices.sort_unstable();
        vertices.dedup();
        let corners: Vec<u32> = all.into_iter().map(|v| vertices.partition_point(|&other| other < v) as u32).collect();
        let labels: Vec<u32> = faces.iter().map(|&face| labels[face as usize]).collect();
        let owners = || (0..faces.len()).flat_map(|f| (starts[f]..starts[f + 1]).map(move |c| (c as usize, f as u32)));
        let mut inner = vec![None; vertices.len()];
        for (c, f) in owners() {
            let v = corners[c] as usize;
            if !bits.has(vertices[v]) {
                inner[v] = Some(labels[f as usize]);
            }
        }
        let mut halves: Vec<([u32; 2], u32)> = Vec::with_capacity(corners.len());
        for f in 0..faces.len() {
            let own = &corners[starts[f] as usize..starts[f + 1] as usize];
            for (k, &a) in own.iter().enumerate() {
                let b = own[(k + 1) % own.len()];
                halves.push(([a.min(b), a.max(b)], starts[f] + k as u32));
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
        let sides = Groups::of(edges.len(), owners().map(|(c, f)| (edge_of[c], f)));
        let stars = Groups::of(vertices.len(), owners().map(|(c, f)| (corners[c], f)));
        let at = vertices.iter().map(|&v| mesh.positions.get(v)).collect();
        Ok(Self { faces, labels, starts, corners, edge_of, vertices, at, inner, edges, sides, stars, _grant: grant })
    }

    /// The corners of face `f`: where they stand among all.
    pub fn range(&self, f: u32) -> std::ops::Range<usize> {
        self.starts[f as usize] as usize..self.starts[f as usize + 1] as usize
    }

    /// The vertices of face `f`.
    pub fn face(&self, f: u32) -> &[u32] {
        &self.corners[self.range(f)]
    }

    /// The vertices of face `f` if it is a triangle of three different ones.
    pub fn triangle(&self, f: u32) -> Option<[u32; 3]> {
        let [a, b, c] = *self.face(f).first_chunk::<3>().filter(|_| self.range(f).len() == 3)?;
        (a != b && b != c && c != a).then_some([a, b, c])
    }

    /// The number of faces.
    pub fn len(&self) -> u32 {
        self.faces.len() as u32
    }
}
