//! Meshes as Python holds them: from arrays or a file, and back to arrays.

use super::listener::run;
use super::{arrays, raised};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, ToPyArray};
use nystrom_stream::Mesh;
use pyo3::prelude::*;
use std::path::PathBuf;

/// A mesh that the library can work on.
#[pyclass(frozen, name = "Mesh", module = "nystrom_stream._native")]
pub struct PyMesh(pub Mesh);

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
        arrays::mesh(vertices, faces).map(Self)
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
        py.detach(|| Mesh::from_polygons(positions, starts, corners)).map(Self).map_err(raised)
    }

    /// The mesh in the file `path`.
    #[staticmethod]
    fn open(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        run(py, |run| Mesh::open_under(&path, run)).map(Self)
    }

    /// The integer property `name` of the faces of the file: (faces,).
    fn face_property<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyArray1<u32>>> {
        let found = run(py, |run| self.0.face_property(name, run))?;
        Ok(PyArray1::from_vec(py, found))
    }

    #[getter]
    fn faces(&self) -> usize {
        self.0.faces.len()
    }

    #[getter]
    fn path(&self) -> String {
        self.0.path().display().to_string()
    }

    /// Positions: (vertices, 3), as exact as they are kept.
    fn vertices<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let all = 0..self.0.positions.len() as u32;
        if self.0.positions.is_double() {
            let vertices: Vec<[f64; 3]> = py.detach(|| all.map(|v| self.0.positions.get(v)).collect());
            return rows(py, &vertices).map(Bound::into_any);
        }
        let vertices: Vec<[f32; 3]> = py.detach(|| all.map(|v| self.0.positions.get(v).map(|x| x as f32)).collect());
        rows(py, &vertices).map(Bound::into_any)
    }

    /// Starts (faces + 1) and corners of all faces.
    fn polygons<'py>(&self, py: Python<'py>) -> (Bound<'py, PyArray1<u64>>, Bound<'py, PyArray1<u32>>) {
        let (mut starts, mut all) = (vec![0u64], Vec::with_capacity(self.0.faces.corner_count()));
        self.0.faces.for_each(0..self.0.faces.len(), |_, corners| {
            all.extend_from_slice(corners);
            starts.push(all.len() as u64);
        });
        (PyArray1::from_vec(py, starts), PyArray1::from_vec(py, all))
    }

    /// Triangles (t, 3), polygons as fans, and the face of each (t,).
    fn triangles<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyArray2<u32>>, Bound<'py, PyArray1<i64>>)> {
        let (mut triangles, mut faces) = (Vec::with_capacity(self.0.faces.len()), Vec::new());
        self.0.faces.for_each(0..self.0.faces.len(), |face, at| {
            for k in 1..at.len().saturating_sub(1) {
                triangles.push([at[0], at[k], at[k + 1]]);
                faces.push(face as i64);
            }
        });
        Ok((rows(py, &triangles)?, PyArray1::from_vec(py, faces)))
    }
}
