//! The vertex whose embedding is nearest to a point: a k-d tree over the mesh, or over a sample of a large one.
//!
//! Up to [`EXACT`] vertices are all in the tree. For a larger mesh every s-th is, and a search over the vertex graph
//! starts from the nearest of these and expands the nearest known vertices until that gains nothing: bounded memory at
//! any size, and the same result whatever the budget. Memory: 12 + 4 k bytes per vertex in the tree; 1 to 3 µs per
//! query.

use crate::base::Result;
use crate::graph::Csr;
use crate::spectral::nystrom::Point;
use crate::store::budget::Grant;
use crate::store::{Context, WorkDir};
use kiddo::SquaredEuclidean;
use kiddo::immutable::float::kdtree::ImmutableKdTree;
use std::cmp::Ordering;
use std::num::NonZero;

/// Maximum number of vertices of a mesh that are all in the tree.
pub const EXACT: usize = 1 << 21;

/// Number of unsuccessful expansions after which a search ends.
const MOST_FAILURES: usize = 24;

/// Maximum number of neighbours examined per vertex. Vertices of meshes have about six; at the tip of a fan of a
/// million faces a search would never end.
const MOST_AROUND: usize = 64;

/// A vertex found, and its squared distance in the embedding.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbour {
    /// The vertex.
    pub vertex: u32,
    /// Squared distance.
    pub square: f32,
}

impl Neighbour {
    /// Nearest first; at equal distances the smallest vertex.
    #[inline]
    fn order(&self, other: &Self) -> Ordering {
        self.square.total_cmp(&other.square).then(self.vertex.cmp(&other.vertex))
    }
}

/// Expands the nearest known vertices, starting at `start`, until `most_failures` of them have added none to the
/// nearest `count`, which it returns. `around` lists the neighbours of a vertex, `square` gives its squared distance.
#[inline(always)]
pub(super) fn walk<'g>(
    start: Neighbour,
    count: usize,
    most_failures: usize,
    around: impl Fn(u32) -> &'g [u32],
    square: impl Fn(u32) -> f32,
) -> Vec<Neighbour> {
    let (mut known, mut seen, mut idle) = (vec![(start, false)], vec![start.vertex], 0);
    while let Some(at) = known.iter().position(|(_, looked)| !looked).filter(|_| idle < most_failures) {
        known[at].1 = true;
        idle += 1;
        for &vertex in around(known[at].0.vertex).iter().take(MOST_AROUND) {
            if seen.contains(&vertex) {
                continue;
            }
            seen.push(vertex);
            let found = Neighbour { vertex, square: square(vertex) };
            let place = known.partition_point(|(other, _)| other.order(&found).is_lt());
            known.insert(place, (found, false));
            if place < count {
                idle = 0;
            }
        }
    }
    known.truncate(count);
    known.into_iter().map(|(found, _)| found).collect()
}

/// A tree with a fixed number of dimensions.
trait Search: Send + Sync {
    fn nearest(&self, point: &Point) -> Neighbour;
    fn k_nearest(&self, point: &Point, count: usize) -> Vec<Neighbour>;
}

struct Tree<const K: usize>(ImmutableKdTree<f32, u32, K, 32>);

impl<const K: usize> Search for Tree<K> {
    fn nearest(&self, point: &Point) -> Neighbour {
        let found = self.0.nearest_one::<SquaredEuclidean>(&first(point));
        Neighbour { vertex: found.item, square: found.distance }
    }

    fn k_nearest(&self, point: &Point, count: usize) -> Vec<Neighbour> {
        let count = NonZero::new(count).unwrap_or(NonZero::<usize>::MIN);
        let found = self.0.nearest_n::<SquaredEuclidean>(&first(point), count);
        let mut found: Vec<Neighbour> =
            found.iter().map(|f| Neighbour { vertex: f.item, square: f.distance }).collect();
        found.sort_by(Neighbour::order);
        found
    }
}

fn first<const K: usize>(point: &Point) -> [f32; K] {
    std::array::from_fn(|i| point[i])
}

/// Embedded vertices that can be searched.
pub struct EmbeddingSearch<'a> {
    points: &'a [Point],
    graph: Csr<'a>,
    /// Vertices from one in the tree to the next.
    step: usize,
    tree: Box<dyn Search>,
    _grant: Grant,
}

/// Squared distance.
#[inline]
pub(super) fn square(a: &Point, b: &Point) -> f32 {
    let mut sum = 0.;
    for i in 0..a.len() {
        sum += (a[i] - b[i]) * (a[i] - b[i]);
    }
    sum
}

impl<'a> EmbeddingSearch<'a> {
    /// Builds the tree over `points` (n, of which the first `dimensions` coordinates are used), vertices of `graph`.
    ///
    /// # Errors
    /// [`crate::base::Error::Memory`], [`crate::base::Error::Io`].
    pub fn new(points: &'a [Point], graph: Csr<'a>, dimensions: usize, context: Context<'_>) -> Result<Self> {
        Self::with_limit(points, graph, dimensions, EXACT, context)
    }

    /// The same with at most `limit` vertices in the tree.
    ///
    /// # Errors
    /// As [`EmbeddingSearch::new`].
    pub fn with_limit(
        points: &'a [Point],
        graph: Csr<'a>,
        dimensions: usize,
        limit: usize,
        context: Context<'_>,
    ) -> Result<Self> {
        let step = points.len().div_ceil(limit.max(1)).max(1);
        let bytes = (points.len().div_ceil(step) * (16 + 4 * dimensions)) as u64;
        let grant = context.run.budget.take("the search tree", bytes, bytes)?;
        let tree: Box<dyn Search> = match dimensions {
            0 | 1 => build::<1>(points, step, context.work)?,
            2 => build::<2>(points, step, context.work)?,
            3 => build::<3>(points, step, context.work)?,
            4 => build::<4>(points, step, context.work)?,
            5 => build::<5>(points, step, context.work)?,
            6 => build::<6>(points, step, context.work)?,
            7 => build::<7>(points, step, context.work)?,
            _ => build::<8>(points, step, context.work)?,
        };
        Ok(Self { points, graph, step, tree, _grant: grant })
    }

    /// The nearest vertex; of several at the same position, always the same.
    pub fn nearest(&self, point: &Point) -> Neighbour {
        if self.step == 1 {
            return self.tree.nearest(point);
        }
        self.explored(point, 1)[0]
    }

    /// Up to `count` of the nearest, in ascending order of distance.
    pub fn k_nearest(&self, point: &Point, count: usize) -> Vec<Neighbour> {
        if self.step == 1 { self.tree.k_nearest(point, count) } else { self.explored(point, count) }
    }

    /// The nearest `count`, by walking from the nearest in the tree.
    fn explored(&self, point: &Point, count: usize) -> Vec<Neighbour> {
        let mut start = self.tree.nearest(point);
        start.vertex *= self.step as u32;
        let around = |vertex: u32| &self.graph.indices[self.graph.span(vertex)];
        walk(start, count, MOST_FAILURES, around, |vertex| square(point, &self.points[vertex as usize]))
    }
}

/// A tree over every `step`-th point.
fn build<const K: usize>(points: &[Point], step: usize, work: &WorkDir) -> Result<Box<dyn Search>> {
    // Mapped, so that only the tree itself is allocated.
    let mut array = work.array::<f32>("tree.tmp", &[points.len().div_ceil(step), K])?;
    for (row, point) in array.data().chunks_exact_mut(K).zip(points.iter().step_by(step)) {
        row.copy_from_slice(&point[..K]);
    }
    let tree = ImmutableKdTree::new_from_slice(bytemuck::cast_slice::<f32, [f32; K]>(array.data()));
    Ok(Box::new(Tree::<K>(tree)))
}
