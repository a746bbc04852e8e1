//! A folder of meshes with human segmentations, such as the Princeton Segmentation Benchmark, and the scores of a
//! folder of labels on it; labels are read in several formats.
//!
//! The folder contains `N.ply`, human labels `N_0.seg`, `N_1.seg`, … and `models.tsv`, whose tab-separated columns
//! `model` and `category` list what to evaluate. Models are independent, one per thread. Cost: some 20 ms per model and
//! thread (20 k faces, 11 people, all metrics), and the memory of as many models as threads. Labels are `.seg` (one per
//! line), `.npy` (a vector of any integer type) or `.ply` (the face property `label`), one per face: one pass, 4 bytes
//! per face.

use super::boundaries::Evaluator;
use super::scores::{ModelScores, ScoreTable, Segmentation};
use crate::apps::labelled_faces::LabelledFaces;
use crate::apps::open_labels;
use crate::base::printable::counted;
use crate::base::{Error, Result};
use crate::mesh::{self, UNLABELLED, ends_with, read_seg};
use crate::store::{Context, Run, WorkDir, private_folder};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Numbers after a model's name that are tried for human labels; some may be missing.
const PEOPLE: usize = 100;

/// A model of a benchmark.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BenchmarkModel {
    /// Its name: `N` of `N.ply`.
    pub name: String,
    /// The category it belongs to.
    pub category: String,
}

/// The folder of a benchmark.
#[derive(Clone, Debug)]
pub struct Benchmark {
    folder: PathBuf,
    /// The models of `models.tsv`, in its order.
    pub models: Vec<BenchmarkModel>,
}

/// The result of an evaluation.
#[derive(Clone, Debug)]
pub struct Evaluation {
    /// Scores of the labels, with a row for people on the same models; scores of people if no labels are given.
    pub table: ScoreTable,
    /// Scores of people against other people on the same models.
    pub people: ScoreTable,
    /// Models without labels, not included in the table.
    pub missing: Vec<String>,
}

/// The scores of a model's labels, if there are any, and of people on it.
struct Outcome {
    labels: Option<ModelScores>,
    people: ModelScores,
}

impl Benchmark {
    /// Opens the benchmark in `folder`.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Malformed`] if `models.tsv` lacks a column; [`Error::Unusable`] if it is not UTF-8,
    /// names no model, or names one twice.
    pub fn open(folder: &Path) -> Result<Self> {
        let path = folder.join("models.tsv");
        let text = std::fs::read(&path).map_err(Error::io(&path, "read"))?;
        let text = String::from_utf8(text).map_err(|_| Error::unusable(&path, "is not UTF-8", "save it as UTF-8"))?;
        // Some editors begin files of UTF-8 with a mark.
        let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
        let mut lines = text.lines().map(|line| line.split('\t').collect::<Vec<_>>()).zip(1usize..);
        let (head, _) = lines.next().unwrap_or_default();
        let column = |name| {
            let remedy = "its first line names the columns, model and category among them, separated by tabs";
            let problem = || Error::malformed(&path, "line 1", format!("no column {name}"), remedy);
            head.iter().position(|title| *title == name).ok_or_else(problem)
        };
        let (model, category) = (column("model")?, column("category")?);
        let named = |(line, number): (Vec<&str>, usize)| {
            let field = |at: usize, name: &str| {
                let remedy = "separate the fields by tabs, as in the first line";
                let missing = || Error::malformed(&path, format!("line {number}"), format!("no {name}"), remedy);
                line.get(at).map(|field| (*field).to_owned()).ok_or_else(missing)
            };
            Ok(BenchmarkModel { name: field(model, "model")?, category: field(category, "category")? })
        };
        let models = lines.filter(|(line, _)| line != &[""]).map(named).collect::<Result<Vec<BenchmarkModel>>>()?;
        let mut names = BTreeSet::new();
        if let Some(twice) = models.iter().find(|model| !names.insert(&model.name)) {
            let problem = format!("names the model {:?} twice, which would count double", twice.name);
            return Err(Error::unusable(&path, problem, "keep one of the lines"));
        }
        if models.is_empty() {
            return Err(Error::unusable(path, "names no model", "add one line per model"));
        }
        Ok(Self { folder: folder.to_path_buf(), models })
    }

    /// Scores the labels `N.seg`, `N.npy` or `N.ply` of a folder, or people if no folder is given; cut discrepancy only
    /// if `cuts`.
    ///
    /// # Errors
    /// Those of the readers; [`Error::Unusable`] for labels that do not match their mesh, for a model that fewer than
    /// two people have segmented, for a folder without any labels; [`Error::Cancelled`].
    pub fn evaluate(&self, labels: Option<&Path>, cuts: bool, run: &Run) -> Result<Evaluation> {
        if let Some(folder) = labels {
            std::fs::read_dir(folder).map_err(Error::io(folder, "list"))?;
        }
        let score = |k: usize, (): &mut ()| self.score_model(&self.models[k], labels, cuts, run);
        let outcomes = run.map_chunks(self.models.len(), || (), score)?;
        let (mut scored, mut people, mut missing) = (Vec::new(), Vec::new(), Vec::new());
        for outcome in outcomes {
            match (outcome.labels, labels) {
                (Some(scores), _) => {
                    scored.push(scores);
                    people.push(outcome.people);
                }
                (None, Some(_)) => missing.push(outcome.people.model),
                (None, None) => people.push(outcome.people),
            }
        }
        if let Some(folder) = labels.filter(|_| scored.is_empty()) {
            let first = &self.models[0].name;
            let remedy = format!("name them after the models, as {first}.seg");
            return Err(Error::unusable(folder, "has no labels of any model", remedy));
        }
        let table =
            if labels.is_some() { ScoreTable::new(scored, &people) } else { ScoreTable::new(people.clone(), &[]) };
        Ok(Evaluation { table, people: ScoreTable::new(people, &[]), missing })
    }

    fn score_model(&self, model: &BenchmarkModel, labels: Option<&Path>, cuts: bool, run: &Run) -> Result<Outcome> {
        run.progress.advance("evaluate", 1);
        let scratch = private_folder(&std::env::temp_dir())?;
        let run = Run { threads: 1, cancel: run.cancel.clone(), ..Run::new(&()) };
        let mesh = mesh::open(&self.folder.join(format!("{}.ply", model.name)), scratch.path(), &run)?;
        let all = || Evaluator::stopped_by(&mesh, run.cancel.clone());
        let surface = if cuts { all()? } else { Evaluator::without_edges(&mesh) };
        let truths = self.truths(&model.name)?;
        let truths: Vec<Segmentation> =
            truths.iter().map(|(path, labels)| fitting(&surface, path, labels)).collect::<Result<_>>()?;
        if truths.len() < 2 {
            let path = self.folder.join(format!("{}_0.seg", model.name));
            let cut = if truths.is_empty() { "nobody has" } else { "only one person has" };
            let problem = format!("{cut} cut this model, but at least two are needed");
            return Err(Error::unusable(path, problem, "leave the model out of models.tsv"));
        }
        let scored =
            |scores, parts| ModelScores { model: model.name.clone(), category: model.category.clone(), scores, parts };
        let mean_parts = truths.iter().map(|truth| truth.parts() as f64).sum::<f64>() / truths.len() as f64;
        let people = scored(surface.people(&truths)?, mean_parts);
        let candidates =
            labels.into_iter().flat_map(|folder| LABEL_EXTENSIONS.map(|e| folder.join(format!("{}.{e}", model.name))));
        let labels = match candidates.into_iter().find(|path| path.exists()) {
            Some(path) => {
                let labels = read_labels(&path, scratch.path(), &run)?;
                let labels = fitting(&surface, &path, &labels)?;
                Some(scored(surface.compare_many(&labels, &truths)?, labels.parts() as f64))
            }
            None => None,
        };
        Ok(Outcome { labels, people })
    }

    /// The human labels of a model.
    fn truths(&self, model: &str) -> Result<Vec<(PathBuf, Vec<u32>)>> {
        let paths = (0..PEOPLE).map(|j| self.folder.join(format!("{model}_{j}.seg"))).filter(|path| path.exists());
        paths.map(|path| read_seg(&path).map(|labels| (path, labels))).collect()
    }
}

/// Prepares labels if there is one per face.
///
/// # Errors
/// [`Error::Unusable`] naming `path` otherwise.
pub fn fitting<'a>(surface: &Evaluator, path: &Path, labels: &'a [u32]) -> Result<Segmentation<'a>> {
    if labels.len() != surface.faces() {
        let problem = format!("has {} for {}", counted(labels.len(), "label"), counted(surface.faces(), "face"));
        return Err(Error::unusable(path, problem, "give labels of this mesh"));
    }
    surface.segmentation(&path.display().to_string(), labels)
}

/// File extensions that [`read_labels`] supports, in the order in which a folder is searched for them.
pub const LABEL_EXTENSIONS: [&str; 3] = ["seg", "npy", "ply"];

/// Reads labels, one per face. Unpacked data go to `scratch`.
///
/// # Errors
/// [`Error::Unusable`] for an unknown extension, a file without labels, or one in which a face has none; and those of
/// the readers.
pub fn read_labels(path: &Path, scratch: &Path, run: &Run) -> Result<Vec<u32>> {
    let work = WorkDir::in_memory(scratch, &run.budget);
    let labels = if ends_with(path, "ply") {
        let mesh = mesh::open(path, scratch, run)?;
        let remedy = "give a mesh that was written with labels";
        LabelledFaces::needed_of_mesh(&mesh, remedy, Context::new(&work, run))?.labels
    } else {
        let known = ends_with(path, "seg") || ends_with(path, "npy");
        let remedy = "give a .seg, .npy or .ply file";
        let unknown = || Error::unusable(path, "unknown extension for labels", remedy);
        known.then(|| open_labels(path, &work)).ok_or_else(unknown)??
    };
    if let Some(face) = labels.iter().position(|&label| label == UNLABELLED) {
        let problem = format!("face {face} has no label (it is negative), but labels are compared on every face");
        return Err(Error::unusable(path, problem, "give such faces a part of their own, or leave them out"));
    }
    Ok(labels.to_vec())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::npy;

    #[test]
    fn arrays_of_several_types_are_read_and_others_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.npy");
        let read = || read_labels(&path, dir.path(), &Run::new(&()));
        npy::write::<u32>(&path, &[5, 0, u32::MAX - 1], 1, false).unwrap();
        assert_eq!(read().unwrap(), [5, 0, u32::MAX - 1]);
        npy::write::<u64>(&path, &[5, 1 << 40], 1, false).unwrap();
        assert!(read().unwrap_err().to_string().contains("item 1 is 1099511627776, beyond 32 bits"));
        // NumPy's default integer type: signed, 64 bits.
        let mut bytes = std::fs::read(&path).unwrap();
        let at = bytes.windows(3).position(|w| w == b"<u8").unwrap();
        bytes[at + 1] = b'i';
        std::fs::write(&path, &bytes).unwrap();
        assert!(read().is_err());
        npy::write::<u64>(&path, &[7, 3], 1, false).unwrap();
        let mut bytes = std::fs::read(&path).unwrap();
        bytes[at + 1] = b'i';
        std::fs::write(&path, &bytes).unwrap();
        assert_eq!(read().unwrap(), [7, 3]);
        npy::write::<f32>(&path, &[1.], 1, false).unwrap();
        assert!(read().unwrap_err().to_string().contains("has items"));
        npy::write::<u32>(&path, &[1, 2], 2, false).unwrap();
        assert!(read().unwrap_err().to_string().contains("dimensions"));
        assert!(read_labels(Path::new("x.txt"), dir.path(), &Run::new(&())).is_err());
    }

    #[test]
    fn a_face_without_a_label_is_named_in_every_form() {
        // Regression: the property of a mesh was read by another rule than an array, and neither error explained it.
        let dir = tempfile::tempdir().unwrap();
        let ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
             element face 2\nproperty list uchar int vertex_indices\nproperty int label\nend_header\n\
             0 0 0\n1 0 0\n0 1 0\n3 0 1 2 4\n3 0 2 1 -1\n";
        let (mesh, array) = (dir.path().join("x.ply"), dir.path().join("x.npy"));
        std::fs::write(&mesh, ply).unwrap();
        npy::write::<u32>(&array, &[4, UNLABELLED], 1, false).unwrap();
        for path in [&mesh, &array] {
            let error = read_labels(path, dir.path(), &Run::new(&())).unwrap_err().to_string();
            assert!(error.contains("face 1 has no label") && error.contains("on every face"), "{error}");
        }
        std::fs::write(&mesh, ply.replace("-1", "7")).unwrap();
        assert_eq!(read_labels(&mesh, dir.path(), &Run::new(&())).unwrap(), [4, 7]);
        std::fs::write(&mesh, ply.replace("label", "part")).unwrap();
        let error = read_labels(&mesh, dir.path(), &Run::new(&())).unwrap_err().to_string();
        assert!(error.contains("no face property `label`"), "{error}");
    }
}
