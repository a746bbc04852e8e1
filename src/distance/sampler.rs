//! The interface between rows and landmarks: who chooses the landmarks, and how the choice gets its distances.
//!
//! Rows are computed while the search for landmarks is still running. So the search is passed to the row job as a
//! [`Sampler`]; the samplings themselves are a layer above, in [`crate::landmarks`]. A sampler queries a [`Space`] for
//! distances; [`GraphSpace`] computes them by fronts over a graph and measures their cost in *full fronts*: visits
//! divided by nodes, so that a pruned front counts for the part of the surface that it covers.
//!
//! Memory: the search field, 4 bytes per node in a mapped file, and the state of the sampler.

use super::front::Front;
use crate::base::{Error, Result};
use crate::graph::Csr;
use crate::graph::weights::LEAST;
use crate::graph::{Node, NodeView};
use crate::store::Run;
use crate::store::mapped::Access;
use std::cell::Cell;
use std::rc::Rc;

/// Receives landmarks as soon as they are found: the node, and its row if the search happens to have it.
pub type Found<'a> = dyn FnMut(u32, Option<&[f32]>) -> Result<()> + 'a;

/// A method of choosing landmarks.
pub trait Sampler: Sync {
    /// Sends `l` distinct nodes of `space` (at most its size) to `found`. `field` (n) is scratch.
    ///
    /// # Errors
    /// [`Error::Cancelled`], or an error of `found`.
    fn choose(
        &self,
        l: usize,
        seed: u64,
        space: &mut dyn Space,
        field: &mut [f32],
        found: &mut Found<'_>,
    ) -> Result<()>;

    /// Whether the search uses length only, instead of the metric of the rows.
    fn needs_lengths(&self) -> bool {
        false
    }

    /// Whether the search is so expensive compared with the rows that the user is informed.
    fn is_costly(&self) -> bool {
        true
    }
}

/// Distances on demand.
pub trait Space {
    /// Geometry of the nodes (n).
    fn nodes(&self) -> NodeView<'_>;

    /// Fills `field` (n) with the distances from `node`.
    ///
    /// # Errors
    /// [`Error::Cancelled`].
    fn row(&mut self, node: u32, field: &mut [f32]) -> Result<()>;

    /// Lowers `field` (n) to the distances from `node`, landmark number `k`, where those are smaller.
    ///
    /// # Errors
    /// [`Error::Cancelled`].
    fn lower(&mut self, k: usize, node: u32, field: &mut [f32]) -> Result<()>;

    /// The same by length only.
    ///
    /// # Errors
    /// [`Error::Cancelled`]; [`Error::Parameter`] if the space has no lengths.
    fn lower_by_length(&mut self, node: u32, field: &mut [f32]) -> Result<()>;

    /// Number of threads that a sampler may use besides fronts.
    fn threads(&self) -> usize;

    /// Ends a long search among rows that are known already, which needs no more fronts.
    ///
    /// # Errors
    /// [`Error::Cancelled`].
    fn check(&self) -> Result<()> {
        Ok(())
    }

    /// Advises the kernel how the space's fields will be used from now on, if that matters.
    fn advise(&self, field: &[f32], access: Access);

    /// Landmark number `k`, if an earlier run found it and computed its row.
    fn finished(&self, _k: usize) -> Option<u32> {
        None
    }
}

/// Rows that an earlier run finished: their landmarks are known, and their distances save the search its fronts.
pub trait FinishedRows {
    /// The landmark of row `k`, if that row is finished.
    fn landmark(&self, k: usize) -> Option<u32>;
    /// Lowers `field` to the distances of the finished row `k` where those are smaller.
    fn lower(&self, k: usize, field: &mut [f32]);
}

impl FinishedRows for () {
    fn landmark(&self, _: usize) -> Option<u32> {
        None
    }
    fn lower(&self, _: usize, _: &mut [f32]) {}
}

/// A shared count of visits, readable while a sampler holds the space.
pub type VisitCount = Rc<Cell<u64>>;

/// The error of [`Space::lower_by_length`] for a space without lengths.
pub(crate) fn no_lengths() -> Error {
    Error::parameter("sampling", "this space has no lengths", "choose another sampling")
}

/// The graph on which landmarks are searched.
#[derive(Clone, Copy, Debug)]
pub struct SearchGraph<'a> {
    /// The graph over which rows are computed.
    pub graph: Csr<'a>,
    /// Geometry of its nodes (n).
    pub nodes: NodeView<'a>,
    /// The same graph weighted by length only, for samplers that need it ([`fill_lengths`]).
    pub lengths: Option<Csr<'a>>,
}

/// Distances by fronts over a graph; scratch memory is the front's.
pub struct GraphSpace<'a> {
    search: SearchGraph<'a>,
    finished: &'a dyn FinishedRows,
    front: &'a mut Front,
    length_front: Option<Front>,
    visits: VisitCount,
    run: &'a Run<'a>,
}

impl<'a> GraphSpace<'a> {
    /// A space over `search` with `front`, a front for its graph; `finished` rows are reused.
    pub fn new(
        search: SearchGraph<'a>,
        front: &'a mut Front,
        finished: &'a dyn FinishedRows,
        run: &'a Run<'a>,
    ) -> Self {
        let length_front = search.lengths.map(Front::over);
        Self { search, finished, front, length_front, visits: VisitCount::default(), run }
    }

    /// The count of visits so far; n of them are one full front.
    pub fn visits(&self) -> VisitCount {
        self.visits.clone()
    }

    /// Sends up to `l` distinct landmarks of `sampler` to `found` (fewer only if there are fewer nodes), and returns
    /// the cost of the search in full fronts. `field` (n) is scratch. Finished rows do not change the landmarks.
    ///
    /// # Errors
    /// [`Error::Cancelled`], or an error of `found`.
    pub fn sample(&mut self, sampler: &dyn Sampler, l: usize, field: &mut [f32], found: &mut Found<'_>) -> Result<f64> {
        let n = self.search.graph.len();
        sampler.choose(l.min(n), self.run.seed, self, field, found)?;
        Ok(self.visits.get() as f64 / n.max(1) as f64)
    }

    fn count(&self, visits: u64) {
        self.visits.set(self.visits.get() + visits);
    }
}

impl Space for GraphSpace<'_> {
    fn nodes(&self) -> NodeView<'_> {
        self.search.nodes
    }

    fn row(&mut self, node: u32, field: &mut [f32]) -> Result<()> {
        let visits = self.front.full(self.search.graph, node, field, &self.run.cancel)?;
        self.count(visits.expanded);
        Ok(())
    }

    fn lower(&mut self, k: usize, node: u32, field: &mut [f32]) -> Result<()> {
        self.run.cancel.check()?;
        if self.finished.landmark(k) == Some(node) {
            self.finished.lower(k, field);
        } else {
            let visits = self.front.lower(self.search.graph, &[node], field, &self.run.cancel)?;
            self.count(visits.expanded);
        }
        Ok(())
    }

    fn lower_by_length(&mut self, node: u32, field: &mut [f32]) -> Result<()> {
        let (Some(lengths), Some(front)) = (self.search.lengths, &mut self.length_front) else {
            return Err(no_lengths());
        };
        let visits = front.lower(lengths, &[node], field, &self.run.cancel)?;
        self.count(visits.expanded);
        Ok(())
    }

    fn threads(&self) -> usize {
        self.run.threads
    }

    fn check(&self) -> Result<()> {
        self.run.cancel.check()
    }

    fn advise(&self, field: &[f32], access: Access) {
        self.front.advise(field, access);
    }

    fn finished(&self, k: usize) -> Option<u32> {
        self.finished.landmark(k)
    }
}

/// Fills `out` (nnz) with the distances between the centroids of neighbours: `graph` weighted by length only.
///
/// # Errors
/// [`Error::Cancelled`].
pub fn fill_lengths(graph: Csr<'_>, nodes: NodeView<'_>, out: &mut [f32], run: &Run) -> Result<()> {
    const CHUNK: usize = 1 << 15;
    let fill = |k: usize, out: &mut [f32], held: &mut Vec<Node>| {
        let (mut row, mut span) = graph.starts.row_of(k * CHUNK);
        let last = graph.starts.row_of((k * CHUNK + out.len()).saturating_sub(1)).0;
        let nodes = nodes.window(row..last + 1, held);
        for (e, slot) in (k * CHUNK..).zip(out) {
            while span.end <= e {
                row += 1;
                span = graph.span(row as u32);
            }
            let (a, b) = (nodes.at(row).centroid, nodes.at(graph.indices[e] as usize).centroid);
            let (x, y, z) = (a[0] - b[0], a[1] - b[1], a[2] - b[2]);
            *slot = (x * x + y * y + z * z).sqrt().max(LEAST);
        }
        Ok(())
    };
    run.fill_chunks(out, CHUNK, Vec::new, fill).map(drop)
}
