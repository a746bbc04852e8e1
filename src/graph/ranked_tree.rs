//! The nearest point among those of lower rank: a k-d tree that stores the least rank in each of its boxes.
//!
//! A component is joined to the nearest face of all larger ones, so each query has a different set of candidates. A
//! tree to which one component after the other is added would work too, but on one thread, in the order of the areas,
//! which jumps through space, and with rebalancing: 7 µs per component. Here all points are sorted into one tree first.
//! A query skips boxes that hold no lower rank or nothing nearer than the best so far; queries run on any thread, in
//! any order. *Rejected:* a library's tree that lists points by distance until one has a lower rank: for the largest
//! components that is nearly all of them.
//!
//! Each level halves the points, so boxes need no pointers. Cost: 20 bytes per point, 2 to 4 per point for boxes, both
//! in the work directory (in memory where the budget has room), and 0.1 to 1 µs per query.

use crate::base::Result;
use crate::base::bounds::Bounds;
use crate::base::parallel::run_concurrently;
use crate::base::vector::{MapEach, dot, minus};
use crate::store::npy::{ArrayMut, Item};
use crate::store::{Context, Run};
use bytemuck::{Pod, Zeroable};
use std::ops::Range;

/// Maximum number of points in a leaf.
const LEAF: usize = 16;

/// A point with a rank.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct RankedPoint {
    pub at: [f32; 3],
    /// The node at this position.
    pub node: u32,
    pub rank: u32,
}

impl Item for RankedPoint {
    const DESCR: &'static str = "[('at','<f4',(3,)),('node','<u4'),('rank','<u4')]";
}

/// Bounds of the points in a box.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
struct RankedBox {
    bounds: Bounds,
    least_rank: u32,
}

impl Item for RankedBox {
    const DESCR: &'static str = "[('low','<f4',(3,)),('high','<f4',(3,)),('rank','<u4')]";
}

impl RankedBox {
    const EMPTY: Self = Self { bounds: Bounds::EMPTY, least_rank: u32::MAX };

    fn of(points: &[RankedPoint]) -> Self {
        let one = |point: &RankedPoint| Self { bounds: Bounds::at(point.at), least_rank: point.rank };
        points.iter().map(one).fold(Self::EMPTY, Self::with)
    }

    fn with(self, other: Self) -> Self {
        Self { bounds: self.bounds.with(&other.bounds), least_rank: self.least_rank.min(other.least_rank) }
    }

    fn widest_axis(&self) -> usize {
        let width = |axis: usize| self.bounds.high[axis] - self.bounds.low[axis];
        (1..3).fold(0, |widest, axis| if width(axis) > width(widest) { axis } else { widest })
    }
}

/// Searchable points.
#[derive(Debug)]
pub(super) struct RankedTree {
    points: ArrayMut<RankedPoint>,
    /// Box 1 has all points, boxes 2 i and 2 i + 1 the halves of box i; box 0 is unused, and half of the array are
    /// leaves.
    boxes: ArrayMut<RankedBox>,
}

/// The range of the points of box `i` among all `n`.
fn span(i: usize, n: usize) -> Range<usize> {
    let depth = i.ilog2();
    let start = |j: usize| ((j as u64 * n as u64) >> depth) as usize;
    let j = i - (1 << depth);
    start(j)..start(j + 1)
}

impl RankedTree {
    /// Sorts `points` into a tree.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
    pub fn new(mut points: ArrayMut<RankedPoint>, context: Context<'_>) -> Result<Self> {
        let n = points.items().len();
        let leaves = n.div_ceil(LEAF).next_power_of_two();
        sort(points.data(), 1, leaves, n, context.run)?;
        let mut boxes = context.work.array::<RankedBox>("bridge_boxes.tmp", &[2 * leaves])?;
        let sorted = points.items();
        let (inner, lowest) = boxes.data().split_at_mut(leaves);
        context.run.fill_each(lowest, 1 << 10, |j, _| RankedBox::of(&sorted[span(leaves + j, n)]))?;
        for i in (1..leaves).rev() {
            let below = |j: usize| if j < leaves { inner[j] } else { lowest[j - leaves] };
            inner[i] = below(2 * i).with(below(2 * i + 1));
        }
        inner[0] = RankedBox::EMPTY;
        Ok(Self { points, boxes })
    }

    /// The squared distance and the node of the point nearest to `at` among those of rank below `rank`; of several
    /// equally near ones always the same. `None` if there is none.
    pub fn nearest_below(&self, rank: u32, at: [f32; 3]) -> Option<(f32, u32)> {
        let (points, boxes) = (self.points.items(), self.boxes.items());
        let leaves = boxes.len() / 2;
        let mut best = (f32::INFINITY, None);
        // At most one box per level waits.
        let mut waiting = [(0f32, 0usize); usize::BITS as usize];
        (waiting[0], waiting[1]) = ((0., 0), (boxes[1].bounds.square_from(at), 1));
        let mut height = 2;
        while height > 1 {
            height -= 1;
            let (least, i) = waiting[height];
            if boxes[i].least_rank >= rank || (least >= best.0 && best.1.is_some()) {
                continue;
            }
            if i >= leaves {
                for point in &points[span(i, points.len())] {
                    let away = minus(at, point.at);
                    let distance = dot(away, away);
                    if point.rank < rank && (best.1.is_none() || distance < best.0) {
                        best = (distance, Some(point.node));
                    }
                }
                continue;
            }
            let mut below = [2 * i, 2 * i + 1].map_each(|j| (boxes[j].bounds.square_from(at), j));
            // The nearer one is pushed last, so that it is searched first.
            if below[0].0 <= below[1].0 {
                below.swap(0, 1);
            }
            (waiting[height], waiting[height + 1]) = (below[0], below[1]);
            height += 2;
        }
        best.1.map(|node| (best.0, node))
    }
}

/// Sorts `points`, those of box `i`, into the order of the boxes below it; there are `leaves` leaves and `n` points in
/// all.
fn sort(points: &mut [RankedPoint], i: usize, leaves: usize, n: usize, run: &Run) -> Result<()> {
    if i >= leaves {
        return Ok(());
    }
    run.cancel.check()?;
    let axis = RankedBox::of(points).widest_axis();
    let half = span(2 * i, n).len();
    if half > 0 && half < points.len() {
        points.select_nth_unstable_by(half, |a, b| a.at[axis].total_cmp(&b.at[axis]));
    }
    let (left, right) = points.split_at_mut(half);
    let below = |points, i| sort(points, i, leaves, n, run);
    // As many boxes in parallel as there are threads.
    if i < run.threads {
        let (left, right) = run_concurrently(run.threads, || below(left, 2 * i), || below(right, 2 * i + 1))?;
        return left.and(right);
    }
    below(left, 2 * i)?;
    below(right, 2 * i + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{stream, unit};
    use crate::store::WorkDir;

    #[test]
    fn the_nearest_below_a_rank_is_what_all_points_say() {
        let work = WorkDir::temporary(&std::env::temp_dir()).unwrap();
        let mut random = stream(3, "ranked tree");
        for (n, grid, threads) in
            [(1, 0, 1), (2, 0, 2), (16, 0, 3), (17, 3, 1), (333, 0, 2), (1_000, 4, 4), (500, 1, 2)]
        {
            let run = Run { threads, ..Run::new(&()) };
            // On a grid, many points coincide.
            let mut place = || {
                [0; 3].map(|_| unit(&mut random) as f32).map(|x| if grid > 0 { (x * grid as f32).floor() } else { x })
            };
            let all: Vec<RankedPoint> =
                (0..n).map(|node| RankedPoint { at: place(), node, rank: node * 37 % 101 }).collect();
            let mut array = work.array("points.tmp", &[all.len()]).unwrap();
            array.data().copy_from_slice(&all);
            let tree = RankedTree::new(array, Context::new(&work, &run)).unwrap();
            for k in 0..200u32 {
                let (rank, at) = (k % 103, place());
                let far = |point: &RankedPoint| dot(minus(at, point.at), minus(at, point.at));
                let expected = all.iter().filter(|point| point.rank < rank).map(far).reduce(f32::min);
                let found = tree.nearest_below(rank, at);
                assert_eq!(found.map(|found| found.0), expected, "{n} points below {rank}");
                assert!(found.is_none_or(|(square, node)| far(&all[node as usize]) == square));
            }
        }
    }
}
