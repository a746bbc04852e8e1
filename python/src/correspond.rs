//! `correspond`: which vertex of one mesh is which of another.

use super::arrays::Arrays;
use super::options::Options;
use super::{loaded, raised, with_run, work_dir};
use numpy::PyArray1;
use nystrom_stream::apps::correspond::Matching;
use nystrom_stream::base::Error;
use nystrom_stream::mesh;
use nystrom_stream::store::Context;
use nystrom_stream::pipeline::correspond::{CorrespondParams, correspond as match_meshes, default_landmarks};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::json;

/// Matches of the vertices of a mesh.
#[pyclass(frozen, module = "nystrom_stream")]
pub struct Correspondence {
    matches: Py<PyArray1<i64>>,
    distances: Py<PyArray1<f32>>,
    confidence: Py<PyArray1<f32>>,
    report: String,
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
        loaded(py, &self.report)
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        Ok(format!("Correspondence({} vertices)", self.matches.bind(py).len()?))
    }
}

/// See the stub file for the documentation of arguments.
#[pyfunction]
#[pyo3(signature = (vertices_a, faces_a, vertices_b, faces_b, *, matching="all", transfer=false, alternative=0,
                    vectors=None, progress=None, **options))]
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
    progress: Option<Py<PyAny>>,
    options: Option<&Bound<'_, PyDict>>,
) -> PyResult<Correspondence> {
    let options = Options::of_run(options)?;
    let matching = match matching {
        "all" => Matching::All,
        "mutual" => Matching::Mutual,
        "one-to-one" => Matching::OneToOne,
        other => {
            let text = format!("matching: '{other}'; choose all, mutual or one-to-one");
            return Err(PyValueError::new_err(text));
        }
    };
    let mut params = CorrespondParams::default().matching(matching).transfer(transfer).alternative(alternative);
    params.embedding.dimensions = vectors.unwrap_or(params.embedding.dimensions);
    let arrays = [Arrays::of(vertices_a, faces_a)?, Arrays::of(vertices_b, faces_b)?];
    let work = work_dir(&options).map_err(raised)?;
    let mut folders = Vec::new();
    for (array, name) in arrays.iter().zip(["mesh-a", "mesh-b"]) {
        let folder = work.file(name);
        std::fs::create_dir_all(&folder)?;
        array.write(&folder.join("input.ply")).map_err(raised)?;
        folders.push(folder);
    }
    let (found, report) = with_run(py, &options, progress, |run, _| {
        let open = |k: usize| mesh::open(&folders[k].join("input.ply"), &folders[k], run);
        let (a, b) = (open(0)?, open(1)?);
        let vertices = a.positions.len().max(b.positions.len());
        params.landmarks = options.landmarks.unwrap_or(default_landmarks(vertices));
        let result = match_meshes(&a, &b, None, &params, Context::new(&work, run))?;
        let report = json!({
            "options": params,
            "seed": run.seed,
            "meshes": result.sides,
            "ambiguous": result.alignments.ambiguous,
            "alignments": result.alignments.found,
            "alternative": alternative,
        });
        Ok::<_, Error>((result.matches.to_vec(), report.to_string()))
    })?;
    Ok(Correspondence {
        matches: PyArray1::from_iter(py, found.iter().map(|one| one.target)).unbind(),
        distances: PyArray1::from_iter(py, found.iter().map(|one| one.distance)).unbind(),
        confidence: PyArray1::from_iter(py, found.iter().map(|one| one.confidence)).unbind(),
        report,
    })
}
