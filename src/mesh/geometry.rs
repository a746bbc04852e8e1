//! The mesh as the layers above see it: positions and [`Faces`] over mapped bytes or arrays in memory, from a file or
//! from arrays of a caller, which are used in place.

pub use super::faces::Faces;
use super::ply::document::Document;
use super::polygon;
use super::positions::{Positions, StridedLayout};
use crate::base::vector::{MapEach, finite};
use crate::base::{Cancel, Error, Result};
use crate::store::{Context, MappedSlice, PrivateFolder, Run};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use xxhash_rust::xxh3::Xxh3;

/// A mesh: positions, and faces whose indices are all in range. Clones share all arrays.
#[derive(Clone, Debug)]
pub struct Mesh {
    /// Vertex positions.
    pub positions: Positions,
    /// Faces, in the order of the file or of the array.
    pub faces: Faces,
    source: Arc<Source>,
    /// Number of vertices that were moved away from their position in the file or array.
    strays: usize,
    /// [`Mesh::duplicates`], and their number.
    pub(super) duplicates: Option<(MappedSlice<u32>, u64)>,
    /// The folder of decoded arrays, if nobody else keeps it. Dropped last.
    pub(super) _scratch: Option<Arc<PrivateFolder>>,
}

/// Origin of a mesh.
#[derive(Debug)]
struct Source {
    /// The path as the user gave it, or a stand-in for messages.
    path: PathBuf,
    document: Option<Document>,
    notes: Vec<String>,
}

/// The name of a mesh from arrays in error messages.
const ARRAYS: &str = "<arrays>";

impl Mesh {
    /// Combines positions and faces; `path` names the mesh in messages. The caller has checked every index (the readers
    /// do so while decoding), or calls [`Mesh::check`]; [`Positions::get`] returns NaN for an index out of range
    /// nevertheless.
    pub fn new(path: impl Into<PathBuf>, positions: Positions, faces: Faces) -> Self {
        Self::with_source(positions, faces, path.into(), None, Vec::new())
    }

    pub(super) fn with_source(
        positions: Positions,
        faces: Faces,
        path: PathBuf,
        document: Option<Document>,
        notes: Vec<String>,
    ) -> Self {
        Self {
            positions,
            faces,
            source: Arc::new(Source { path, document, notes }),
            strays: 0,
            duplicates: None,
            _scratch: None,
        }
    }

    /// The same mesh with the positions of strays replaced by `repairs`, ascending by vertex.
    pub(super) fn repaired(mut self, repairs: Vec<(u32, [f64; 3])>) -> Self {
        self.strays = repairs.len();
        self.positions.repair(repairs);
        self
    }

    /// The same mesh in another order: `positions` and `faces` are its own, permuted.
    pub fn with_arrays(&self, positions: Positions, faces: Faces) -> Self {
        Self { strays: self.strays, ..Self::new(self.path(), positions, faces) }
    }

    /// The same faces with their vertices at `positions` (one per vertex).
    #[cfg(feature = "pictures")]
    pub(crate) fn with_positions(&self, positions: Vec<[f64; 3]>) -> Result<Self> {
        let layout = StridedLayout::packed(0, true, positions.len());
        let positions = Positions::strided(self.path(), sealed::Sealed::into_bytes(positions), layout)?;
        Ok(self.with_arrays(positions, self.faces.clone()))
    }

    /// Number of vertices that [`Mesh::without_strays`] moved; 0 for a mesh as opened.
    pub fn strays(&self) -> usize {
        self.strays
    }

    /// The path as the user gave it (`<stdin>` or the like for a stream, `<arrays>` without a file).
    pub fn path(&self) -> &Path {
        &self.source.path
    }

    /// The file that the mesh was read from, for outputs that preserve what they do not change; `None` without a file.
    pub fn document(&self) -> Option<&Document> {
        self.source.document.as_ref()
    }

    /// Oddities of the file, one line each: trailing bytes, expanded strips.
    pub fn notes(&self) -> &[String] {
        &self.source.notes
    }

    /// The values of the face property `name` of the file, such as the labels that another run wrote.
    ///
    /// # Errors
    /// As [`Document::face_property`]; [`Error::Unusable`] without a file.
    pub fn face_property(&self, name: &str, run: &Run) -> Result<Vec<u32>> {
        self.file()?.face_property(name, run)
    }

    /// The same as an array of the work directory of `context`, which is removed with its last reader.
    ///
    /// # Errors
    /// As [`Mesh::face_property`]; [`Error::Io`].
    pub fn face_values(&self, name: &str, context: Context<'_>) -> Result<MappedSlice<u32>> {
        const FILE: &str = "face_values.tmp";
        let document = self.file()?;
        let mut writer = context.work.writer_of(FILE, 1, self.faces.len())?;
        document.for_each_value(name, context.run, |value| writer.push(&[value]))?;
        let values = writer.finish(false)?;
        context.work.remove(FILE);
        Ok(values)
    }

    fn file(&self) -> Result<&Document> {
        let problem = "was made from arrays and has no properties";
        self.document().ok_or_else(|| Error::unusable(self.path(), problem, "open a file"))
    }

    /// A mesh of copied arrays: `positions` (vertices × 3, `f32` or `f64`) and for each face the numbers of its corners
    /// from 0, three or any other number of them. Coordinates need not be finite. Nothing is written to disk; it takes
    /// 12 or 24 bytes per vertex, 4 per corner, and 8 per face where not all are triangles.
    ///
    /// ```
    /// # fn main() -> nystrom_stream::base::Result<()> {
    /// use nystrom_stream::mesh::Mesh;
    /// let corners = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]];
    /// let mesh = Mesh::from_slices(&corners, &[[0, 1, 2], [0, 2, 3]])?;
    /// assert_eq!((mesh.positions.len(), mesh.faces.len()), (4, 2));
    /// let error = Mesh::from_slices(&corners, &[[0, 1, 4]]).unwrap_err();
    /// assert!(error.to_string().starts_with("<arrays>: faces[0]: names vertex 4"));
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// [`Error::Malformed`] naming the face that names no vertex; [`Error::Unusable`] without faces or
    /// with more than 2³² − 1 vertices or corners, or 2³¹ − 1 faces.
    pub fn from_slices<P: Coordinate, F: AsRef<[u32]>>(positions: &[[P; 3]], faces: &[F]) -> Result<Self> {
        let sizes = || faces.iter().map(|face| face.as_ref().len() as u64);
        let mut corners = Vec::with_capacity(sizes().sum::<u64>() as usize);
        faces.iter().for_each(|face| corners.extend_from_slice(face.as_ref()));
        let ends = sizes().scan(0, |end, size| {
            *end += size;
            Some(*end)
        });
        let starts = sizes().any(|size| size != 3).then(|| std::iter::once(0).chain(ends).collect());
        Self::of_arrays(positions.to_vec(), starts, corners)
    }

    /// A mesh of triangles whose arrays are taken over without a copy: `positions` (vertices × 3) and the numbers of
    /// each face's corners from 0 (faces × 3).
    ///
    /// # Errors
    /// As [`Mesh::from_slices`].
    pub fn from_vecs<P: Coordinate>(positions: Vec<[P; 3]>, faces: Vec<[u32; 3]>) -> Result<Self> {
        Self::of_arrays(positions, None, faces.into_flattened())
    }

    /// A mesh of polygons whose arrays are taken over without a copy: face `f` has the corners
    /// `corners[starts[f]..starts[f + 1]]`, so `starts` has one item more than there are faces.
    ///
    /// ```
    /// # fn main() -> nystrom_stream::base::Result<()> {
    /// use nystrom_stream::mesh::Mesh;
    /// let positions = vec![[0f32, 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.], [2., 0., 1.]];
    /// let mesh = Mesh::from_polygons(positions, vec![0, 4, 7], vec![0, 1, 2, 3, 1, 4, 2])?;
    /// assert_eq!(mesh.faces.with(1, |corners| corners.to_vec()), [1, 4, 2]);
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// As [`Mesh::from_slices`]; [`Error::Malformed`] where `starts` does not ascend from 0 to the number of corners.
    pub fn from_polygons<P: Coordinate>(positions: Vec<[P; 3]>, starts: Vec<u64>, corners: Vec<u32>) -> Result<Self> {
        Self::of_arrays(positions, Some(starts), corners)
    }

    fn of_arrays<P: Coordinate>(positions: Vec<[P; 3]>, starts: Option<Vec<u64>>, corners: Vec<u32>) -> Result<Self> {
        let path = Path::new(ARRAYS);
        let vertices = positions.len();
        if u32::try_from(vertices).is_err() {
            return Err(too_many_vertices(path));
        }
        let layout = StridedLayout::packed(0, size_of::<P>() == 8, vertices);
        let positions = Positions::strided(path, P::into_bytes(positions), layout)?;
        let faces = match starts {
            Some(starts) => Faces::Polygons { starts: starts.into(), corners: corners.into() },
            None => {
                let len = corners.len() / 3;
                Faces::triangles(path, corners.into(), 0, 12, len)?
            }
        };
        let mesh = Self::new(path, positions, faces);
        mesh.check()?;
        Ok(mesh)
    }

    /// Rejects faces that do not fit their arrays or the vertices, after [`Mesh::new`] or a change of the fields. One
    /// pass over the faces.
    ///
    /// # Errors
    /// As [`Mesh::from_polygons`].
    pub fn check(&self) -> Result<()> {
        match &self.faces {
            Faces::Triangles { bytes, offset, stride, len } => {
                Faces::triangles(self.path(), bytes.clone(), *offset, *stride, *len)?;
            }
            Faces::Polygons { starts, corners } => {
                let end = corners.len() as u64;
                if starts.first() != Some(&0) || starts.last() != Some(&end) || !starts.is_sorted() {
                    let problem = format!("do not ascend from 0 to the {end} corners");
                    let remedy = "give where each face begins, and the end";
                    return Err(Error::malformed(self.path(), "starts", problem, remedy));
                }
            }
        }
        if self.faces.is_empty() {
            return Err(no_faces(self.path()));
        }
        check_size(self.faces.len() as u64, self.faces.corner_count() as u64, self.path())?;
        let vertices = self.positions.len();
        self.faces.try_for_each(0..self.faces.len(), |face, corners| {
            corners.iter().find(|&&v| v as usize >= vertices).map_or(Ok(()), |v| {
                let problem = format!("names vertex {v}, but there are {vertices}, counted from 0");
                Err(Error::malformed(self.path(), format!("faces[{face}]"), problem, "correct the indices"))
            })
        })
    }

    /// A hash of all positions and faces: equal for equal meshes, whatever their storage. One pass, about 10 ns per
    /// face. The only error is [`Error::Cancelled`].
    pub fn content_hash(&self, cancel: &Cancel) -> Result<u64> {
        const BLOCK: usize = 1 << 14;
        let mut hash = Xxh3::new();
        hash.update(bytemuck::bytes_of(&[self.positions.len() as u64, self.faces.len() as u64]));
        let mut block: Vec<u64> = Vec::with_capacity(3 * BLOCK);
        for start in (0..self.positions.len()).step_by(BLOCK) {
            cancel.check()?;
            block.clear();
            for v in start..self.positions.len().min(start + BLOCK) {
                block.extend(self.positions.get(v as u32).map(f64::to_bits));
            }
            hash.update(bytemuck::cast_slice(&block));
        }
        let mut block: Vec<u32> = Vec::with_capacity(4 * BLOCK);
        for start in (0..self.faces.len()).step_by(BLOCK) {
            cancel.check()?;
            block.clear();
            self.faces.for_each(start..self.faces.len().min(start + BLOCK), |_, corners| {
                block.push(corners.len() as u32);
                block.extend_from_slice(corners);
            });
            hash.update(bytemuck::cast_slice(&block));
        }
        Ok(hash.digest())
    }

    /// Calls `visit(corners, positions)` for the [triangles](polygon::triangles) of a face's `corners`; triangles with
    /// a non-finite position are skipped.
    #[inline]
    pub fn triangles(&self, corners: &[u32], mut visit: impl FnMut([u32; 3], [[f64; 3]; 3])) {
        let at = |k: usize| self.positions.get(corners[k]);
        polygon::triangles_of(corners.len(), at, |numbers| {
            let places = numbers.map_each(at);
            if finite(places[0]) && finite(places[1]) && finite(places[2]) {
                visit(numbers.map_each(|k| corners[k]), places);
            }
        });
    }
}

mod sealed {
    use crate::store::MappedBytes;

    pub trait Sealed: bytemuck::Pod {
        /// The bytes of an array, which is taken over without a copy.
        fn into_bytes(positions: Vec<[Self; 3]>) -> MappedBytes;
    }

    impl Sealed for f32 {
        fn into_bytes(positions: Vec<[Self; 3]>) -> MappedBytes {
            bytemuck::cast_vec::<Self, u32>(positions.into_flattened()).into()
        }
    }

    impl Sealed for f64 {
        fn into_bytes(positions: Vec<[Self; 3]>) -> MappedBytes {
            bytemuck::cast_vec::<Self, u64>(positions.into_flattened()).into()
        }
    }
}

/// Coordinate types: `f32` or `f64`.
pub trait Coordinate: sealed::Sealed {}

impl Coordinate for f32 {}
impl Coordinate for f64 {}

/// Maximum number of faces: node numbers have 31 bits, as one bit stores the winding, and one number is reserved for
/// "none".
pub const MOST_FACES: u64 = (1 << 31) - 1;
/// Maximum number of corners: half-edges number them in 32 bits.
pub const MOST_CORNERS: u64 = u32::MAX as u64;

/// Rejects a mesh in the file `path` whose corners or faces cannot be numbered. Takes constant time, so that commands
/// can check before they start.
///
/// # Errors
/// [`Error::Unusable`].
pub fn check_size(faces: u64, corners: u64, path: &Path) -> Result<()> {
    if faces <= MOST_FACES && corners <= MOST_CORNERS {
        return Ok(());
    }
    let problem = format!(
        "has {faces} faces with {corners} corners, but at most {MOST_FACES} faces and {MOST_CORNERS} corners are \
         supported"
    );
    Err(Error::unusable(path, problem, "cut it into several meshes, or decimate it"))
}

/// The error for a file without content.
pub(super) fn empty(path: &Path) -> Error {
    Error::unusable(path, "is empty (0 bytes)", "get the file again")
}

/// The error for a mesh without faces.
pub fn no_faces(path: &Path) -> Error {
    Error::unusable(
        path,
        "has no faces; a surface is needed, not a point cloud",
        "reconstruct a surface from it first, or export the mesh with its faces",
    )
}

/// Rejects the array `name` of `items` items unless there is one for each of `faces` faces.
pub(crate) fn one_per_face(name: &str, items: usize, faces: usize) -> Result<()> {
    if items == faces {
        return Ok(());
    }
    let problem = format!("{items} values for {faces} faces");
    Err(Error::parameter(name, problem, "give one for every face of the mesh"))
}

/// The error for a mesh with more vertices than can be numbered.
pub(super) fn too_many_vertices(path: &Path) -> Error {
    Error::unusable(path, "has more than 2^32 − 1 vertices", "cut it into several meshes")
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

    const SQUARE: [[f64; 3]; 4] = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]];

    fn faces_of(mesh: &Mesh) -> Vec<Vec<u32>> {
        let mut seen = Vec::new();
        mesh.faces.for_each(0..mesh.faces.len(), |f, corners| {
            assert_eq!((f, mesh.faces.with(f, <[u32]>::to_vec)), (seen.len(), corners.to_vec()));
            seen.push(corners.to_vec());
        });
        seen
    }

    #[test]
    fn arrays_make_a_mesh() {
        let faces = [vec![0u32, 1, 2, 3], vec![0, 2, 1]];
        let mesh = Mesh::from_slices(&SQUARE, &faces).unwrap();
        assert_eq!(faces_of(&mesh), faces);
        assert_eq!(mesh.positions.get(2), [1., 1., 0.]);
        assert_eq!((0..7).map(|c| mesh.faces.face_of_corner(c)).collect::<Vec<_>>(), [0, 0, 0, 0, 1, 1, 1]);
        assert!(mesh.positions.get(9)[0].is_nan());
    }

    #[test]
    fn every_way_in_makes_the_same_mesh() {
        let triangles = [[0u32, 1, 2], [0, 2, 3]];
        let narrow = SQUARE.map(|position| position.map(|x| x as f32));
        let same = [
            Mesh::from_slices(&SQUARE, &triangles),
            Mesh::from_slices(&narrow, &triangles),
            Mesh::from_vecs(SQUARE.to_vec(), triangles.to_vec()),
            Mesh::from_vecs(narrow.to_vec(), triangles.to_vec()),
            Mesh::from_polygons(SQUARE.to_vec(), vec![0, 3, 6], triangles.as_flattened().to_vec()),
        ]
        .map(Result::unwrap);
        let hash = |mesh: &Mesh| mesh.content_hash(&Cancel::default()).unwrap();
        for mesh in &same {
            assert_eq!(faces_of(mesh), triangles);
            assert_eq!(mesh.positions.get(3), [0., 1., 0.]);
            assert_eq!(hash(mesh), hash(&same[0]));
        }
        // Work directories of meshes from arrays are keyed by this hash: it must stay the same with any compiler and on
        // any machine.
        assert_eq!(hash(&same[0]), 0x0475_989b_2f76_fce3);
        let others =
            [Mesh::from_slices(&SQUARE, &[[0u32, 1, 2], [0, 3, 2]]), Mesh::from_slices(&SQUARE, &triangles[..1])];
        for mesh in others {
            assert_ne!(hash(&mesh.unwrap()), hash(&same[0]));
        }
    }

    #[test]
    fn wrong_arrays_are_refused_and_odd_numbers_are_not() {
        let wrong = |made: Result<Mesh>, part: &str| {
            let message = made.unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        };
        wrong(Mesh::from_slices(&SQUARE, &[vec![0u32, 1, 2, 3], vec![], vec![0, 4, 2]]), "faces[2]: names vertex 4");
        wrong(Mesh::from_vecs(SQUARE.to_vec(), vec![[0, 1, 2], [0, 1, u32::MAX]]), "faces[1]: names vertex 4294967295");
        wrong(Mesh::from_slices(&SQUARE, &[[0u32; 3]; 0]), "has no faces");
        wrong(Mesh::from_polygons(SQUARE.to_vec(), vec![0], vec![]), "has no faces");
        for starts in [vec![], vec![1, 3], vec![0, 2], vec![0, 4, 3], vec![0, 2, 1, 3]] {
            wrong(Mesh::from_polygons(SQUARE.to_vec(), starts, vec![0, 1, 2]), "starts: do not ascend");
        }
        // Regression: a stride shorter than a record was accepted, and bytes beyond the end were read.
        let twelve = || vec![0u32; 3].into();
        assert!(Faces::triangles("x".as_ref(), twelve(), 0, 0, 2).is_err());
        assert!(Faces::triangles("x".as_ref(), twelve(), 0, 0, 1).is_ok());
        let odd = Mesh::from_slices(&[[f32::NAN, f32::INFINITY, 0.]; 3], &[[0u32, 1, 2]]).unwrap();
        assert!(odd.positions.get(0)[0].is_nan());
    }
}
