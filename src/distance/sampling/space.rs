//! Where samplers get distances from: fronts over a graph, or a matrix of all of them.
//!
//! A space counts what it was asked for in *fronts*: visits divided by nodes, so that a pruned front counts for the
//! part of the surface that it covers.

use crate::base::{Cancel, Error, Result};
use crate::distance::front::{Front, mean_weight};
use crate::distance::landmarks::Finished;
use crate::graph::Node;
use crate::graph::dual::Csr;
use crate::store::Run;
use crate::store::mapped::Access;
use std::cell::Cell;
use std::rc::Rc;

/// Distances on demand.
pub trait Space {
    /// Geometry of the nodes (n).
    fn nodes(&self) -> &[Node];

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

    /// The same by length alone.
    ///
    /// # Errors
    /// [`Error::Cancelled`]; [`Error::Parameter`] where the space has no lengths.
    fn lower_by_length(&mut self, node: u32, field: &mut [f32]) -> Result<()>;

    /// Threads that a sampler may use besides fronts.
    fn threads(&self) -> usize {
        1
    }

    /// Tells the kernel how the space's fields will be used from now on, where that matters.
    fn advise(&self, _field: &[f32], _access: Access) {}

    /// Landmark number `k` where an earlier run found it and computed its row.
    fn finished(&self, _k: usize) -> Option<u32> {
        None
    }
}

/// A count of visits, readable while a sampler holds the space.
pub type Visits = Rc<Cell<u64>>;

fn no_lengths() -> Error {
    Error::parameter("--sampling", "this space has no lengths", "choose another sampling")
}

/// A graph and a front; scratch memory is the front's.
pub struct GraphSpace<'a, F> {
    graph: Csr<'a>,
    nodes: &'a [Node],
    /// The same graph weighted by length alone, where asked for.
    lengths: Option<Csr<'a>>,
    finished: &'a F,
    front: &'a mut Front,
    straight: Option<Front>,
    visits: Visits,
    run: &'a Run<'a>,
}

impl<'a, F: Finished> GraphSpace<'a, F> {
    /// A space over `graph`, for which `front` is one; rows in `finished` are taken over.
    pub fn new(
        graph: Csr<'a>,
        nodes: &'a [Node],
        lengths: Option<Csr<'a>>,
        front: &'a mut Front,
        finished: &'a F,
        run: &'a Run<'a>,
    ) -> Self {
        let straight = lengths.map(|lengths| Front::new(mean_weight(lengths)));
        Self { graph, nodes, lengths, finished, front, straight, visits: Visits::default(), run }
    }

    /// The count of visits so far; n of them are a front.
    pub fn visits(&self) -> Visits {
        self.visits.clone()
    }

    fn count(&self, visits: u64) {
        self.visits.set(self.visits.get() + visits);
    }
}

impl<F: Finished> Space for GraphSpace<'_, F> {
    fn nodes(&self) -> &[Node] {
        self.nodes
    }

    fn row(&mut self, node: u32, field: &mut [f32]) -> Result<()> {
        let visits = self.front.full(self.graph, node, field, &self.run.cancel)?;
        self.count(visits.expanded);
        Ok(())
    }

    fn lower(&mut self, k: usize, node: u32, field: &mut [f32]) -> Result<()> {
        self.run.cancel.check()?;
        if self.finished.landmark(k) == Some(node) {
            self.finished.lower(k, field);
        } else {
            let visits = self.front.lower(self.graph, &[node], field, &self.run.cancel)?;
            self.count(visits.expanded);
        }
        Ok(())
    }

    fn lower_by_length(&mut self, node: u32, field: &mut [f32]) -> Result<()> {
        let (Some(lengths), Some(front)) = (self.lengths, &mut self.straight) else { return Err(no_lengths()) };
        let visits = front.lower(lengths, &[node], field, &self.run.cancel)?;
        self.count(visits.expanded);
        Ok(())
    }

    fn threads(&self) -> usize {
        self.run.threads
    }

    fn advise(&self, field: &[f32], access: Access) {
        self.front.advise(field, access);
    }

    fn finished(&self, k: usize) -> Option<u32> {
        self.finished.landmark(k)
    }
}

/// All distances of a small set, row i at `i * n`.
pub struct MatrixSpace<'a> {
    distances: &'a [f32],
    nodes: &'a [Node],
    lengths: Option<(Csr<'a>, Front)>,
    visits: Visits,
}

impl<'a> MatrixSpace<'a> {
    /// A space over `distances` (n × n), with the graph of lengths where it is asked for.
    pub fn new(distances: &'a [f32], nodes: &'a [Node], lengths: Option<Csr<'a>>) -> Self {
        let lengths = lengths.map(|lengths| (lengths, Front::new(mean_weight(lengths))));
        Self { distances, nodes, lengths, visits: Visits::default() }
    }

    /// The count of visits so far; n of them are a front.
    pub fn visits(&self) -> Visits {
        self.visits.clone()
    }

    fn count(&self, visits: u64) {
        self.visits.set(self.visits.get() + visits);
    }
}

impl Space for MatrixSpace<'_> {
    fn nodes(&self) -> &[Node] {
        self.nodes
    }

    fn row(&mut self, node: u32, field: &mut [f32]) -> Result<()> {
        let n = self.nodes.len();
        field.copy_from_slice(&self.distances[node as usize * n..(node as usize + 1) * n]);
        self.count(n as u64);
        Ok(())
    }

    fn lower(&mut self, _: usize, node: u32, field: &mut [f32]) -> Result<()> {
        let n = self.nodes.len();
        let mut lowered = 0;
        for (known, &d) in field.iter_mut().zip(&self.distances[node as usize * n..(node as usize + 1) * n]) {
            // As many visits as a pruned front would make.
            if d < *known {
                *known = d;
                lowered += 1;
            }
        }
        self.count(lowered);
        Ok(())
    }

    fn lower_by_length(&mut self, node: u32, field: &mut [f32]) -> Result<()> {
        let (lengths, front) = self.lengths.as_mut().ok_or_else(no_lengths)?;
        let visits = front.lower(*lengths, &[node], field, &Cancel::default())?;
        self.count(visits.expanded);
        Ok(())
    }
}
