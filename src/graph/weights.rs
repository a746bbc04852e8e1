//! Edge weights: how far apart two neighbouring faces are, for a front.
//!
//! Two forms. [`Metric::ScaleFree`] (the default) adds turning to length in units of the shape's own
//! size, w = d + β |θ| (1 concave, η convex): the same shape gives the same distances at every
//! resolution (d: centroid distance), since turning angles add up along a path whatever the tessellation. [`Metric::Paper`] is
//! the form of Katz and Tal (2003) and of Liu and Zhang (2004) that the paper builds on:
//! δ d/mean(d) + (1−δ) a/mean(a), a = η (1 − cos θ), η = 1 for concave edges.
//!
//! A weight is a symmetric formula of the two nodes and the step between them, so both
//! directions agree to the bit. One parallel pass (two for the paper's form, for its means),
//! 32 bytes read and 4 written an entry, about 5 ns an entry and thread.

use super::angle::{between, chord2};
use super::dual_edges::DualEdges;
use super::node_geometry::NodeGeometry;
use super::nodes::Node;
use crate::base::{Error, Result};
use crate::store::{Context, MappedSlice, Run};
use serde::{Deserialize, Serialize};

/// Least weight of an edge: keeps every step positive.
pub const LEAST: f32 = 1e-9;

/// Entries a chunk; part of the results, since the means of the paper's form add up by chunks.
const CHUNK: usize = 1 << 15;

/// The form of the edge weights.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "form")]
pub enum Metric {
    /// d + β |θ| (1 concave, η convex), lengths in units of √(total area), angles in radians.
    ScaleFree {
        /// Length that a turn of one radian is worth.
        beta: f32,
        /// Share of it at convex edges.
        eta: f32,
    },
    /// δ d/mean + (1−δ) η(1−cos θ)/mean.
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
    /// The paper's form with the constants of Liu and Zhang.
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
fn weight(metric: Metric, scale: Scale, a: &Node, b: &Node, centroid_distance: f32, against: bool) -> f32 {
    // Where no orientation exists, turning counts as concave.
    let concave = |a: &Node, b: &Node| against || concave(a, b);
    let length = centroid_distance * scale.centroid_distance;
    let w = match metric {
        Metric::Geodesic => length,
        Metric::ScaleFree { eta, .. } => {
            length + scale.angle * between(a.normal, b.normal) * if concave(a, b) { 1. } else { eta }
        }
        Metric::Paper { eta, .. } => length + scale.angle * turning(a, b, eta, against),
    };
    w.max(LEAST)
}

/// η (1 − cos θ), 0 beside a degenerate face.
#[inline]
fn turning(a: &Node, b: &Node, eta: f32, against: bool) -> f32 {
    if a.area > 0. && b.area > 0. {
        0.5 * chord2(a.normal, b.normal) * if against || concave(a, b) { 1. } else { eta }
    } else {
        0.
    }
}

/// What the edges of a graph are weighted by.
#[derive(Clone, Copy, Debug)]
pub struct Weighting<'a> {
    /// The edges (nnz).
    pub edges: &'a DualEdges,
    /// Geometry of the nodes (n).
    pub nodes: &'a NodeGeometry,
    /// Normals (n) that take the place of the nodes' own, where given.
    pub normals: Option<&'a [[f32; 3]]>,
    /// Sum of the nodes' areas, in the frame.
    pub area: f64,
    /// The form of the weights.
    pub metric: Metric,
}

impl Weighting<'_> {
    /// Writes the weights (nnz) into the array `name`.
    ///
    /// # Errors
    /// [`Error::Parameter`], [`Error::Io`], [`Error::Cancelled`].
    pub fn build(&self, name: &str, Context { work, run }: Context<'_>) -> Result<MappedSlice<f32>> {
        let Self { edges, nodes, normals, metric, .. } = *self;
        metric.check()?;
        let (starts, indices, centroid_distance, edge) =
            (edges.starts.view(), &edges.indices[..], &edges.centroid_distance[..], edges.shared());
        let scale = self.scale(run)?;
        let mut array = work.array::<f32>(name, &[centroid_distance.len()])?;
        run.fill_chunks(array.data(), CHUNK, Vec::new, |k, out, held| {
            let first = k * CHUNK;
            run.will_need(indices, first..first + out.len());
            run.will_need(centroid_distance, first..first + out.len());
            let (mut row, mut span) = starts.row_of(first);
            let last = starts.row_of((first + out.len()).saturating_sub(1)).0;
            let window = nodes.window(row..last + 1, held);
            let node = |i: usize| match normals {
                Some(normals) => Node { normal: normals[i], ..window.at(i) },
                None => window.at(i),
            };
            let mut own = node(row);
            for (i, w) in out.iter_mut().enumerate() {
                let e = first + i;
                while span.end <= e {
                    row += 1;
                    span = starts.span(row as u32);
                    own = node(row);
                }
                let to = node(indices[e] as usize);
                *w = weight(metric, scale, &own, &to, centroid_distance[e], edge.against(row as u32, e));
            }
            Ok(())
        })?;
        array.finish(false)
    }

    /// The scale of the metric on this mesh: from its area, or from means over all edges.
    fn scale(&self, run: &Run) -> Result<Scale> {
        let unit = if self.area > 0. { (1. / self.area.sqrt()) as f32 } else { 1. };
        Ok(match self.metric {
            Metric::ScaleFree { beta, .. } => Scale { centroid_distance: unit, angle: beta },
            Metric::Geodesic => Scale { centroid_distance: unit, angle: 0. },
            Metric::Paper { delta, eta } => {
                let [length, angle] = self.means(eta, run)?;
                let inverse = |x: f64| if x > 0. { (1. / x) as f32 } else { 0. };
                Scale { centroid_distance: delta * inverse(length), angle: (1. - delta) * inverse(angle) }
            }
        })
    }

    /// Mean length and mean angular distance of the edges.
    fn means(&self, eta: f32, run: &Run) -> Result<[f64; 2]> {
        let (nodes, lengths, edge) = (self.nodes, self.edges.by_distance(), self.edges.shared());
        let sums = run.map_ranges(nodes.len(), CHUNK, |range| {
            let (mut length, mut angle, mut count) = (0f64, 0f64, 0u64);
            lengths.will_need(range.clone(), run);
            for i in range {
                for (e, (near, distance)) in lengths.span(i as u32).zip(lengths.neighbours(i as u32)) {
                    // Each edge once.
                    if near as usize > i {
                        let against = edge.against(i as u32, e);
                        length += f64::from(distance);
                        angle += f64::from(turning(&nodes.at(i), &nodes.at(near as usize), eta, against));
                        count += 1;
                    }
                }
            }
            Ok((length, angle, count))
        })?;
        let total = sums.iter().fold((0., 0., 0u64), |t, s| (t.0 + s.0, t.1 + s.1, t.2 + s.2));
        let count = total.2.max(1) as f64;
        Ok([total.0 / count, total.1 / count])
    }
}
