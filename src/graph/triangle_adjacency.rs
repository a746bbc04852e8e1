//! The graph of a closed triangle mesh in records of three steps, for fronts.
//!
//! Nearly every face has three neighbours. With their numbers and the weights of the steps in one record a front needs
//! one cache line a node instead of three and no row start, and its inner loop has a fixed length: with
//! large pages a row takes about half the time (`benches/records`). It is a copy, 24 bytes a node beside the sparse matrix, so it is made only where many rows
//! will be computed and half of the budget stays free; without it fronts walk the matrix, with the same result.

use super::dual::Csr;
use crate::base::Result;
use crate::base::parallel::fill_chunks;
use crate::store::Run;
use crate::store::in_memory::AlignedBuffer;
use bytemuck::{Pod, Zeroable};

/// Nodes a chunk of the pass that makes them.
const CHUNK: usize = 1 << 14;
/// In the place of the first neighbour: there are more than three, look them up in the matrix.
const MORE: u32 = u32::MAX;

/// The steps from a node; where there are fewer than three, infinite ones to itself besides.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub struct TriangleNeighbours {
    next: [u32; 3],
    weights: [f32; 3],
}

impl TriangleNeighbours {
    /// The steps, where there are no more than three.
    #[inline(always)]
    pub fn steps(&self) -> Option<(&[u32; 3], &[f32; 3])> {
        (self.next[0] != MORE).then_some((&self.next, &self.weights))
    }
}

/// A triple a node (n).
#[derive(Debug)]
pub struct TriangleAdjacency {
    words: AlignedBuffer,
    nodes: usize,
}

impl TriangleAdjacency {
    /// The triples of `graph`; `None` where the budget has no room for them. One parallel pass.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn of(graph: Csr<'_>, run: &Run) -> Result<Option<Self>> {
        let Some(mut words) = AlignedBuffer::spare(&run.budget, graph.len() * size_of::<TriangleNeighbours>()) else {
            return Ok(None);
        };
        let all: &mut [TriangleNeighbours] = words.items_mut(graph.len());
        fill_chunks(
            run.threads,
            &run.cancel,
            all,
            CHUNK,
            || (),
            |k, out, ()| {
                for (node, triple) in (k * CHUNK..).zip(out) {
                    let span = graph.indptr[node] as usize..graph.indptr[node + 1] as usize;
                    let (next, weights) = (&graph.indices[span.clone()], &graph.weights[span]);
                    *triple = TriangleNeighbours { next: [node as u32; 3], weights: [f32::INFINITY; 3] };
                    if next.len() > 3 {
                        triple.next[0] = MORE;
                    } else {
                        triple.next[..next.len()].copy_from_slice(next);
                        triple.weights[..next.len()].copy_from_slice(weights);
                    }
                }
                Ok(())
            },
        )?;
        Ok(Some(Self { words, nodes: graph.len() }))
    }

    /// The triples (n).
    pub fn all(&self) -> &[TriangleNeighbours] {
        self.words.items(self.nodes)
    }
}
