//! Corrects labels that may be stale after a front from many sources, using the final distances.
//!
//! A node's label is that of its shortest path, and the smallest one at a tie. While a front runs, a node may pass its
//! label on and then be lowered by so little that rounding hides the change from the next node, which keeps the label
//! of a path that is no longer shortest. This can be detected: when the lowered node passes on its new, larger label,
//! the next node meets a tie that it has already won. Such nodes are listed and checked once distances are final. The
//! right label is the smallest among the neighbours on shortest paths; these are nearer, so labels are corrected in
//! order of distance. All other nodes have received the last label of every such neighbour. Usually nothing is wrong,
//! because ties between genuinely equal paths look the same.
//!
//! A second front over the final distances, in which only labels move, gives the same result but doubles the time. It
//! is used only for graphs with edges of length 0, where a neighbour on a shortest path may be as far away as the node
//! itself.
//!
//! Memory: 4 bytes per tie, for a sixty-fourth of the nodes at most. Time: each tie checks its neighbours once.

use crate::base::{Cancel, Result};
use crate::graph::Csr;
use crate::graph::csr::near_ranges;
use crate::store::mapped::{Access, advise, will_need};
use std::collections::BTreeSet;

/// Ties processed between checks of the stop flag.
const STOP_CHECK: usize = 1 << 12;

/// Nodes that met a tie which they had already won. Their labels may be stale: passed on by a node that was lowered
/// later, by so little that rounding hides it here.
#[derive(Clone, Debug, Default)]
pub(super) struct Ties {
    /// In any order, possibly repeated.
    nodes: Vec<u32>,
    /// Whether there are more than are listed.
    more: bool,
}

impl Ties {
    /// Whether no label can be stale.
    pub(super) fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// The ties at `nodes`, but no more than `most`. If there are at least twice as many, the list may have been
    /// truncated.
    pub(super) fn of(nodes: Vec<u32>, most: usize) -> Self {
        let mut all = Self::default();
        let more = nodes.len() >= 2 * most;
        all.add(Self { nodes, more }, most);
        all
    }

    /// Maximum number of ties listed for a graph.
    pub(super) fn most(graph: Csr<'_>) -> usize {
        graph.len() / 64 + (1 << 12)
    }

    /// Adds the ties of `other`, but keeps no more than `most`.
    pub(super) fn add(&mut self, mut other: Self, most: usize) {
        self.nodes.append(&mut other.nodes);
        self.more |= other.more;
        if self.nodes.len() > most {
            self.nodes.sort_unstable();
            self.nodes.dedup();
            self.more |= self.nodes.len() > most / 2;
            self.nodes.truncate(most / 2);
        }
    }

    /// Corrects the labels given the final distances `field` (n). Returns whether that was possible. `paged`: the graph
    /// is larger than memory.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub(super) fn correct_labels(
        mut self,
        graph: Csr<'_>,
        field: &[f32],
        label: &mut [u32],
        paged: bool,
        cancel: &Cancel,
    ) -> Result<bool> {
        if self.more {
            return Ok(false);
        }
        self.nodes.sort_unstable();
        self.nodes.dedup();
        let access = |access: Access, label: &[u32]| {
            if paged {
                graph.advise(access);
                advise(field, access);
                advise(label, access);
            }
        };
        access(Access::Random, label);
        let corrected = correct_labels(graph, &self.nodes, field, label, paged, cancel);
        access(Access::Local, label);
        corrected
    }
}

fn correct_labels(
    graph: Csr<'_>,
    ties: &[u32],
    field: &[f32],
    label: &mut [u32],
    paged: bool,
    cancel: &Cancel,
) -> Result<bool> {
    let mut wrong = BTreeSet::new();
    for nodes in ties.chunks(STOP_CHECK) {
        cancel.check()?;
        if paged {
            for near in near_ranges(nodes) {
                graph.will_need_rows(near.clone());
                will_need(&field[near.clone()]);
                will_need(&label[near]);
            }
        }
        for &node in nodes {
            let Some(right) = label_of_paths(graph, node, field, label) else { return Ok(false) };
            if right != label[node as usize] {
                wrong.insert((field[node as usize].to_bits(), node));
            }
        }
    }
    while let Some((bits, node)) = wrong.pop_first() {
        cancel.check()?;
        let Some(right) = label_of_paths(graph, node, field, label) else { return Ok(false) };
        if std::mem::replace(&mut label[node as usize], right) == right {
            continue;
        }
        for (next, weight) in graph.neighbours(node) {
            let there = field[next as usize];
            if f32::from_bits(bits) + weight == there {
                wrong.insert((there.to_bits(), next));
            }
        }
    }
    Ok(true)
}

/// The smallest label among the neighbours through which `node` has its distance; `None` if one of them is as far as
/// the node, or if there are none.
fn label_of_paths(graph: Csr<'_>, node: u32, field: &[f32], label: &[u32]) -> Option<u32> {
    let own = field[node as usize];
    let tight = graph.neighbours(node).filter(|&(next, weight)| field[next as usize] + weight == own);
    let label = |(next, _): (u32, f32)| (field[next as usize] < own).then(|| label[next as usize]);
    tight.map(label).reduce(|a, b| Some(a?.min(b?))).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::OwnedRowStarts;

    /// The result for `label` on a path of nodes with these weights, with `ties` at these nodes.
    fn corrected(steps: &[f32], field: &[f32], label: &[u32], ties: Ties) -> (bool, Vec<u32>) {
        let n = field.len();
        let beside = |i: usize| [i.checked_sub(1), (i + 1 < n).then_some(i + 1)].into_iter().flatten();
        let starts = OwnedRowStarts::of((0..n).map(|i| beside(i).count()));
        let indices: Vec<u32> = (0..n).flat_map(beside).map(|j| j as u32).collect();
        let weights: Vec<f32> = (0..n).flat_map(|i| beside(i).map(move |j| steps[i.min(j)])).collect();
        let mut label = label.to_vec();
        let graph = Csr::new(starts.view(), &indices, &weights);
        let done = ties.correct_labels(graph, field, &mut label, false, &Cancel::default()).unwrap();
        (done, label)
    }

    #[test]
    fn a_stale_label_and_what_follows_from_it_are_mended() {
        // Source 0 is in the middle; node 1 was lowered by source 1 at the left end after it had passed 0 on to node 2.
        let (steps, field) = ([1., 1e6, 2., 3.], [0., 1., 1_000_001., 3., 0.]);
        let label = [1, 1, 0, 0, 0];
        assert_eq!(corrected(&steps, &field, &label, Ties::of(vec![2, 2], 9)), (true, vec![1, 1, 1, 0, 0]));
        // All the way down, but not beyond where another path is as short.
        let field = [0., 1., 1_000_001., 1_000_003., 1_000_006.];
        let label = [1, 1, 0, 0, 0];
        assert_eq!(corrected(&steps, &field, &label, Ties::of(vec![2], 9)), (true, vec![1; 5]));
        // A tie between equal paths has the smaller label already.
        let (steps, field, label) = ([2., 2.], [0., 2., 0.], [7, 5, 5]);
        assert_eq!(corrected(&steps, &field, &label, Ties::of(vec![1], 9)), (true, vec![7, 5, 5]));
    }

    #[test]
    fn steps_of_no_length_and_too_many_ties_are_left_to_another_front() {
        let (steps, field, label) = ([1., 0.], [0., 1., 1.], [0, 0, 0]);
        assert!(!corrected(&steps, &field, &label, Ties::of(vec![2], 9)).0);
        assert!(!corrected(&steps, &field, &label, Ties::of((0..3).collect(), 2)).0);
        assert!(!corrected(&steps, &field, &label, Ties::of(vec![1; 18], 9)).0);
        assert!(corrected(&steps, &field, &label, Ties::of(vec![], 9)).0);
    }
}
