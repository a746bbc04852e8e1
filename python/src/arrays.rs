//! NumPy arrays as a mesh: any of the usual types, copied once, nothing written.
//!
//! Rows are one after the other and items aligned: the package sees to it, since `numpy` counts strides in whole items, which fields
//! of packed records do not have.

use numpy::{Element, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use nystrom_stream::base::printable::counted;
use nystrom_stream::mesh::Coordinate;
use nystrom_stream::{Error, Mesh, Result};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

fn readonly<'py, T: Element>(array: &Bound<'py, PyAny>) -> Option<PyReadonlyArrayDyn<'py, T>> {
    let array = array.cast::<PyArrayDyn<T>>().ok()?.try_readonly().ok()?;
    (array.is_c_contiguous() && array.data().is_aligned()).then_some(array)
}

/// Rows and columns of a two-dimensional array.
fn shape(name: &str, array: &Bound<'_, PyAny>) -> PyResult<(usize, usize)> {
    let wrong = || PyTypeError::new_err(format!("{name}: not a two-dimensional NumPy array"));
    let shape: Vec<usize> = array.getattr("shape").and_then(|shape| shape.extract()).map_err(|_| wrong())?;
    match shape[..] {
        [rows, columns] => Ok((rows, columns)),
        _ => Err(wrong()),
    }
}

/// An integer that numbers vertices.
trait Corner: Element + Copy + TryInto<u32> + std::fmt::Display {}

impl<T: Element + Copy + TryInto<u32> + std::fmt::Display> Corner for T {}

/// Vertices (v, 3) and faces (n, columns).
#[derive(Clone, Copy)]
struct Arrays<'a, 'py> {
    vertices: &'a Bound<'py, PyAny>,
    faces: &'a Bound<'py, PyAny>,
    columns: usize,
}

/// The mesh of positions and corners, with `columns` corners a face.
fn build<P: Coordinate, C: Corner>(positions: &[P], corners: &[C], columns: usize) -> Result<Mesh> {
    if let Some(at) = corners.iter().position(|&corner| corner.try_into().is_err()) {
        let (place, problem) = (format!("faces[{}]", at / columns), format!("names vertex {}", corners[at]));
        return Err(Error::malformed("<arrays>", place, problem, "count vertices from 0"));
    }
    let number = |corner: C| corner.try_into().unwrap_or(u32::MAX);
    let positions = positions.as_chunks::<3>().0.to_vec();
    if columns == 3 {
        return Mesh::from_vecs(positions, corners.as_chunks::<3>().0.iter().map(|face| face.map(number)).collect());
    }
    let starts = (0..=corners.len() / columns).map(|face| (face * columns) as u64).collect();
    Mesh::from_polygons(positions, starts, corners.iter().map(|&corner| number(corner)).collect())
}

/// The same for arrays whose types are `P` and `C`.
fn of_types<P: Coordinate + Element, C: Corner>(arrays: Arrays<'_, '_>) -> Option<Result<Mesh>> {
    let (vertices, faces) = (readonly::<P>(arrays.vertices)?, readonly::<C>(arrays.faces)?);
    Some(build(vertices.as_slice().ok()?, faces.as_slice().ok()?, arrays.columns))
}

/// The same for corners of type `C`.
fn of_corners<C: Corner>(arrays: Arrays<'_, '_>) -> Option<Result<Mesh>> {
    of_types::<f32, C>(arrays).or_else(|| of_types::<f64, C>(arrays))
}

/// The mesh of `vertices` (v, 3) and `faces` (n, corners).
pub fn mesh(vertices: &Bound<'_, PyAny>, faces: &Bound<'_, PyAny>) -> PyResult<Mesh> {
    let ((_, three), (_, columns)) = (shape("vertices", vertices)?, shape("faces", faces)?);
    if three != 3 {
        return Err(PyValueError::new_err(format!(
            "vertices: {} instead of three (x, y and z)",
            counted(three, "column")
        )));
    }
    if columns < 3 {
        return Err(PyValueError::new_err(format!(
            "faces: {}; a face has 3 corners or more",
            counted(columns, "column")
        )));
    }
    let arrays = Arrays { vertices, faces, columns };
    of_corners::<i64>(arrays)
        .or_else(|| of_corners::<i32>(arrays))
        .or_else(|| of_corners::<u32>(arrays))
        .or_else(|| of_corners::<u64>(arrays))
        .ok_or_else(|| PyTypeError::new_err("vertices and faces: not of real numbers and integers, row by row"))?
        .map_err(super::raised)
}
