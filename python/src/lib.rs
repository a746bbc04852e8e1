//! Python bindings: NumPy arrays or a file in, labels, merge tree and report out; two meshes in, matches out.
//!
//! Arrays are read where they lie and written once, as a mesh file in the temporary work directory, which the program
//! maps like any other; nothing of the mesh is copied in memory. Python's lock is given up meanwhile, and taken
//! now and then for the progress callback and for Ctrl-C.

mod arrays;
mod correspond;
mod listener;
mod options;

use listener::Listener;
use numpy::{PyArray1, PyArray2, ToPyArray};
use nystrom_stream::base::{Cancel, Error};
use nystrom_stream::mesh;
use nystrom_stream::pipeline::report::Report;
use nystrom_stream::pipeline::{SegmentParams, input, segment as segment_mesh};
use nystrom_stream::store::{Context, Budget, Run, WorkDir};
use options::Options;
use pyo3::exceptions::{PyKeyboardInterrupt, PyMemoryError, PyOSError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

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
    labels: Py<PyArray1<u32>>,
    quality: Py<PyArray1<f32>>,
    colours: Py<PyArray2<u8>>,
    tree: Option<String>,
    report: String,
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

    /// A colour a part, neighbours unlike, safe for the colour-blind: (parts, 3) uint8.
    #[getter]
    fn colours(&self, py: Python<'_>) -> Py<PyArray2<u8>> {
        self.colours.clone_ref(py)
    }

    /// The hierarchy of parts over some two thousand cells, or None for K-means and two-means.
    #[getter]
    fn tree<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.tree.as_deref().map(|text| loaded(py, text)).transpose()
    }

    /// The run's report: parts with their areas, landmarks, eigenvalues, Γ, seconds a stage.
    #[getter]
    fn report<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        loaded(py, &self.report)
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let parts = self.colours.bind(py).getattr("shape")?.get_item(0)?.extract::<usize>()?;
        Ok(format!("Segmentation({} faces, {parts} parts)", self.labels.bind(py).len()?))
    }
}

fn loaded<'py>(py: Python<'py>, text: &str) -> PyResult<Bound<'py, PyAny>> {
    py.import("json")?.call_method1("loads", (text,))
}

/// What a run left, without Python.
struct Outcome {
    labels: Vec<u32>,
    quality: Vec<f32>,
    colours: Vec<[u8; 3]>,
    tree: Option<String>,
    report: String,
}

impl Outcome {
    /// Of the mesh in the file `path`, cut.
    fn of(
        path: &Path,
        identity: &serde_json::Value,
        params: &SegmentParams,
        context: Context<'_>,
        listener: &Listener,
    ) -> Result<Self, Error> {
        let opened = &mesh::open(path, context.work.path(), context.run)?;
        let result = segment_mesh(opened, identity, params, context)?;
        let seconds: BTreeMap<String, f64> = listener.seconds();
        let report = Report::new(opened, params, &result, context, seconds, None);
        Ok(Self {
            labels: result.labels.to_vec(),
            quality: result.quality.to_vec(),
            colours: result.colours,
            tree: std::fs::read_to_string(context.work.file("tree.json")).ok(),
            report: serde_json::to_string(&report).unwrap_or_default(),
        })
    }

    fn into_python(self, py: Python<'_>) -> PyResult<Segmentation> {
        Ok(Segmentation {
            labels: PyArray1::from_vec(py, self.labels).unbind(),
            quality: PyArray1::from_vec(py, self.quality).unbind(),
            colours: PyArray2::from_vec2(py, &self.colours.iter().map(|c| c.to_vec()).collect::<Vec<_>>())?.unbind(),
            tree: self.tree,
            report: self.report,
        })
    }
}

/// Runs `work` without Python's lock, with a listener, threads and a budget as asked for.
fn with_run<T: Send>(
    py: Python<'_>,
    options: &Options,
    progress: Option<Py<PyAny>>,
    work: impl FnOnce(&Run, &Listener) -> Result<T, Error> + Send,
) -> PyResult<T> {
    let cancel = Cancel::default();
    let listener = Listener::new(progress, cancel.clone());
    let defaults = Run::new(&());
    let budget = options.max_memory.map_or(defaults.budget, Budget::new);
    let threads = options.threads.unwrap_or(defaults.threads);
    let run = Run { threads, budget, cancel, seed: options.seed, progress: &listener, ..Run::new(&()) };
    let result = py.detach(|| work(&run, &listener));
    match listener.failure() {
        Some(error) => Err(error),
        None => result.map_err(raised),
    }
}

/// The work directory asked for, or a temporary one.
fn work_dir(options: &Options) -> Result<WorkDir, Error> {
    match &options.work_dir {
        Some(path) => WorkDir::open(path),
        None => WorkDir::temporary(options.tmp.as_deref().unwrap_or(&std::env::temp_dir())),
    }
}

/// See the stub file for the documentation of arguments.
#[pyfunction]
#[pyo3(signature = (vertices, faces, parts=None, *, progress=None, **options))]
fn segment(
    py: Python<'_>,
    vertices: &Bound<'_, PyAny>,
    faces: &Bound<'_, PyAny>,
    parts: Option<usize>,
    progress: Option<Py<PyAny>>,
    options: Option<&Bound<'_, pyo3::types::PyDict>>,
) -> PyResult<Segmentation> {
    let options = Options::of(parts, options)?;
    let params = options.params()?;
    let arrays = arrays::Arrays::of(vertices, faces)?;
    let work = work_dir(&options).map_err(raised)?;
    let path = work.file("input.ply");
    // The arrays belong to Python: the lock is kept while they are read.
    let identity = arrays.write(&path).map_err(raised)?;
    let outcome =
        with_run(py, &options, progress, |run, listener| Outcome::of(&path, &identity, &params, Context::new(&work, run), listener))?;
    outcome.into_python(py)
}

/// See the stub file for the documentation of arguments.
#[pyfunction]
#[pyo3(signature = (path, parts=None, *, progress=None, **options))]
fn segment_file(
    py: Python<'_>,
    path: PathBuf,
    parts: Option<usize>,
    progress: Option<Py<PyAny>>,
    options: Option<&Bound<'_, pyo3::types::PyDict>>,
) -> PyResult<Segmentation> {
    let options = Options::of(parts, options)?;
    let params = options.params()?;
    let outcome = with_run(py, &options, progress, |run, listener| {
        let work = work_dir(&options)?;
        let identity = input::identity(&path)?;
        Outcome::of(&path, &identity, &params, Context::new(&work, run), listener)
    })?;
    outcome.into_python(py)
}

/// Reads a mesh file: (vertices, faces) as float64 and uint32 arrays; polygons are cut into triangles as a fan.
#[pyfunction]
fn read_mesh(py: Python<'_>, path: PathBuf) -> PyResult<(Py<PyArray2<f64>>, Py<PyArray2<u32>>)> {
    let read = |path: &Path| -> Result<_, Error> {
        let scratch = tempfile::tempdir().map_err(Error::io(path, "make a temporary folder for"))?;
        let mesh = mesh::open(path, scratch.path(), &Run::new(&()))?;
        let vertices: Vec<[f64; 3]> = (0..mesh.positions.len() as u32).map(|v| mesh.positions.get(v)).collect();
        let mut faces: Vec<[u32; 3]> = Vec::with_capacity(mesh.faces.len());
        mesh.faces.for_each(0..mesh.faces.len(), |_, at| {
            faces.extend((1..at.len().saturating_sub(1)).map(|k| [at[0], at[k], at[k + 1]]));
        });
        Ok((vertices, faces))
    };
    let (vertices, faces) = py.detach(|| read(&path)).map_err(raised)?;
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
