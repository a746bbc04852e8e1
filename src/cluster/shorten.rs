//! Boundaries shortened to the locally shortest curves along edges: minimum cuts in narrow bands.
//!
//! Diffusion ([`super::smooth`]) leaves a boundary where the surface wants it, but as a zigzag by a face or two: it labels
//! face by face. Between two parts the labels of the faces within [`HOPS`] of their boundary are found again as a minimum
//! cut, whose cost is the length of the edges between the parts, less across a crease; so a boundary on a crease stays there,
//! and elsewhere it is the shortest one that the edges of the mesh offer so near. Parts are taken two by two, in order of
//! their labels, which is exact for two parts and a local optimum where three meet.
//!
//! Cost: the bands have 2 [`HOPS`] faces across, and flows through them need tens of passes; 100 bytes per node of the band of one pair.

use super::max_flow::MaxFlow;
use crate::base::{Cancel, Result};
use std::collections::BTreeSet;

/// How far from a boundary, in faces, it may be moved.
pub const HOPS: usize = 4;
/// The greatest weight of an edge is this many units.
const UNITS: f64 = (1 << 20) as f64;
const NONE: u32 = u32::MAX;

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
#[derive(Clone, Copy, Debug)]
pub struct BandGraph<'a> {
    /// First edge of each position (m + 1).
    pub start: &'a [u32],
    /// All edges.
    pub edges: &'a [BandEdge],
}

impl<'a> BandGraph<'a> {
    fn of(&self, position: u32) -> &'a [BandEdge] {
        &self.edges[self.start[position as usize] as usize..self.start[position as usize + 1] as usize]
    }
}

/// Shortens the boundaries between the `labels` (m) of a band's positions.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn shorten(graph: BandGraph<'_>, labels: &mut [u32], cancel: &Cancel) -> Result<()> {
    let greatest = graph.edges.iter().map(|edge| edge.weight).fold(0f32, f32::max);
    if !(greatest > 0. && greatest.is_finite()) {
        return Ok(());
    }
    // In f64, where no length of f32 is too short to be divided by.
    let scale = UNITS / f64::from(greatest);
    let mut place = vec![NONE; labels.len()];
    for [a, b] in neighbouring_labels(graph, labels) {
        cancel.check()?;
        let nodes = strip(graph, labels, [a, b], &mut place);
        let mut flow = flow_between(graph, labels, [a, b], &nodes, &place, scale);
        flow.run(cancel)?;
        for (k, &node) in nodes.iter().enumerate() {
            labels[node as usize] = if flow.is_on_source_side(k) { a } else { b };
            place[node as usize] = NONE;
        }
    }
    Ok(())
}

fn label_of(edge: &BandEdge, labels: &[u32]) -> u32 {
    if edge.inside { labels[edge.to as usize] } else { edge.to }
}

/// All pairs of labels that touch, ascending.
fn neighbouring_labels(graph: BandGraph<'_>, labels: &[u32]) -> BTreeSet<[u32; 2]> {
    let of = |position: u32| {
        let own = labels[position as usize];
        let others = graph.of(position).iter().map(|edge| label_of(edge, labels));
        others.filter(move |&other| other != own).map(move |other| [own.min(other), own.max(other)])
    };
    (0..labels.len() as u32).flat_map(of).collect()
}

/// The positions of label a or b within [`HOPS`] of the boundary between the two; `place` gets the number of each.
fn strip(graph: BandGraph<'_>, labels: &[u32], [a, b]: [u32; 2], place: &mut [u32]) -> Vec<u32> {
    let mut nodes = Vec::new();
    for i in 0..labels.len() as u32 {
        let own = labels[i as usize];
        let other = if own == a { b } else { a };
        if (own == a || own == b) && graph.of(i).iter().any(|edge| label_of(edge, labels) == other) {
            place[i as usize] = nodes.len() as u32;
            nodes.push(i);
        }
    }
    let mut ring = 0;
    for _ in 1..HOPS {
        let end = nodes.len();
        for k in ring..end {
            for edge in graph.of(nodes[k]).iter().filter(|edge| edge.inside) {
                let (to, own) = (edge.to as usize, labels[edge.to as usize]);
                if place[to] == NONE && (own == a || own == b) {
                    place[to] = nodes.len() as u32;
                    nodes.push(edge.to);
                }
            }
        }
        ring = end;
    }
    nodes
}

/// The flow from label a to label b through the strip of `nodes`.
fn flow_between(
    graph: BandGraph<'_>,
    labels: &[u32],
    [a, b]: [u32; 2],
    nodes: &[u32],
    place: &[u32],
    scale: f64,
) -> MaxFlow {
    let m = nodes.len();
    let units = |weight: f32| ((f64::from(weight.max(0.)) * scale) as i64).max(1);
    let (mut source, mut sink) = (vec![0; m], vec![0; m]);
    let (mut start, mut arcs) = (vec![0], Vec::with_capacity(3 * m));
    for (k, &node) in nodes.iter().enumerate() {
        for edge in graph.of(node) {
            let within = if edge.inside { place[edge.to as usize] } else { NONE };
            if within != NONE {
                arcs.push((within, units(edge.weight)));
            } else {
                let label = label_of(edge, labels);
                source[k] += if label == a { units(edge.weight) } else { 0 };
                sink[k] += if label == b { units(edge.weight) } else { 0 };
            }
        }
        start.push(arcs.len() as u32);
    }
    MaxFlow::new(source, sink, start, &arcs)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{Random, below, stream};

    /// A band `w` nodes long and `h` across, between fixed nodes of label 0 above and 1 below, with random weights.
    fn band(w: usize, h: usize, random: &mut Random) -> (Vec<u32>, Vec<BandEdge>) {
        let mut weights = std::collections::BTreeMap::new();
        let mut weight =
            |i: usize, j: usize| *weights.entry((i.min(j), i.max(j))).or_insert_with(|| (1 + below(random, 8)) as f32);
        let (mut start, mut edges) = (vec![0], Vec::new());
        for i in 0..w * h {
            let (x, y) = (i % w, i / w);
            let mut step = |other: Option<usize>, fixed: Option<u32>| match (other, fixed) {
                (Some(j), _) => edges.push(BandEdge { to: j as u32, inside: true, weight: weight(i, j) }),
                (None, Some(label)) => {
                    edges.push(BandEdge { to: label, inside: false, weight: weight(i, w * h + i + label as usize) });
                }
                _ => {}
            };
            step((y > 0).then(|| i - w), Some(0));
            step((x > 0).then(|| i - 1), None);
            step((x + 1 < w).then(|| i + 1), None);
            step((y + 1 < h).then(|| i + w), Some(1));
            start.push(edges.len() as u32);
        }
        (start, edges)
    }

    /// What boundaries cost; those between two positions twice.
    fn cost(graph: BandGraph<'_>, labels: &[u32]) -> f32 {
        let of = |i: u32| {
            let apart = graph.of(i).iter().filter(move |edge| label_of(edge, labels) != labels[i as usize]);
            apart.map(|edge| if edge.inside { 0.5 * edge.weight } else { edge.weight }).sum::<f32>()
        };
        (0..labels.len() as u32).map(of).sum()
    }

    #[test]
    fn two_parts_get_the_cheapest_boundary_of_all() {
        let (w, h) = (4, 3);
        for seed in 0..40 {
            let mut random = stream(seed, "bands");
            let (start, edges) = band(w, h, &mut random);
            let graph = BandGraph { start: &start, edges: &edges };
            let mut labels: Vec<u32> = (0..w * h).map(|_| below(&mut random, 2) as u32).collect();
            shorten(graph, &mut labels, &Cancel::default()).unwrap();
            let all = (0..1u32 << (w * h)).map(|bits| (0..w * h).map(|i| bits >> i & 1).collect::<Vec<u32>>());
            let least = all.map(|labels| cost(graph, &labels)).fold(f32::INFINITY, f32::min);
            assert_eq!(cost(graph, &labels), least, "{seed}");
        }
    }

    #[test]
    fn several_parts_get_a_boundary_that_is_no_longer() {
        for seed in 0..20 {
            let mut random = stream(seed, "several");
            let (start, edges) = band(30, 9, &mut random);
            let graph = BandGraph { start: &start, edges: &edges };
            let mut labels: Vec<u32> = (0..270).map(|_| below(&mut random, 4) as u32).collect();
            let before = cost(graph, &labels);
            shorten(graph, &mut labels, &Cancel::default()).unwrap();
            assert!(cost(graph, &labels) < before, "{seed}");
        }
    }

    /// Capacities overflowed where 2²⁰ divided by the longest edge was no finite f32.
    #[test]
    fn the_tiniest_boundary_is_shortened_like_any_other() {
        let mut random = stream(0, "tiny");
        let (start, mut edges) = band(12, 6, &mut random);
        let labels: Vec<u32> = (0..72).map(|_| below(&mut random, 2) as u32).collect();
        let mut plain = labels.clone();
        shorten(BandGraph { start: &start, edges: &edges }, &mut plain, &Cancel::default()).unwrap();
        edges.iter_mut().for_each(|edge| edge.weight *= f32::MIN_POSITIVE / 8.);
        let mut tiny = labels;
        shorten(BandGraph { start: &start, edges: &edges }, &mut tiny, &Cancel::default()).unwrap();
        assert_eq!(tiny, plain);
    }

    #[test]
    fn a_boundary_is_moved_no_farther_than_told() {
        // Weights fall towards the lower end, where the cheapest boundary is.
        let (w, h) = (6, 20);
        let (start, mut edges) = band(w, h, &mut stream(0, "far"));
        for i in 0..w * h {
            let fall = |j: u32| 1. + (2 * h - i / w - j as usize / w) as f32;
            let own = &mut edges[start[i] as usize..start[i + 1] as usize];
            own.iter_mut().for_each(|edge| edge.weight = if edge.inside { fall(edge.to) } else { 100. });
        }
        let graph = BandGraph { start: &start, edges: &edges };
        let mut labels: Vec<u32> = (0..w * h).map(|i| u32::from(i / w >= 8)).collect();
        shorten(graph, &mut labels, &Cancel::default()).unwrap();
        let expected: Vec<u32> = (0..w * h).map(|i| u32::from(i / w >= 8 + HOPS)).collect();
        assert_eq!(labels, expected);
    }
}
