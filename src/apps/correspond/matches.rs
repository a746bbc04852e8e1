//! Matches: for every vertex of A the vertex of B whose embedding is nearest, under one of three rules, with a
//! confidence.
//!
//! All: every vertex has its nearest, and several may share one. Mutual: a match counts only if each vertex is the
//! nearest of the other. One to one: the stable assignment in which each vertex requests its nearest and each target is
//! held by its nearest requester, over [`CHOICES`] choices each; a vertex that holds no target is unmatched. No rule
//! depends on threads or on the order of requests. Cost: 16 bytes per vertex on disk, some µs per vertex.
//!
//! Confidence: going from a vertex to its match, and from there to the nearest vertex of A, should lead back to the
//! start. Two errors are averaged over some rings of neighbours, both over √area: the distance by which that round trip
//! misses its start, and the difference between the length of each edge and the distance between the matches of its
//! ends. That mean ε becomes the confidence 1/(1 + (ε/[`HALF`])²). Distance in the embedding itself indicates next to
//! nothing. On scanned poses the rank correlation of confidence with the true error was −.37 to −.45. Two fields of 8
//! bytes per vertex on disk, [`ROUNDS`] passes over the edges.

use super::align::{Alignment, apply};
use super::search::{EmbeddingSearch, Neighbour};
use crate::base::vector::{distance, wide};
use crate::base::{Error, Result};
use crate::graph::VertexGraph;
use crate::spectral::nystrom::Point;
use crate::store::npy::Item;
use crate::store::{Context, MappedSlice};
use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Vertices per chunk.
const CHUNK: usize = 1 << 12;
/// Number of vertices that one may request, one to one.
pub const CHOICES: usize = 24;

/// Maximum number of vertices from whose matches the round trip is made for the confidence.
const RETURNS: usize = 1 << 18;

/// A vertex's match: one record of `matches.npy`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Match {
    /// The vertex of B, −1 without one.
    pub target: i64,
    /// Distance in the embedding, whose inner products approximate affinities (at most 1); infinite without a match.
    pub distance: f32,
    /// The confidence, from 0 to 1.
    pub confidence: f32,
}

impl Item for Match {
    // Without blanks, so that the header has room for a length of nine digits.
    const DESCR: &'static str = "[('match','<i8'),('distance','<f4'),('confidence','<f4')]";
}

impl Match {
    /// No match.
    pub const NONE: Self = Self { target: -1, distance: f32::INFINITY, confidence: 0. };

    /// The vertex of B, if there is one.
    #[inline]
    pub fn vertex(&self) -> Option<u32> {
        u32::try_from(self.target).ok()
    }
}

/// Which matches are kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Matching {
    /// The nearest of each vertex.
    #[default]
    All,
    /// Those that are mutually nearest.
    Mutual,
    /// Each vertex of B at most once.
    OneToOne,
}

/// Two meshes in the same coordinates, with nearest-vertex searches.
pub trait Pair: Sync {
    /// The surfaces of A and B.
    fn graphs(&self) -> [&VertexGraph; 2];
    /// Factors that make lengths on A and B comparable: 1/√area of each.
    fn units(&self) -> [f64; 2] {
        self.graphs().map(VertexGraph::unit)
    }
    /// For each vertex of A in `range` the nearest vertex of B.
    fn nearest(&self, range: Range<usize>) -> Vec<Neighbour>;
    /// For each pair of a vertex of A and its match, the vertex of A that is nearest to the match.
    fn round_trip(&self, pairs: &[(u32, u32)]) -> Vec<u32>;
    /// Whether two vertices of A have the same coordinates.
    fn at_same_place(&self, v: u32, w: u32) -> bool;
    /// Up to `count` vertices of B nearest to `v` of A, in ascending order of distance; `known` is a nearby one.
    fn k_nearest(&self, v: u32, known: u32, count: usize) -> Vec<Neighbour>;
}

/// Two aligned embeddings.
#[derive(Clone, Copy)]
pub struct AlignedPair<'a> {
    /// Embedded vertices of A (n).
    pub a: &'a [Point],
    /// Embedded vertices of B.
    pub b: &'a [Point],
    /// The surface of A.
    pub graph_a: &'a VertexGraph,
    /// The surface of B.
    pub graph_b: &'a VertexGraph,
    /// Transforms A's coordinates to B's.
    pub alignment: &'a Alignment,
    /// Searches B.
    pub in_b: &'a EmbeddingSearch<'a>,
    /// Searches A.
    pub in_a: &'a EmbeddingSearch<'a>,
}

impl Pair for AlignedPair<'_> {
    fn graphs(&self) -> [&VertexGraph; 2] {
        [self.graph_a, self.graph_b]
    }

    fn nearest(&self, range: Range<usize>) -> Vec<Neighbour> {
        range.map(|v| self.in_b.nearest(&self.alignment.apply(&self.a[v]))).collect()
    }

    fn round_trip(&self, pairs: &[(u32, u32)]) -> Vec<u32> {
        let back = self.alignment.transform.transpose();
        pairs.iter().map(|(_, target)| self.in_a.nearest(&apply(&back, &self.b[*target as usize])).vertex).collect()
    }

    fn at_same_place(&self, v: u32, w: u32) -> bool {
        self.a[v as usize] == self.a[w as usize]
    }

    fn k_nearest(&self, v: u32, _: u32, count: usize) -> Vec<Neighbour> {
        self.in_b.k_nearest(&self.alignment.apply(&self.a[v as usize]), count)
    }
}

/// Matches every vertex of A, into the file `name` of `work`. Progress is reported as stage `match`.
///
/// # Errors
/// [`Error::Parameter`] for more vertices than the array's header has digits for (10⁹), [`Error::Io`],
/// [`Error::Cancelled`].
pub fn matches(pair: &impl Pair, matching: Matching, name: &str, context: Context<'_>) -> Result<MappedSlice<Match>> {
    let [graph_a, _] = pair.graphs();
    let n = graph_a.len();
    if n >= 1_000_000_000 {
        return Err(Error::parameter("A", format!("{n} vertices are too many to match"), "match a decimated mesh"));
    }
    let mut array = context.work.array::<Match>(name, &[n])?;
    let mut doubt = context.work.array::<f32>("doubt.tmp", &[n])?;
    // A sample of a large mesh suffices for the round trips; mutual matches need all.
    let step = if matching == Matching::Mutual { 1 } else { n.div_ceil(RETURNS) };
    let [unit, _] = pair.units();
    let fill = |k: usize, out: &mut [Match], doubt: &mut [f32], (): &mut ()| {
        let first = k * CHUNK;
        for (out, found) in out.iter_mut().zip(pair.nearest(first..first + doubt.len())) {
            *out = Match { target: i64::from(found.vertex), distance: found.square.sqrt(), confidence: 0. };
        }
        doubt.fill(f32::NAN);
        let asked: Vec<(u32, u32)> = (0..out.len())
            .filter(|i| (first + i).is_multiple_of(step))
            .filter_map(|i| Some(((first + i) as u32, out[i].vertex()?)))
            .collect();
        for (&(v, _), returned) in asked.iter().zip(pair.round_trip(&asked)) {
            let [from, to] = [v, returned].map(|v| wide(graph_a.nodes[v as usize].centroid));
            doubt[v as usize - first] = (unit * distance(from, to)) as f32;
            // Ending at the same place in the embedding is as good as at the same vertex.
            if matching == Matching::Mutual && returned != v && !pair.at_same_place(v, returned) {
                out[v as usize - first] = Match::NONE;
            }
        }
        context.run.progress.advance("match", out.len() as u64);
        Ok(())
    };
    context.run.fill_two((array.data(), doubt.data()), CHUNK, || (), fill)?;
    if matching == Matching::OneToOne {
        one_to_one(pair, array.data(), context)?;
    }
    fill_confidence(pair, array.data(), doubt.data(), context)?;
    array.finish(false)
}

/// Makes `matches`, which are all nearest vertices, one to one.
fn one_to_one(pair: &impl Pair, matches: &mut [Match], context: Context<'_>) -> Result<()> {
    const FREE: u32 = u32::MAX;
    let mut holders = context.work.array::<u32>("holders.tmp", &[pair.graphs()[1].len()])?;
    let holder = &mut holders.data()[..];
    holder.fill(FREE);
    for v in 0..matches.len() {
        if v % CHUNK == 0 {
            context.run.cancel.check()?;
        }
        let mut asking = v as u32;
        // A vertex that loses its target requests its next one; a chain ends with a request for a free target.
        while let Some(target) = matches[asking as usize].vertex() {
            let held = std::mem::replace(&mut holder[target as usize], asking);
            if held == FREE {
                break;
            }
            let rank = |v: u32| (matches[v as usize].distance, v);
            let keeps = rank(held) < rank(asking);
            let loser = if keeps { asking } else { held };
            if keeps {
                holder[target as usize] = held;
            }
            let choices = pair.k_nearest(loser, target, CHOICES);
            let place = choices.iter().position(|choice| choice.vertex == target);
            // The nearest search may have met another vertex at the same position first.
            let next = choices.get(place.map_or(0, |place| place + 1));
            matches[loser as usize] = match next.filter(|_| place.is_some()) {
                Some(next) => Match { target: i64::from(next.vertex), distance: next.square.sqrt(), confidence: 0. },
                None => Match::NONE,
            };
            asking = loser;
        }
    }
    Ok(())
}

/// The error, over √area, at which the confidence is ½.
pub const HALF: f32 = 0.05;
/// Number of averaging passes.
const ROUNDS: usize = 10;
const CONFIDENCE_CHUNK: usize = 1 << 14;

/// Sum and weight of the error.
type Doubt = [f32; 2];

/// Sets the confidence of `matches` (n) from the round-trip errors in `returned` (n; NaN if not computed).
fn fill_confidence(pair: &impl Pair, matches: &mut [Match], returned: &[f32], context: Context<'_>) -> Result<()> {
    let (n, graphs) = (matches.len(), pair.graphs());
    let field = |name: &str| context.work.array::<f32>(name, &[n, 2]);
    let mut fields = [field("doubt_a.tmp")?, field("doubt_b.tmp")?];
    let (units, csr) = (pair.units(), graphs[0].csr());
    let [now, next] = &mut fields;
    let (mut now, mut next): (&mut [Doubt], &mut [Doubt]) =
        (bytemuck::cast_slice_mut(now.data()), bytemuck::cast_slice_mut(next.data()));
    context.run.fill_each(now, CONFIDENCE_CHUNK, |v, _| {
        let Some(target) = matches[v].vertex() else { return [0.; 2] };
        let here = wide(graphs[1].nodes[target as usize].centroid);
        let (mut sum, mut count) = (0f64, 0f64);
        for (near, weight) in csr.neighbours(v as u32) {
            if let Some(other) = matches[near as usize].vertex() {
                let there = distance(here, wide(graphs[1].nodes[other as usize].centroid));
                sum += (units[1] * there - units[0] * f64::from(weight)).abs();
                count += 1.;
            }
        }
        let stretch = if count > 0. { (sum / count) as f32 } else { 0. };
        if returned[v].is_nan() { [0.; 2] } else { [returned[v] + stretch, 1.] }
    })?;
    for _ in 0..ROUNDS {
        let before = &*now;
        let average = |k: usize, out: &mut [Doubt], (): &mut ()| {
            for (i, out) in out.iter_mut().enumerate() {
                let v = k * CONFIDENCE_CHUNK + i;
                let (mut sum, mut count) = (before[v], 1.);
                for (near, _) in csr.neighbours(v as u32) {
                    let [doubt, weight] = before[near as usize];
                    sum = [sum[0] + doubt, sum[1] + weight];
                    count += 1.;
                }
                *out = [sum[0] / count, sum[1] / count];
            }
            Ok(())
        };
        context.run.fill_chunks(next, CONFIDENCE_CHUNK, || (), average)?;
        std::mem::swap(&mut now, &mut next);
    }
    let doubts = &*now;
    let sure = |v: usize, one: Match| {
        let [sum, weight] = doubts[v];
        let known = one.target >= 0 && weight > 0.;
        Match { confidence: if known { 1. / (1. + (sum / weight / HALF).powi(2)) } else { 0. }, ..one }
    };
    context.run.fill_each(matches, CONFIDENCE_CHUNK, sure)
}
