//! How sure matches are: by whether they come back, and whether neighbours stay neighbours.
//!
//! From a vertex to its match and from there to the nearest of A one should be back; the way missing, and how much the
//! matches of an edge's ends are farther apart or nearer than the ends, both over √area, are averaged over some rings of
//! neighbours. That mean ε becomes the confidence 1/(1 + (ε/[`HALF`])²). Distance in the embedding itself says next to nothing. On
//! scanned poses the rank correlation of confidence with the true error was −.37 to −.45. Two fields of
//! 8 bytes a vertex on disk, [`ROUNDS`] passes over the edges.

use super::matches::{Match, Pair};
use crate::base::Result;
use crate::base::parallel::{fill_chunks, fill_each};
use crate::base::vector::{distance, wide};
use crate::store::Context;

/// The error, over √area, at which a match is half sure.
pub const HALF: f32 = 0.05;
/// Passes of averaging.
const ROUNDS: usize = 10;
const CHUNK: usize = 1 << 14;

/// Sum and weight of doubt.
type Doubt = [f32; 2];

/// Sets the confidence of `matches` (n) from the ways missing on return in `returned` (n; NaN where not looked at).
pub(super) fn fill(pair: &Pair<'_>, matches: &mut [Match], returned: &[f32], context: Context<'_>) -> Result<()> {
    let n = matches.len();
    let names = ["doubt_a.tmp", "doubt_b.tmp"];
    let mut fields = [context.work.array::<f32>(names[0], &[n, 2])?, context.work.array::<f32>(names[1], &[n, 2])?];
    let (units, csr) = ([pair.graph_a, pair.graph_b].map(|g| 1. / g.facts.area.sqrt().max(1e-300)), pair.graph_a.csr());
    let around = |v: usize| csr.indptr[v] as usize..csr.indptr[v + 1] as usize;
    let [now, next] = &mut fields;
    let (mut now, mut next): (&mut [Doubt], &mut [Doubt]) =
        (bytemuck::cast_slice_mut(now.data()), bytemuck::cast_slice_mut(next.data()));
    fill_each(context.run.threads, &context.run.cancel, now, CHUNK, |v, _| {
        let Some(target) = matches[v].vertex() else { return [0.; 2] };
        let here = wide(pair.graph_b.nodes[target as usize].centroid);
        let (mut sum, mut count) = (0f64, 0f64);
        for e in around(v) {
            if let Some(other) = matches[csr.indices[e] as usize].vertex() {
                let there = distance(here, wide(pair.graph_b.nodes[other as usize].centroid));
                sum += (units[1] * there - units[0] * f64::from(csr.weights[e])).abs();
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
                let v = k * CHUNK + i;
                let (mut sum, mut count) = (before[v], 1.);
                for e in around(v) {
                    let [doubt, weight] = before[csr.indices[e] as usize];
                    sum = [sum[0] + doubt, sum[1] + weight];
                    count += 1.;
                }
                *out = [sum[0] / count, sum[1] / count];
            }
            Ok(())
        };
        fill_chunks(context.run.threads, &context.run.cancel, next, CHUNK, || (), average)?;
        std::mem::swap(&mut now, &mut next);
    }
    let doubts = &*now;
    let sure = |v: usize, one: Match| {
        let [sum, weight] = doubts[v];
        let known = one.target >= 0 && weight > 0.;
        Match { confidence: if known { 1. / (1. + (sum / weight / HALF).powi(2)) } else { 0. }, ..one }
    };
    fill_each(context.run.threads, &context.run.cancel, matches, CHUNK, sure)?;
    drop(fields);
    names.iter().for_each(|name| context.work.remove(&format!("{name}.partial")));
    Ok(())
}
