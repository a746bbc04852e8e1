//! Landmarks of a graph: a [`Sampling`] let loose on fronts.
//!
//! Landmarks are sent as soon as they are known, so rows can start. Memory: the field, 4 bytes a
//! node in a mapped file, and what the sampler keeps ([`super::sampling`]).

pub use super::sampling::farthest::{SEEDING_ROUNDS, extremity, farthest_node};
pub use super::sampling::{Sampling, SamplingParams};

use super::front::Front;
use super::sampling::GraphSpace;
use crate::base::Result;
use crate::graph::Node;
use crate::graph::dual::Csr;
use crate::store::Run;

/// Rows that an earlier run finished: their landmarks are known, and their distances spare the search its fronts.
pub trait Finished {
    /// The landmark of row `k`, where that row is finished.
    fn landmark(&self, k: usize) -> Option<u32>;
    /// Lowers `field` to the distances of the finished row `k` where those are smaller.
    fn lower(&self, k: usize, field: &mut [f32]);
}

impl Finished for () {
    fn landmark(&self, _: usize) -> Option<u32> {
        None
    }
    fn lower(&self, _: usize, _: &mut [f32]) {}
}

/// Sends up to `l` distinct landmarks to `found` (fewer only where there are fewer nodes), and returns what the search
/// cost in full fronts. `field` (n) is scratch; `lengths` is the graph weighted by length alone, for the
/// sampling that needs it; `front` is one for `graph`. Rows in `finished` are taken over: the landmarks are the same as without.
///
/// # Errors
/// [`crate::base::Error::Cancelled`], or an error of `found`.
pub fn choose(
    sampling: Sampling,
    l: usize,
    (graph, lengths): (Csr<'_>, Option<Csr<'_>>),
    nodes: &[Node],
    field: &mut [f32],
    front: &mut Front,
    finished: &impl Finished,
    run: &Run,
    mut found: impl FnMut(u32, Option<&[f32]>) -> Result<()>,
) -> Result<f64> {
    let mut space = GraphSpace::new(graph, nodes, lengths, front, finished, run);
    let visits = space.visits();
    let sampler = sampling.sampler(SamplingParams::default());
    sampler.choose(l.min(graph.len()), run.seed, &mut space, field, &mut found)?;
    Ok(visits.get() as f64 / graph.len().max(1) as f64)
}
