//! Python bindings: NumPy arrays or a file in; labels, hierarchy and report out; two meshes in, matches out.
//!
//! All goes through the library's front door ([`nystrom_stream::Segmenter`] and its like). Arrays are copied once, and
//! nothing is written where memory allows. Python's lock is given up while the library works, and taken now and then for
//! the progress callback and for Ctrl-C.

mod arrays;
mod correspond;
mod listener;

use listener::Listener;
use numpy::{PyArray1, PyArray2, ToPyArray};
use nystrom_stream::pipeline::Cluster;
use nystrom_stream::{Cancel, Error, Mesh, Segmenter};
use pyo3::exceptions::{PyIndexError, PyKeyboardInterrupt, PyMemoryError, PyOSError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::Arc;

/// The program's allocator: the same speed.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// What the library says, as Python's exceptions.
fn raised(error: Error) -> PyErr {
    let text = error.to_string();
    match error {
        Error::Parameter { .. } | Error::Malformed { .. } | Error::Unusable { .. } => PyValueError::new_err(text),
        Error::Io { .. } | Error::Disk { .. } => PyOSError::new_err(text),
        Error::Memory { .. } => PyMemoryError::new_err(text),
        Error::Cancelled => PyKeyboardInterrupt::new_err(text),
        _ => PyRuntimeError::new_err(text),
    }
}

/// A mesh cut into parts.
#[pyclass(frozen, module = "nystrom_stream")]
struct Segmentation {
    cut: nystrom_stream::Segmentation,
    labels: Py<PyArray1<u32>>,
    quality: Py<PyArray1<f32>>,
    colours: Py<PyArray2<u8>>,
}

#[pymethods]
impl Segmentation {
    /// Part of each face: (faces,) uint32, from 0.
    #[getter]
    fn labels(&self, py: Python<'_>) -> Py<PyArray1<u32>> {
        self.labels.clone_ref(py)
    }

    /// How sure each label is, 0 to 1: (faces,) float32.
    #[getter]
    fn quality(&self, py: Python<'_>) -> Py<PyArray1<f32>> {
        self.quality.clone_ref(py)
    }

    /// One sRGB colour per part, neighbours unlike, safe for the colour-blind: (parts, 3) uint8.
    #[getter]
    fn colours(&self, py: Python<'_>) -> Py<PyArray2<u8>> {
        self.colours.clone_ref(py)
    }

    /// The hierarchy of parts over some two thousand cells, as a dict; None for K-means and two-means.
    #[getter]
    fn tree<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.cut.hierarchy().map(|hierarchy| loaded(py, hierarchy.tree())).transpose()
    }

    /// The run's report as a dict: parts with their areas, landmarks, eigenvalues, Γ, seconds by stage.
    #[getter]
    fn report<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        loaded(py, self.cut.report())
    }

    /// Labels of the same mesh in another number of parts, at once, with boundaries along cells: (faces,) uint32.
    fn recut<'py>(&self, py: Python<'py>, parts: usize) -> PyResult<Bound<'py, PyArray1<u32>>> {
        let hierarchy = self.cut.hierarchy();
        let hierarchy = hierarchy.ok_or_else(|| PyValueError::new_err("K-means and two-means have no hierarchy"))?;
        let labels = py.detach(|| hierarchy.labels(parts)).map_err(raised)?;
        Ok(PyArray1::from_vec(py, labels))
    }

    /// Writes the labelled mesh: .ply, .seg, .npy, .glb, or a folder where `path` ends with a slash.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        py.detach(|| self.cut.save(path)).map_err(raised)
    }

    /// Number of parts.
    fn __len__(&self) -> usize {
        self.cut.parts()
    }

    /// The faces of a part: (faces of the part,) int64.
    fn __getitem__<'py>(&self, py: Python<'py>, part: usize) -> PyResult<Bound<'py, PyArray1<i64>>> {
        if part >= self.cut.parts() {
            return Err(PyIndexError::new_err(format!("part {part} of {}", self.cut.parts())));
        }
        let of_part = |(face, &label): (usize, &u32)| (label as usize == part).then_some(face as i64);
        Ok(PyArray1::from_vec(py, self.cut.labels().iter().enumerate().filter_map(of_part).collect()))
    }

    fn __repr__(&self) -> String {
        format!("Segmentation({} faces, {} parts)", self.cut.labels().len(), self.cut.parts())
    }
}

/// A value as JSON has it.
fn loaded<'py>(py: Python<'py>, value: &impl serde::Serialize) -> PyResult<Bound<'py, PyAny>> {
    let text = serde_json::to_string(value).map_err(|error| PyRuntimeError::new_err(error.to_string()))?;
    py.import("json")?.call_method1("loads", (text,))
}

/// Gives a builder of the library the options that all runs share.
macro_rules! with_options {
    ($builder:expr, $seed:expr, $threads:expr, $max_memory:expr, $tmp:expr, $listener:expr, $cancel:expr) => {{
        let builder = $builder.seed($seed).progress($listener.clone()).cancel($cancel);
        let builder = $threads.into_iter().fold(builder, |builder, threads| builder.threads(threads));
        let builder = $max_memory.into_iter().fold(builder, |builder, bytes| builder.memory(bytes));
        $tmp.into_iter().fold(builder, |builder, folder: PathBuf| builder.temporary_folder(folder))
    }};
}
use with_options;

/// Runs `work` without Python's lock; what the progress callback or Ctrl-C raised comes before its own error.
fn detached<T: Send>(
    py: Python<'_>,
    listener: &Listener,
    work: impl FnOnce() -> nystrom_stream::Result<T> + Send,
) -> PyResult<T> {
    let result = py.detach(work);
    match listener.failure() {
        Some(error) => Err(error),
        None => result.map_err(raised),
    }
}

/// The way of `cluster`, and a number of parts or a range, checked.
fn segmenter(
    parts: Option<usize>,
    parts_range: Option<(usize, usize)>,
    detail: f64,
    cluster: &str,
    landmarks: Option<usize>,
    coarse: bool,
    work_dir: Option<PathBuf>,
) -> PyResult<Segmenter> {
    let wrong = |text: String| Err(PyValueError::new_err(text));
    let method = match cluster {
        "parts" => Cluster::Parts,
        "kmeans" => Cluster::KMeans,
        "two-means" => Cluster::TwoMeans,
        other => return wrong(format!("cluster: '{other}'; choose parts, kmeans or two-means")),
    };
    if !(-1. ..=1.).contains(&detail) {
        return wrong(format!("detail: {detail} is not within -1 and 1"));
    }
    if coarse && method != Cluster::Parts {
        return wrong("coarse goes with cluster='parts'".into());
    }
    let segmenter = Segmenter::new().method(method).detail(detail).coarse(coarse);
    let segmenter = landmarks.into_iter().fold(segmenter, Segmenter::landmarks);
    let segmenter = work_dir.into_iter().fold(segmenter, |segmenter, folder| segmenter.work_dir(folder));
    match (parts, parts_range) {
        (Some(_), Some(_)) => wrong("parts and parts_range exclude each other; give one".into()),
        (Some(parts), None) => Ok(segmenter.parts(parts)),
        (None, Some((least, most))) => Ok(segmenter.parts_between(least, most)),
        (None, None) => Ok(segmenter),
    }
}

/// Cuts what `open` gives.
fn cut(
    py: Python<'_>,
    segmenter: &Segmenter,
    listener: &Listener,
    open: impl FnOnce() -> nystrom_stream::Result<Mesh> + Send,
) -> PyResult<Segmentation> {
    let cut = detached(py, listener, || segmenter.run(&open()?))?;
    Ok(Segmentation {
        labels: PyArray1::from_slice(py, cut.labels()).unbind(),
        quality: PyArray1::from_slice(py, cut.confidences()).unbind(),
        colours: PyArray2::from_vec2(py, &cut.colours().iter().map(|colour| colour.to_vec()).collect::<Vec<_>>())?
            .unbind(),
        cut,
    })
}

/// Cuts the mesh of `vertices` (v, 3) and `faces` (n, corners) into parts. See help(nystrom_stream) for the arguments.
#[pyfunction]
#[pyo3(signature = (vertices, faces, parts=None, *, parts_range=None, detail=0.0, cluster="parts", landmarks=None,
                    coarse=false, seed=0, threads=None, max_memory=None, work_dir=None, tmp=None, progress=None))]
fn segment(
    py: Python<'_>,
    vertices: &Bound<'_, PyAny>,
    faces: &Bound<'_, PyAny>,
    parts: Option<usize>,
    parts_range: Option<(usize, usize)>,
    detail: f64,
    cluster: &str,
    landmarks: Option<usize>,
    coarse: bool,
    seed: u64,
    threads: Option<usize>,
    max_memory: Option<u64>,
    work_dir: Option<PathBuf>,
    tmp: Option<PathBuf>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Segmentation> {
    let cancel = Cancel::default();
    let listener = Arc::new(Listener::new(progress, cancel.clone()));
    let segmenter = segmenter(parts, parts_range, detail, cluster, landmarks, coarse, work_dir)?;
    let segmenter = with_options!(segmenter, seed, threads, max_memory, tmp, listener, cancel);
    // The arrays belong to Python: the lock is kept while they are copied.
    let mesh = arrays::mesh(vertices, faces)?;
    cut(py, &segmenter, &listener, || Ok(mesh))
}

/// Cuts the mesh in the file `path` into parts. See help(nystrom_stream) for the arguments.
#[pyfunction]
#[pyo3(signature = (path, parts=None, *, parts_range=None, detail=0.0, cluster="parts", landmarks=None, coarse=false,
                    seed=0, threads=None, max_memory=None, work_dir=None, tmp=None, progress=None))]
fn segment_file(
    py: Python<'_>,
    path: PathBuf,
    parts: Option<usize>,
    parts_range: Option<(usize, usize)>,
    detail: f64,
    cluster: &str,
    landmarks: Option<usize>,
    coarse: bool,
    seed: u64,
    threads: Option<usize>,
    max_memory: Option<u64>,
    work_dir: Option<PathBuf>,
    tmp: Option<PathBuf>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Segmentation> {
    let cancel = Cancel::default();
    let listener = Arc::new(Listener::new(progress, cancel.clone()));
    let segmenter = segmenter(parts, parts_range, detail, cluster, landmarks, coarse, work_dir)?;
    let segmenter = with_options!(segmenter, seed, threads, max_memory, tmp, listener, cancel);
    cut(py, &segmenter, &listener, || Mesh::open(&path))
}

/// Reads a mesh file: (vertices, faces) as float64 and uint32 arrays; polygons are cut into triangles as a fan.
#[pyfunction]
fn read_mesh(py: Python<'_>, path: PathBuf) -> PyResult<(Py<PyArray2<f64>>, Py<PyArray2<u32>>)> {
    let read = || {
        let mesh = Mesh::open(&path)?;
        let vertices: Vec<[f64; 3]> = (0..mesh.positions.len() as u32).map(|v| mesh.positions.get(v)).collect();
        let mut faces: Vec<[u32; 3]> = Vec::with_capacity(mesh.faces.len());
        mesh.faces.for_each(0..mesh.faces.len(), |_, at| {
            faces.extend((1..at.len().saturating_sub(1)).map(|k| [at[0], at[k], at[k + 1]]));
        });
        Ok((vertices, faces))
    };
    let (vertices, faces) = py.detach(read).map_err(raised)?;
    let vertices = vertices.as_flattened().to_pyarray(py).call_method1("reshape", ((vertices.len(), 3),))?;
    let faces = faces.as_flattened().to_pyarray(py).call_method1("reshape", ((faces.len(), 3),))?;
    Ok((vertices.cast_into::<PyArray2<f64>>()?.unbind(), faces.cast_into::<PyArray2<u32>>()?.unbind()))
}

/// Cuts triangle meshes of any size into their meaningful parts.
#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<Segmentation>()?;
    module.add_class::<correspond::Correspondence>()?;
    module.add_function(wrap_pyfunction!(correspond::correspond, module)?)?;
    module.add_function(wrap_pyfunction!(segment, module)?)?;
    module.add_function(wrap_pyfunction!(segment_file, module)?)?;
    module.add_function(wrap_pyfunction!(read_mesh, module)?)
}
