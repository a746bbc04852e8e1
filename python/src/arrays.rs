//! NumPy arrays as a mesh: any of the usual types, copied once, nothing written.
//!
//! Rows are one after the other and items aligned: the package sees to it, since `numpy` counts strides in whole items, which fields
//! of packed records do not have.

use numpy::{Element, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
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

/// The items of an array row by row.
fn items<T: Element + Copy>(array: &PyReadonlyArrayDyn<'_, T>) -> Vec<T> {
    array.as_slice().map(<[T]>::to_vec).unwrap_or_default()
}

/// Corners as the library numbers them.
fn corners<T: Element + Copy + TryInto<u32> + std::fmt::Display>(
    array: &PyReadonlyArrayDyn<'_, T>,
    columns: usize,
) -> Result<Vec<u32>> {
    let convert = |(at, corner): (usize, T)| {
        let place = format!("faces[{}]", at / columns);
        let wrong = || Error::malformed("<arrays>", place, format!("names vertex {corner}"), "count vertices from 0");
        corner.try_into().map_err(|_| wrong())
    };
    items(array).into_iter().enumerate().map(convert).collect()
}

fn build<P: Coordinate + Element>(
    vertices: &PyReadonlyArrayDyn<'_, P>,
    corners: Vec<u32>,
    columns: usize,
) -> Result<Mesh> {
    let positions = items(vertices).chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
    if columns == 3 {
        return Mesh::from_vecs(positions, corners.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect());
    }
    let starts = (0..=corners.len() / columns).map(|face| (face * columns) as u64).collect();
    Mesh::from_polygons(positions, starts, corners)
}

/// The mesh of `vertices` (v, 3) and `faces` (n, corners).
pub fn mesh(vertices: &Bound<'_, PyAny>, faces: &Bound<'_, PyAny>) -> PyResult<Mesh> {
    let ((_, three), (_, columns)) = (shape("vertices", vertices)?, shape("faces", faces)?);
    if three != 3 {
        return Err(PyValueError::new_err(format!("vertices: {three} columns instead of three (x, y and z)")));
    }
    if columns < 3 {
        return Err(PyValueError::new_err(format!("faces: {columns} columns; a face has 3 corners or more")));
    }
    let corners = readonly::<i32>(faces)
        .map(|array| corners(&array, columns))
        .or_else(|| readonly::<i64>(faces).map(|array| corners(&array, columns)))
        .or_else(|| readonly::<u32>(faces).map(|array| corners(&array, columns)))
        .or_else(|| readonly::<u64>(faces).map(|array| corners(&array, columns)))
        .ok_or_else(|| PyTypeError::new_err("faces: not a NumPy array of integers, row by row"))?
        .map_err(super::raised)?;
    let made = match readonly::<f32>(vertices) {
        Some(array) => build(&array, corners, columns),
        None => match readonly::<f64>(vertices) {
            Some(array) => build(&array, corners, columns),
            None => return Err(PyTypeError::new_err("vertices: not a NumPy array of float32 or float64, row by row")),
        },
    };
    made.map_err(super::raised)
}
