//! Passes over all nodes of a graph that find a few of them. Time: one look at each node, and at the neighbours of
//! those looked for. Memory: 4 bytes per node found, and 8 per node of the chunk that a thread works on.

use crate::base::Result;
use crate::graph::Csr;
use crate::graph::csr::near_ranges;
use crate::store::Run;
use std::ops::Range;

const CHUNK: usize = 1 << 15;

/// Applies `of` to the nodes of each chunk for which `own` holds, and concatenates the results. Such nodes are few as a
/// rule, and no other rows are read.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn of_chunks(
    graph: Csr<'_>,
    run: &Run,
    own: impl Fn(usize) -> bool + Sync,
    of: impl Fn(Vec<u32>) -> Vec<u32> + Sync,
) -> Result<Vec<u32>> {
    Ok(run.map_ranges(graph.len(), CHUNK, |range| Ok(of_chunk(graph, run, range, &own, &of)))?.concat())
}

/// The same for one chunk.
fn of_chunk(
    graph: Csr<'_>,
    run: &Run,
    range: Range<usize>,
    own: impl Fn(usize) -> bool,
    of: impl Fn(Vec<u32>) -> Vec<u32>,
) -> Vec<u32> {
    let nodes_in = |range: Range<usize>| {
        let mut nodes: Vec<u32> = range.map(|i| i as u32).collect();
        nodes.retain(|&i| own(i as usize));
        nodes
    };
    let nodes = nodes_in(range.clone());
    if run.is_paged(graph.indices) {
        let later = nodes_in(range.end..(range.end + CHUNK).min(graph.len()));
        for nodes in [&nodes, &later] {
            will_need_rows(graph, nodes, run);
        }
    }
    fitted(of(nodes))
}

/// `found` in no more memory than it needs: what is found in all chunks is held at once, but each has room for all
/// nodes that were looked at.
pub fn fitted<T>(mut found: Vec<T>) -> Vec<T> {
    found.shrink_to_fit();
    found
}

/// Asks the kernel to read the neighbours of `nodes`, which ascend.
pub fn will_need_rows(graph: Csr<'_>, nodes: &[u32], run: &Run) {
    run.will_need_few(graph.indices, near_ranges(nodes).map(|nodes| graph.starts.entries_of(nodes)));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::OwnedRowStarts;

    /// Regression: 4 bytes for each node of the graph, beside the budget: 40 MB at 10 million faces.
    #[test]
    fn what_is_found_takes_no_memory_for_the_rest() {
        let starts = OwnedRowStarts::of(vec![0; CHUNK]);
        let graph = Csr::new(starts.view(), &[], &[]);
        let rare = |i: usize| i.is_multiple_of(1000);
        for own in [&rare as &dyn Fn(usize) -> bool, &|_| true] {
            let found = of_chunk(graph, &Run::new(&()), 0..CHUNK, own, |mut nodes| {
                nodes.retain(|&i| rare(i as usize));
                nodes
            });
            assert!(found.len() == CHUNK.div_ceil(1000) && found.capacity() < 2 * found.len(), "{}", found.capacity());
        }
    }
}
