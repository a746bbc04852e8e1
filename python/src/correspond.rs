//! `correspond`: which vertex of one mesh is which of another.

use super::listener::{run, watched};
use super::mesh::PyMesh;
use super::tasks::named;
use super::{text, with_options};
use numpy::{PyArray1, PyReadonlyArray1};
use nystrom_stream::Matcher;
use nystrom_stream::apps::correspond::{Match, files};
use pyo3::prelude::*;
use std::path::PathBuf;

/// What matching gives: a vertex of B for each of A, distances, confidences, and the report as JSON.
type Found<'py> = (Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<f32>>, String);

/// Writes matches as .npy, .csv or .parquet.
#[pyfunction]
pub fn save_matches(
    py: Python<'_>,
    matches: PyReadonlyArray1<'_, i64>,
    distances: PyReadonlyArray1<'_, f32>,
    confidence: PyReadonlyArray1<'_, f32>,
    path: PathBuf,
) -> PyResult<()> {
    let (matches, distances, confidence) = (matches.as_array(), distances.as_array(), confidence.as_array());
    let all = matches.iter().zip(distances).zip(confidence);
    let all: Vec<Match> =
        all.map(|((&target, &distance), &confidence)| Match { target, distance, confidence }).collect();
    run(py, |run| files::write(&path, &all, run))
}

/// Finds for every vertex of mesh A its match in mesh B.
#[pyfunction]
#[pyo3(signature = (a, b, matching, refine, partial, transfer, alternative, vectors, sigma, landmarks, sampling, distance, work_dir, force, seed, threads, max_memory, tmp, progress))]
pub fn correspond<'py>(
    py: Python<'py>,
    a: &PyMesh,
    b: &PyMesh,
    matching: &str,
    refine: &str,
    partial: bool,
    transfer: bool,
    alternative: usize,
    vectors: Option<usize>,
    sigma: f64,
    landmarks: Option<usize>,
    sampling: &str,
    distance: &str,
    work_dir: Option<PathBuf>,
    force: bool,
    seed: u64,
    threads: Option<usize>,
    max_memory: Option<u64>,
    tmp: Option<PathBuf>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Found<'py>> {
    let matcher = Matcher::new().matching(named("matching", matching)?).refine(named("refine", refine)?);
    let matcher = matcher.sampling(named("sampling", sampling)?).distance(named("distance", distance)?).width(sigma);
    let matcher = matcher.partial(partial).transfer(transfer).alternative(alternative).force(force);
    let matcher = vectors.into_iter().fold(matcher, Matcher::dimensions);
    let matcher = landmarks.into_iter().fold(matcher, Matcher::landmarks);
    // A work directory knows a mesh by its file.
    let (a, b) =
        if work_dir.is_some() { (a.with_its_file()?, b.with_its_file()?) } else { (a.current()?, b.current()?) };
    let matcher = work_dir.into_iter().fold(matcher, |matcher, folder| matcher.work_dir(folder));
    let found = watched(py, progress, |listener, cancel| {
        with_options!(matcher, seed, threads, max_memory, tmp, listener, cancel).run(a, b)
    })?;
    let matches = found.matches();
    Ok((
        PyArray1::from_iter(py, matches.iter().map(|one| one.target)),
        PyArray1::from_iter(py, matches.iter().map(|one| one.distance)),
        PyArray1::from_iter(py, matches.iter().map(|one| one.confidence)),
        text(found.report())?,
    ))
}
