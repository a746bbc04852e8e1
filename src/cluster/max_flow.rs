//! Maximum flow, and the minimum cut that it ends at.
//!
//! Dinic's algorithm (1970) on integers. Levels are counted from the sink: until an arc is full, every path along
//! descending levels reaches the sink, and one phase augments paths of all lengths. The nodes that the source reaches
//! in the residual graph are the same whatever the order of the paths, so cuts are repeatable. This is our own code
//! because crates for maximum flow take adjacency matrices or maps. It cuts bands along boundaries
//! ([`super::shorten`]) and the inside of a surface ([`super::parts`]).
//!
//! Cost: 32 bytes per node and 16 per arc; passes over both, tens of them in narrow bands.

use crate::base::{Cancel, Result};

const NONE: u32 = u32::MAX;

/// An arc: the node it leads to, the position of its twin, which leads back, in the list of all arcs, and its residual
/// capacity.
#[derive(Clone, Copy, Debug)]
struct Arc {
    to: u32,
    twin: u32,
    residual: i64,
}

/// A flow from a source to a sink through m nodes.
#[derive(Clone, Debug)]
pub struct MaxFlow {
    /// First arc of each node (m + 1).
    start: Vec<u32>,
    arcs: Vec<Arc>,
    /// Residual capacity from the source into each node.
    source: Vec<i64>,
    /// Residual capacity from each node into the sink.
    sink: Vec<i64>,
    /// Number of arcs to the sink in the last search, [`NONE`] if it is out of reach; in the end, from the source.
    level: Vec<u32>,
}

impl MaxFlow {
    /// The capacities from the source into each node and from each node into the sink (m), the first arc of each node
    /// (m + 1), and all arcs: the node that each leads to, and its capacity. An arc without a twin carries nothing.
    pub fn new(source: Vec<i64>, sink: Vec<i64>, start: Vec<u32>, arcs: &[(u32, i64)]) -> Self {
        let m = source.len();
        let arcs = arcs.iter().map(|&(to, residual)| Arc { to, twin: NONE, residual }).collect();
        let mut flow = Self { start, arcs, source, sink, level: vec![NONE; m] };
        // Parallel arcs come in the same order from both sides.
        for k in 0..m {
            for arc in flow.arcs_of(k) {
                let Arc { to, twin, .. } = flow.arcs[arc];
                if twin != NONE {
                    continue;
                }
                let free = |back: &usize| {
                    let other = flow.arcs[*back];
                    other.to as usize == k && *back != arc && other.twin == NONE
                };
                if let Some(back) = flow.arcs_of(to as usize).find(free) {
                    (flow.arcs[arc].twin, flow.arcs[back].twin) = (back as u32, arc as u32);
                } else {
                    flow.arcs[arc].residual = 0;
                }
            }
        }
        flow
    }

    /// Whether node `k` is on the source's side of the minimum cut that is nearest to the source, once the flow
    /// has [run](MaxFlow::run).
    pub fn is_on_source_side(&self, k: usize) -> bool {
        self.level[k] != NONE
    }

    fn arcs_of(&self, node: usize) -> std::ops::Range<usize> {
        self.start[node] as usize..self.start[node + 1] as usize
    }

    /// Finds a maximum flow.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn run(&mut self, cancel: &Cancel) -> Result<()> {
        // Paths through a single node.
        for (source, sink) in self.source.iter_mut().zip(&mut self.sink) {
            let through = (*source).min(*sink);
            *source -= through;
            *sink -= through;
        }
        let (mut next, mut queue, mut path) = (vec![0u32; self.level.len()], Vec::new(), Vec::new());
        while self.search_from_sink(&mut queue) {
            cancel.check()?;
            next.copy_from_slice(&self.start[..self.level.len()]);
            for root in 0..self.level.len() {
                if self.source[root] > 0 && self.level[root] != NONE {
                    self.push(root, &mut next, &mut path);
                }
            }
        }
        self.search_from_source(&mut queue);
        Ok(())
    }

    /// Levels by breadth-first search from the sink; returns whether the source reaches it.
    fn search_from_sink(&mut self, queue: &mut Vec<u32>) -> bool {
        let reached =
            self.search(queue, |flow, k| flow.sink[k] > 0, |flow, arc| flow.arcs[arc.twin as usize].residual > 0);
        reached.iter().any(|&node| self.source[node as usize] > 0)
    }

    /// Levels by breadth-first search from the source.
    fn search_from_source(&mut self, queue: &mut Vec<u32>) {
        self.search(queue, |flow, k| flow.source[k] > 0, |_, arc| arc.residual > 0);
    }

    /// Levels by breadth-first search from the nodes that are `first`, along the arcs that are `open`; returns the
    /// nodes that are reached.
    fn search<'q>(
        &mut self,
        queue: &'q mut Vec<u32>,
        first: impl Fn(&Self, usize) -> bool,
        open: impl Fn(&Self, Arc) -> bool,
    ) -> &'q [u32] {
        self.level.fill(NONE);
        queue.clear();
        for k in 0..self.level.len() {
            if first(self, k) {
                self.level[k] = 0;
                queue.push(k as u32);
            }
        }
        let mut head = 0;
        while let Some(&node) = queue.get(head) {
            head += 1;
            for arc in self.arcs_of(node as usize) {
                let arc = self.arcs[arc];
                if self.level[arc.to as usize] == NONE && arc.twin != NONE && open(self, arc) {
                    self.level[arc.to as usize] = self.level[node as usize] + 1;
                    queue.push(arc.to);
                }
            }
        }
        queue
    }

    /// Augments paths from `root` to the sink until nothing more can flow into it from the source, or no path is left.
    fn push(&mut self, root: usize, next: &mut [u32], path: &mut Vec<u32>) {
        path.clear();
        let mut node = root;
        loop {
            if self.sink[node] > 0 {
                let least = path.iter().map(|&arc| self.arcs[arc as usize].residual).min().unwrap_or(i64::MAX);
                let amount = least.min(self.source[root]).min(self.sink[node]);
                self.source[root] -= amount;
                self.sink[node] -= amount;
                for &arc in &*path {
                    let arc = &mut self.arcs[arc as usize];
                    arc.residual -= amount;
                    let twin = arc.twin as usize;
                    self.arcs[twin].residual += amount;
                }
                if self.source[root] == 0 {
                    return;
                }
                // Continue before the first arc that is full.
                if let Some(full) = path.iter().position(|&arc| self.arcs[arc as usize].residual == 0) {
                    node = self.tail(path[full]);
                    path.truncate(full);
                    continue;
                }
            }
            let end = self.start[node + 1];
            let open = (next[node]..end).find(|&arc| {
                let Arc { to, residual, .. } = self.arcs[arc as usize];
                residual > 0 && self.level[to as usize] != NONE && self.level[to as usize] + 1 == self.level[node]
            });
            next[node] = open.unwrap_or(end);
            match open {
                Some(arc) => {
                    path.push(arc);
                    node = self.arcs[arc as usize].to as usize;
                }
                None => {
                    // A dead end: go back, and skip the arc that led here.
                    let Some(arc) = path.pop() else { return };
                    node = self.tail(arc);
                    next[node] += 1;
                }
            }
        }
    }

    /// The node that `arc`, which has a twin, leads from.
    fn tail(&self, arc: u32) -> usize {
        self.arcs[self.arcs[arc as usize].twin as usize].to as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{below, stream};

    #[test]
    fn the_cut_is_the_cheapest_of_all() {
        let mut random = stream(0, "flow");
        for _ in 0..100 {
            let m = 1 + below(&mut random, 7);
            let mut ends: Vec<[usize; 2]> =
                (0..2 * m).map(|_| [below(&mut random, m), below(&mut random, m)]).collect();
            ends.retain(|[i, j]| i != j);
            let limits: Vec<i64> = ends.iter().map(|_| below(&mut random, 9) as i64).collect();
            let [source, sink] = [0, 1].map(|_| (0..m).map(|_| below(&mut random, 9) as i64).collect::<Vec<i64>>());
            let (mut start, mut arcs) = (vec![0], Vec::new());
            for k in 0..m {
                for ([i, j], limit) in ends.iter().zip(&limits) {
                    arcs.extend((*i == k).then_some((*j as u32, *limit)));
                    arcs.extend((*j == k).then_some((*i as u32, *limit)));
                }
                start.push(arcs.len() as u32);
            }
            let cost = |on_source: &dyn Fn(usize) -> bool| {
                let ends_of = (0..m).map(|k| if on_source(k) { sink[k] } else { source[k] }).sum::<i64>();
                let cut = ends.iter().zip(&limits).filter(|([i, j], _)| on_source(*i) != on_source(*j));
                ends_of + cut.map(|(_, limit)| limit).sum::<i64>()
            };
            let mut flow = MaxFlow::new(source.clone(), sink.clone(), start, &arcs);
            flow.run(&Cancel::default()).unwrap();
            let least = (0..1u32 << m).map(|sides| cost(&|k| sides >> k & 1 == 1)).min().unwrap();
            assert_eq!(cost(&|k| flow.is_on_source_side(k)), least);
        }
    }
}
