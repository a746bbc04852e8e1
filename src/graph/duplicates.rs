//! Finds faces that lie exactly where another face lies, in either winding.
//!
//! Two-sided models of games, and exports that write a face for each side, have every face twice. Then four faces meet
//! at each edge, and linking these in the order of the file joins the two sides of one face like a fold by 180°; or, if
//! both sides have vertices of their own, each is a body of its own. So a duplicate takes part in the graph only by one
//! edge to another face in its place, whose label it gets, and has no area.
//!
//! Only what suggests duplicates leads to a search ([`Evidence`]): an edge of three faces or more two of which lie in
//! the same place, two open edges at the same position whose triangles do, or components of the same size. Places
//! are compared as hashes of 96 bits.
//!
//! Where two bodies touch, faces coincide as well, but each belongs to its own body, so they stay: without one of them,
//! its winding would follow from the other body. Such pieces border on other faces all around, two-sided ones on few
//! ([`DuplicateSides`]). That is decided once for the whole mesh. Components of the same size are duplicates only as a
//! whole.
//!
//! Cost, after a search: 20 bytes per face are shuffled. If it finds duplicates, the graph is built a second time, and
//! 4 bytes per face are kept in the work directory. For components up to 1.3 MB.

use super::components::{ComponentTable, Components};
use super::half_edge_pairs::OPPOSITE_WINDING;
use super::nonmanifold::DuplicateSides;
use crate::base::Result;
use crate::base::parallel::{chunk_count, chunk_range};
use crate::mesh::Mesh;
use crate::store::npy::ArrayWriter;
use crate::store::shuffle::{BudgetedShuffle, Producer, RangeBuckets};
use crate::store::{Context, Run, WorkDir};

const CHUNK: usize = 1 << 14;
/// Maximum number of components that are compared.
const MOST_COMPONENTS: usize = 1 << 16;
/// Maximum difference of the areas of components of the same size, relative to them.
const SAME_AREA: f64 = 1e-9;
/// The file of the duplicates, if there are any: `u32` (n), as [`Mesh::duplicates`].
pub const FILE: &str = "duplicates.npy";

/// What suggests that there are duplicates.
#[derive(Clone, Copy, Debug)]
pub(super) enum Evidence<'a> {
    /// Edges.
    Sides(DuplicateSides),
    /// Components.
    Components(&'a Components),
}

impl<'a> Evidence<'a> {
    /// Whether a search is worth its time.
    fn is_strong(self) -> bool {
        match self {
            Self::Sides(sides) => sides.inner + sides.rim > 0,
            Self::Components(_) => self.table().is_some_and(has_twins),
        }
    }

    /// The components, if they are the evidence.
    fn table(self) -> Option<&'a ComponentTable> {
        match self {
            Self::Sides(_) => None,
            Self::Components(components) => components.table.as_ref(),
        }
    }

    /// A number that is the same for all faces that are duplicates of one another only as a whole.
    fn body(self, face: usize) -> u32 {
        match self {
            Self::Sides(_) => 0,
            Self::Components(components) => components.link(face) & !OPPOSITE_WINDING,
        }
    }
}

/// Whether components of the same number of faces and the same area have at least a tenth of all faces. Scans have many
/// specks of the same size.
fn has_twins(table: &ComponentTable) -> bool {
    if table.count() > MOST_COMPONENTS {
        return false;
    }
    let mut sizes: Vec<(u32, f64)> = table.nodes().iter().copied().zip(table.area().iter().copied()).collect();
    sizes.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let is_same = |a: &(u32, f64), b: &(u32, f64)| a.0 == b.0 && b.1 - a.1 <= SAME_AREA * b.1;
    let faces = |sizes: &[(u32, f64)]| sizes.iter().map(|size| u64::from(size.0)).sum::<u64>();
    let twins: u64 = sizes.chunk_by(is_same).filter(|same| same.len() > 1).map(faces).sum();
    10 * twins >= faces(&sizes)
}

/// The same mesh, in which all but one of the faces in one place are known as duplicates; `None` if there are none, or
/// if they are contacts of bodies.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Memory`], [`crate::base::Error::Cancelled`].
pub(super) fn with_duplicates(mesh: &Mesh, evidence: Evidence<'_>, context: Context<'_>) -> Result<Option<Mesh>> {
    if !evidence.is_strong() {
        return Ok(None);
    }
    let Context { work, run } = context;
    let (n, threads) = (mesh.faces.len(), run.threads as u64);
    let places = FacePlaces::of(mesh, |face| evidence.body(face), context)?;
    let file = work.spill("duplicate_faces.tmp");
    let found = BudgetedShuffle::<[u32; 2]>::new(file, "comparing faces", n as u64, 6 * threads, 2, run)?;
    let (by_face, mut out) = (RangeBuckets::new(n, found.shuffle.buckets()), found.shuffle.producer());
    let (mut corners, mut of_component) = (0, vec![0u32; evidence.table().map_or(0, ComponentTable::count)]);
    places.each(run, |same| {
        let (_, first) = same[0];
        corners += ((same.len() - 1) * mesh.faces.corner_range(first as usize).len()) as u64;
        same[1..].iter().try_for_each(|&(body, face)| {
            if let Some(table) = evidence.table() {
                of_component[table.number(body, 0)] += 1;
            }
            out.push(by_face.bucket_of(face), [face, first])
        })
    })?;
    out.finish()?;
    if let Evidence::Sides(sides) = evidence
        && !sides.are_two_sided(corners)
    {
        return Ok(None);
    }
    let mut number = 0;
    let mut is_whole = |face: u32| {
        evidence.table().is_none_or(|table| {
            number = table.number(evidence.body(face as usize), number);
            of_component[number] == table.nodes()[number]
        })
    };
    let mut writer = Writer::new(n, work)?;
    found.shuffle.sorted(run, |records| {
        records.into_iter().filter(|[face, _]| is_whole(*face)).try_for_each(|[face, first]| writer.push(face, first))
    })?;
    writer.finish(mesh, work)
}

/// The places of all faces.
pub(super) struct FacePlaces(BudgetedShuffle<[u32; 5]>);

impl FacePlaces {
    /// Those of the faces of `mesh`, together with the number `body(face)`.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`], [`crate::base::Error::Memory`], [`crate::base::Error::Cancelled`].
    pub fn of(mesh: &Mesh, body: impl Fn(usize) -> u32 + Sync, context: Context<'_>) -> Result<Self> {
        let Context { work, run } = context;
        let (n, threads) = (mesh.faces.len(), run.threads as u64);
        let file = work.spill("face_places.tmp");
        let places = BudgetedShuffle::<[u32; 5]>::new(file, "comparing faces", n as u64, 6 * threads, 3, run)?;
        let buckets = places.shuffle.buckets() as u64;
        run.each_chunk(
            chunk_count(n, CHUNK),
            || places.shuffle.producer(),
            |k, out| {
                run.progress.advance("graph", 0);
                chunk_range(n, CHUNK, k).try_for_each(|face| match mesh.place_of(face) {
                    Some([a, b, c]) => {
                        let bucket = ((u64::from(a) * buckets) >> 32) as usize;
                        out.push(bucket, [a, b, c, body(face), face as u32])
                    }
                    None => Ok(()),
                })
            },
            Producer::finish,
        )?;
        Ok(Self(places))
    }

    /// Calls `visit` with the faces in each place that has several, each after the number of its body; ascending.
    ///
    /// # Errors
    /// As [`FacePlaces::of`], and those of `visit`.
    pub fn each(self, run: &Run, mut visit: impl FnMut(&[(u32, u32)]) -> Result<()>) -> Result<()> {
        let mut faces = Vec::new();
        self.0.shuffle.sorted(run, |records| {
            let places = records.chunk_by(|a, b| a[..3] == b[..3]);
            places.filter(|same| same.len() > 1).try_for_each(|same| {
                faces.clear();
                faces.extend(same.iter().map(|&[.., body, face]| (body, face)));
                visit(&faces)
            })
        })
    }
}

/// Writes [`FILE`].
pub(super) struct Writer {
    array: ArrayWriter<u32>,
    next: usize,
    n: usize,
    count: u64,
}

impl Writer {
    /// For a mesh of `n` faces.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`].
    pub fn new(n: usize, work: &WorkDir) -> Result<Self> {
        Ok(Self { array: work.writer_of::<u32>(FILE, 1, n)?, next: 0, n, count: 0 })
    }

    /// Adds `face`, greater than those before, which is linked to the face `to`.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`].
    pub fn push(&mut self, face: u32, to: u32) -> Result<()> {
        skip(&mut self.array, face as usize - self.next)?;
        (self.next, self.count) = (face as usize + 1, self.count + 1);
        self.array.push(&[to + 1])
    }

    /// `mesh` with these duplicates; `None` if there are none.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`].
    pub fn finish(mut self, mesh: &Mesh, work: &WorkDir) -> Result<Option<Mesh>> {
        skip(&mut self.array, self.n - self.next)?;
        let of = self.array.finish(false)?;
        if self.count == 0 {
            drop(of);
            work.remove(FILE);
            return Ok(None);
        }
        Ok(Some(mesh.clone().with_duplicates(of, self.count)))
    }
}

/// Appends `count` zeros: faces that are no duplicates.
fn skip(array: &mut ArrayWriter<u32>, count: usize) -> Result<()> {
    (0..count).step_by(CHUNK).try_for_each(|k| array.push(&[0; CHUNK][..CHUNK.min(count - k)]))
}
