//! Distances on demand from a full distance matrix: for studies of sampling on small sets.
//!
//! A row is a copy of n numbers; the matrix (4 n² bytes) belongs to the caller.

use crate::base::{Cancel, Result};
use crate::distance::front::{Front, mean_weight};
use crate::distance::sampler::{Space, VisitCount, no_lengths};
use crate::graph::Csr;
use crate::graph::NodeView;
use crate::store::mapped::Access;

/// All distances of a small set, row i at `i * n`.
pub struct MatrixSpace<'a> {
    distances: &'a [f32],
    nodes: NodeView<'a>,
    lengths: Option<(Csr<'a>, Front)>,
    visits: VisitCount,
}

impl<'a> MatrixSpace<'a> {
    /// A space over `distances` (n × n), with the graph of lengths if needed.
    pub fn new(distances: &'a [f32], nodes: NodeView<'a>, lengths: Option<Csr<'a>>) -> Self {
        let lengths = lengths.map(|lengths| (lengths, Front::new(mean_weight(lengths))));
        Self { distances, nodes, lengths, visits: VisitCount::default() }
    }

    /// The count of visits so far; n of them are one full front.
    pub fn visits(&self) -> VisitCount {
        self.visits.clone()
    }

    fn count(&self, visits: u64) {
        self.visits.set(self.visits.get() + visits);
    }
}

impl Space for MatrixSpace<'_> {
    fn nodes(&self) -> NodeView<'_> {
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
            // Counts the visits of a pruned front.
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

    fn threads(&self) -> usize {
        1
    }

    /// The fields are in memory.
    fn advise(&self, _: &[f32], _: Access) {}
}
