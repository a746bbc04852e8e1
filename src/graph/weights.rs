//! Edge weights: how far apart two neighbouring faces are, for a front.
//!
//! Two forms. [`Metric::ScaleFree`] (the default) adds turning to length in units of the shape's own
//! size, w = gd + β |θ| (1 concave, η convex): the same shape gives the same distances at every
//! resolution, since turning angles add up along a path whatever the tessellation. [`Metric::Paper`] is
//! the form of Katz and Tal (2003) and of Liu and Zhang (2004) that the paper builds on:
//! δ gd/mean(gd) + (1−δ) a/mean(a), a = η (1 − cos θ), η = 1 for concave edges.
//!
//! A weight is a symmetric formula of the two nodes and the step between them, so both
//! directions agree to the bit. One parallel pass (two for the paper's form, for its means),
//! 32 bytes read and 4 written an entry, about 5 ns an entry and thread.

use super::angle::{between, chord2};
use super::assemble::Rows;
use super::nodes::Node;
use crate::base::parallel::{fill_chunks, map_ranges};
use crate::base::{Error, Result};
use crate::store::{MappedSlice, Run, WorkDir};
use serde::{Deserialize, Serialize};

/// Least weight of an edge: keeps every step positive.
pub const LEAST: f32 = 1e-9;

/// Entries a chunk; part of the results, since the means of the paper's form add up by chunks.
const CHUNK: usize = 1 << 15;

/// The form of the edge weights.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "form")]
pub enum Metric {
    /// gd + β |θ| (1 concave, η convex), lengths in units of √(total area), angles in radians.
    ScaleFree {
        /// Length that a turn of one radian is worth.
        beta: f32,
        /// Share of it at convex edges.
        eta: f32,
    },
    /// δ gd/mean + (1−δ) η(1−cos θ)/mean.
    Paper {
        /// Share of the geodesic part.
        delta: f32,
        /// Factor of convex turning.
        eta: f32,
    },
    /// Length alone, in units of √(total area).
    Geodesic,
}

impl Default for Metric {
    fn default() -> Self {
        Self::ScaleFree { beta: 5., eta: 0.05 }
    }
}

impl Metric {
    /// The paper's manner with the constants of Liu and Zhang.
    pub fn paper() -> Self {
        Self::Paper { delta: 0.03, eta: 0.1 }
    }

    /// # Errors
    /// [`Error::Parameter`] for constants outside their range.
    pub fn check(&self) -> Result<()> {
        let range = |name: &str, value: f32, low: f32, high: f32| {
            if value >= low && value <= high {
                Ok(())
            } else {
                Err(Error::parameter(name, format!("{value} is out of range"), format!("choose from {low} to {high}")))
            }
        };
        match *self {
            Self::ScaleFree { beta, eta } => range("--beta", beta, 0., 1e6).and_then(|()| range("--eta", eta, 0., 1.)),
            Self::Paper { delta, eta } => range("--delta", delta, 0., 1.).and_then(|()| range("--eta", eta, 0., 1.)),
            Self::Geodesic => Ok(()),
        }
    }
}

/// Whether the edge between two faces is concave: seen from the middle, the normals lean
/// towards each other. Symmetric to the bit.
#[inline]
pub fn concave(a: &Node, b: &Node) -> bool {
    let mut dot = 0f32;
    for axis in 0..3 {
        dot += (a.normal[axis] - b.normal[axis]) * (b.centroid[axis] - a.centroid[axis]);
    }
    dot > 0.
}

/// The numbers of a metric that come from the whole mesh.
#[derive(Clone, Copy, Debug)]
struct Scale {
    /// Factor on a step's length.
    centroid_distance: f32,
    /// Factor on an angular distance.
    angle: f32,
}

#[inline]
fn weight(metric: Metric, scale: Scale, a: &Node, b: &Node, centroid_distance: f32, edge: f32) -> f32 {
    // Where no orientation exists, turning counts as concave.
    let concave = |a: &Node, b: &Node| edge < 0. || concave(a, b);
    let length = centroid_distance * scale.centroid_distance;
    let w = match metric {
        Metric::Geodesic => length,
        Metric::ScaleFree { eta, .. } => {
            length + scale.angle * between(a.normal, b.normal) * if concave(a, b) { 1. } else { eta }
        }
        Metric::Paper { eta, .. } => length + scale.angle * turning(a, b, eta, edge),
    };
    w.max(LEAST)
}

/// η (1 − cos θ), 0 beside a degenerate face.
#[inline]
fn turning(a: &Node, b: &Node, eta: f32, edge: f32) -> f32 {
    if a.area > 0. && b.area > 0. {
        0.5 * chord2(a.normal, b.normal) * if edge < 0. || concave(a, b) { 1. } else { eta }
    } else {
        0.
    }
}

/// Writes `file` (nnz), the weights of `rows`. `area` is the sum of the nodes' areas; `normals` (n), where given,
/// take the place of the nodes' own.
///
/// # Errors
/// [`Error::Parameter`], [`Error::Io`], [`Error::Cancelled`].
pub fn build(
    rows: &Rows,
    nodes: &[Node],
    normals: Option<&[[f32; 3]]>,
    area: f64,
    metric: Metric,
    (work, file): (&WorkDir, &str),
    run: &Run,
) -> Result<MappedSlice<f32>> {
    metric.check()?;
    let (indptr, indices, centroid_distance, edge) =
        (&rows.indptr[..], &rows.indices[..], &rows.centroid_distance[..], &rows.edge[..]);
    let scale = scale(rows, nodes, area, metric, run)?;
    let mut array = work.array::<f32>(file, &[centroid_distance.len()])?;
    let node = |i: usize| match normals {
        Some(normals) => Node { normal: normals[i], ..nodes[i] },
        None => nodes[i],
    };
    fill_chunks(
        run.threads,
        &run.cancel,
        array.data(),
        CHUNK,
        || (),
        |k, out, ()| {
            let first = k * CHUNK;
            let mut row = indptr.partition_point(|&start| start as usize <= first) - 1;
            for (i, w) in out.iter_mut().enumerate() {
                let e = first + i;
                while indptr[row + 1] as usize <= e {
                    row += 1;
                }
                *w = weight(metric, scale, &node(row), &node(indices[e] as usize), centroid_distance[e], edge[e]);
            }
            Ok(())
        },
    )?;
    array.finish(false)
}

/// The scale of a metric on this mesh: from the area alone, or from means over all edges.
fn scale(rows: &Rows, nodes: &[Node], area: f64, metric: Metric, run: &Run) -> Result<Scale> {
    let (indptr, indices, centroid_distance, edge) =
        (&rows.indptr[..], &rows.indices[..], &rows.centroid_distance[..], &rows.edge[..]);
    let n = nodes.len();
    let eta = if let Metric::Paper { eta, .. } = metric { eta } else { 0. };
    let needs_angle = matches!(metric, Metric::Paper { .. });
    let sums = map_ranges(run.threads, &run.cancel, n, CHUNK, |range| {
        let (mut length, mut angle, mut count) = (0f64, 0f64, 0u64);
        for i in range {
            for e in indptr[i] as usize..indptr[i + 1] as usize {
                // Each edge once.
                if indices[e] as usize > i {
                    length += f64::from(centroid_distance[e]);
                    count += 1;
                    if needs_angle {
                        angle += f64::from(turning(&nodes[i], &nodes[indices[e] as usize], eta, edge[e]));
                    }
                }
            }
        }
        Ok((length, angle, count))
    })?;
    let total = sums.iter().fold((0., 0., 0u64), |t, s| (t.0 + s.0, t.1 + s.1, t.2 + s.2));
    let count = total.2.max(1) as f64;
    let (mean_gd, mean_angle) = (total.0 / count, total.1 / count);
    let inverse = |x: f64| if x > 0. { (1. / x) as f32 } else { 0. };
    let unit = if area > 0. { (1. / area.sqrt()) as f32 } else { 1. };
    Ok(match metric {
        Metric::ScaleFree { beta, .. } => Scale { centroid_distance: unit, angle: beta },
        Metric::Geodesic => Scale { centroid_distance: unit, angle: 0. },
        Metric::Paper { delta, .. } => {
            Scale { centroid_distance: delta * inverse(mean_gd), angle: (1. - delta) * inverse(mean_angle) }
        }
    })
}
