//! The default way: parts as people would cut them.
//!
//! Everything of the size of the mesh happens here once, out of core: shares of area, normals at a radius of the shape,
//! weights, rows, cells; then the parts are decided on cells, in constant time, as a whole tree of answers, and
//! one more front moves their boundaries onto creases. Another number of parts needs only the last step.

use super::report::Numbers;
use super::{Clustered, SegmentParams, landmarks_for_parts, rows};
use crate::base::Result;
use crate::base::parallel::{chunk_count, chunk_range, fill_chunks, map_chunks};
use crate::cluster::cells::{Cells, Smooth};
use crate::cluster::normals::{self, Normals, RADII};
use crate::cluster::parts::{self, PartTree, PartsReport};
use crate::cluster::shares::Shares;
use crate::cluster::{boundary, cell_rows};
use crate::distance::DistanceRows;
use crate::graph::DualGraph;
use crate::store::{MappedSlice, Run, WorkDir};

const CHUNK: usize = 1 << 15;

/// Cuts the mesh of `graph`.
pub(super) fn parts(graph: &DualGraph, params: &SegmentParams, work: &WorkDir, run: &Run) -> Result<Clustered> {
    let n = graph.nodes.len();
    let shares = Shares::of(graph, work, run)?;
    let ([fine, medium, coarse], _) = run.stage("normals", "faces", n as u64, || smooth(graph, &shares, work, run))?;
    let turning = normals::total_turning(graph, &shares, &[&fine, &medium], run)?;
    let radius = normals::choose_radius(&turning);
    let chosen = radius.map(|k| [&fine, &medium][k]);
    let area = 1. / f64::from(shares.unit).powi(2);
    let radius = radius.map_or(0., |k| RADII[k]);
    let weighted = graph.weighted_with(params.metric, chosen, radius, area, work, run)?;
    let smooth = Smooth { fine: &fine, medium: &medium, coarse: &coarse };
    let (cells, _) = run.stage("cells", "faces", n as u64, || Cells::cut(graph, &shares, smooth, work, run))?;
    let l = params.landmarks.unwrap_or(landmarks_for_parts(n));
    let rows = rows(graph, &weighted, l, params, work, run)?;
    let average = || cell_rows::average(&rows, &cells, &shares, run);
    let (b, _) = run.stage("cell rows", "rows", rows.len() as u64, average)?;
    let decided = parts::parts(&cells.graph, &b, rows.len(), &params.parts, run)?;
    keep_tree(&decided.tree, work)?;
    let (labels, _) = run.stage("boundaries", "faces", n as u64, || {
        boundary::refine(graph, weighted.csr(), &shares, &cells.of_node, &decided.label, work, run)
    })?;
    let quality = confidence(&cells, &decided.confidence, work, run)?;
    let (faces, area) = totals(graph, &labels, decided.parts, run)?;
    let numbers = Numbers { radius, dust: shares.dust, faces, area, ..numbers(&rows, decided.report) };
    Ok(Clustered { labels, quality, numbers })
}

/// Normals at the three radii; with two threads, two fronts at a time.
fn smooth(graph: &DualGraph, shares: &Shares, work: &WorkDir, run: &Run) -> Result<[Normals; 3]> {
    let names = ["normals_01.npy", "normals_02.npy", "normals_04.npy"];
    let made = map_chunks(
        run.threads.min(3),
        &run.cancel,
        3,
        || (),
        |k, ()| normals::smoothed(graph, shares, RADII[k], names[k], work, run),
    )?;
    let mut made = made.into_iter();
    let mut next = || made.next().unwrap_or_else(MappedSlice::empty);
    Ok([next(), next(), next()])
}

/// Keeps the tree of answers in the work directory, as JSON.
fn keep_tree(tree: &PartTree, work: &WorkDir) -> Result<()> {
    let path = work.file("tree.json");
    let text = serde_json::to_vec(tree).unwrap_or_default();
    std::fs::write(&path, text).map_err(crate::base::Error::io(&path, "write"))
}

/// How sure each face's label is: its cell's.
fn confidence(cells: &Cells, confidence: &[f64], work: &WorkDir, run: &Run) -> Result<MappedSlice<f32>> {
    let n = cells.of_node.len();
    let mut quality = work.array::<f32>("quality.npy", &[n])?;
    fill_chunks(
        run.threads,
        &run.cancel,
        quality.data(),
        CHUNK,
        || (),
        |k, out, ()| {
            for (slot, i) in out.iter_mut().zip(chunk_range(n, CHUNK, k)) {
                *slot = confidence[cells.of_node[i] as usize] as f32;
            }
            Ok(())
        },
    )?;
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
