//! From a refined map to a match for every vertex.
//!
//! All of B is transformed to A's functions ([`super::functional::ToA`]). For small meshes every vertex of A is then
//! compared with every one of B. For large ones ([`EXHAUSTIVE`]) the search is local: neighbours on A have neighbouring
//! matches on B, so from the match of a finished vertex the search walks over B's graph to the nearest vertex, always
//! expanding the nearest known one, until [`MOST_FAILURES`] expansions have found none nearer. The first vertices of
//! each chunk start at the match of the nearest of [`SEEDS`]`[0]` vertices of A, which is searched for among `[1]`
//! vertices of B; so it costs little if neighbours lie far apart in the file. Such a match also reveals where one error
//! has led to the next: if it is nearer than what was found, another walk starts there. For 28,000 vertices of two cats
//! this finds what exhaustive comparison finds (mean square 11.005 against 11.002; without it 37).
//!
//! Cost: exhaustive, n_A n_B k multiplications, 10 to 20 per nanosecond and thread; local, about 10 µs per vertex, and
//! on disk 4 k bytes per vertex of B and 4 per vertex of A (8 while the nearest seeds are found).

use super::functional::{Targets, ToA};
use super::matches::{Match, Pair};
use super::points::SurfacePoint;
use super::search::{Neighbour, walk};
use crate::base::Result;
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::simd::{SimdKernel, dispatch};
use crate::base::vector::square_apart;
use crate::distance::voronoi;
use crate::graph::{Csr, VertexGraph};
use crate::spectral::local::LocalBasis;
use crate::store::{Context, MappedSlice};
use nalgebra::DMatrix;
use std::ops::Range;

/// Number of vertex pairs up to which all are compared.
pub const EXHAUSTIVE: u64 = 1 << 27;
/// Number of unsuccessful expansions after which a local search ends.
const MOST_FAILURES: usize = 6;
/// Number of vertices of A that are matched first, and of B among which their matches are searched.
const SEEDS: [usize; 2] = [1 << 14, 1 << 12];
/// Seeds per chunk.
const SEEDED: usize = 1 << 8;
/// Vertices per chunk.
const CHUNK: usize = 1 << 12;
/// Number of vertices compared with a chunk at a time.
const SLAB: usize = 1 << 10;
/// No vertex.
const NOBODY: u32 = u32::MAX;

/// Vertices of a mesh in the coordinates of A's functions.
#[derive(Clone, Copy)]
struct Placed<'a> {
    values: &'a [f32],
    dimensions: usize,
    /// Number of floats from one vertex to the next.
    stride: usize,
    graph: Csr<'a>,
}

struct Square<'a>(&'a [f32], &'a [f32]);

impl SimdKernel for Square<'_> {
    type Output = f32;

    #[inline(always)]
    fn run(self) -> f32 {
        square_apart::<16>(self.0, self.1)
    }
}

/// A local search from a vertex.
struct Walk<'a> {
    placed: Placed<'a>,
    query: &'a [f32],
    start: u32,
    count: usize,
    most_failures: usize,
}

impl SimdKernel for Walk<'_> {
    type Output = Vec<Neighbour>;

    #[inline(always)]
    fn run(self) -> Vec<Neighbour> {
        let Self { placed, query, start, count, most_failures } = self;
        let square = |vertex: u32| square_apart::<16>(query, placed.at(vertex));
        let around = |vertex: u32| &placed.graph.indices[placed.graph.span(vertex)];
        walk(Neighbour { vertex: start, square: square(start) }, count, most_failures, around, square)
    }
}

impl<'a> Placed<'a> {
    #[inline(always)]
    fn at(&self, vertex: u32) -> &'a [f32] {
        &self.values[vertex as usize * self.stride..][..self.dimensions]
    }

    /// The nearest `count` vertices found by walking from `start`.
    fn walk(self, query: &[f32], start: u32, count: usize, most_failures: usize) -> Vec<Neighbour> {
        dispatch(Walk { placed: self, query, start, count, most_failures })
    }

    fn targets(self, vertices: impl ExactSizeIterator<Item = u32>) -> Targets {
        Targets::new(vertices.map(|v| self.at(v)), self.dimensions)
    }

    /// The nearest of all vertices to each of `queries`, slab by slab.
    fn compared(self, queries: &[&[f32]]) -> Vec<Neighbour> {
        let n = self.values.len() / self.stride.max(1);
        let mut best = vec![Neighbour { vertex: 0, square: f32::INFINITY }; queries.len()];
        for first in (0..n).step_by(SLAB) {
            let targets = self.targets(first as u32..(first + SLAB).min(n) as u32);
            let found = targets.nearest(queries.iter().copied());
            for ((best, query), &at) in best.iter_mut().zip(queries).zip(&found) {
                let vertex = first as u32 + at;
                let square = self.square(query, vertex);
                if square < best.square {
                    *best = Neighbour { vertex, square };
                }
            }
        }
        best
    }

    fn square(self, query: &[f32], vertex: u32) -> f32 {
        dispatch(Square(query, self.at(vertex)))
    }
}

/// Two meshes in the same coordinates, ready for matching.
pub struct RefinedPair<'a> {
    a: Placed<'a>,
    b: Placed<'a>,
    graph_a: &'a VertexGraph,
    graph_b: &'a VertexGraph,
    /// Whether all pairs are compared.
    all: bool,
    /// For each vertex of A the vertex of B where its search starts; empty if all pairs are compared.
    starts: MappedSlice<u32>,
    /// Factors that make lengths on A and B comparable.
    units: [f64; 2],
}

/// For each vertex of A the match of the nearest seed, where its search starts; vertex 0 if no seed is connected with
/// it.
fn starts(a: Placed<'_>, b: Placed<'_>, context: Context<'_>) -> Result<MappedSlice<u32>> {
    let (run, [n_a, n_b]) = (context.run, [a, b].map(|placed| placed.graph.len()));
    let some = |n: usize, most: usize| (0..n as u32).step_by(n.div_ceil(most).max(1)).collect::<Vec<u32>>();
    let (of_a, of_b) = (some(n_a, SEEDS[0]), some(n_b, SEEDS[1]));
    let targets = b.targets(of_b.iter().copied());
    let matched = |k: usize, (): &mut ()| {
        let here = &of_a[chunk_range(of_a.len(), SEEDED, k)];
        let queries: Vec<&[f32]> = here.iter().map(|&v| a.at(v)).collect();
        let found = targets.nearest(queries.iter().copied());
        let walk = |(query, &at): (&&[f32], &u32)| b.walk(query, of_b[at as usize], 1, 4 * MOST_FAILURES)[0].vertex;
        Ok(queries.iter().zip(&found).map(walk).collect::<Vec<u32>>())
    };
    let of_seed = run.map_chunks(chunk_count(of_a.len(), SEEDED), || (), matched)?.concat();
    let mut array = context.work.array::<u32>("starts.npy", &[n_a])?;
    {
        let mut field = context.work.array::<f32>("starts_field.tmp", &[n_a])?;
        voronoi::nearest_source(a.graph, &of_a, field.data(), array.data(), run)?;
    }
    run.fill_each(array.data(), CHUNK, |_, seed: u32| of_seed.get(seed as usize).copied().unwrap_or(0))?;
    array.finish(false)
}

/// Transforms the vertices of `basis` to A's coordinates by the map `c` (its functions × those of A), into the file
/// `name`.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub fn transformed(basis: &LocalBasis, c: &DMatrix<f64>, name: &str, context: Context<'_>) -> Result<MappedSlice<f32>> {
    let (n, k) = (basis.values.len() / basis.count.max(1), c.ncols());
    let to_a = ToA::new(c);
    let mut array = context.work.array::<f32>(name, &[n, k])?;
    let fill = |chunk: usize, out: &mut [f32], (): &mut ()| {
        for (v, out) in chunk_range(n, CHUNK, chunk).zip(out.chunks_exact_mut(k)) {
            to_a.apply(basis.at(v), out);
        }
        Ok(())
    };
    context.run.fill_chunks(array.data(), CHUNK * k.max(1), || (), fill)?;
    array.finish(false)
}

impl<'a> RefinedPair<'a> {
    /// Vertices of A and of B in the same coordinates, of which only the first `dimensions` are used: values, vertex by
    /// vertex, and how many each has. Up to `exhaustive` pairs, all are compared; beyond, a file of `context` stores
    /// where searches start.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
    pub fn new(
        coordinates: [(&'a [f32], usize); 2],
        dimensions: usize,
        graphs: [&'a VertexGraph; 2],
        exhaustive: u64,
        context: Context<'_>,
    ) -> Result<Self> {
        let [graph_a, graph_b] = graphs;
        let (n_a, n_b) = (graph_a.len(), graph_b.len());
        let [a, b] = [0, 1].map(|s| {
            let (values, stride) = coordinates[s];
            Placed { values, dimensions, stride, graph: graphs[s].csr() }
        });
        let all = n_a as u64 * n_b as u64 <= exhaustive;
        let starts = if all { MappedSlice::empty() } else { starts(a, b, context)? };
        let units = graphs.map(VertexGraph::unit);
        Ok(Self { a, b, graph_a, graph_b, all, starts, units })
    }

    /// The same with lengths compared in other units than those of either area.
    #[must_use]
    pub fn with_units(self, units: [f64; 2]) -> Self {
        Self { units, ..self }
    }

    /// The nearest vertex to `v` of A, walking from `from`, the match of a neighbour. If the match of the nearest seed
    /// is nearer, an error was propagated to `from`, as from a leg onto the chest next to it.
    fn walk_from(&self, v: u32, from: u32) -> Neighbour {
        let (query, start) = (self.a.at(v), self.starts[v as usize]);
        let found = self.b.walk(query, from, 1, MOST_FAILURES)[0];
        if start == from || self.b.square(query, start) >= found.square {
            return found;
        }
        let other = self.b.walk(query, start, 1, MOST_FAILURES)[0];
        if other.square < found.square { other } else { found }
    }

    /// The nearest vertex to each vertex of `range`, by walking over B.
    fn walked(&self, range: Range<usize>) -> Vec<Neighbour> {
        let first = range.start;
        let mut found = vec![Neighbour { vertex: NOBODY, square: f32::INFINITY }; range.len()];
        let mut waiting = std::collections::VecDeque::new();
        for v in range.clone() {
            if found[v - first].vertex != NOBODY {
                continue;
            }
            found[v - first] = self.b.walk(self.a.at(v as u32), self.starts[v], 1, 2 * MOST_FAILURES)[0];
            waiting.push_back(v as u32);
            while let Some(here) = waiting.pop_front() {
                let from = found[here as usize - first].vertex;
                for &next in &self.a.graph.indices[self.a.graph.span(here)] {
                    if range.contains(&(next as usize)) && found[next as usize - first].vertex == NOBODY {
                        found[next as usize - first] = self.walk_from(next, from);
                        waiting.push_back(next);
                    }
                }
            }
        }
        found
    }
}

impl<'a> RefinedPair<'a> {
    /// For each of `matches` the nearest point in the triangles around it ([`super::points`]), into the file `name`.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
    pub fn points(&self, matches: &[Match], name: &str, context: Context<'_>) -> Result<MappedSlice<SurfacePoint>> {
        super::points::points(matches, |v| self.a.at(v), |v| self.b.at(v), self.graph_b, name, context)
    }
}

impl Pair for RefinedPair<'_> {
    fn graphs(&self) -> [&VertexGraph; 2] {
        [self.graph_a, self.graph_b]
    }

    fn units(&self) -> [f64; 2] {
        self.units
    }

    fn nearest(&self, range: Range<usize>) -> Vec<Neighbour> {
        if !self.all {
            return self.walked(range);
        }
        self.b.compared(&range.map(|v| self.a.at(v as u32)).collect::<Vec<_>>())
    }

    fn round_trip(&self, pairs: &[(u32, u32)]) -> Vec<u32> {
        if !self.all {
            let walk = |&(v, target): &(u32, u32)| self.a.walk(self.b.at(target), v, 1, MOST_FAILURES)[0].vertex;
            return pairs.iter().map(walk).collect();
        }
        let queries: Vec<&[f32]> = pairs.iter().map(|(_, target)| self.b.at(*target)).collect();
        self.a.compared(&queries).into_iter().map(|found| found.vertex).collect()
    }

    fn at_same_place(&self, v: u32, w: u32) -> bool {
        self.a.at(v) == self.a.at(w)
    }

    fn k_nearest(&self, v: u32, known: u32, count: usize) -> Vec<Neighbour> {
        self.b.walk(self.a.at(v), known, count, 4 * MOST_FAILURES)
    }
}
