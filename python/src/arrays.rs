//! NumPy arrays as a mesh file: read where they lie, written once.

use numpy::{Element, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use nystrom_stream::base::Error;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use serde_json::json;
use std::fs::File;
use std::hash::{DefaultHasher, Hasher};
use std::io::{BufWriter, Write};
use std::path::Path;

/// An array of any of the usual types.
enum SegmentStats<'py> {
    F32(PyReadonlyArrayDyn<'py, f32>),
    F64(PyReadonlyArrayDyn<'py, f64>),
    I32(PyReadonlyArrayDyn<'py, i32>),
    I64(PyReadonlyArrayDyn<'py, i64>),
    U32(PyReadonlyArrayDyn<'py, u32>),
    U64(PyReadonlyArrayDyn<'py, u64>),
}

/// Vertices (v, 3) and faces (n, corners).
pub struct Arrays<'py> {
    vertices: SegmentStats<'py>,
    faces: SegmentStats<'py>,
    counts: (usize, usize),
    corners: usize,
}

fn readonly<'py, T: Element>(array: &Bound<'py, PyAny>) -> Option<PyReadonlyArrayDyn<'py, T>> {
    array.cast::<PyArrayDyn<T>>().ok()?.try_readonly().ok()
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

impl<'py> Arrays<'py> {
    pub fn of(vertices: &Bound<'py, PyAny>, faces: &Bound<'py, PyAny>) -> PyResult<Self> {
        let ((v, three), (n, corners)) = (shape("vertices", vertices)?, shape("faces", faces)?);
        if three != 3 {
            return Err(PyValueError::new_err(format!("vertices: {three} columns instead of x, y and z")));
        }
        if !(3..=255).contains(&corners) {
            return Err(PyValueError::new_err(format!("faces: {corners} columns; a face has 3 corners or more")));
        }
        let kinds = "of float32 or float64";
        let points = readonly(vertices).map(SegmentStats::F32).or_else(|| readonly(vertices).map(SegmentStats::F64));
        let points = points.ok_or_else(|| PyTypeError::new_err(format!("vertices: not a NumPy array {kinds}")))?;
        let indices = readonly(faces)
            .map(SegmentStats::I32)
            .or_else(|| readonly(faces).map(SegmentStats::I64))
            .or_else(|| readonly(faces).map(SegmentStats::U32))
            .or_else(|| readonly(faces).map(SegmentStats::U64));
        let indices = indices.ok_or_else(|| PyTypeError::new_err("faces: not a NumPy array of integers"))?;
        Ok(Self { vertices: points, faces: indices, counts: (v, n), corners })
    }

    /// Writes them to `path` as a binary PLY; tells what identifies them.
    pub fn write(&self, path: &Path) -> Result<serde_json::Value, Error> {
        let file = File::create(path).map_err(Error::io(path, "create"))?;
        let mut out = BufWriter::with_capacity(1 << 18, Hashing { out: file, hash: DefaultHasher::new() });
        let real = if matches!(self.vertices, SegmentStats::F64(_)) { "double" } else { "float" };
        let (v, n) = self.counts;
        let header = format!(
            "ply\nformat binary_little_endian 1.0\nelement vertex {v}\nproperty {real} x\nproperty {real} y\nproperty \
             {real} z\nelement face {n}\nproperty list uchar int vertex_indices\nend_header\n"
        );
        let mut write = || -> std::io::Result<Result<(), (usize, String)>> {
            out.write_all(header.as_bytes())?;
            match &self.vertices {
                SegmentStats::F32(array) => each(array, |x| out.write_all(&x.to_le_bytes()))?,
                SegmentStats::F64(array) => each(array, |x| out.write_all(&x.to_le_bytes()))?,
                _ => {}
            }
            let mut bad = None;
            let mut corner = 0;
            let mut put = |index: Option<i32>, told: &dyn Fn() -> String| -> std::io::Result<()> {
                if corner % self.corners == 0 {
                    out.write_all(&[self.corners as u8])?;
                }
                if index.is_none_or(|index| index as usize >= v) {
                    bad.get_or_insert((corner / self.corners, told()));
                }
                corner += 1;
                out.write_all(&index.unwrap_or(0).to_le_bytes())
            };
            match &self.faces {
                SegmentStats::I32(array) => each(array, |x| put((x >= 0).then_some(x), &|| x.to_string()))?,
                SegmentStats::I64(array) => {
                    each(array, |x| put(i32::try_from(x).ok().filter(|x| *x >= 0), &|| x.to_string()))?
                }
                SegmentStats::U32(array) => each(array, |x| put(i32::try_from(x).ok(), &|| x.to_string()))?,
                SegmentStats::U64(array) => each(array, |x| put(i32::try_from(x).ok(), &|| x.to_string()))?,
                _ => {}
            }
            out.flush()?;
            Ok(bad.map_or(Ok(()), Err))
        };
        if let Err((face, index)) = write().map_err(Error::io(path, "write"))? {
            let remedy = "correct the indices; they count from 0";
            return Err(Error::parameter("faces", format!("face {face} names vertex {index} of {v}"), remedy));
        }
        Ok(json!({"arrays": format!("{:016x}", out.get_ref().hash.finish()), "vertices": v, "faces": n}))
    }
}

/// Calls `with` for every number, in rows.
fn each<T: Element + Copy>(
    array: &PyReadonlyArrayDyn<'_, T>,
    mut with: impl FnMut(T) -> std::io::Result<()>,
) -> std::io::Result<()> {
    debug_assert!(array.ndim() == 2);
    match array.as_slice() {
        Ok(slice) if array.is_c_contiguous() => slice.iter().try_for_each(|&x| with(x)),
        // A view, or columns one after another: walked in rows.
        _ => array.as_array().iter().try_for_each(|&x| with(x)),
    }
}

/// A writer that remembers what went through it.
struct Hashing<W> {
    out: W,
    hash: DefaultHasher,
}

impl<W: Write> Write for Hashing<W> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let written = self.out.write(bytes)?;
        self.hash.write(&bytes[..written]);
        Ok(written)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.out.flush()
    }
}
