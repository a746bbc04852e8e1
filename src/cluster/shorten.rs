//! Boundaries shortened to the locally shortest curves along edges: minimum cuts in narrow bands.
//!
//! Diffusion ([`super::smooth`]) leaves a boundary where the surface wants it, but as a zigzag by a face or two: it labels
//! face by face. Between two parts the labels of the faces within [`HOPS`] of their boundary are found again as a minimum
//! cut, whose cost is the length of the edges between the parts, less across a crease; so a boundary on a crease stays there,
//! and elsewhere it is the shortest one that the edges of the mesh offer so near. Parts are taken two by two, in order of
//! their labels, which is exact for two parts and a local optimum where three meet.
//!
//! Maximum flow by Dinic's algorithm (1970), in whole numbers: the faces that the source still reaches are the same
//! whatever the order of the paths, so labels are repeatable. Own code, since crates for maximum flow take adjacency
//! matrices or maps. Cost: the bands have 2 [`HOPS`] faces across, and flows through them need tens of passes; 100 bytes per
//! node of the band of one pair.

use crate::base::Cancel;
use crate::base::Result;
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
        let mut flow = Flow::between(graph, labels, [a, b], &nodes, &place, scale);
        flow.run(cancel)?;
        for (k, &node) in nodes.iter().enumerate() {
            labels[node as usize] = if flow.level[k] != NONE { a } else { b };
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

/// A flow from label a to label b through a strip.
struct Flow {
    /// First arc of each node (m + 1).
    start: Vec<u32>,
    /// Where each arc leads.
    to: Vec<u32>,
    /// Its position in the list of arcs of the node that it leads to.
    twin: Vec<u32>,
    /// What may still flow along it.
    left: Vec<i64>,
    /// What may still flow into each node from a.
    source: Vec<i64>,
    /// What may still flow from each node into b.
    sink: Vec<i64>,
    /// Arcs from a, by the last search; [`NONE`] where a does not reach.
    level: Vec<u32>,
}

impl Flow {
    fn between(
        graph: BandGraph<'_>,
        labels: &[u32],
        [a, b]: [u32; 2],
        nodes: &[u32],
        place: &[u32],
        scale: f64,
    ) -> Self {
        let m = nodes.len();
        let units = |weight: f32| ((f64::from(weight.max(0.)) * scale) as i64).max(1);
        let mut flow = Self {
            start: vec![0],
            to: Vec::with_capacity(3 * m),
            twin: Vec::new(),
            left: Vec::with_capacity(3 * m),
            source: vec![0; m],
            sink: vec![0; m],
            level: vec![NONE; m],
        };
        for (k, &node) in nodes.iter().enumerate() {
            for edge in graph.of(node) {
                let within = if edge.inside { place[edge.to as usize] } else { NONE };
                if within != NONE {
                    flow.to.push(within);
                    flow.left.push(units(edge.weight));
                } else {
                    let label = label_of(edge, labels);
                    flow.source[k] += if label == a { units(edge.weight) } else { 0 };
                    flow.sink[k] += if label == b { units(edge.weight) } else { 0 };
                }
            }
            flow.start.push(flow.to.len() as u32);
        }
        // Both directions of an edge are in the graph, parallel ones in the same order.
        let mut taken = vec![0u32; flow.to.len()];
        flow.twin = vec![NONE; flow.to.len()];
        for k in 0..m {
            for arc in flow.arcs(k) {
                if flow.twin[arc] != NONE {
                    continue;
                }
                let back = flow.arcs(flow.to[arc] as usize).find(|&back| {
                    flow.to[back] as usize == k && taken[back] == 0 && back != arc && flow.twin[back] == NONE
                });
                if let Some(back) = back {
                    (flow.twin[arc], flow.twin[back]) = (back as u32, arc as u32);
                    (taken[arc], taken[back]) = (1, 1);
                } else {
                    flow.left[arc] = 0;
                }
            }
        }
        flow
    }

    fn arcs(&self, node: usize) -> std::ops::Range<usize> {
        self.start[node] as usize..self.start[node + 1] as usize
    }

    /// Finds a maximum flow; `level` then tells what the source still reaches.
    fn run(&mut self, cancel: &Cancel) -> Result<()> {
        // What flows through one node alone.
        for (source, sink) in self.source.iter_mut().zip(&mut self.sink) {
            let through = (*source).min(*sink);
            *source -= through;
            *sink -= through;
        }
        let (mut next, mut queue, mut path) = (vec![0u32; self.level.len()], Vec::new(), Vec::new());
        while self.search(&mut queue) {
            cancel.check()?;
            next.copy_from_slice(&self.start[..self.level.len()]);
            for root in 0..self.level.len() {
                while self.source[root] > 0 && self.level[root] == 0 && self.push(root, &mut next, &mut path) {}
            }
        }
        Ok(())
    }

    /// Levels by breadth; whether the sink is reached.
    fn search(&mut self, queue: &mut Vec<u32>) -> bool {
        self.level.fill(NONE);
        queue.clear();
        for (k, &source) in self.source.iter().enumerate() {
            if source > 0 {
                self.level[k] = 0;
                queue.push(k as u32);
            }
        }
        let (mut head, mut reached) = (0, false);
        while let Some(&node) = queue.get(head) {
            head += 1;
            let node = node as usize;
            reached |= self.sink[node] > 0;
            for arc in self.arcs(node) {
                let to = self.to[arc] as usize;
                if self.left[arc] > 0 && self.level[to] == NONE {
                    self.level[to] = self.level[node] + 1;
                    queue.push(to as u32);
                }
            }
        }
        reached
    }

    /// Pushes along one path from `root` to the sink; false where there is none any more.
    fn push(&mut self, root: usize, next: &mut [u32], path: &mut Vec<u32>) -> bool {
        path.clear();
        let mut node = root;
        loop {
            if self.sink[node] > 0 {
                let least = path.iter().map(|&arc| self.left[arc as usize]).min().unwrap_or(i64::MAX);
                let much = least.min(self.source[root]).min(self.sink[node]);
                self.source[root] -= much;
                self.sink[node] -= much;
                for &arc in &*path {
                    self.left[arc as usize] -= much;
                    self.left[self.twin[arc as usize] as usize] += much;
                }
                return true;
            }
            let end = self.start[node + 1];
            let open = (next[node]..end).find(|&arc| {
                let arc = arc as usize;
                self.left[arc] > 0 && self.level[self.to[arc] as usize] == self.level[node] + 1
            });
            next[node] = open.unwrap_or(end);
            match open {
                Some(arc) => {
                    path.push(arc);
                    node = self.to[arc as usize] as usize;
                }
                None => {
                    // A dead end: back, and past the arc that led here.
                    let Some(arc) = path.pop() else { return false };
                    node = self.to[self.twin[arc as usize] as usize] as usize;
                    next[node] += 1;
                }
            }
        }
    }
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
