//! Edge weights: the cost of stepping between two neighbouring faces.
//!
//! Two forms. [`Metric::ScaleFree`] (the default) adds turning to length in units of the shape's own size, w = d + β
//! |θ| (1 concave, η convex), where d is the centroid distance. The same shape gives the same distances at every
//! resolution, since turning angles add up along a path whatever the tessellation. [`Metric::Paper`] is the form of
//! Katz and Tal (2003) and of Liu and Zhang (2004) that the paper builds on: δ d/mean(d) + (1−δ) a/mean(a), a = η (1 −
//! cos θ), η = 1 for concave edges.
//!
//! A weight is a symmetric formula of the two nodes and the step between them, so both directions agree to the bit. One
//! parallel pass (two for the paper's form, for its means), 32 bytes read and 4 written per entry, about 5 ns per entry
//! and thread.

use super::angle::{between, chord2};
use super::csr::SampledMean;
use super::dual_edges::DualEdges;
use super::node_geometry::NodeGeometry;
use super::nodes::Node;
use crate::base::parallel::{chunk_count, chunk_range, parts_of};
use crate::base::printable::Significant;
use crate::base::{Error, Result};
use crate::store::{Context, MappedSlice, Run};
use serde::{Deserialize, Serialize};

/// Minimum weight of an edge: keeps every step positive.
pub const LEAST: f32 = 1e-9;

/// Nodes per chunk of the means of the paper's form; it affects results, since sums are formed by chunks.
const CHUNK: usize = 1 << 15;
/// Nodes per chunk of the weights.
const NODES: usize = 1 << 14;

/// The form of the edge weights.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "form")]
pub enum Metric {
    /// d + β |θ| (1 concave, η convex), lengths in units of √(total area), angles in radians.
    ScaleFree {
        /// Length equivalent to a turn of one radian.
        beta: f32,
        /// Factor for convex turning.
        eta: f32,
    },
    /// δ d/mean + (1−δ) η(1−cos θ)/mean.
    Paper {
        /// Weight of the geodesic term.
        delta: f32,
        /// Factor for convex turning.
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

    /// Checks that the constants are in range.
    ///
    /// # Errors
    /// [`Error::Parameter`] for constants outside their range.
    pub fn check(&self) -> Result<()> {
        let range = |name: &str, value: f32, low: f32, high: f32| {
            if value >= low && value <= high {
                Ok(())
            } else {
                let problem = format!("{} is out of range", Significant(value));
                Err(Error::parameter(name, problem, format!("choose from {low} to {high}")))
            }
        };
        match *self {
            Self::ScaleFree { beta, eta } => range("beta", beta, 0., 1e6).and_then(|()| range("eta", eta, 0., 1.)),
            Self::Paper { delta, eta } => range("delta", delta, 0., 1.).and_then(|()| range("eta", eta, 0., 1.)),
            Self::Geodesic => Ok(()),
        }
    }
}

/// Whether the edge between two faces is concave: seen from its middle, the normals lean towards each other. Symmetric
/// to the bit.
#[inline]
pub fn concave(a: &Node, b: &Node) -> bool {
    Side::of(a).is_concave_towards(Side::of(b))
}

/// One of the two faces at an edge. Holds references, since node data are read in place ([`super::node_geometry`]).
#[derive(Clone, Copy, Debug)]
struct Side<'a> {
    centroid: &'a [f32; 3],
    normal: &'a [f32; 3],
    area: f32,
}

impl<'a> Side<'a> {
    #[inline(always)]
    fn of(node: &'a Node) -> Self {
        Self { centroid: &node.centroid, normal: &node.normal, area: node.area }
    }

    /// The node number `i`, with its normal from `normals` if given.
    #[inline(always)]
    fn with(node: &'a Node, normals: Option<&'a [[f32; 3]]>, i: usize) -> Self {
        match normals {
            Some(normals) => Self { normal: &normals[i], ..Self::of(node) },
            None => Self::of(node),
        }
    }

    /// [`concave`].
    #[inline(always)]
    fn is_concave_towards(self, other: Self) -> bool {
        let mut dot = 0f32;
        for axis in 0..3 {
            dot += (self.normal[axis] - other.normal[axis]) * (other.centroid[axis] - self.centroid[axis]);
        }
        dot > 0.
    }
}

/// Factors of a metric that depend on the whole mesh.
#[derive(Clone, Copy, Debug)]
struct Scale {
    /// Factor for a step's length.
    centroid_distance: f32,
    /// Factor for an angular distance.
    angle: f32,
}

/// η (1 − cos θ), 0 beside a degenerate face.
#[inline(always)]
fn turning(a: Side<'_>, b: Side<'_>, eta: f32, opposite_winding: bool) -> f32 {
    // Branch-free: which edges are concave is practically random.
    let turning =
        0.5 * chord2(*a.normal, *b.normal) * if opposite_winding | a.is_concave_towards(b) { 1. } else { eta };
    if (a.area > 0.) & (b.area > 0.) { turning } else { 0. }
}

/// Inputs of the edge weights.
#[derive(Clone, Copy, Debug)]
pub struct Weighting<'a> {
    /// The edges (nnz).
    pub edges: &'a DualEdges,
    /// Geometry of the nodes (n).
    pub nodes: &'a NodeGeometry,
    /// Normals (n) to use instead of the nodes' own, if given.
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
        self.metric.check()?;
        let Scale { centroid_distance: unit, angle } = self.scale(run)?;
        let mut array = work.array::<f32>(name, &[self.edges.centroid_distance.len()])?;
        let out = array.data();
        // A branch-free loop for each form. Where no orientation exists, turning counts as concave.
        match self.metric {
            Metric::Geodesic => self.fill(out, run, |_, _, length, _| length * unit),
            Metric::ScaleFree { eta, .. } => self.fill(out, run, |a, b, length, opposite_winding| {
                let turn = if opposite_winding | a.is_concave_towards(b) { 1. } else { eta };
                length * unit + angle * between(*a.normal, *b.normal) * turn
            }),
            Metric::Paper { eta, .. } => self.fill(out, run, |a, b, length, opposite_winding| {
                length * unit + angle * turning(a, b, eta, opposite_winding)
            }),
        }?;
        array.finish(false)
    }

    /// Fills `out` (nnz) with `weight` of each edge: its nodes, its length, whether their windings contradict.
    fn fill(
        &self,
        out: &mut [f32],
        run: &Run,
        weight: impl Fn(Side<'_>, Side<'_>, f32, bool) -> f32 + Sync,
    ) -> Result<()> {
        let Self { edges, nodes, normals, .. } = *self;
        let (starts, indices, lengths, edge) =
            (edges.starts.view(), &edges.indices[..], &edges.centroid_distance[..], edges.shared());
        let rows = |k: usize| chunk_range(starts.len(), NODES, k);
        let chunks = chunk_count(starts.len(), NODES);
        let ends = (0..chunks).map(|k| starts.span(rows(k).end as u32 - 1).end);
        let mean = SampledMean::of(lengths.len());
        let sampled = run.fill_pieces(parts_of(out, ends), Vec::new, |k, out, held| {
            let entries = starts.entries_of(rows(k));
            run.will_need(indices, entries.clone());
            run.will_need(lengths, entries.clone());
            let window = nodes.window(rows(k), held);
            let (first, indices, lengths) = (entries.start, &indices[entries.clone()], &lengths[entries]);
            starts.each(rows(k), |row, span| {
                let mut held = [Node::default(); 2];
                let [one, two] = &mut held;
                let own = Side::with(window.look(row, one), normals, row);
                for e in span {
                    let i = e - first;
                    let near = indices[i] as usize;
                    let to = Side::with(window.look(near, two), normals, near);
                    out[i] = weight(own, to, lengths[i], edge.opposite_winding(row as u32, e)).max(LEAST);
                }
            });
            Ok(mean.sample(first, lengths).collect::<Vec<f32>>())
        })?;
        edges.mean.get_or_init(|| SampledMean::mean(sampled.into_iter().flatten()));
        Ok(())
    }

    /// The factors of the metric on this mesh: from its area, or from means over all edges.
    fn scale(&self, run: &Run) -> Result<Scale> {
        let unit = if self.area > 0. { (1. / self.area.sqrt()) as f32 } else { 1. };
        Ok(match self.metric {
            Metric::ScaleFree { beta, .. } => Scale { centroid_distance: unit, angle: beta },
            Metric::Geodesic => Scale { centroid_distance: unit, angle: 0. },
            Metric::Paper { delta, eta } => {
                let [length, angle] = self.means(eta, run)?;
                let inverse = |x: f64| {
                    let inverse = (1. / x) as f32;
                    // A mean this small counts as zero: a plane up to noise.
                    if inverse.is_finite() { inverse } else { 0. }
                };
                Scale { centroid_distance: delta * inverse(length), angle: (1. - delta) * inverse(angle) }
            }
        })
    }

    /// Mean length and mean angular distance of the edges.
    fn means(&self, eta: f32, run: &Run) -> Result<[f64; 2]> {
        let (nodes, edges, edge) = (self.nodes, self.edges.by_distance(), self.edges.shared());
        let sums = run.map_chunks(chunk_count(nodes.len(), CHUNK), Vec::new, |k, held| {
            let (mut length, mut angle, mut count) = (0f64, 0f64, 0u64);
            let range = chunk_range(nodes.len(), CHUNK, k);
            edges.will_need(range.clone(), run);
            let window = nodes.window(range.clone(), held);
            edges.starts.each(range, |i, span| {
                let mut held = [Node::default(); 2];
                let [one, two] = &mut held;
                let own = Side::of(window.look(i, one));
                for e in span {
                    let near = edges.indices[e] as usize;
                    let to = Side::of(window.look(near, two));
                    let turning = turning(own, to, eta, edge.opposite_winding(i as u32, e));
                    // Each edge once. Adding 0 changes no sum, and a branch would be mispredicted half of the time.
                    let once = near > i;
                    length += if once { f64::from(edges.weights[e]) } else { 0. };
                    angle += if once { f64::from(turning) } else { 0. };
                    count += u64::from(once);
                }
            });
            Ok((length, angle, count))
        })?;
        let total = sums.iter().fold((0., 0., 0u64), |t, s| (t.0 + s.0, t.1 + s.1, t.2 + s.2));
        let count = total.2.max(1) as f64;
        Ok([total.0 / count, total.1 / count])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::DualGraph;
    use crate::mesh::Mesh;
    use crate::store::WorkDir;
    use serde_json::Value;

    /// Regression: in a plane with noisy heights, one over the mean angular distance was infinite in `f32`: edges that
    /// turn had infinite weights, and all others the least one, whatever their lengths.
    #[test]
    fn the_papers_weights_are_lengths_where_turning_is_noise() {
        let points: Vec<[f64; 3]> =
            (0..60).map(|v| [f64::from(v / 2), f64::from(v % 2), f64::from(v * 37 % 11) * 1e-20]).collect();
        let faces: Vec<[u32; 3]> = (0..58).map(|v| [v, v + 1 + v % 2, v + 2 - v % 2]).collect();
        let mesh = Mesh::from_slices(&points, &faces).unwrap();
        let (run, work) = (Run::new(&()), WorkDir::temporary(&std::env::temp_dir()).unwrap());
        let context = Context::new(&work, &run);
        let graph = DualGraph::build(&mesh, "plane".as_ref(), &Value::Null, context).unwrap();
        let weights = graph.weighted(Metric::paper(), context).unwrap();
        let lengths = graph.edges.by_distance();
        let ratios = weights.csr().weights.iter().zip(lengths.weights).map(|(weight, length)| weight / length);
        let (least, most) = ratios.fold((f32::MAX, 0f32), |(least, most), ratio| (least.min(ratio), most.max(ratio)));
        assert!(least > 0. && most < 1.001 * least, "{least} {most}");
    }

    /// The mean step that weighting leaves behind is that of one pass over all steps, to the bit.
    #[test]
    fn the_mean_step_is_known_from_weighting() {
        let (width, height) = (300u32, 150u32);
        let points: Vec<[f64; 3]> = (0..width * height)
            .map(|v| [f64::from(v % width), f64::from(v / width), f64::from(v * 37 % 11) / 7.])
            .collect();
        let quads = (0..width * (height - 1)).filter(|v| v % width + 1 < width);
        let faces: Vec<[u32; 3]> =
            quads.flat_map(|v| [[v, v + 1, v + width + 1], [v, v + width + 1, v + width]]).collect();
        let mesh = Mesh::from_slices(&points, &faces).unwrap();
        let (run, work) = (Run::new(&()), WorkDir::temporary(&std::env::temp_dir()).unwrap());
        let context = Context::new(&work, &run);
        let graph = DualGraph::build(&mesh, "sheet".as_ref(), &Value::Null, context).unwrap();
        let steps = graph.edges.centroid_distance.to_vec();
        let sampled: Vec<f64> = steps.iter().step_by(steps.len() / 65_536).map(|&step| f64::from(step)).collect();
        assert!(steps.len() > 4 * 65_536 && sampled.len() < steps.len() / 2);
        graph.weighted(Metric::default(), context).unwrap();
        assert_eq!(graph.edges.mean.get(), Some(&((sampled.iter().sum::<f64>() / sampled.len() as f64) as f32)));
    }
}
