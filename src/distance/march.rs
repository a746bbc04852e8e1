//! Fast marching over triangles: distances along the surface instead of along edges.
//!
//! A vertex x of a triangle whose other corners p, q have the distances d(p), d(q) gets the minimum of d(p) + t (d(q) −
//! d(p)) + |x − p − t (q − p)| over 0 ≤ t ≤ 1: a straight path through the triangle (Kimmel and Sethian 1998, in the
//! Hopf–Lax form, which also holds if the triangle is obtuse). t = 0 and 1 are the graph's edges, so bridges and welded
//! duplicates are crossed as well.
//!
//! Label-correcting on [`super::front`]'s buckets: a vertex that is lowered revisits its triangles and updates those
//! corners that are farther than itself. Each update is monotone, so values only fall; gains below [`GAIN`] of a value
//! are ignored, and so are updates against the front's direction, which obtuse triangles could need (less than 1 % in
//! tests). Cost: 0.3 to 0.5 µs per vertex, most of which are visited once; scratch is that of the front.

use super::front::FRONT_WIDTH;
use super::queue::{Entry, Queue};
use crate::base::vector::{dot, minus, wide};
use crate::base::{Cancel, Result};
use crate::graph::Csr;
use crate::graph::{Node, VertexGraph};

/// The relative decrease of a distance that counts as an improvement.
pub const GAIN: f32 = 1e-6;
/// Visits between checks of the stop flag.
const STOP_CHECK: usize = 1 << 19;

/// A surface as raw slices.
#[derive(Clone, Copy, Debug)]
pub struct Surface<'a> {
    /// Its edges.
    pub graph: Csr<'a>,
    /// Positions of vertices (n).
    pub nodes: &'a [Node],
    /// Where each vertex's triangles start (n + 1).
    pub ring_starts: &'a [u64],
    /// The other two corners of each triangle (2 each).
    pub ring: &'a [u32],
}

impl<'a> Surface<'a> {
    /// The surface of `graph`.
    pub fn of(graph: &'a VertexGraph) -> Self {
        Self { graph: graph.csr(), nodes: &graph.nodes, ring_starts: &graph.ring_starts, ring: &graph.ring }
    }
}

/// How far a march goes.
trait Extent {
    /// Whether it may stop, as all distances up to `reached` are final.
    fn is_done(&self, _field: &[f32], _reached: f32) -> bool {
        false
    }
    /// Called once for each vertex, when it is first reached.
    fn reached(&mut self, _vertex: u32) {}
}

/// Unlimited.
impl Extent for () {}

/// Until the targets' distances are final; remembers the vertices touched.
struct UntilTargets<'a> {
    targets: &'a [u32],
    touched: Vec<u32>,
}

impl Extent for UntilTargets<'_> {
    fn is_done(&self, field: &[f32], reached: f32) -> bool {
        self.targets.iter().all(|&target| field[target as usize] <= reached)
    }
    fn reached(&mut self, vertex: u32) {
        self.touched.push(vertex);
    }
}

/// As far as `limit`; remembers the vertices touched.
struct UpTo {
    limit: f32,
    touched: Vec<u32>,
}

impl Extent for UpTo {
    fn is_done(&self, _: &[f32], reached: f32) -> bool {
        reached >= self.limit
    }
    fn reached(&mut self, vertex: u32) {
        self.touched.push(vertex);
    }
}

/// A reusable march.
#[derive(Debug)]
pub struct March {
    queue: Queue,
    batch: Vec<Entry>,
}

/// The distance of x through the interior of the edge from p (at distance `dp`) to q (at `dq`); infinite if the path
/// through one of its ends is shorter.
#[inline]
pub fn through(x: [f32; 3], p: [f32; 3], q: [f32; 3], dp: f32, dq: f32) -> f32 {
    let (e, a) = (minus(wide(q), wide(p)), minus(wide(x), wide(p)));
    let square = dot(e, e);
    let length = square.sqrt();
    let rise = f64::from(dq) - f64::from(dp);
    let rest = square - rise * rise;
    if rest <= 0. || !rest.is_finite() {
        return f32::INFINITY;
    }
    // Components along the edge and perpendicular to it.
    let along = dot(a, e) / length;
    let off = (dot(a, a) - along * along).max(0.).sqrt();
    let (slope, fall) = (rise / length, rest.sqrt() / length);
    let at = along * fall - off * slope;
    if at <= 0. || at >= length * fall {
        return f32::INFINITY;
    }
    (f64::from(dp) + slope * along + off * fall) as f32
}

impl March {
    /// A march over surfaces whose edges have the given mean length.
    pub fn new(mean_edge: f32) -> Self {
        Self { queue: Queue::new(4. * FRONT_WIDTH * mean_edge), batch: Vec::new() }
    }

    /// Distances from one vertex: `field` (n) is overwritten, infinite where unreached.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn full(&mut self, surface: Surface<'_>, source: u32, field: &mut [f32], cancel: &Cancel) -> Result<()> {
        field.fill(f32::INFINITY);
        self.spread(surface, source, field, &mut (), cancel)
    }

    /// Distances from `source`, until those of `targets`, which are returned, are final (except for what obtuse
    /// triangles ahead might still save). `field` (n) must be infinite everywhere and is left so; cost is proportional
    /// to the area reached.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn between(
        &mut self,
        surface: Surface<'_>,
        source: u32,
        targets: &[u32],
        field: &mut [f32],
        cancel: &Cancel,
    ) -> Result<Vec<f32>> {
        let mut until = UntilTargets { targets, touched: vec![source] };
        let result = self.spread(surface, source, field, &mut until, cancel);
        let found = targets.iter().map(|&target| field[target as usize]).collect();
        until.touched.into_iter().for_each(|node| field[node as usize] = f32::INFINITY);
        result.map(|()| found)
    }

    /// The vertices nearer than `limit` to `source` and their distances, ascending by vertex. `field` (n) must be
    /// infinite everywhere and is left so; cost is proportional to the area reached.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn within(
        &mut self,
        surface: Surface<'_>,
        source: u32,
        limit: f32,
        field: &mut [f32],
        cancel: &Cancel,
    ) -> Result<Vec<(u32, f32)>> {
        let mut extent = UpTo { limit, touched: vec![source] };
        let result = self.spread(surface, source, field, &mut extent, cancel);
        extent.touched.sort_unstable();
        let reached = |&v: &u32| Some((v, field[v as usize])).filter(|(_, distance)| *distance < limit);
        let found = extent.touched.iter().filter_map(reached).collect();
        extent.touched.into_iter().for_each(|node| field[node as usize] = f32::INFINITY);
        result.map(|()| found)
    }

    /// Spreads from `source` until `extent` stops it.
    fn spread(
        &mut self,
        surface: Surface<'_>,
        source: u32,
        field: &mut [f32],
        extent: &mut impl Extent,
        cancel: &Cancel,
    ) -> Result<()> {
        let Self { queue, batch } = self;
        let Surface { graph, nodes, ring_starts, ring } = surface;
        queue.restart(0.);
        field[source as usize] = 0.;
        queue.push(Entry { node: source, distance: 0. });
        let mut visits_left = STOP_CHECK;
        batch.clear();
        while queue.pop_bucket(batch) {
            let least = batch.iter().fold(f32::INFINITY, |least, entry| least.min(entry.distance));
            let stop = extent.is_done(field, least);
            visits_left = visits_left.saturating_sub(batch.len());
            let cancelled = visits_left == 0 && cancel.is_cancelled();
            if stop || cancelled {
                queue.clear();
                return cancel.check();
            }
            visits_left = if visits_left == 0 { STOP_CHECK } else { visits_left };
            for k in 0..batch.len() {
                let Entry { node, distance } = batch[k];
                if field[node as usize] < distance {
                    continue;
                }
                let mut lower = |field: &mut [f32], to: u32, there: f32| {
                    let known = &mut field[to as usize];
                    if there < *known * (1. - GAIN) {
                        if *known == f32::INFINITY {
                            extent.reached(to);
                        }
                        *known = there;
                        queue.push_late(Entry { node: to, distance: there });
                    }
                };
                for (next, weight) in graph.neighbours(node) {
                    lower(field, next, distance + weight);
                }
                let here = nodes[node as usize].centroid;
                let span = 2 * ring_starts[node as usize] as usize..2 * ring_starts[node as usize + 1] as usize;
                for pair in ring[span].chunks_exact(2) {
                    let [b, c] = [pair[0], pair[1]];
                    let (db, dc) = (field[b as usize], field[c as usize]);
                    let (at_b, at_c) = (nodes[b as usize].centroid, nodes[c as usize].centroid);
                    // Values below this distance are not changed from here.
                    if dc > distance {
                        lower(field, c, through(at_c, here, at_b, distance, db));
                    }
                    if db > distance {
                        lower(field, b, through(at_b, here, at_c, distance, field[c as usize]));
                    }
                }
            }
            batch.clear();
        }
        Ok(())
    }
}
