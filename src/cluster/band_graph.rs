//! The dual graph of the narrow band along the boundaries, with what a boundary costs on each edge.
//!
//! A boundary costs its length, and less across a crease, so that one on a crease stays there. What counts as a
//! crease depends on the mesh: turning that most of the band's edges have is the shape's roundness, or noise, and
//! would only make a boundary ragged. On a rough mesh the faces' own turning counts, averaged along the edges
//! ([`super::crease`]).
//!
//! Cost: a pass over the edges of the band's nodes, which looks up their neighbours by bisection; 90 bytes per node, on
//! a rough mesh twice as many.

use super::crease::{self, OwnTurning};
use crate::base::Result;
use crate::graph::csr::near_ranges;
use crate::graph::{Csr, SharedEdges};
use crate::spectral::exp::exp;
use crate::store::Run;

/// Share of the band's edges that are no creases.
const USUAL: f64 = 0.75;
/// Turning cost (β|θ|), above that of a usual edge, at which a boundary costs 1/e of what it costs on a flat edge.
const CREASE: f32 = 1.;
const CHUNK: usize = 1 << 12;

/// An edge of a band's node: to another position in the band, or to a fixed node, of which only the label matters.
#[derive(Clone, Copy, Debug)]
pub struct BandEdge {
    /// Position in the band, or label.
    pub to: u32,
    /// Whether it is a position.
    pub inside: bool,
    /// The length of the boundary there, in any unit; less across creases.
    pub weight: f32,
}

/// The edges of all positions of a band.
#[derive(Clone, Debug)]
pub struct BandGraph {
    /// First edge of each position (m + 1).
    pub start: Vec<u32>,
    /// All edges.
    pub edges: Vec<BandEdge>,
}

/// The graph of all nodes, as a band is taken from it.
#[derive(Clone, Copy)]
pub struct WeightedLengths<'a> {
    /// The graph under the weights that fronts use.
    pub steps: Csr<'a>,
    /// Centroid distance of each step, in the frame (nnz).
    pub centroid_distance: &'a [f32],
    /// Length of the edge that each step crosses, in the frame (nnz).
    pub edge: SharedEdges<'a>,
    /// From the frame to units of √(area).
    pub unit: f32,
    /// The faces' own turning, on a rough mesh.
    pub own: Option<OwnTurning<'a>>,
}

impl BandGraph {
    /// The graph of the nodes of `band` (ascending), with fixed nodes of these `labels` (n) around them.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn of(graph: WeightedLengths<'_>, band: &[u32], labels: &[u32], run: &Run) -> Result<Self> {
        let WeightedLengths { steps, centroid_distance, edge, unit, own } = graph;
        let chunks = run.map_ranges(band.len(), CHUNK, |range| {
            // This chunk's rows, and the next one's while it is summed up.
            let soon = || near_ranges(&band[range.start..(range.end + CHUNK).min(band.len())]);
            let entries = || soon().map(|nodes| steps.starts.entries_of(nodes));
            run.will_need_few(steps.indices, entries());
            run.will_need_few(steps.weights, entries());
            run.will_need_few(centroid_distance, entries());
            run.will_need_few(labels, soon());
            let (mut counts, mut list) = (Vec::with_capacity(range.len()), Vec::with_capacity(3 * range.len()));
            let (mut turning, mut crease) = (Vec::with_capacity(3 * range.len()), Vec::new());
            for &node in &band[range] {
                let span = steps.span(node);
                counts.push(span.len() as u32);
                for e in span {
                    let length = edge.length(node, e);
                    let (weight, other) = (length.abs(), steps.indices[e]);
                    match own {
                        Some(own) => crease.push(own.edge(node, other, length)),
                        None => turning.push((steps.weights[e] - centroid_distance[e] * unit).max(0.)),
                    }
                    list.push(match band.binary_search(&other) {
                        Ok(position) => BandEdge { to: position as u32, inside: true, weight },
                        Err(_) => BandEdge { to: labels[other as usize], inside: false, weight },
                    });
                }
            }
            Ok((counts, list, turning, crease))
        })?;
        let entries = chunks.iter().map(|chunk| chunk.1.len()).sum();
        let mut of_band = Self { start: vec![0], edges: Vec::with_capacity(entries) };
        let (mut end, mut turning, mut crease) = (0, Vec::with_capacity(entries), Vec::new());
        for (counts, list, turns, creases) in chunks {
            of_band.start.extend(counts.iter().map(|&count| {
                end += count;
                end
            }));
            of_band.edges.extend(list);
            turning.extend(turns);
            crease.extend(creases);
        }
        if own.is_some() {
            let inside = |e: usize| Some(&of_band.edges[e]).filter(|edge| edge.inside).map(|edge| edge.to);
            turning = crease::averaged(&of_band.start, inside, &crease, run)?;
        }
        let usual = usual_turning(&mut turning.clone());
        for (edge, turning) in of_band.edges.iter_mut().zip(turning) {
            edge.weight *= exp(-(turning - usual).max(0.) / CREASE);
        }
        Ok(of_band)
    }

    /// The edges of a position.
    pub fn around(&self, position: u32) -> &[BandEdge] {
        &self.edges[self.start[position as usize] as usize..self.start[position as usize + 1] as usize]
    }
}

impl BandEdge {
    /// The label where this edge leads to, with the `labels` of the band's positions (m).
    pub fn label(&self, labels: &[u32]) -> u32 {
        if self.inside { labels[self.to as usize] } else { self.to }
    }
}

/// The turning that [`USUAL`] of the edges do not exceed; reorders them.
fn usual_turning(turning: &mut [f32]) -> f32 {
    let usual = (turning.len().saturating_sub(1) as f64 * USUAL) as usize;
    if turning.is_empty() { 0. } else { *turning.select_nth_unstable_by(usual, f32::total_cmp).1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quarter_of_the_edges_turn_more_than_usual() {
        let mut turning: Vec<f32> = (0..101).map(|i| (i * 37 % 101) as f32).collect();
        assert_eq!(usual_turning(&mut turning), 75.);
        assert_eq!(usual_turning(&mut [3.]), 3.);
        assert_eq!(usual_turning(&mut []), 0.);
    }
}
