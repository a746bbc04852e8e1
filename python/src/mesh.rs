//! Meshes as Python holds them: from arrays or a file, and back to arrays.
//!
//! A mesh of a file may be a map of that file, as long as a result has it. Whoever writes to the file meanwhile changes the mesh, or
//! has the process killed where the file is shorter now. So the state of the file is compared before each use. A file that another
//! one took the place of is still there for the map, and matters to what looks at the path again alone.

use super::listener::{run, watched};
use super::{arrays, raised};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, ToPyArray};
use nystrom_stream::Mesh;
use nystrom_stream::mesh::polygon;
use nystrom_stream::store::{Budget, PrivateFolder, Run, private_folder};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// A file: where it is, device and number, bytes, and nanoseconds of its last change.
type State = (PathBuf, u64, u64, u64, i128);

/// The state of the file `path`; none of what is no file.
fn state(path: &Path) -> Option<State> {
    let file = path.metadata().ok().filter(|file| file.is_file())?;
    let changed = i128::from(file.mtime()) * 1_000_000_000 + i128::from(file.mtime_nsec());
    Some((std::path::absolute(path).ok()?, file.dev(), file.ino(), file.len(), changed))
}

/// A mesh that the library can work on.
#[pyclass(frozen, name = "Mesh", module = "nystrom_stream._native")]
pub struct PyMesh {
    mesh: Mesh,
    /// The file that it was read from, as it was before.
    file: Option<State>,
    /// What had to be decoded lies there, so it goes after the mesh.
    _scratch: Option<PrivateFolder>,
}

impl PyMesh {
    fn of(mesh: Mesh) -> Self {
        Self { mesh, file: None, _scratch: None }
    }

    /// The mesh, if its file still holds it.
    ///
    /// # Errors
    /// ValueError where the file was written to.
    pub fn current(&self) -> PyResult<&Mesh> {
        self.checked(|was, now| (was.1, was.2) != (now.1, now.2))
    }

    /// The same for what reads the file again: nor may there be another in its place.
    ///
    /// # Errors
    /// ValueError where the file was written to or replaced.
    pub fn with_its_file(&self) -> PyResult<&Mesh> {
        self.checked(|_, _| false)
    }

    /// The mesh, where its file is as it was or `may_differ` of it now.
    fn checked(&self, may_differ: impl Fn(&State, &State) -> bool) -> PyResult<&Mesh> {
        let Some(was) = &self.file else { return Ok(&self.mesh) };
        match state(&was.0) {
            Some(now) if now != *was && !may_differ(was, &now) => {
                Err(PyValueError::new_err(format!("{} has changed since it was read; cut it again", self.path())))
            }
            _ => Ok(&self.mesh),
        }
    }
}

/// `items` as rows of three.
fn rows<'py, T: numpy::Element>(py: Python<'py>, items: &[[T; 3]]) -> PyResult<Bound<'py, PyArray2<T>>>
where
    [T]: ToPyArray<Item = T, Dim = numpy::Ix1>,
{
    items.as_flattened().to_pyarray(py).reshape([items.len(), 3])
}

#[pymethods]
impl PyMesh {
    /// The mesh of `vertices` (v, 3) and `faces` (n, corners).
    #[staticmethod]
    fn from_arrays(vertices: &Bound<'_, PyAny>, faces: &Bound<'_, PyAny>) -> PyResult<Self> {
        arrays::mesh(vertices, faces).map(Self::of)
    }

    /// The mesh of `vertices` (v, 3) float64 and polygons: face k has `corners[starts[k]:starts[k + 1]]`.
    #[staticmethod]
    fn from_polygons(
        py: Python<'_>,
        vertices: numpy::PyReadonlyArray2<'_, f64>,
        starts: PyReadonlyArray1<'_, u64>,
        corners: PyReadonlyArray1<'_, u32>,
    ) -> PyResult<Self> {
        let positions = vertices.as_array().outer_iter().map(|p| [p[0], p[1], p[2]]).collect();
        let (starts, corners) = (starts.as_array().to_vec(), corners.as_array().to_vec());
        py.detach(|| Mesh::from_polygons(positions, starts, corners)).map(Self::of).map_err(raised)
    }

    /// The mesh in the file `path`; what has to be decoded goes to a folder in `tmp`.
    #[staticmethod]
    #[pyo3(signature = (path, threads, max_memory, tmp, progress))]
    fn open(
        py: Python<'_>,
        path: PathBuf,
        threads: Option<usize>,
        max_memory: Option<u64>,
        tmp: Option<PathBuf>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Self> {
        let file = state(&path);
        watched(py, progress, |listener, cancel| {
            let mut run = Run::new(&**listener);
            run.threads = threads.unwrap_or(run.threads);
            run.budget = max_memory.map_or(run.budget, Budget::new);
            run.cancel = cancel.clone();
            let scratch = private_folder(&tmp.unwrap_or_else(std::env::temp_dir))?;
            let open = || nystrom_stream::mesh::open(&path, scratch.path(), &run);
            let (mesh, _) = run.stage("read", "faces", 0, open)?;
            Ok(Self { mesh, file, _scratch: Some(scratch) })
        })
    }

    /// Itself: nothing changes it.
    fn __copy__(this: Py<Self>) -> Py<Self> {
        this
    }

    fn __deepcopy__(this: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
        this
    }

    /// The file that it was read from as it was then: path, device, number on it, bytes, nanoseconds of the last change.
    #[getter]
    fn file(&self) -> Option<State> {
        self.file.clone()
    }

    /// The integer property `name` of the faces of the file: (faces,).
    fn face_property<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyArray1<u32>>> {
        let mesh = self.current()?;
        let found = run(py, |run| mesh.face_property(name, run))?;
        Ok(PyArray1::from_vec(py, found))
    }

    #[getter]
    fn faces(&self) -> usize {
        self.mesh.faces.len()
    }

    #[getter]
    fn path(&self) -> String {
        self.mesh.path().display().to_string()
    }

    /// Positions: (vertices, 3), as exact as they are kept.
    fn vertices<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let positions = &self.current()?.positions;
        let all = 0..positions.len() as u32;
        if positions.is_double() {
            let vertices: Vec<[f64; 3]> = py.detach(|| all.map(|v| positions.get(v)).collect());
            return rows(py, &vertices).map(Bound::into_any);
        }
        let vertices: Vec<[f32; 3]> = py.detach(|| all.map(|v| positions.get(v).map(|x| x as f32)).collect());
        rows(py, &vertices).map(Bound::into_any)
    }

    /// Starts (faces + 1) and corners of all faces.
    fn polygons<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyArray1<u64>>, Bound<'py, PyArray1<u32>>)> {
        let faces = &self.current()?.faces;
        let (mut starts, mut all) = (vec![0u64], Vec::with_capacity(faces.corner_count()));
        faces.for_each(0..faces.len(), |_, corners| {
            all.extend_from_slice(corners);
            starts.push(all.len() as u64);
        });
        Ok((PyArray1::from_vec(py, starts), PyArray1::from_vec(py, all)))
    }

    /// Triangles (t, 3), of a polygon those that do not leave it, and the face of each (t,).
    fn triangles<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyArray2<u32>>, Bound<'py, PyArray1<i64>>)> {
        let mesh = self.current()?;
        let (mut triangles, mut faces) = (Vec::with_capacity(mesh.faces.len()), Vec::new());
        let mut at: Vec<[f64; 3]> = Vec::new();
        mesh.faces.for_each(0..mesh.faces.len(), |face, corners| {
            at.clear();
            // Of a triangle, positions do not matter.
            at.extend(
                corners.iter().map(|&vertex| if corners.len() > 3 { mesh.positions.get(vertex) } else { [0.; 3] }),
            );
            polygon::triangles(&at, |triangle| {
                triangles.push(triangle.map(|corner| corners[corner]));
                faces.push(face as i64);
            });
        });
        Ok((rows(py, &triangles)?, PyArray1::from_vec(py, faces)))
    }
}
