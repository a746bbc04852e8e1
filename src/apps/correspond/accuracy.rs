//! The error of matches: the distance along the surface from the found vertex to the true one, divided by √area.
//!
//! Fast marching from each true vertex until the found one is reached, so the cost is proportional to the error: an
//! exact match costs nothing. Scratch is one field per thread, 4 bytes per vertex. [`Errors`] summarises them: mean,
//! median, and the share of vertices below each of fifty errors, as plotted by correspondence benchmarks.

use crate::base::printable::counted;
use crate::base::sort::order_by;
use crate::base::{Error, Result};
use crate::distance::front::mean_weight;
use crate::distance::march::{March, Surface};
use crate::graph::VertexGraph;
use crate::store::Run;
use serde::Serialize;

/// Pairs per chunk.
const CHUNK: usize = 64;
/// Number of steps of the curve, up to [`Errors::END`].
const STEPS: usize = 50;

/// Errors of many matches, in units of √area.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Errors {
    /// Vertices evaluated.
    pub evaluated: u64,
    /// Vertices with a true match but no found one, excluded from the other numbers.
    pub unmatched: u64,
    /// Mean.
    pub mean: f64,
    /// Half of the errors are below.
    pub median: f64,
    /// Nine in ten errors are below.
    pub ninth_decile: f64,
    /// Greatest.
    pub maximum: f64,
    /// Share of the evaluated vertices whose error is at most [`Errors::END`] · i / 50 (51).
    pub curve: Vec<f64>,
}

impl Errors {
    /// The error at which the curve ends.
    pub const END: f64 = 0.25;

    /// Summarises errors (in units of √area) in any order.
    ///
    /// ```
    /// use nystrom_stream::apps::correspond::Errors;
    /// let errors = Errors::of(vec![0., 0.1, 0.2], 1);
    /// assert_eq!((errors.evaluated, errors.unmatched, errors.median), (3, 1, 0.1));
    /// ```
    pub fn of(mut errors: Vec<f64>, unmatched: u64) -> Self {
        errors.sort_by(f64::total_cmp);
        let at = |share: f64| errors.get(((errors.len() as f64 - 1.) * share).round() as usize).copied().unwrap_or(0.);
        let count = errors.len().max(1) as f64;
        let below = |end: f64| errors.partition_point(|&error| error <= end) as f64 / count;
        Self {
            evaluated: errors.len() as u64,
            unmatched,
            mean: errors.iter().sum::<f64>() / count,
            median: at(0.5),
            ninth_decile: at(0.9),
            maximum: at(1.),
            curve: (0..=STEPS).map(|i| below(Self::END * i as f64 / STEPS as f64)).collect(),
        }
    }
}

/// The errors of the matches `found`, vertices on `graph`, where `real` are the true ones, or vertices of the same
/// number if there are none: at up to `samples` vertices, evenly spread.
///
/// # Errors
/// As [`distances`].
pub fn errors(
    graph: &VertexGraph,
    found: &[Option<u32>],
    real: Option<&[Option<u32>]>,
    samples: usize,
    run: &Run,
) -> Result<Errors> {
    let step = found.len().div_ceil(samples.max(1)).max(1);
    let (mut pairs, mut unmatched) = (Vec::new(), 0);
    for v in (0..found.len()).step_by(step) {
        match (found[v], real.map_or(Some(v as u32), |real| real.get(v).copied().flatten())) {
            (Some(found), Some(real)) => pairs.push((found, real)),
            (None, Some(_)) => unmatched += 1,
            (_, None) => {}
        }
    }
    let march = || distances(graph, &pairs, run);
    let (errors, _) = run.stage("march", "vertices", pairs.len() as u64, march)?;
    Ok(Errors::of(errors, unmatched))
}

/// The distances between the pairs of vertices (found, true) on `graph`, in units of √area, in the order of `pairs`.
///
/// # Errors
/// [`Error::Parameter`] for a vertex that does not exist, [`Error::Memory`], [`Error::Cancelled`].
pub fn distances(graph: &VertexGraph, pairs: &[(u32, u32)], run: &Run) -> Result<Vec<f64>> {
    let n = graph.len();
    if let Some((found, real)) = pairs.iter().find(|(found, real)| *found as usize >= n || *real as usize >= n) {
        let problem = format!("name vertex {}, but the mesh has only {}", found.max(real), counted(n, "vertex"));
        return Err(Error::parameter("matches", problem, "give the mesh that the matches point to"));
    }
    let order = order_by(pairs.len(), |i, j| pairs[i].1.cmp(&pairs[j].1));
    // One march per true vertex, however many vertices were matched to it.
    let groups: Vec<&[usize]> = order.chunk_by(|&a, &b| pairs[a].1 == pairs[b].1).collect();
    let (run, _grant) = run.some_threads("marching", 0, 4 * n as u64)?;
    let surface = Surface::of(graph);
    let mean = mean_weight(surface.graph);
    let unit = graph.unit();
    let chunk = |k: usize, (march, field): &mut (March, Vec<f32>)| {
        let mut out = Vec::new();
        for group in groups.iter().skip(k * CHUNK).take(CHUNK) {
            let source = pairs[group[0]].1;
            let targets: Vec<u32> = group.iter().map(|&p| pairs[p].0).collect();
            if targets.iter().all(|&target| target == source) {
                out.extend(group.iter().map(|&p| (p, 0.)));
                continue;
            }
            let found = march.between(surface, source, &targets, field, &run.cancel)?;
            out.extend(group.iter().zip(found).map(|(&p, d)| (p, unit * f64::from(d))));
        }
        Ok(out)
    };
    let state = || (March::new(mean), vec![f32::INFINITY; n]);
    let mut all = vec![0.; pairs.len()];
    let chunks = groups.len().div_ceil(CHUNK);
    for (pair, error) in run.map_chunks(chunks, state, chunk)?.into_iter().flatten() {
        all[pair] = error;
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_are_those_of_the_errors() {
        let errors = Errors::of(vec![0.2, 0., 0.1, 0.5], 3);
        assert_eq!((errors.evaluated, errors.unmatched, errors.maximum), (4, 3, 0.5));
        assert!((errors.mean - 0.2).abs() < 1e-12);
        assert_eq!((errors.curve[0], errors.curve[20], errors.curve[STEPS]), (0.25, 0.5, 0.75));
        assert_eq!(Errors::of(Vec::new(), 0).mean, 0.);
    }
}
