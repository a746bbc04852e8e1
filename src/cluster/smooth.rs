//! Boundaries smoothed: labels diffused over a narrow band, then the strongest taken.
//!
//! Where the surface turns, the front that labels the narrow band meets on the crease; where it does not, it meets where
//! noise decides, and the boundary is ragged. A few sweeps of diffusion (Merriman, Bence and Osher's method of moving a
//! curve by its curvature) straighten it within [`REACH`] of where it was. Edges across a crease carry little, so
//! a boundary on one stays there. Nodes outside the band, and interiors of parts, are fixed: no part vanishes.
//!
//! Cost: at most [`SWEEPS`] sweeps over the band's nodes and edges; 130 bytes per node of the band, which
//! is at most [`FACES`] faces wide, so a fraction of a per cent of a large mesh.

use super::shorten::{BandEdge, BandGraph, shorten};
use crate::base::Result;
use crate::base::parallel::chunk_range;
use crate::graph::csr::near_ranges;
use crate::graph::{Csr, SharedEdges};
use crate::spectral::exp::exp;
use crate::store::Run;

/// Half the width of the band at the most, in units of √(area).
pub const REACH: f32 = 0.01;
/// … and in mean steps from face to face.
pub const FACES: f32 = 12.;
/// … and at least, so that a boundary can move by a face to either side of a coarse mesh.
pub const LEAST_FACES: f32 = 2.;
/// Sweeps at the most.
const SWEEPS: usize = 40;
/// Turning cost (β|θ|) at which an edge carries 1/e of what a flat one does.
const CREASE: f32 = 1.;
const CHUNK: usize = 1 << 12;
const NONE: u32 = u32::MAX;

/// A node's strongest labels and their strengths; a fixed node has one of strength 1. Two are in ascending order, so that
/// neighbours between the same parts have the same ones at the same positions; three with the strongest first.
#[derive(Clone, Copy, Debug)]
struct LabelMixture {
    label: [u32; 3],
    strength: [f32; 3],
}

impl LabelMixture {
    fn pure(label: u32) -> Self {
        Self { label: [label, NONE, NONE], strength: [1., 0., 0.] }
    }

    fn two(label: [u32; 2], strength: [f32; 2]) -> Self {
        let [a, b] = if label[0] < label[1] { [0, 1] } else { [1, 0] };
        Self { label: [label[a], label[b], NONE], strength: [strength[a], strength[b], 0.] }
    }

    /// The strongest label; the lower one at a tie.
    fn strongest(&self) -> u32 {
        self.label[usize::from(self.strength[1] > self.strength[0])]
    }
}

/// A small tally of labels; the first three of most strength are kept.
#[derive(Default)]
struct LabelTally(Vec<(u32, f32)>);

impl LabelTally {
    fn add(&mut self, mixture: &LabelMixture, weight: f32) {
        for (&label, &strength) in mixture.label.iter().zip(&mixture.strength) {
            if label == NONE {
                break;
            }
            match self.0.iter_mut().find(|entry| entry.0 == label) {
                Some(entry) => entry.1 += weight * strength,
                None => self.0.push((label, weight * strength)),
            }
        }
    }

    /// The mix of unit strength; the lower label wins a tie.
    fn take(&mut self) -> Option<LabelMixture> {
        self.0.sort_unstable_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        self.0.truncate(3);
        let sum: f32 = self.0.iter().map(|entry| entry.1).sum();
        let mut mixture = LabelMixture { label: [NONE; 3], strength: [0.; 3] };
        for (k, (label, strength)) in self.0.drain(..).enumerate() {
            (mixture.label[k], mixture.strength[k]) = (label, strength / sum);
        }
        if let LabelMixture { label: [a, b, NONE], strength: [x, y, _] } = mixture {
            mixture = LabelMixture::two([a, b], [x, y]);
        }
        (sum > 0.).then_some(mixture)
    }
}

/// The mixture of `own` and of what `edges` lead to, where no more than two labels meet: the same numbers as by a
/// [`LabelTally`], a few times faster. Most of a band has one boundary within reach.
fn of_two(own: &LabelMixture, edges: &[BandEdge], before: &[LabelMixture]) -> Option<LabelMixture> {
    let mut label = [own.label[0], own.label[1]];
    let (mut strength, mut all) = ([0f32; 2], 0f32);
    let mut add_all = |mixture: &LabelMixture, weight: f32| {
        if mixture.label == [label[0], label[1], NONE] {
            strength[0] += weight * mixture.strength[0];
            strength[1] += weight * mixture.strength[1];
            return Some(());
        }
        for k in 0..2 {
            let (of, much) = (mixture.label[k], weight * mixture.strength[k]);
            if of == NONE {
                return Some(());
            }
            if of == label[0] {
                strength[0] += much;
            } else if label[1] == NONE || of == label[1] {
                label[1] = of;
                strength[1] += much;
            } else {
                return None;
            }
        }
        (mixture.label[2] == NONE).then_some(())
    };
    for edge in edges {
        let fixed = LabelMixture::pure(edge.to);
        add_all(if edge.inside { &before[edge.to as usize] } else { &fixed }, edge.weight)?;
        all += edge.weight;
    }
    add_all(own, all)?;
    let [a, b] = strength;
    if label[1] == NONE {
        return (a > 0.).then(|| LabelMixture::pure(label[0]));
    }
    let sum = a + b;
    (sum > 0. && sum < f32::INFINITY).then(|| LabelMixture::two(label, [a / sum, b / sum]))
}

/// The edges of all nodes of the band.
struct DiffusionGraph {
    start: Vec<u32>,
    list: Vec<BandEdge>,
}

impl DiffusionGraph {
    fn of(graph: WeightedLengths<'_>, band: &[u32], labels: &[u32], run: &Run) -> Result<Self> {
        let WeightedLengths { steps, centroid_distance, edge, unit, .. } = graph;
        let chunks = run.map_ranges(band.len(), CHUNK, |range| {
            // This chunk's rows, and the next one's while it is summed up.
            let soon = || near_ranges(&band[range.start..(range.end + CHUNK).min(band.len())]);
            let entries = || soon().map(|nodes| steps.starts.entries_of(nodes));
            run.will_need_few(steps.indices, entries());
            run.will_need_few(steps.weights, entries());
            run.will_need_few(centroid_distance, entries());
            run.will_need_few(labels, soon());
            let (mut counts, mut list) = (Vec::with_capacity(range.len()), Vec::with_capacity(3 * range.len()));
            for &node in &band[range] {
                let span = steps.span(node);
                counts.push(span.len() as u32);
                for e in span {
                    let turning = (steps.weights[e] - centroid_distance[e] * unit).max(0.);
                    let weight = edge.length(node, e).abs() * exp(-turning / CREASE);
                    let other = steps.indices[e];
                    list.push(match band.binary_search(&other) {
                        Ok(position) => BandEdge { to: position as u32, inside: true, weight },
                        Err(_) => BandEdge { to: labels[other as usize], inside: false, weight },
                    });
                }
            }
            Ok((counts, list))
        })?;
        let mut edges = Self { start: vec![0], list: Vec::with_capacity(chunks.iter().map(|c| c.1.len()).sum()) };
        let mut end = 0;
        for (counts, list) in chunks {
            edges.start.extend(counts.iter().map(|&count| {
                end += count;
                end
            }));
            edges.list.extend(list);
        }
        Ok(edges)
    }
}

/// The graph as smoothing needs it.
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
    /// Mean centroid distance, in units of √(area).
    pub mean: f32,
}

/// Smooths `labels` (n) over the nodes of `band` (ascending).
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn smooth(graph: WeightedLengths<'_>, band: &[u32], labels: &mut [u32], run: &Run) -> Result<()> {
    let mean = graph.mean;
    let reach = REACH.min(FACES * mean);
    let sweeps = if mean > 0. { (0.5 * (reach / mean).powi(2)).round() as usize } else { 0 };
    if band.is_empty() {
        return Ok(());
    }
    let edges = DiffusionGraph::of(graph, band, labels, run)?;
    let mut now: Vec<LabelMixture> = band.iter().map(|&node| LabelMixture::pure(labels[node as usize])).collect();
    let mut next = now.clone();
    for _ in 0..sweeps.min(SWEEPS) {
        let before = &now[..];
        run.fill_chunks(&mut next, CHUNK, LabelTally::default, |k, out, tally| {
            for (slot, b) in out.iter_mut().zip(chunk_range(band.len(), CHUNK, k)) {
                let around = &edges.list[edges.start[b] as usize..edges.start[b + 1] as usize];
                if let Some(mixture) = of_two(&before[b], around, before) {
                    *slot = mixture;
                    continue;
                }
                let mut all = 0.;
                for edge in around {
                    if edge.inside {
                        tally.add(&before[edge.to as usize], edge.weight);
                    } else {
                        tally.add(&LabelMixture::pure(edge.to), edge.weight);
                    }
                    all += edge.weight;
                }
                // As much of its own: without it, opposite labels of a regular mesh would swap each sweep.
                tally.add(&before[b], all);
                *slot = tally.take().unwrap_or(before[b]);
            }
            Ok(())
        })?;
        std::mem::swap(&mut now, &mut next);
    }
    let mut strongest: Vec<u32> = now.iter().map(LabelMixture::strongest).collect();
    shorten(BandGraph { start: &edges.start, edges: &edges.list }, &mut strongest, &run.cancel)?;
    for (&node, label) in band.iter().zip(strongest) {
        labels[node as usize] = label;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{below, stream, unit};

    #[test]
    fn two_labels_are_tallied_as_any_number_is() {
        let mut random = stream(1, "mixes");
        let mut mixed = 0;
        for _ in 0..2000 {
            let mut draw = || {
                let (a, b, s) = (below(&mut random, 3) as u32, below(&mut random, 3) as u32, unit(&mut random) as f32);
                if a == b { LabelMixture::pure(a) } else { LabelMixture::two([a, b], [s, 1. - s]) }
            };
            let before: Vec<LabelMixture> = (0..4).map(|_| draw()).collect();
            let edges: Vec<BandEdge> = (1..4)
                .map(|k| BandEdge { to: k % 3, inside: below(&mut random, 2) == 0, weight: unit(&mut random) as f32 })
                .collect();
            let (mut tally, mut all) = (LabelTally::default(), 0.);
            for edge in &edges {
                let fixed = LabelMixture::pure(edge.to);
                tally.add(if edge.inside { &before[edge.to as usize] } else { &fixed }, edge.weight);
                all += edge.weight;
            }
            tally.add(&before[0], all);
            let labels = tally.0.len();
            let expected = tally.take().unwrap();
            match of_two(&before[0], &edges, &before) {
                Some(mixture) => assert_eq!((mixture.label, mixture.strength), (expected.label, expected.strength)),
                None => assert_eq!(labels, 3),
            }
            mixed += usize::from(labels == 2);
        }
        assert!(mixed > 200, "{mixed}");
    }
}
