//! Matches: for every vertex of A the vertex of B whose embedding is nearest, in three manners.
//!
//! All: every vertex has its nearest, and several may share one. Mutual: only those whose match has them for its own
//! nearest. One to one: the stable assignment in which vertices ask for their nearest first and each is held by the
//! nearest that asks, over [`CHOICES`] choices each; what stays without is unmatched. None depends on threads, or on the
//! order of requests. 16 bytes a vertex on disk; some µs a vertex.

use super::align::{Alignment, apply};
use super::confidence;
use super::nearest::Nearest;
use crate::base::parallel::fill_two;
use crate::base::vector::{distance, wide};
use crate::base::{Error, Result};
use crate::graph::VertexGraph;
use crate::spectral::orthogonal::Point;
use crate::store::npy::Item;
use crate::store::{Context, MappedSlice};
use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};

/// Vertices a chunk.
const CHUNK: usize = 1 << 12;
/// Vertices that one may ask for, one to one.
pub const CHOICES: usize = 24;

/// Vertices at the most from whose matches one comes back, to see how sure they are.
const RETURNS: usize = 1 << 18;

/// A vertex's match: what `matches.npy` holds of each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Match {
    /// The vertex of B, −1 without one.
    pub target: i64,
    /// Distance in the embedding, whose products approximate affinities (which are 1 at most); infinite without a match.
    pub distance: f32,
    /// How sure, from 0 to 1.
    pub confidence: f32,
}

impl Item for Match {
    // Without blanks, so that the header has room for nine digits of a length.
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
    /// Those that are nearest to each other.
    Mutual,
    /// No vertex of B twice.
    OneToOne,
}

/// What matching needs of both meshes.
#[derive(Clone, Copy)]
pub struct Pair<'a> {
    /// Embedded vertices of A (n).
    pub a: &'a [Point],
    /// Embedded vertices of B.
    pub b: &'a [Point],
    /// The surface of A.
    pub graph_a: &'a VertexGraph,
    /// The surface of B.
    pub graph_b: &'a VertexGraph,
    /// From A's coordinates to B's.
    pub alignment: &'a Alignment,
    /// Searches B.
    pub in_b: &'a Nearest<'a>,
    /// Searches A.
    pub in_a: &'a Nearest<'a>,
}

/// Matches every vertex of A, into the file `name` of `work`. Progress is told as stage `match`.
///
/// # Errors
/// [`Error::Parameter`] for more vertices than the header of the array has digits for (10⁹), [`Error::Io`],
/// [`Error::Cancelled`].
pub fn matches(pair: Pair<'_>, matching: Matching, name: &str, context: Context<'_>) -> Result<MappedSlice<Match>> {
    let back = pair.alignment.transform.transpose();
    let n = pair.a.len();
    if n >= 1_000_000_000 {
        return Err(Error::parameter("A", format!("{n} vertices are too many to match"), "match a decimated mesh"));
    }
    let mut array = context.work.array::<Match>(name, &[n])?;
    let mut doubt = context.work.array::<f32>("doubt.tmp", &[n])?;
    // Enough of a large mesh to tell where matches come back to; all for mutual ones.
    let step = if matching == Matching::Mutual { 1 } else { n.div_ceil(RETURNS) };
    let unit = 1. / pair.graph_a.facts.area.sqrt().max(1e-300);
    let fill = |k: usize, out: &mut [Match], doubt: &mut [f32], (): &mut ()| {
        for (i, (out, doubt)) in out.iter_mut().zip(doubt).enumerate() {
            let v = k * CHUNK + i;
            let found = pair.in_b.nearest(&pair.alignment.apply(&pair.a[v]));
            *out = Match { target: i64::from(found.vertex), distance: found.square.sqrt(), confidence: 0. };
            *doubt = f32::NAN;
            if !v.is_multiple_of(step) {
                continue;
            }
            let home = pair.in_a.nearest(&apply(&back, &pair.b[found.vertex as usize])).vertex as usize;
            let [from, to] = [v, home].map(|v| wide(pair.graph_a.nodes[v].centroid));
            *doubt = (unit * distance(from, to)) as f32;
            // At the same place in the embedding is as good as the same.
            if matching == Matching::Mutual && home != v && pair.a[v] != pair.a[home] {
                *out = Match::NONE;
            }
        }
        context.run.progress.advance("match", out.len() as u64);
        Ok(())
    };
    fill_two(context.run.threads, &context.run.cancel, (array.data(), doubt.data()), CHUNK, || (), fill)?;
    if matching == Matching::OneToOne {
        one_to_one(&pair, array.data(), context)?;
    }
    confidence::fill(&pair, array.data(), doubt.data(), context)?;
    drop(doubt);
    context.work.remove("doubt.tmp.partial");
    array.finish(false)
}

/// Makes `matches`, which are everyone's nearest, one to one.
fn one_to_one(pair: &Pair<'_>, matches: &mut [Match], context: Context<'_>) -> Result<()> {
    const FREE: u32 = u32::MAX;
    const NAME: &str = "holders.tmp";
    let mut holders = context.work.array::<u32>(NAME, &[pair.b.len()])?;
    let holder = &mut holders.data()[..];
    holder.fill(FREE);
    for v in 0..matches.len() {
        if v % CHUNK == 0 {
            context.run.cancel.check()?;
        }
        let mut asking = v as u32;
        // Whoever loses a vertex asks for the next; who asks last for one that is free ends the chain.
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
            let choices = pair.in_b.several(&pair.alignment.apply(&pair.a[loser as usize]), CHOICES);
            let place = choices.iter().position(|choice| choice.vertex == target);
            // The nearest search may have met another vertex at the same place first.
            let next = choices.get(place.map_or(0, |place| place + 1));
            matches[loser as usize] = match next.filter(|_| place.is_some()) {
                Some(next) => Match { target: i64::from(next.vertex), distance: next.square.sqrt(), confidence: 0. },
                None => Match::NONE,
            };
            asking = loser;
        }
    }
    drop(holders);
    context.work.remove("holders.tmp.partial");
    Ok(())
}
