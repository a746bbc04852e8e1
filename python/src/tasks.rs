//! What is done with a mesh besides cutting it, and with labels: one function each, called by the Python side.

use super::decision::PyDecision;
use super::listener::{run, watched};
use super::mesh::PyMesh;
use super::{raised, text, with_options};
use numpy::{PyArray1, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, ToPyArray};
use nystrom_stream::apps::colours::colours_for;
use nystrom_stream::apps::edits::{self, Edits};
use nystrom_stream::apps::evaluate::Evaluator;
use nystrom_stream::apps::export::split::PartForm;
use nystrom_stream::apps::export::{Form, csv};
use nystrom_stream::apps::labelled_faces::LabelledFaces;
use nystrom_stream::apps::measure;
use nystrom_stream::apps::open_labels;
use nystrom_stream::apps::page::{CellModel, Cuts, Page};
use nystrom_stream::apps::picture::{PictureParams, render_named};
use nystrom_stream::apps::sequence::SequenceOrder;
use nystrom_stream::graph::Metric;
use nystrom_stream::landmarks::Sampling;
use nystrom_stream::mesh::UNLABELLED;
use nystrom_stream::mesh::ply::labelled::colour_of;
use nystrom_stream::mesh::split_faces::FineLabels;
use nystrom_stream::pipeline::cuts;
use nystrom_stream::spectral::Kernel;
use nystrom_stream::store::{Budget, Context, Run, WorkDir, json, private_folder};
use nystrom_stream::{Error, LabelTransfer, Labelling, SamplingQuality, SaveOptions, Sequencer};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use serde::de::DeserializeOwned;
use std::path::PathBuf;

/// A word as the library's enums are written: "geodesic-farthest".
pub fn named<T: DeserializeOwned>(name: &str, word: &str) -> PyResult<T> {
    serde_json::from_value(word.into()).map_err(|error| PyValueError::new_err(format!("{name}: {error}")))
}

/// A value of the library from JSON.
fn parsed<T: DeserializeOwned>(name: &str, json: &str) -> PyResult<T> {
    serde_json::from_str(json).map_err(|error| PyValueError::new_err(format!("{name}: {error}")))
}

fn colours(array: &PyReadonlyArray2<'_, u8>) -> PyResult<Vec<[u8; 3]>> {
    let array = array.as_array();
    if array.ncols() != 3 {
        let text = format!("colours: {}×{}; give red, green and blue per part", array.nrows(), array.ncols());
        return Err(PyValueError::new_err(text));
    }
    Ok(array.outer_iter().map(|c| [c[0], c[1], c[2]]).collect())
}

/// Writes `text` to the file `path`, by rename: if that fails, the file is as it was.
#[pyfunction]
pub fn publish(path: PathBuf, text: &str) -> PyResult<()> {
    json::publish(&path, text.as_bytes()).map_err(raised)
}

/// A colour per part, unlike where parts touch: (parts, 3).
#[pyfunction]
pub fn part_colours<'py>(
    py: Python<'py>,
    mesh: &PyMesh,
    labels: PyReadonlyArray1<'py, u32>,
) -> PyResult<Bound<'py, numpy::PyArray2<u8>>> {
    let labels = labels.as_array().to_vec();
    let mesh = mesh.current()?;
    let found = run(py, |run| colours_for(mesh, &labels, run))?;
    let parts = labels.iter().filter(|&&label| label != UNLABELLED).max().map_or(0, |&label| label as usize + 1);
    let found: Vec<[u8; 3]> = (0..parts as u32).map(|label| colour_of(&found, label)).collect();
    found.as_flattened().to_pyarray(py).reshape([found.len(), 3])
}

/// Labels of faces from a `.seg` or `.npy` file, or of the faces of a mesh file with a property `label`: (faces,); 2³² − 1 says that a
/// face has none.
#[pyfunction]
pub fn read_labels(py: Python<'_>, path: PathBuf) -> PyResult<Bound<'_, PyArray1<u32>>> {
    let found = run(py, |run| {
        let scratch = private_folder(&std::env::temp_dir())?;
        let work = WorkDir::temporary(scratch.path())?;
        if matches!(Form::of(&path), Some(Form::Seg | Form::Npy)) {
            return Ok(open_labels(&path, &work)?.to_vec());
        }
        let mesh = nystrom_stream::mesh::open(&path, scratch.path(), run)?;
        let found = LabelledFaces::of_mesh(&mesh, Context::new(&work, run))?;
        let missing =
            || Error::unusable(&path, "has no labels", "give a .seg, a .npy, or a mesh that was written with labels");
        Ok(found.ok_or_else(missing)?.labels.to_vec())
    })?;
    Ok(PyArray1::from_vec(py, found))
}

/// Names of parts from a table.
#[pyfunction]
pub fn read_names(path: PathBuf) -> PyResult<Vec<String>> {
    nystrom_stream::apps::edits::read_names(&path).map_err(raised)
}

/// Choices of forms as Python gives them: vertex_labels, split_vertices, split_faces, cap, part_form.
type SaveChoices = (bool, bool, bool, bool, String);

fn save_options((vertex_labels, split_vertices, split_faces, cap, part_form): SaveChoices) -> PyResult<SaveOptions> {
    let part_form = match part_form.as_str() {
        "ply" => PartForm::Binary,
        "stl" => PartForm::Stl,
        other => return Err(PyValueError::new_err(format!("part_form: '{other}'; choose ply or stl"))),
    };
    let ply = SaveOptions::new().vertex_labels(vertex_labels).split_vertices(split_vertices).split_faces(split_faces);
    Ok(ply.cap(cap).part_form(part_form))
}

/// Labels on the refinement of a mesh: the fields of [`FineLabels`].
type Fine<'py> = (PyReadonlyArray1<'py, u32>, PyReadonlyArray1<'py, u32>, PyReadonlyArray1<'py, u32>, usize, u64);

/// Writes the labelled mesh in the form that the ending of `path` names; a page has a slider and follows edits where there is a
/// `decision` over `cells`. `edits` is the text of those that the labels are of, `fine` has their
/// labels on the refinement of the mesh.
#[pyfunction]
#[pyo3(signature = (mesh, labels, colours, quality, names, path, report, fine, cells, decision, edits, options))]
pub fn save(
    py: Python<'_>,
    mesh: &PyMesh,
    labels: PyReadonlyArray1<'_, u32>,
    colours: PyReadonlyArray2<'_, u8>,
    quality: Option<PyReadonlyArray1<'_, f32>>,
    names: Vec<String>,
    path: PathBuf,
    report: &str,
    fine: Option<Fine<'_>>,
    cells: Option<PyReadonlyArray1<'_, u32>>,
    decision: Option<PyRef<'_, PyDecision>>,
    edits: Option<&str>,
    options: SaveChoices,
) -> PyResult<()> {
    let options = save_options(options)?;
    // Of an OBJ the lines of its file are written again.
    let form = Form::of(&path);
    let mesh = if form == Some(Form::Obj) { mesh.with_its_file()? } else { mesh.current()? };
    let (labels, colours) = (labels.as_array().to_vec(), self::colours(&colours)?);
    let quality = quality.map(|quality| quality.as_array().to_vec());
    let cells = cells.map(|cells| cells.as_array().to_vec());
    let report: serde_json::Value =
        serde_json::from_str(report).map_err(|error| PyValueError::new_err(error.to_string()))?;
    let fine = fine.map(|(triangles, corners, parents, originals, belongs_to)| {
        let [triangles, corners, parents] =
            [triangles, corners, parents].map(|numbers| numbers.as_array().to_vec().into());
        FineLabels { triangles, corners, parents, originals, belongs_to }
    });
    let (quality, fine) = (quality.as_deref(), fine.as_ref());
    let labelling = Labelling { labels: &labels, colours: &colours, quality, names: &names, fine };
    if options == SaveOptions::default() && form == Some(Form::Csv) {
        let parts = report["parts"].as_array().map_or(&[][..], |parts| parts);
        let agreement: Vec<f64> = parts.iter().filter_map(|part| part["expected_agreement"].as_f64()).collect();
        return run(py, |run| csv::write(&path, mesh, &labelling, &agreement, run));
    }
    if options != SaveOptions::default() || form != Some(Form::Html) {
        return run(py, |run| mesh.save_under(path, labelling, &options, run));
    }
    let edits = edits.map(|text| Edits::of_text(text.as_bytes(), "edits".as_ref())).transpose().map_err(raised)?;
    let decision: Option<&PyDecision> = decision.as_deref();
    run(py, |run| {
        let hierarchy = decision.zip(cells.as_ref());
        let parts = hierarchy.map(|(decided, _)| decided.kept.decision.tree.first_cuts(cuts::MOST)).transpose()?;
        let cuts = hierarchy.zip(parts.as_ref()).map(|((PyDecision { kept, start }, cells), parts)| {
            let model = CellModel { affinities: kept.affinities(), tree: &kept.decision.tree, start };
            Cuts { cells, parts, model: Some(model) }
        });
        let title = mesh.path().file_name().unwrap_or_default().to_string_lossy();
        let (labels, colours, edits) = (&labels[..], &colours[..], edits.as_ref());
        Page { title: &title, mesh, labels, colours, names: &names, cuts, edits, report: &report }.write(&path, run)
    })
}

/// A picture: (height, width, 4) uint8.
#[pyfunction]
#[pyo3(signature = (mesh, labels, colours, names, width, height, views, transparent, legend, lines, up, turn, tilt, max_memory))]
pub fn picture<'py>(
    py: Python<'py>,
    mesh: &PyMesh,
    labels: Option<PyReadonlyArray1<'py, u32>>,
    colours: PyReadonlyArray2<'py, u8>,
    names: Vec<String>,
    width: usize,
    height: usize,
    views: usize,
    transparent: bool,
    legend: bool,
    lines: bool,
    up: Option<&str>,
    turn: f64,
    tilt: f64,
    max_memory: Option<u64>,
) -> PyResult<Bound<'py, PyArray3<u8>>> {
    let up = up.map(|up| up.parse().map_err(PyValueError::new_err)).transpose()?;
    let params = PictureParams::default().width(width).height(height).views(views).transparent(transparent);
    let params = params.legend(legend).lines(lines).up(up).turn(turn).tilt(tilt);
    let (labels, colours) = (labels.map(|labels| labels.as_array().to_vec()), self::colours(&colours)?);
    let mesh = mesh.current()?;
    let image = run(py, |run| {
        let budget = max_memory.map_or(run.budget.clone(), Budget::new);
        let run = &Run { budget, cancel: run.cancel.clone(), ..*run };
        let work = WorkDir::in_memory(&std::env::temp_dir(), &run.budget);
        render_named(mesh, labels.as_deref(), (&colours, &names), &params, Context::new(&work, run))
    })?;
    image.pixels.as_flattened().to_pyarray(py).reshape([image.height, image.width, 4])
}

/// What the parts measure, as JSON.
#[pyfunction]
pub fn measure_parts(
    py: Python<'_>,
    mesh: &PyMesh,
    labels: PyReadonlyArray1<'_, u32>,
    parts: usize,
) -> PyResult<String> {
    let labels = labels.as_array().to_vec();
    let mesh = mesh.current()?;
    let found = run(py, |run| {
        let work = WorkDir::in_memory(&std::env::temp_dir(), &run.budget);
        measure::parts(mesh, &labels, parts, Context::new(&work, run))
    });
    text(&found?)
}

/// What the mesh measures, as JSON.
#[pyfunction]
pub fn measure_mesh(py: Python<'_>, mesh: &PyMesh) -> PyResult<String> {
    let mesh = mesh.current()?;
    let found =
        run(py, |run| measure::mesh(mesh, Context::new(&WorkDir::in_memory(&std::env::temp_dir(), &run.budget), run)));
    text(&found?)
}

/// Least and greatest corner of the box in which edits know the mesh again; none without a finite face.
#[pyfunction]
pub fn edits_box(py: Python<'_>, mesh: &PyMesh) -> PyResult<Option<[[f64; 3]; 2]>> {
    let mesh = mesh.current()?;
    let bounds = run(py, |run| edits::bounds(&mesh.without_strays(run)?, run))?;
    Ok(bounds.iter().flatten().all(|x| x.is_finite()).then_some(bounds))
}

/// `text`, a file of edits, with places in units of the mesh, and its box if there was one.
#[pyfunction]
pub fn edits_on(py: Python<'_>, mesh: &PyMesh, text: &str) -> PyResult<String> {
    let edits = Edits::of_text(text.as_bytes(), "edits".as_ref()).map_err(raised)?;
    let mesh = mesh.current()?;
    let found = run(py, |run| edits.in_units_of(mesh, run))?;
    self::text(&found)
}

/// Scores of labels against truths, as JSON.
#[pyfunction]
pub fn evaluate(
    py: Python<'_>,
    mesh: &PyMesh,
    labels: PyReadonlyArray1<'_, u32>,
    truths: Vec<PyReadonlyArray1<'_, u32>>,
) -> PyResult<String> {
    let labels = labels.as_array().to_vec();
    let truths: Vec<Vec<u32>> = truths.iter().map(|truth| truth.as_array().to_vec()).collect();
    let mesh = mesh.current()?;
    let scores = run(py, |run| {
        let evaluator = Evaluator::stopped_by(mesh, run.cancel.clone())?;
        evaluator.compare_many(&evaluator.segmentation("labels", &labels)?, &evaluator.segmentations(&truths)?)
    });
    text(&scores?)
}

/// Labels carried to another mesh: labels, qualities, and counts as JSON.
#[pyfunction]
#[pyo3(signature = (from_mesh, labels, to_mesh, threads, max_memory, tmp, progress))]
pub fn transfer_labels<'py>(
    py: Python<'py>,
    from_mesh: &PyMesh,
    labels: PyReadonlyArray1<'py, u32>,
    to_mesh: &PyMesh,
    threads: Option<usize>,
    max_memory: Option<u64>,
    tmp: Option<PathBuf>,
    progress: Option<Py<PyAny>>,
) -> PyResult<(Bound<'py, PyArray1<u32>>, Bound<'py, PyArray1<f32>>, String)> {
    let labels = labels.as_array().to_vec();
    let (from_mesh, to_mesh) = (from_mesh.current()?, to_mesh.current()?);
    let found = watched(py, progress, |listener, cancel| {
        let transfer = with_options!(LabelTransfer::new(), 0, threads, max_memory, tmp, listener, cancel);
        transfer.run(from_mesh, &labels, to_mesh)
    })?;
    let facts = text(&found.facts)?;
    Ok((PyArray1::from_slice(py, &found.labels), PyArray1::from_slice(py, &found.quality), facts))
}

/// An order to stream the mesh in: the place of each face, the number of each vertex, and measures as JSON.
#[pyfunction]
#[pyo3(signature = (mesh, order, sweeps, landmarks, seed, threads, max_memory, tmp, progress))]
pub fn sequence<'py>(
    py: Python<'py>,
    mesh: &PyMesh,
    order: &str,
    sweeps: usize,
    landmarks: Option<usize>,
    seed: u64,
    threads: Option<usize>,
    max_memory: Option<u64>,
    tmp: Option<PathBuf>,
    progress: Option<Py<PyAny>>,
) -> PyResult<(Bound<'py, PyArray1<u32>>, Bound<'py, PyArray1<u32>>, String)> {
    let sequencer = Sequencer::new().order(named::<SequenceOrder>("order", order)?).sweeps(sweeps);
    let sequencer = landmarks.into_iter().fold(sequencer, Sequencer::landmarks);
    let mesh = mesh.current()?;
    let found = watched(py, progress, |listener, cancel| {
        with_options!(sequencer, seed, threads, max_memory, tmp, listener, cancel).run(mesh)
    })?;
    let measures = text(found.measures())?;
    Ok((PyArray1::from_slice(py, found.places()), PyArray1::from_slice(py, found.vertex_numbers()), measures))
}

/// How well samples of landmarks represent the mesh: one record per sample, as JSON. `kernel` and `metric` are JSON as parameters of a
/// cut have them.
#[pyfunction]
#[pyo3(signature = (mesh, landmarks, samplings, seeds, kernel, sigma, metric, seed, threads, max_memory, tmp, progress))]
pub fn quality(
    py: Python<'_>,
    mesh: &PyMesh,
    landmarks: Vec<usize>,
    samplings: Vec<String>,
    seeds: u64,
    kernel: &str,
    sigma: f64,
    metric: &str,
    seed: u64,
    threads: Option<usize>,
    max_memory: Option<u64>,
    tmp: Option<PathBuf>,
    progress: Option<Py<PyAny>>,
) -> PyResult<String> {
    let samplings = samplings.iter().map(|name| named::<Sampling>("samplings", name)).collect::<PyResult<Vec<_>>>()?;
    let (kernel, metric): (Kernel, Metric) = (parsed("kernel", kernel)?, parsed("metric", metric)?);
    metric.check().map_err(raised)?;
    let quality = SamplingQuality::new().landmarks(landmarks).samplings(samplings).seeds(seeds);
    let quality = quality.kernel(kernel, sigma).metric(metric);
    let mesh = mesh.current()?;
    let found = watched(py, progress, |listener, cancel| {
        with_options!(quality, seed, threads, max_memory, tmp, listener, cancel).run(mesh)
    });
    text(&found?)
}
