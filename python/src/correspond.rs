//! `correspond`: which vertex of one mesh is which of another.

use super::listener::Listener;
use super::{arrays, detached, loaded, raised, with_options};
use numpy::PyArray1;
use nystrom_stream::apps::correspond::Matching;
use nystrom_stream::{Cancel, Matcher};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::Arc;

/// Matches of the vertices of a mesh.
#[pyclass(frozen, module = "nystrom_stream")]
pub struct Correspondence {
    matches: Py<PyArray1<i64>>,
    distances: Py<PyArray1<f32>>,
    confidence: Py<PyArray1<f32>>,
    found: nystrom_stream::Correspondence,
}

#[pymethods]
impl Correspondence {
    /// The vertex of B for each vertex of A, -1 without one: (vertices of A,) int64.
    #[getter]
    fn matches(&self, py: Python<'_>) -> Py<PyArray1<i64>> {
        self.matches.clone_ref(py)
    }

    /// Distances in the embedding, infinite without a match: (vertices of A,) float32.
    #[getter]
    fn distances(&self, py: Python<'_>) -> Py<PyArray1<f32>> {
        self.distances.clone_ref(py)
    }

    /// How sure each match is, 0 to 1: (vertices of A,) float32.
    #[getter]
    fn confidence(&self, py: Python<'_>) -> Py<PyArray1<f32>> {
        self.confidence.clone_ref(py)
    }

    /// The alignments that fit, whether the shape leaves a choice, and facts of both meshes.
    #[getter]
    fn report<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        loaded(py, self.found.report())
    }

    /// Writes the matches as .npy or .csv.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        py.detach(|| self.found.save(path)).map_err(raised)
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        Ok(format!("Correspondence({} vertices)", self.matches.bind(py).len()?))
    }
}

/// Finds for every vertex of mesh A its match in mesh B. See help(nystrom_stream) for the arguments.
#[pyfunction]
#[pyo3(signature = (vertices_a, faces_a, vertices_b, faces_b, *, matching="all", transfer=false, alternative=0,
                    vectors=None, landmarks=None, seed=0, threads=None, max_memory=None, tmp=None, progress=None))]
pub fn correspond(
    py: Python<'_>,
    vertices_a: &Bound<'_, PyAny>,
    faces_a: &Bound<'_, PyAny>,
    vertices_b: &Bound<'_, PyAny>,
    faces_b: &Bound<'_, PyAny>,
    matching: &str,
    transfer: bool,
    alternative: usize,
    vectors: Option<usize>,
    landmarks: Option<usize>,
    seed: u64,
    threads: Option<usize>,
    max_memory: Option<u64>,
    tmp: Option<PathBuf>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Correspondence> {
    let matching = match matching {
        "all" => Matching::All,
        "mutual" => Matching::Mutual,
        "one-to-one" => Matching::OneToOne,
        other => {
            let text = format!("matching: '{other}'; choose all, mutual or one-to-one");
            return Err(PyValueError::new_err(text));
        }
    };
    let matcher = Matcher::new().matching(matching).transfer(transfer).alternative(alternative);
    let matcher = vectors.into_iter().fold(matcher, Matcher::dimensions);
    let matcher = landmarks.into_iter().fold(matcher, Matcher::landmarks);
    let cancel = Cancel::default();
    let listener = Arc::new(Listener::new(progress, cancel.clone()));
    let matcher = with_options!(matcher, seed, threads, max_memory, tmp, listener, cancel);
    let (a, b) = (arrays::mesh(vertices_a, faces_a)?, arrays::mesh(vertices_b, faces_b)?);
    let found = detached(py, &listener, || matcher.run(&a, &b))?;
    let matches = found.matches();
    Ok(Correspondence {
        matches: PyArray1::from_iter(py, matches.iter().map(|one| one.target)).unbind(),
        distances: PyArray1::from_iter(py, matches.iter().map(|one| one.distance)).unbind(),
        confidence: PyArray1::from_iter(py, matches.iter().map(|one| one.confidence)).unbind(),
        found,
    })
}
