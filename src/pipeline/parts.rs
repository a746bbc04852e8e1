//! The default way: parts as people would cut them.
//!
//! Everything of the size of the mesh happens here once, out of core: shares of area, normals at a radius of the shape,
//! weights, rows, cells; then the parts are decided on cells, in constant time, as a whole tree of answers, and
//! one more front moves their boundaries onto creases. Another number of parts needs only the last step.

use super::report::Numbers;
use super::surface::{Kind, Surface};
use super::{Clustered, SegmentParams, landmarks_for_parts, rows};
use crate::base::Result;
use crate::base::parallel::{chunk_count, chunk_range, fill_each, map_chunks};
use crate::cluster::parts::{self, PartTree, PartsReport, PartsResult};
use crate::cluster::{boundary, cell_rows, contract};
use crate::distance::DistanceRows;
use crate::graph::DualGraph;
use crate::graph::dual::Weighted;
use crate::store::workdir::key_of;
use crate::store::{MappedSlice, Run, WorkDir, npy};
use serde_json::json;

const CHUNK: usize = 1 << 15;

/// Cuts the mesh of `graph`.
pub(super) fn parts(graph: &DualGraph, params: &SegmentParams, work: &WorkDir, run: &Run) -> Result<Clustered> {
    let n = graph.nodes.len();
    let (surface, weighted) = weighted(graph, params, work, run)?;
    let Surface { shares, radius, .. } = &surface;
    let decided = if params.coarse && n > contract::NODES {
        decide_coarsely(graph, &weighted, &surface, params, work, run)?
    } else {
        let of_node = surface.cells.of_node.clone();
        decide(graph, &weighted, &surface, of_node, params, work, run)?
    };
    let Decided { result, unit_of_node, .. } = &decided;
    let (labels, _) = run.stage("boundaries", "faces", n as u64, || {
        boundary::refine(graph, weighted.csr(), shares, unit_of_node, &decided.label, work, run)
    })?;
    let quality = confidence(unit_of_node, &decided.confidence, work, run)?;
    keep_tree(&result.tree, work)?;
    let (faces, area) = totals(graph, &labels, result.parts, run)?;
    let numbers = Numbers { radius: *radius, dust: shares.dust, faces, area, ..decided.numbers };
    Ok(Clustered { labels, quality, numbers })
}

/// Parts decided on cells, and how they reach the faces.
struct Decided {
    result: PartsResult,
    /// Cell, or contracted node, of each node (n).
    unit_of_node: MappedSlice<u32>,
    /// Label of each of those.
    label: Vec<u32>,
    /// How sure it is.
    confidence: Vec<f64>,
    numbers: Numbers,
}

/// Rows over all nodes of `graph`, averaged to cells; parts decided on these.
fn decide(
    graph: &DualGraph,
    weighted: &Weighted,
    surface: &Surface,
    unit_of_node: MappedSlice<u32>,
    params: &SegmentParams,
    work: &WorkDir,
    run: &Run,
) -> Result<Decided> {
    let l = params.landmarks.unwrap_or(landmarks_for_parts(graph.nodes.len()));
    let rows = rows(graph, weighted, l, params, work, run)?;
    let b = cell_rows(&rows, surface, work, run)?;
    let result = parts::parts(&surface.cells.graph, &b, rows.len(), &params.parts, run)?;
    let numbers = numbers(&rows, result.report.clone());
    let (label, confidence) = (result.label.clone(), result.confidence.clone());
    Ok(Decided { label, confidence, unit_of_node, numbers, result })
}

/// The same on the contracted graph: constant time after one front.
fn decide_coarsely(
    graph: &DualGraph,
    weighted: &Weighted,
    surface: &Surface,
    params: &SegmentParams,
    work: &WorkDir,
    run: &Run,
) -> Result<Decided> {
    run.progress.note("preview: rows over a contracted mesh instead of all faces (--coarse)");
    let inner = WorkDir::open(&work.file("coarse"))?;
    let contract = || contract::contract(graph, weighted, &surface.shares, work, &inner, run);
    let (small, _) = run.stage("contraction", "faces", graph.nodes.len() as u64, contract)?;
    let coarse = Surface::build(&small.graph, Kind::Contracted, &inner, run)?;
    let of_node = coarse.cells.of_node.clone();
    let decided = decide(&small.graph, &small.weighted, &coarse, of_node, params, &inner, run)?;
    let of_small = &decided.unit_of_node;
    Ok(Decided {
        label: of_small.iter().map(|&cell| decided.label[cell as usize]).collect(),
        confidence: of_small.iter().map(|&cell| decided.confidence[cell as usize]).collect(),
        unit_of_node: small.of_node,
        // Landmarks are contracted nodes here; no face is one.
        numbers: Numbers { landmarks: Vec::new(), ..decided.numbers },
        ..decided
    })
}

/// The surface of `graph`, and the graph weighted with its normals and unit.
pub(super) fn weighted(
    graph: &DualGraph,
    params: &SegmentParams,
    work: &WorkDir,
    run: &Run,
) -> Result<(Surface, Weighted)> {
    let surface = Surface::build(graph, Kind::Faces, work, run)?;
    let area = 1. / f64::from(surface.shares.unit).powi(2);
    let (normals, radius) = (surface.normals.as_ref(), surface.radius);
    let weighted = graph.weighted_with(params.metric, normals, radius, area, work, run)?;
    Ok((surface, weighted))
}

/// The rows averaged over cells: made, or reused.
fn cell_rows(rows: &DistanceRows, surface: &Surface, work: &WorkDir, run: &Run) -> Result<Vec<f64>> {
    const FILE: &str = "cell_rows.npy";
    let options = json!({"stage": "cell rows", "rows": rows.key, "surface": surface.key});
    let key = key_of(&options);
    if work.reuse::<()>("cell rows", &key).is_ok() {
        return Ok(work.open_array::<f64>(FILE)?.to_vec());
    }
    let average = || cell_rows::average(rows, &surface.cells, &surface.shares, run);
    let (b, seconds) = run.stage("cell rows", "rows", rows.len() as u64, average)?;
    npy::write(&work.file(FILE), &b, surface.cells.len(), false)?;
    work.stamp("cell rows", &key, &options, &[FILE], &(), seconds)?;
    Ok(b)
}

/// Keeps the tree of answers in the work directory, as JSON.
fn keep_tree(tree: &PartTree, work: &WorkDir) -> Result<()> {
    let path = work.file("tree.json");
    let text = serde_json::to_vec(tree).unwrap_or_default();
    std::fs::write(&path, text).map_err(crate::base::Error::io(&path, "write"))
}

/// How sure each face's label is: its cell's.
fn confidence(unit_of_node: &[u32], confidence: &[f64], work: &WorkDir, run: &Run) -> Result<MappedSlice<f32>> {
    let n = unit_of_node.len();
    let mut quality = work.array::<f32>("quality.npy", &[n])?;
    fill_each(run.threads, &run.cancel, quality.data(), CHUNK, |i, _| confidence[unit_of_node[i] as usize] as f32)?;
    quality.finish(false)
}

/// Faces and area (in the frame) of each part.
fn totals(graph: &DualGraph, labels: &[u32], parts: usize, run: &Run) -> Result<(Vec<u64>, Vec<f64>)> {
    let n = labels.len();
    let chunks = map_chunks(
        run.threads,
        &run.cancel,
        chunk_count(n, CHUNK),
        || (),
        |k, ()| {
            let mut sums = vec![(0u64, 0f64); parts];
            for i in chunk_range(n, CHUNK, k) {
                sums[labels[i] as usize].0 += 1;
                sums[labels[i] as usize].1 += f64::from(graph.nodes[i].area);
            }
            Ok(sums)
        },
    )?;
    let (mut faces, mut area) = (vec![0; parts], vec![0.; parts]);
    for chunk in chunks {
        for (part, (count, sum)) in chunk.into_iter().enumerate() {
            faces[part] += count;
            area[part] += sum;
        }
    }
    Ok((faces, area))
}

/// The spectral numbers of the report, which deciding parts does not need itself.
fn numbers(rows: &DistanceRows, decision: PartsReport) -> Numbers {
    use crate::spectral::kernel::Kernel;
    use crate::spectral::{eigen, embedding};
    // Γ and eigenvalues under the kernel of the members' middle width.
    let sigma = 0.25 * rows.mean();
    let kernel = Kernel::Gaussian;
    let (eigenvalues, _) = eigen::symmetric(embedding::landmark_affinities(rows, kernel, sigma));
    let cut = kernel.tolerance(rows.len()) * eigenvalues.first().copied().unwrap_or(0.);
    let negative: f64 = eigenvalues.iter().filter(|v| **v < 0.).map(|v| -v).sum();
    let mass: f64 = eigenvalues.iter().map(|v| v.abs()).sum();
    Numbers {
        landmarks: rows.landmarks.clone(),
        sigma,
        dropped_eigenpairs: eigenvalues.iter().filter(|v| **v <= cut.max(0.)).count(),
        negative_mass: if mass > 0. { negative / mass } else { 0. },
        eigenvalues,
        decision: Some(decision),
        ..Numbers::default()
    }
}
