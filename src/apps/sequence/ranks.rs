//! Ranks of vertices: breadth-first and reverse Cuthill–McKee searches, principal axes, Hilbert's curve, any
//! coordinate, and random.
//!
//! Searches (Cuthill, McKee 1969; George, Liu 1979): each component is entered at a peripheral vertex found by repeated
//! searches (George and Liu's pseudo-peripheral vertex); components follow each other by their first vertices. Cost:
//! about five searches, one thread; 8 bytes per vertex in mapped files, accessed as locally as the mesh is numbered. A
//! search's queue is the order itself. All other ranks are external sorts within the budget.

use super::sorting::{Scatter, ordered, ranks_by_key};
use crate::base::Result;
use crate::base::moments::{principal_axes, products};
use crate::base::vector::{dot, finite};
use crate::graph::order::hilbert;
use crate::graph::{Frame, VertexAdjacency};
use crate::mesh::Mesh;
use crate::store::{Context, MappedSlice, Run};
use xxhash_rust::xxh3::xxh3_64_with_seed;

/// Vertices between checks of the stop flag.
const STOP_CHECK: usize = 1 << 16;
/// Maximum number of searches for a start.
const SEARCHES: usize = 8;

struct Search<'a> {
    graph: &'a VertexAdjacency,
    /// The number of the search that visited a vertex last.
    met: &'a mut [u32],
    /// Vertices in order of visit, of all components.
    queue: &'a mut [u32],
    searches: u32,
    by_degree: bool,
    run: &'a Run<'a>,
}

impl Search<'_> {
    fn degree(&self, v: u32) -> usize {
        self.graph.neighbours(v).len()
    }

    /// Searches from `start`, filling the queue from `base` on; returns its end, the number of levels, and the start of
    /// the last level.
    fn from(&mut self, start: u32, base: usize) -> Result<(usize, usize, usize)> {
        self.searches += 1;
        let graph = self.graph;
        let (mut head, mut end, mut levels, mut last) = (base, base + 1, 0, base);
        self.queue[base] = start;
        self.met[start as usize] = self.searches;
        let mut level_end = end;
        while head < end {
            if head % STOP_CHECK == 0 {
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

    /// Orders the component of `seed` from a peripheral start; returns its end.
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

/// The rank of each vertex: breadth-first, or with `cuthill_mckee` by ascending degree, reversed.
fn search_ranks(
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
        if v % STOP_CHECK == 0 {
            context.run.cancel.check()?;
        }
        if search.met[v] == 0 {
            end = search.component(v as u32, end)?;
        }
    }
    let scatter = Scatter::new(name, n, context)?;
    let mut out = scatter.producer();
    for (place, &v) in search.queue[..end].iter().enumerate() {
        let rank = if cuthill_mckee { n - 1 - place } else { place };
        scatter.put(&mut out, v, rank as u32)?;
    }
    out.finish()?;
    drop((met, queue));
    scatter.finish()
}

const CHUNK: usize = 1 << 15;

fn add<const N: usize>(sums: &mut [f64; N], terms: [f64; N]) {
    sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
}

/// Ranks along the longest principal axis of the vertices, ties along the second.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Memory`], [`crate::base::Error::Cancelled`].
pub fn pca_ranks(name: &str, mesh: &Mesh, context: Context<'_>) -> Result<MappedSlice<u32>> {
    let (positions, frame) = (&mesh.positions, Frame::of(mesh, context.run)?);
    let n = positions.len();
    let place = |v: usize| frame.place(positions.get(v as u32));
    let chunks = context.run.map_ranges(n, CHUNK, |range| {
        let (mut sum, mut second, mut count) = ([0.; 3], [0.; 6], 0u64);
        for p in range.map(place).filter(|&p| finite(p)) {
            count += 1;
            add(&mut sum, p);
            add(&mut second, products(p));
        }
        Ok((sum, second, count))
    })?;
    let (mut sum, mut second, mut count) = ([0.; 3], [0.; 6], 0u64);
    for (s, p, c) in chunks {
        count += c;
        add(&mut sum, s);
        add(&mut second, p);
    }
    let (m, of_sum) = (count.max(1) as f64, products(sum));
    let (_, axes) = principal_axes(std::array::from_fn(|k| second[k] / m - of_sum[k] / (m * m)));
    let key = |v: usize| {
        let p = place(v);
        (0, dot(axes[0], p), dot(axes[1], p) as f32)
    };
    ranks_along(name, n, key, context)
}

/// Ranks along Hilbert's curve.
///
/// # Errors
/// As [`pca_ranks`].
pub fn hilbert_ranks(name: &str, mesh: &Mesh, context: Context<'_>) -> Result<MappedSlice<u32>> {
    let (positions, frame) = (&mesh.positions, Frame::of(mesh, context.run)?);
    let key = |v: usize| {
        let place = hilbert::place_of(frame.place(positions.get(v as u32)));
        [(place >> 32) as u32, place as u32, 0, 0]
    };
    ranks_by_key(name, positions.len(), key, context)
}

/// Random ranks, from the run's seed.
///
/// # Errors
/// As [`pca_ranks`].
pub fn random_ranks(name: &str, vertices: usize, context: Context<'_>) -> Result<MappedSlice<u32>> {
    let key = |v: usize| {
        let draw = xxh3_64_with_seed(&(v as u64).to_le_bytes(), context.run.seed);
        [(draw >> 32) as u32, draw as u32, 0, 0]
    };
    ranks_by_key(name, vertices, key, context)
}

/// Breadth-first ranks of the vertices of `graph`, as the array `name` of `work`.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Memory`], [`crate::base::Error::Cancelled`].
pub fn bfs_ranks(name: &str, graph: &VertexAdjacency, context: Context<'_>) -> Result<MappedSlice<u32>> {
    search_ranks(name, graph, false, context)
}

/// Reverse Cuthill–McKee ranks.
///
/// # Errors
/// As [`bfs_ranks`].
pub fn rcm_ranks(name: &str, graph: &VertexAdjacency, context: Context<'_>) -> Result<MappedSlice<u32>> {
    search_ranks(name, graph, true, context)
}

/// Ranks of `n` vertices by component, then coordinate, ties by a second one, then by number.
///
/// # Errors
/// As [`bfs_ranks`].
pub fn ranks_along(
    name: &str,
    n: usize,
    key: impl Fn(usize) -> (u32, f64, f32) + Sync,
    context: Context<'_>,
) -> Result<MappedSlice<u32>> {
    let words = |v: usize| {
        let (component, first, second) = key(v);
        let ([high, low], [next, _]) = (ordered(first), ordered(f64::from(second)));
        [component, high, low, next]
    };
    ranks_by_key(name, n, words, context)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;
    use crate::store::WorkDir;

    /// Reference: textbook Cuthill–McKee, quadratic.
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
        // A second component, and vertices 66, 67 without a face.
        faces.push([63, 64, 65]);
        let mesh = Mesh::from_slices(&[[0.; 3]; 68], &faces).unwrap();
        let run = Run::new(&());
        let graph = VertexAdjacency::build(&mesh, Context::new(&work, &run)).unwrap();
        for reverse in [false, true] {
            let found = search_ranks("r.tmp", &graph, reverse, Context::new(&work, &run)).unwrap();
            for (rank, &v) in oracle(&graph, reverse).iter().enumerate() {
                assert_eq!(found[v as usize] as usize, rank, "{reverse}");
            }
        }
    }
}
