//! Creases under noise: how much the surface turns at the edges of a band, averaged along the edges.
//!
//! On a rough mesh fronts see normals that are averaged over a radius, so a crease is smeared over twice that radius,
//! and a boundary beside it has no line to follow. The faces' own normals know the crease, but noise turns every edge.
//! Averaged over edges that go the same way, far along them and hardly across, noise cancels out, and a line that turns
//! stays one. Edges of a face with many sides keep their own turning: they lie far from each other.
//!
//! Cost: some fifty edges are looked at for each, 2 µs per node of the band, and at most those of faces with 64 sides;
//! 4 bytes per edge of the band beside what it is given, in a file where the budget is short, and a bit per node of the
//! band and thread.

use crate::base::Result;
use crate::base::bit_set::BitSet;
use crate::base::parallel::{chunk_range, entry_ends, parts_of};
use crate::base::vector::{MapEach, cross, dot, length, minus, wide};
use crate::graph::angle::between;
use crate::graph::weights::concave;
use crate::graph::{Metric, NodeView};
use crate::spectral::exp::exp;
use crate::store::{Context, ScratchArray};
use bytemuck::{Pod, Zeroable};

/// Faces from an edge's own to the farthest whose edges are looked at.
const HOPS: usize = 4;
/// Standard deviation of the Gaussian along an edge, in mean lengths of the edges around.
const ALONG: f32 = 2.;
/// The same across the edge.
const ACROSS: f32 = 0.6;
/// Maximum number of edges of a face that is looked at, and beyond which other faces are.
const MOST_EDGES: usize = 64;
const CHUNK: usize = 1 << 10;

/// The faces' own geometry, and how turning counts.
#[derive(Clone, Copy, Debug)]
pub struct OwnTurning<'a> {
    nodes: NodeView<'a>,
    beta: f32,
    eta: f32,
}

impl<'a> OwnTurning<'a> {
    /// That of `nodes` under `metric`; none where turning has no scale of its own, or no cost.
    pub fn new(nodes: NodeView<'a>, metric: Metric) -> Option<Self> {
        match metric {
            Metric::ScaleFree { beta, eta } => Some(Self { nodes, beta, eta }),
            Metric::Geodesic | Metric::Paper { .. } => None,
        }
    }

    /// The edge between two nodes, which is as long as `length`: negative where they are wound against each other.
    #[inline]
    pub fn edge(&self, node: u32, other: u32, length: f32) -> CreaseEdge {
        let (a, b) = (self.nodes.at(node as usize), self.nodes.at(other as usize));
        let step = minus(wide(b.centroid), wide(a.centroid));
        let normal = [0, 1, 2].map_each(|axis| f64::from(a.normal[axis]) + f64::from(b.normal[axis]));
        let along = cross(normal, step);
        let size = self::length(along);
        let factor = if length < 0. || concave(&a, &b) { 1. } else { self.eta };
        CreaseEdge {
            middle: [0, 1, 2].map_each(|axis| 0.5 * (a.centroid[axis] + b.centroid[axis])),
            along: if size > 0. { along.map_each(|x| (x / size) as f32) } else { [0.; 3] },
            length: length.abs(),
            turning: self.beta * between(a.normal, b.normal) * factor,
        }
    }
}

/// An edge between two faces.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub struct CreaseEdge {
    /// Its middle, and its direction, of unit length or 0.
    middle: [f32; 3],
    along: [f32; 3],
    /// How long it is, in the frame.
    length: f32,
    /// β|θ|, less where it is convex.
    turning: f32,
}

impl CreaseEdge {
    /// How much `other` counts for this edge; `per_length` is one over the mean length of the edges around.
    #[inline]
    fn weight(&self, other: &Self, per_length: f32) -> f32 {
        let away = [0, 1, 2].map_each(|axis| (other.middle[axis] - self.middle[axis]) * per_length);
        let along = dot(away, self.along);
        let across = (dot(away, away) - along * along).max(0.);
        let far = along * along * (0.5 / (ALONG * ALONG)) + across * (0.5 / (ACROSS * ACROSS));
        // Beyond, the Gaussian is below a thousandth.
        if far > 7. {
            return 0.;
        }
        let same = dot(self.along, other.along);
        other.length * same * same * exp(-far)
    }
}

/// The turning of each of `edges`, averaged: those of a band's positions one after the other, which begin at `start`
/// (m + 1). `inside` is the position that an edge leads to, none where it leads out of the band.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub fn averaged(
    start: &[u32],
    inside: impl Fn(usize) -> Option<u32> + Sync,
    edges: &[CreaseEdge],
    context: Context<'_>,
) -> Result<ScratchArray<f32>> {
    let m = start.len() - 1;
    let mut turning = ScratchArray::<f32>::new("averaged.tmp", edges.len(), context)?;
    let span = |i: u32| start[i as usize] as usize..start[i as usize + 1] as usize;
    let many = |i: u32| span(i).len() > MOST_EDGES;
    let around = |k: usize, turning: &mut &mut [f32], seen: &mut BitSet| {
        let positions = chunk_range(m, CHUNK, k);
        let first = start[positions.start] as usize;
        let (mut nodes, mut near) = (Vec::new(), Vec::new());
        for i in positions.start as u32..positions.end as u32 {
            span(i).for_each(|e| turning[e - first] = edges[e].turning);
            if many(i) {
                continue;
            }
            nodes.clear();
            nodes.push(i);
            seen.add(i);
            let mut ring = 0;
            for _ in 0..HOPS {
                let end = nodes.len();
                for at in ring..end {
                    let edges = if many(nodes[at]) { 0..0 } else { span(nodes[at]) };
                    for e in edges {
                        if let Some(next) = inside(e)
                            && seen.add(next)
                        {
                            nodes.push(next);
                        }
                    }
                }
                ring = end;
            }
            // Each edge once: of two positions that were seen the lesser tells it.
            let is_first = |p: u32, e: usize| inside(e).is_none_or(|q| p < q || !seen.has(q));
            near.clear();
            for &p in &nodes {
                for e in if many(p) { 0..0 } else { span(p) } {
                    if is_first(p, e) {
                        near.push(edges[e]);
                    }
                }
            }
            nodes.iter().for_each(|&p| seen.remove(p));
            let per_length = near.len() as f32 / near.iter().map(|edge| edge.length).sum::<f32>();
            // The other end's edges are filled in below.
            for e in span(i) {
                if inside(e).is_some_and(|j| j < i || many(j)) {
                    continue;
                }
                let own = &edges[e];
                let (mut sum, mut total) = (0., 0.);
                for other in &near {
                    let weight = own.weight(other, per_length);
                    (sum, total) = (sum + weight * other.turning, total + weight);
                }
                if total > 0. {
                    turning[e - first] = sum / total;
                }
            }
        }
        Ok(())
    };
    let pieces = parts_of(&mut turning, entry_ends(start, CHUNK));
    context.run.fill_pieces(pieces, || BitSet::new(m), around)?;
    for i in (0..m as u32).filter(|&i| !many(i)) {
        for e in span(i) {
            if let Some(j) = inside(e).filter(|&j| j < i && !many(j))
                && let Some(twin) = span(j).find(|&twin| inside(twin) == Some(i))
            {
                turning[e] = turning[twin];
            }
        }
    }
    Ok(turning)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{stream, unit};
    use crate::store::{Budget, Run, WorkDir};

    /// What is averaged with `threads`, in memory or in files.
    fn averaged(start: &[u32], to: &[u32], edges: &[CreaseEdge], threads: usize, budget: u64) -> Vec<f32> {
        let folder = tempfile::tempdir().unwrap();
        let work = WorkDir::temporary(folder.path()).unwrap();
        let run = Run { threads, budget: Budget::new(budget), ..Run::new(&()) };
        super::averaged(start, |e| Some(to[e]), edges, Context::new(&work, &run)).unwrap().to_vec()
    }

    /// A strip of `w` by 8 squares in the plane, whose edges turn at random, and more across its middle.
    fn strip(w: usize) -> (Vec<u32>, Vec<u32>, Vec<CreaseEdge>) {
        let mut random = stream(0, "creases");
        let (mut start, mut to, mut edges) = (vec![0], Vec::new(), Vec::new());
        let mut noise = std::collections::BTreeMap::new();
        for i in 0..8 * w {
            let (x, y) = (i % w, i / w);
            let mut step = |other: usize, along: [f32; 3]| {
                let crease = if along[0] > 0. && y.min(other / w) == 3 { 1. } else { 0. };
                let turning = *noise.entry((i.min(other), i.max(other))).or_insert_with(|| unit(&mut random) as f32);
                let at = |k: usize| [(k % w) as f32, (k / w) as f32];
                let middle = [0.5 * (at(i)[0] + at(other)[0]), 0.5 * (at(i)[1] + at(other)[1]), 0.];
                to.push(other as u32);
                edges.push(CreaseEdge { middle, along, length: 1., turning: turning + crease });
            };
            [(x > 0).then(|| i - 1), (x + 1 < w).then(|| i + 1)]
                .into_iter()
                .flatten()
                .for_each(|k| step(k, [0., 1., 0.]));
            [(y > 0).then(|| i - w), (y < 7).then(|| i + w)].into_iter().flatten().for_each(|k| step(k, [1., 0., 0.]));
            start.push(to.len() as u32);
        }
        (start, to, edges)
    }

    #[test]
    fn a_crease_stands_out_of_noise_and_both_sides_agree() {
        let w = 40;
        let (start, to, edges) = strip(w);
        let turning = averaged(&start, &to, &edges, 3, 0);
        assert_eq!(turning, averaged(&start, &to, &edges, 1, 1 << 30));
        let (mut least, mut most) = (f32::INFINITY, 0f32);
        for i in 0..8 * w {
            for e in start[i] as usize..start[i + 1] as usize {
                let (j, x) = (to[e] as usize, i % w);
                let back = (start[j] as usize..start[j + 1] as usize).find(|&back| to[back] as usize == i).unwrap();
                assert_eq!(turning[e], turning[back]);
                if (4..w - 4).contains(&x) && (i / w).min(j / w) == 3 && i % w == j % w {
                    least = least.min(turning[e]);
                } else if (4..w - 4).contains(&x) {
                    most = most.max(turning[e]);
                }
            }
        }
        assert!(least > 1.15 * most, "{least} {most}");
    }

    /// Regression: each face within four of a face with very many sides looked at all of these, and so did that face
    /// itself for each of its edges: a cap of 24,000 corners on a rough mesh took minutes.
    #[test]
    fn edges_of_a_face_with_many_sides_keep_their_own_turning() {
        let (sides, at) = (2 * MOST_EDGES, |k: usize| [(k as f32).cos(), (k as f32).sin(), 0.]);
        let edge = |k: usize| CreaseEdge { middle: at(k), along: [0., 0., 1.], length: 1., turning: k as f32 };
        // The face, and a ring of others around it, each with its two neighbours there.
        let (mut start, mut to) = (vec![0, sides as u32], (1..=sides as u32).collect::<Vec<u32>>());
        let mut edges: Vec<CreaseEdge> = (0..sides).map(edge).collect();
        for k in 0..sides {
            to.extend([0, (k + 1) % sides + 1, (k + sides - 1) % sides + 1].map(|i| i as u32));
            edges.extend([edge(k), edge(sides + k), edge(sides + (k + sides - 1) % sides)]);
            start.push(to.len() as u32);
        }
        let turning = averaged(&start, &to, &edges, 2, 0);
        for e in 0..edges.len() {
            let is_of_hub = e < sides || to[e] == 0;
            assert_eq!(turning[e] == edges[e].turning, is_of_hub, "{e}");
        }
    }
}
