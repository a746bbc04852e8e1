//! Python bindings: meshes, and functions over them that return arrays and JSON.
//!
//! All goes through the API at the root of the library ([`nystrom_stream::Segmenter`] and its like). Arrays are copied
//! once, and of them nothing is written where memory allows. Python's lock is given up while the library works, and taken
//! now and then for the progress callback and for Ctrl-C ([`listener`]). The package in `python/nystrom_stream` turns this
//! into classes and functions with signatures.

mod arrays;
mod correspond;
mod decision;
mod listener;
mod mesh;
mod tasks;

use decision::PyDecision;
use listener::watched;
use mesh::PyMesh;
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, ToPyArray};
use nystrom_stream::apps::edits::Edits;
use nystrom_stream::base::error::refusal;
use nystrom_stream::mesh::{MeshSize, size_of_mesh};
use nystrom_stream::pipeline::SegmentParams;
use nystrom_stream::spectral::EmbeddingParams;
use nystrom_stream::{Error, Segmenter};
use pyo3::exceptions::{PyKeyboardInterrupt, PyMemoryError, PyOSError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use std::path::PathBuf;

/// The program's allocator: the same speed.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Parameters of the library that this module calls otherwise.
const NAMES: [(&str, &str); 4] =
    [("dimensions", "vectors"), ("output", "path"), ("parts_between", "parts_range"), ("width", "sigma")];

/// What the library's texts call otherwise than this module.
const WORDS: [(&str, &str); 8] = [
    ("a smaller `parts`", "fewer parts"),
    ("`parts` 6", "parts=6"),
    ("`cluster` kmeans", "cluster='kmeans'"),
    ("`cluster` parts", "cluster='parts'"),
    ("`memory`", "`max_memory`"),
    ("`temporary_folder`", "`tmp`"),
    ("`force`", "force=True"),
    (
        ".npy, .obj or .glb (.png, .parquet and, for a segmentation, .html with their features)",
        ".npy, .obj, .glb, .parquet, .csv, .png or .html",
    ),
];

/// A message of the library in the words of this module.
fn reworded(text: &str) -> String {
    let part = |c: char| c.is_alphanumeric() || c == '-' || c == '/' || c == '.';
    let mut told = text.to_string();
    for (option, name) in WORDS {
        let (mut done, mut rest) = (String::new(), told.as_str());
        while let Some(at) = rest.find(option) {
            let after = &rest[at + option.len()..];
            let alone = !rest[..at].ends_with(part) && !after.starts_with(|c| part(c) && c != '.');
            done += &rest[..at];
            done += if alone { name } else { option };
            rest = after;
        }
        told = done + rest;
    }
    told
}

/// What the library says, as Python's exceptions: FileNotFoundError and its like where the system says so.
fn raised(error: Error) -> PyErr {
    let error = match error {
        Error::Parameter { name, problem, remedy } => {
            let own = NAMES.iter().find(|(option, _)| *option == name).map(|(_, own)| own.to_string());
            Error::parameter(own.unwrap_or(name), problem, remedy)
        }
        other => other,
    };
    let text = reworded(&error.to_string());
    match error {
        Error::Parameter { .. } | Error::Malformed { .. } | Error::Unusable { .. } => PyValueError::new_err(text),
        Error::Io { path, action, source } => match source.raw_os_error() {
            // With a number Python chooses the class itself.
            Some(number) => PyOSError::new_err((number, reworded(&refusal(action, &source)), path.into_os_string())),
            None => PyOSError::new_err(text),
        },
        Error::Disk { .. } => PyOSError::new_err(text),
        Error::Memory { .. } => PyMemoryError::new_err(text),
        Error::Cancelled => PyKeyboardInterrupt::new_err(text),
        Error::WorkDir { .. } => PyValueError::new_err(text),
        _ => PyRuntimeError::new_err(text),
    }
}

/// `value` as JSON.
fn text(value: &impl serde::Serialize) -> PyResult<String> {
    serde_json::to_string(value).map_err(|error| PyRuntimeError::new_err(error.to_string()))
}

/// Gives a builder of the library the options that all runs share.
macro_rules! with_options {
    ($builder:expr, $seed:expr, $threads:expr, $max_memory:expr, $tmp:expr, $listener:expr, $cancel:expr) => {{
        let builder = $builder.seed($seed).progress($listener.clone()).cancel($cancel.clone());
        let builder = $threads.into_iter().fold(builder, |builder, threads| builder.threads(threads));
        let builder = $max_memory.into_iter().fold(builder, |builder, bytes| builder.memory(bytes));
        $tmp.into_iter().fold(builder, |builder, folder: PathBuf| builder.temporary_folder(folder))
    }};
}
use with_options;

/// Labels on the refinement of a mesh: the fields of [`FineLabels`](nystrom_stream::mesh::split_faces::FineLabels).
type Fine<'py> = (Bound<'py, PyArray1<u32>>, Bound<'py, PyArray1<u32>>, Bound<'py, PyArray1<u32>>, usize, u64);

/// What a cut gives: labels, qualities, colours (parts, 3), labels on the refinement, the cell of each face and what it was decided
/// with, names, the report as JSON.
type Cut<'py> = (
    Bound<'py, PyArray1<u32>>,
    Bound<'py, PyArray1<f32>>,
    Bound<'py, PyArray2<u8>>,
    Option<Fine<'py>>,
    Option<Bound<'py, PyArray1<u32>>>,
    Option<PyDecision>,
    Vec<String>,
    String,
);

/// Cuts `mesh` under `params`, JSON as [`default_params`] gives it, and corrects it by `edits`, the text of such a file, and `hints`,
/// a value per face.
#[pyfunction]
#[pyo3(signature = (mesh, params, edits, hints, work_dir, force, seed, threads, max_memory, tmp, progress))]
fn segment<'py>(
    py: Python<'py>,
    mesh: &PyMesh,
    params: &str,
    edits: Option<&str>,
    hints: Option<PyReadonlyArray1<'py, u32>>,
    work_dir: Option<PathBuf>,
    force: bool,
    seed: u64,
    threads: Option<usize>,
    max_memory: Option<u64>,
    tmp: Option<PathBuf>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Cut<'py>> {
    let params = checked(params)?;
    let edits = edits.map(|text| Edits::of_text(text.as_bytes(), "edits".as_ref())).transpose().map_err(raised)?;
    let segmenter = Segmenter::with_params(params).force(force);
    let segmenter = edits.into_iter().fold(segmenter, Segmenter::edits);
    let segmenter = hints.iter().fold(segmenter, |segmenter, hints| segmenter.hints(hints.as_array().to_vec()));
    // A work directory knows a mesh by its file.
    let mesh = if work_dir.is_some() { mesh.with_its_file()? } else { mesh.current()? };
    let segmenter = work_dir.into_iter().fold(segmenter, |segmenter, folder| segmenter.work_dir(folder));
    let cut = watched(py, progress, |listener, cancel| {
        with_options!(segmenter, seed, threads, max_memory, tmp, listener, cancel).run(mesh)
    })?;
    let colours = cut.colours();
    Ok((
        PyArray1::from_slice(py, cut.labels()),
        PyArray1::from_slice(py, cut.confidences()),
        colours.as_flattened().to_pyarray(py).reshape([colours.len(), 3])?,
        cut.labelling().fine.map(|fine| {
            let [triangles, corners, parents] =
                [&fine.triangles, &fine.corners, &fine.parents].map(|numbers| PyArray1::from_slice(py, numbers));
            (triangles, corners, parents, fine.originals, fine.belongs_to)
        }),
        cut.hierarchy().map(|hierarchy| PyArray1::from_slice(py, hierarchy.cells())),
        cut.hierarchy()
            .map(|hierarchy| PyDecision { kept: hierarchy.decision().clone(), start: cut.cell_labels().to_vec() }),
        cut.names().to_vec(),
        text(cut.report())?,
    ))
}

/// What `segment` takes, as JSON: of the mesh in the file `path`, which is not read for it, or else of `mesh`.
#[pyfunction]
#[pyo3(signature = (path, mesh, params, calibrate, work_dir, seed, threads, max_memory, tmp))]
fn plan(
    py: Python<'_>,
    path: PathBuf,
    mesh: Option<&PyMesh>,
    params: &str,
    calibrate: bool,
    work_dir: Option<PathBuf>,
    seed: u64,
    threads: Option<usize>,
    max_memory: Option<u64>,
    tmp: Option<PathBuf>,
) -> PyResult<String> {
    let segmenter = Segmenter::with_params(checked(params)?);
    let segmenter = work_dir.into_iter().fold(segmenter, |segmenter, folder| segmenter.work_dir(folder));
    let mesh = mesh.map(PyMesh::current).transpose()?;
    let mut found = watched(py, None, |listener, cancel| {
        let size = mesh.map_or_else(|| size_of_mesh(&path, cancel), |mesh| Ok(MeshSize::of(mesh)))?;
        with_options!(segmenter, seed, threads, max_memory, tmp, listener, cancel).plan(&path, size, calibrate)
    })?;
    // Who plans wants to see what is missing, so it is no exception.
    found.notes.extend(found.shortage.as_ref().map(|error| format!("warning: {error}")));
    found.notes.iter_mut().for_each(|note| *note = reworded(note));
    text(&found)
}

/// Parameters from JSON, which make sense for some mesh at least.
fn checked(params: &str) -> PyResult<SegmentParams> {
    let told = |error: serde_json::Error| {
        let text = error.to_string();
        PyValueError::new_err(text.split(" at line ").next().unwrap_or(&text).to_string())
    };
    let params: SegmentParams = serde_json::from_str(params).map_err(told)?;
    params.metric.check().and_then(|()| params.check()).map_err(raised)?;
    Ok(params)
}

/// Refuses `params`, JSON as [`default_params`] gives it, that make no sense, before a mesh is read for them.
#[pyfunction]
fn check_params(params: &str) -> PyResult<()> {
    checked(params).map(drop)
}

/// The parameters of a cut, as JSON.
#[pyfunction]
fn default_params() -> PyResult<String> {
    text(&SegmentParams::default())
}

/// The embedding of K-means and 2-means in `dimensions` coordinates, as JSON.
#[pyfunction]
fn default_embedding(dimensions: usize) -> PyResult<String> {
    text(&EmbeddingParams::for_parts(dimensions))
}

/// What `nystrom_stream` is made of.
#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<PyMesh>()?;
    module.add_class::<PyDecision>()?;
    module.add_function(wrap_pyfunction!(segment, module)?)?;
    module.add_function(wrap_pyfunction!(plan, module)?)?;
    module.add_function(wrap_pyfunction!(check_params, module)?)?;
    module.add_function(wrap_pyfunction!(default_params, module)?)?;
    module.add_function(wrap_pyfunction!(default_embedding, module)?)?;
    module.add_function(wrap_pyfunction!(correspond::correspond, module)?)?;
    module.add_function(wrap_pyfunction!(correspond::save_matches, module)?)?;
    module.add_function(wrap_pyfunction!(tasks::publish, module)?)?;
    module.add_function(wrap_pyfunction!(tasks::read_labels, module)?)?;
    module.add_function(wrap_pyfunction!(tasks::read_names, module)?)?;
    module.add_function(wrap_pyfunction!(tasks::part_colours, module)?)?;
    module.add_function(wrap_pyfunction!(tasks::save, module)?)?;
    module.add_function(wrap_pyfunction!(tasks::picture, module)?)?;
    module.add_function(wrap_pyfunction!(tasks::measure_parts, module)?)?;
    module.add_function(wrap_pyfunction!(tasks::measure_mesh, module)?)?;
    module.add_function(wrap_pyfunction!(tasks::edits_box, module)?)?;
    module.add_function(wrap_pyfunction!(tasks::edits_on, module)?)?;
    module.add_function(wrap_pyfunction!(tasks::evaluate, module)?)?;
    module.add_function(wrap_pyfunction!(tasks::transfer_labels, module)?)?;
    module.add_function(wrap_pyfunction!(tasks::sequence, module)?)?;
    module.add_function(wrap_pyfunction!(tasks::quality, module)?)
}
