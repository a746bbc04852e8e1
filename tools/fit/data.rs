//! What a fit needs of a model: its cells, their rows, and what people made of each cell.
//!
//! All of it comes from the library's own pipeline, run once a model and seed in a work directory, and is kept as one
//! JSON file a model in the cache (some 4 MB): members, trees and scores are made from it again at each run.

use nystrom_stream::base::{Error, Result};
use nystrom_stream::cluster::cells::OF_FACE;
use nystrom_stream::cluster::contract;
use nystrom_stream::cluster::parts::CellGraph;
use nystrom_stream::graph::{DualGraph, NodeOrder};
use nystrom_stream::mesh::{self, read_seg};
use nystrom_stream::pipeline::{SegmentParams, input, segment};
use nystrom_stream::spectral::anchor::LandmarkDistances;
use nystrom_stream::store::{Context, Run, WorkDir};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap};
use std::fs;
use std::path::Path;
use std::sync::Arc;

/// Numbers after a model's name that are tried for people's labels; some may be left out.
const PEOPLE: usize = 100;
/// The graph of cells in the work directory where parts are decided.
const CELL_GRAPH: &str = "cell_graph.json";
/// Work directories within others: of a proxy, and of a contraction.
const CONTRACTED: &str = "contracted";
const PROXY: &str = "proxy";
/// The node of the mesh for each triangle of its proxy.
const PROXY_NODES: &str = "proxy_nodes.npy";

/// The part of a cell that a person gave one label.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Overlap {
    pub cell: u32,
    /// The person's label, numbered from 0.
    pub label: u32,
    /// Faces, or triangles of the mesh's proxy.
    pub faces: u32,
    pub area: f64,
}

/// A model under one seed.
#[derive(Debug, Serialize, Deserialize)]
pub struct Data {
    pub cells: CellGraph,
    /// Distances of the cells from the landmarks, row-major.
    pub rows: Vec<f64>,
    pub landmarks: usize,
    /// All overlaps of each person's labels with the cells.
    pub people: Vec<Vec<Overlap>>,
}

/// A model of the benchmark.
pub struct Model {
    pub name: String,
    /// Number of its category, in order of first appearance.
    pub category: usize,
    /// Number within the category.
    pub position: usize,
    /// People's most common number of parts.
    pub parts: usize,
}

/// The models of `models.tsv`, by its columns `model`, `category` and `parts`.
pub fn models(folder: &Path) -> Result<Vec<Model>> {
    let path = folder.join("models.tsv");
    let text = fs::read_to_string(&path).map_err(Error::io(&path, "read"))?;
    let mut lines = text.lines().map(|line| line.split('\t').collect::<Vec<_>>());
    let head = lines.next().unwrap_or_default();
    let mut sizes: Vec<(String, usize)> = Vec::new();
    let mut model = |line: &[&str]| {
        let field = |name| line.get(head.iter().position(|title| *title == name)?).copied();
        let (name, parts) = (field("model")?.to_owned(), field("parts")?.parse().ok()?);
        let title = field("category")?;
        let category = sizes.iter().position(|(name, _)| name == title).unwrap_or(sizes.len());
        if category == sizes.len() {
            sizes.push((title.to_owned(), 0));
        }
        sizes[category].1 += 1;
        Some(Model { name, category, position: sizes[category].1 - 1, parts })
    };
    let models = lines.map(|line| model(&line)).collect::<Option<Vec<_>>>().filter(|models| !models.is_empty());
    let remedy = "list the models under the titles model, category and parts, separated by tabs";
    models.ok_or_else(|| Error::unusable(&path, "does not name category and parts of each model", remedy))
}

/// Reads each model from the cache, where `seed` has a folder; makes what is missing.
pub fn collect(benchmark: &Path, models: &[Model], cache: &Path, seed: u64, run: &Run) -> Result<Vec<Data>> {
    let folder = cache.join(format!("seed-{seed}"));
    fs::create_dir_all(&folder).map_err(Error::io(&folder, "create"))?;
    let one = |k: usize, (): &mut ()| {
        let path = folder.join(format!("{}.json", models[k].name));
        if let Some(data) = fs::read(&path).ok().and_then(|text| serde_json::from_slice(&text).ok()) {
            return Ok(data);
        }
        let data = make(benchmark, &models[k].name, &folder, seed)?;
        let text = serde_json::to_vec(&data).unwrap_or_default();
        fs::write(&path, text).map_err(Error::io(&path, "write"))?;
        Ok(data)
    };
    run.map_chunks(models.len(), || (), one)
}

/// Runs the pipeline with its defaults.
fn make(benchmark: &Path, name: &str, scratch: &Path, seed: u64) -> Result<Data> {
    let run = Run { threads: 1, seed, ..Run::new(&()) };
    let kept = tempfile::tempdir_in(scratch).map_err(Error::io(scratch, "create a folder in"))?;
    let work = WorkDir::open(&kept.path().join("work"))?;
    let path = benchmark.join(format!("{name}.ply"));
    let opened = mesh::open(&path, work.path(), &run)?;
    segment(&opened, &input::identity(&path)?, &SegmentParams::default(), Context::new(&work, &run))?;
    let decided = Decided::of(&work)?;
    let cells_in = decided.work.as_deref().unwrap_or(&work);
    let file = cells_in.file(CELL_GRAPH);
    let text = fs::read(&file).map_err(Error::io(&file, "read"))?;
    let wrong = |error: serde_json::Error| Error::malformed(&file, "cell graph", error.to_string(), "report this");
    let cells = serde_json::from_slice::<CellGraph>(&text).map_err(wrong)?.cleaned()?;
    let rows = cells_in.open_array::<f64>("cell_rows.npy")?;
    let landmarks = rows.len() / cells.len().max(1);
    let rows = LandmarkDistances::new(&rows, landmarks, cells.len()).values;
    let people = people(benchmark, name, &work, &decided)?;
    Ok(Data { cells, rows, landmarks, people })
}

/// Where in a work directory parts were decided.
struct Decided {
    /// That of the mesh's proxy, or of a contraction in either; `None`: that of the mesh.
    work: Option<Arc<WorkDir>>,
    /// For each face, or each triangle of the proxy, its cell.
    cell: Vec<u16>,
    /// The node of the mesh that each triangle of the proxy stands for; `None` without a proxy.
    node: Option<Vec<u32>>,
    /// The area of each face or triangle.
    area: Vec<f32>,
}

impl Decided {
    fn of(mesh: &WorkDir) -> Result<Self> {
        let proxy = mesh.path().join(PROXY).exists().then(|| mesh.inner(PROXY)).transpose()?;
        let node = proxy.is_some().then(|| mesh.open_array::<u32>(PROXY_NODES)).transpose()?;
        let node = node.map(|node| node.to_vec());
        let faces = proxy.as_deref().unwrap_or(mesh);
        let graph = DualGraph::kept(faces)?.0;
        let area = (0..graph.nodes.len()).map(|k| graph.nodes.at(k).area).collect();
        if faces.file(CELL_GRAPH).exists() {
            return Ok(Self { cell: faces.open_array::<u16>(OF_FACE)?.to_vec(), work: proxy, node, area });
        }
        let inner = faces.inner(CONTRACTED)?;
        let (of_node, cell) = (inner.open_array::<u16>(contract::OF_FACE)?, inner.open_array::<u16>(OF_FACE)?);
        let cell = of_node.iter().map(|&k| cell[usize::from(k)]).collect();
        Ok(Self { work: Some(inner), cell, node, area })
    }
}

/// People's labels of the faces, or of the triangles of the mesh's proxy, of each cell.
fn people(benchmark: &Path, name: &str, work: &WorkDir, decided: &Decided) -> Result<Vec<Vec<Overlap>>> {
    let (graph, input) = DualGraph::kept(work)?;
    let order = NodeOrder::kept(&input, graph.nodes.len(), work)?;
    let node = |k: usize| decided.node.as_ref().map_or(k as u32, |nodes| nodes[k]);
    let paths = (0..PEOPLE).map(|j| benchmark.join(format!("{name}_{j}.seg"))).filter(|path| path.exists());
    let person = |path: std::path::PathBuf| {
        let labels = read_seg(&path)?;
        if labels.len() != graph.nodes.len() {
            return Err(Error::unusable(path, "is not of this mesh", "give one label a face"));
        }
        let mut numbers = HashMap::new();
        let mut found: BTreeMap<(u32, u32), (u32, f64)> = BTreeMap::new();
        for (k, (&cell, &area)) in decided.cell.iter().zip(&decided.area).enumerate() {
            let next = numbers.len() as u32;
            let label = *numbers.entry(labels[order.face(node(k)) as usize]).or_insert(next);
            let sums = found.entry((u32::from(cell), label)).or_default();
            sums.0 += 1;
            sums.1 += f64::from(area);
        }
        Ok(found.into_iter().map(|((cell, label), (faces, area))| Overlap { cell, label, faces, area }).collect())
    };
    paths.map(person).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fmt::Write;

    /// A torus of 3,600 triangles whose vertices are off by up to `noise` of its thickness.
    fn torus(noise: f64) -> String {
        let (around, across) = (60, 30);
        let turn = |k: u32, n: u32| std::f64::consts::TAU * f64::from(k) / f64::from(n);
        let mut text = format!(
            "ply\nformat ascii 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\n\
             element face {}\nproperty list uchar uint vertex_indices\nend_header\n",
            around * across,
            2 * around * across
        );
        for k in 0..around * across {
            let (u, v) = (turn(k / across, around), turn(k % across, across));
            let off = noise * ((f64::from(k) * 0.618_034).fract() * 7919.).fract();
            let (far, up) = (3. + (1. + off) * v.cos(), (1. + off) * v.sin());
            writeln!(text, "{} {} {up}", far * u.cos(), far * u.sin()).unwrap();
        }
        for k in 0..around * across {
            let at = |i: u32, j: u32| (k / across + i) % around * across + (k % across + j) % across;
            let [a, b, c, d] = [at(0, 0), at(1, 0), at(1, 1), at(0, 1)];
            writeln!(text, "3 {a} {b} {c}\n3 {a} {c} {d}").unwrap();
        }
        text
    }

    /// The fit stopped at the first mesh whose parts are decided on a proxy.
    #[test]
    fn smooth_and_rough_models_are_read_with_all_their_faces() {
        let folder = tempfile::tempdir().unwrap();
        let halves: String = (0..3600).map(|k| if k < 1800 { "0\n" } else { "7\n" }).collect();
        for (name, noise) in [("smooth", 0.), ("rough", 0.2)] {
            fs::write(folder.path().join(format!("{name}.ply")), torus(noise)).unwrap();
            fs::write(folder.path().join(format!("{name}_0.seg")), &halves).unwrap();
        }
        fs::write(folder.path().join("models.tsv"), "model\tcategory\tparts\nsmooth\ttorus\t2\nrough\ttorus\t2\n")
            .unwrap();
        let models = models(folder.path()).unwrap();
        let all = collect(folder.path(), &models, &folder.path().join("cache"), 0, &Run::new(&())).unwrap();
        assert_eq!(all.len(), 2);
        for data in all {
            let faces = |label| data.people[0].iter().filter(|o| o.label == label).map(|o| o.faces).sum::<u32>();
            assert_eq!((data.people.len(), faces(0), faces(1)), (1, 1800, 1800));
            assert_eq!(data.rows.len(), data.landmarks * data.cells.len());
        }
    }
}
