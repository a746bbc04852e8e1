//! Breadth-first and reverse Cuthill–McKee ranks of vertices (Cuthill, McKee 1969; George, Liu 1979).
//!
//! Each component is entered at a vertex as far out as repeated searches find (George and Liu's pseudo-peripheral
//! vertex); components follow each other by their first vertices. Cost: about five searches, one thread; 8 B a vertex in
//! mapped files, read and written as locally as the mesh is numbered. A search is a queue that is the order itself.

use crate::base::Result;
use crate::graph::VertexAdjacency;
use crate::store::{Context, MappedSlice, Run};

/// Vertices between looks at the stop flag.
const CHUNK: usize = 1 << 16;
/// Searches for a start, at the most.
const SEARCHES: usize = 8;

struct Search<'a> {
    graph: &'a VertexAdjacency,
    /// The number of the search that met a vertex last.
    met: &'a mut [u32],
    /// Vertices in order of meeting, of all components.
    queue: &'a mut [u32],
    searches: u32,
    by_degree: bool,
    run: &'a Run<'a>,
}

impl Search<'_> {
    fn degree(&self, v: u32) -> usize {
        self.graph.neighbours(v).len()
    }

    /// Searches from `start`, filling the queue from `base` on; tells its end, the levels, and where the last level began.
    fn from(&mut self, start: u32, base: usize) -> Result<(usize, usize, usize)> {
        self.searches += 1;
        let graph = self.graph;
        let (mut head, mut end, mut levels, mut last) = (base, base + 1, 0, base);
        self.queue[base] = start;
        self.met[start as usize] = self.searches;
        let mut level_end = end;
        while head < end {
            if head % CHUNK == 0 {
                self.run.cancel.check()?;
            }
            let v = self.queue[head];
            head += 1;
            let before = end;
            for &w in graph.neighbours(v) {
                if self.met[w as usize] != self.searches {
                    self.met[w as usize] = self.searches;
                    self.queue[end] = w;
                    end += 1;
                }
            }
            if self.by_degree {
                self.queue[before..end].sort_unstable_by_key(|&w| (graph.neighbours(w).len(), w));
            }
            if head == level_end && head < end {
                (levels, last, level_end) = (levels + 1, head, end);
            }
        }
        Ok((end, levels, last))
    }

    /// Orders the component of `seed` from a start far out; tells its end.
    fn component(&mut self, seed: u32, base: usize) -> Result<usize> {
        let (mut end, mut levels, mut last) = self.from(seed, base)?;
        for _ in 0..SEARCHES {
            let candidate = self.queue[last..end].iter().copied().min_by_key(|&v| (self.degree(v), v)).unwrap_or(seed);
            let before = levels;
            (end, levels, last) = self.from(candidate, base)?;
            if levels <= before {
                break;
            }
        }
        Ok(end)
    }
}

/// The rank of each vertex: breadth-first, or with `cuthill_mckee` by ascending degrees, and back to front.
pub(super) fn ranks(
    name: &str,
    graph: &VertexAdjacency,
    cuthill_mckee: bool,
    context: Context<'_>,
) -> Result<MappedSlice<u32>> {
    let n = graph.len();
    let mut queue = context.work.array::<u32>("queue.tmp", &[n])?;
    let mut met = context.work.array::<u32>("met.tmp", &[n])?;
    let (met_slice, queue_slice) = (&mut met.data()[..], &mut queue.data()[..]);
    let mut search =
        Search { graph, met: met_slice, queue: queue_slice, searches: 0, by_degree: cuthill_mckee, run: context.run };
    let mut end = 0;
    for v in 0..n {
        if v % CHUNK == 0 {
            context.run.cancel.check()?;
        }
        if search.met[v] == 0 {
            end = search.component(v as u32, end)?;
        }
    }
    let scatter = super::sorting::Scatter::new(name, n, context)?;
    let mut out = scatter.producer();
    for (place, &v) in search.queue[..end].iter().enumerate() {
        let rank = if cuthill_mckee { n - 1 - place } else { place };
        scatter.put(&mut out, v, rank as u32)?;
    }
    out.finish()?;
    drop((met.finish(false)?, queue.finish(false)?));
    ["queue.tmp", "met.tmp"].iter().for_each(|name| context.work.remove(name));
    scatter.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;
    use crate::store::WorkDir;

    /// Cuthill–McKee as the textbook says it, quadratic.
    fn oracle(graph: &VertexAdjacency, reverse: bool) -> Vec<u32> {
        let n = graph.len();
        let levels = |start: u32| {
            let mut level = vec![usize::MAX; n];
            level[start as usize] = 0;
            let mut depth = 0;
            loop {
                let mut grown = false;
                for v in 0..n as u32 {
                    if level[v as usize] == depth {
                        for &w in graph.neighbours(v) {
                            if level[w as usize] == usize::MAX {
                                level[w as usize] = depth + 1;
                                grown = true;
                            }
                        }
                    }
                }
                if !grown {
                    return (level, depth);
                }
                depth += 1;
            }
        };
        let mut order: Vec<u32> = Vec::new();
        for seed in 0..n as u32 {
            if order.contains(&seed) {
                continue;
            }
            let (mut start, mut depth) = (seed, levels(seed).1);
            loop {
                let (level, _) = levels(start);
                let next = (0..n as u32).filter(|&v| level[v as usize] == depth);
                start = next.min_by_key(|&v| (graph.neighbours(v).len(), v)).unwrap();
                let deeper = levels(start).1;
                if deeper <= depth {
                    break;
                }
                depth = deeper;
            }
            let mut at = order.len();
            order.push(start);
            while at < order.len() {
                let mut next: Vec<u32> = graph.neighbours(order[at]).to_vec();
                next.retain(|w| !order.contains(w));
                if reverse {
                    next.sort_by_key(|&w| (graph.neighbours(w).len(), w));
                }
                order.extend(next);
                at += 1;
            }
        }
        if reverse {
            order.reverse();
        }
        order
    }

    #[test]
    fn orders_are_the_textbooks() {
        let dir = tempfile::tempdir().unwrap();
        let work = WorkDir::temporary(dir.path()).unwrap();
        let id = |x: u32, y: u32| (x * 9 + y) * 37 % 63;
        let mut faces: Vec<[u32; 3]> = Vec::new();
        for x in 0..6 {
            for y in 0..8 {
                faces.push([id(x, y), id(x + 1, y), id(x + 1, y + 1)]);
                faces.push([id(x, y), id(x + 1, y + 1), id(x, y + 1)]);
            }
        }
        // A second component, and vertices 66, 67 of no face.
        faces.push([63, 64, 65]);
        let mesh = Mesh::from_slices(&[[0.; 3]; 68], &faces).unwrap();
        let run = Run::new(&());
        let graph = VertexAdjacency::build(&mesh, Context::new(&work, &run)).unwrap();
        for reverse in [false, true] {
            let found = ranks("r.tmp", &graph, reverse, Context::new(&work, &run)).unwrap();
            for (rank, &v) in oracle(&graph, reverse).iter().enumerate() {
                assert_eq!(found[v as usize] as usize, rank, "{reverse}");
            }
        }
    }
}
