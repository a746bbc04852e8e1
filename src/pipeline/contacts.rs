//! Which parts touch, and along what length: for colours and reports. One parallel pass over the graph.

use crate::base::Result;
use crate::graph::DualGraph;
use crate::store::Run;
use std::collections::BTreeMap;

const CHUNK: usize = 1 << 15;

/// Pairs of touching parts, ascending, with the length of their common boundary in the frame (at least 1e-9).
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn between(graph: &DualGraph, labels: &[u32], run: &Run) -> Result<Vec<(u32, u32, f64)>> {
    let n = labels.len();
    let shared = graph.edges.by_shared_edge();
    let chunks = run.map_ranges(n, CHUNK, |range| {
        let mut pairs: BTreeMap<(u32, u32), f64> = BTreeMap::new();
        for i in range {
            for (j, edge) in shared.neighbours(i as u32) {
                let j = j as usize;
                if j > i && labels[i] != labels[j] {
                    let pair = (labels[i].min(labels[j]), labels[i].max(labels[j]));
                    *pairs.entry(pair).or_default() += f64::from(edge.abs());
                }
            }
        }
        Ok(pairs)
    })?;
    let mut all: BTreeMap<(u32, u32), f64> = BTreeMap::new();
    for (pair, length) in chunks.into_iter().flatten() {
        *all.entry(pair).or_default() += length;
    }
    Ok(all.into_iter().map(|((a, b), length)| (a, b, length.max(1e-9))).collect())
}
