//! One label per vertex: that of most faces around it.
//!
//! Labels are tallied in blocks of vertices as large as the budget allows, with one pass over the faces per block. A
//! vertex has room for [`KINDS`] labels, so its result is exact if no more meet there, on fewer than 65,536 faces each;
//! 24 bytes per vertex. A face counts once at a vertex, however many of its corners are there.

use crate::base::Result;
use crate::mesh::geometry::Mesh;
use crate::store::Run;
use crate::store::budget::Grant;

/// Labels tallied per vertex.
const KINDS: usize = 3;
/// Minimum number of vertices in a block, if there are as many.
const LEAST: usize = 1 << 12;
/// Faces between two checks of the stop flag.
const CHUNK: usize = 1 << 16;

/// The labels at a vertex and their counts.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    labels: [u32; KINDS],
    counts: [u16; KINDS],
    /// The number of the last face counted, from 1; 0 if there is none.
    last: u32,
}

impl Tally {
    /// Counts `face`, whose label is `label`; faces come in ascending order.
    fn add(&mut self, face: usize, label: u32) {
        let last = std::mem::replace(&mut self.last, face as u32 + 1);
        if last == self.last {
            return;
        }
        let known = (0..KINDS).find(|&k| self.counts[k] > 0 && self.labels[k] == label);
        match known.or_else(|| (0..KINDS).find(|&k| self.counts[k] == 0)) {
            Some(k) => {
                self.labels[k] = label;
                self.counts[k] = self.counts[k].saturating_add(1);
            }
            // Four different labels, one face each: any of them will do.
            None if self.counts == [1; KINDS] => {
                let least = self.labels.into_iter().fold(label, u32::min);
                (self.labels[0], self.counts) = (least, [1, 0, 0]);
            }
            // One label too many: decrement all counts, so that a label of most faces stays (Misra–Gries).
            None => self.counts.iter_mut().for_each(|count| *count -= 1),
        }
    }

    /// The most frequent label; of several, the smallest.
    fn most(&self) -> Option<u32> {
        let met = (0..KINDS).filter(|&k| self.counts[k] > 0);
        met.max_by_key(|&k| (self.counts[k], std::cmp::Reverse(self.labels[k]))).map(|k| self.labels[k])
    }
}

/// The labels of all vertices, queried in ascending order.
pub(super) struct VertexLabels<'a> {
    mesh: &'a Mesh,
    labels: &'a [u32],
    run: &'a Run<'a>,
    start: usize,
    block: Vec<Tally>,
    width: usize,
    _grant: Grant,
}

impl<'a> VertexLabels<'a> {
    /// For the vertices of `mesh`, whose faces have `labels`.
    ///
    /// # Errors
    /// [`crate::base::Error::Memory`].
    pub(super) fn new(mesh: &'a Mesh, labels: &'a [u32], run: &'a Run<'a>) -> Result<Self> {
        let (vertices, size) = (mesh.positions.len().max(1), size_of::<Tally>() as u64);
        let least = size * vertices.min(LEAST) as u64;
        let grant = run.budget.take("labels of vertices", least, size * vertices as u64)?;
        let width = (grant.bytes() / size) as usize;
        Ok(Self { mesh, labels, run, start: 0, block: Vec::new(), width, _grant: grant })
    }

    /// The label of `vertex`; `None` if it has no face.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub(super) fn get(&mut self, vertex: usize) -> Result<Option<u32>> {
        if vertex < self.start || vertex >= self.start + self.block.len() {
            self.fill(vertex)?;
        }
        Ok(self.block.get(vertex - self.start).and_then(Tally::most))
    }

    /// Tallies the block that starts at `start`.
    fn fill(&mut self, start: usize) -> Result<()> {
        self.start = start;
        self.block.clear();
        self.block.resize(self.width.min(self.mesh.positions.len() - start), Tally::default());
        let faces = self.mesh.faces.len();
        for first in (0..faces).step_by(CHUNK) {
            self.run.cancel.check()?;
            self.mesh.faces.for_each(first..faces.min(first + CHUNK), |face, corners| {
                for &corner in corners {
                    if let Some(tally) = (corner as usize).checked_sub(start).and_then(|at| self.block.get_mut(at)) {
                        tally.add(face, self.labels[face]);
                    }
                }
            });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Budget;

    /// Regression: four labels on one face each cancelled each other, and the vertex had none.
    #[test]
    fn a_vertex_of_faces_has_a_label() {
        for n in 1..9u32 {
            let mut tally = Tally::default();
            (0..n).for_each(|k| tally.add(k as usize, 3 * k % n));
            assert!(tally.most().is_some(), "{n}");
        }
        let mut tally = Tally::default();
        [9, 5, 7, 6].into_iter().enumerate().for_each(|(face, label)| tally.add(face, label));
        assert_eq!(tally.most(), Some(5));
    }

    /// Regression: a degenerate face counted once for each of its corners at a vertex.
    #[test]
    fn a_face_counts_once_at_a_vertex() {
        let mesh = Mesh::from_slices(&[[0.; 3]; 5], &[[0u32, 1, 2], [0, 2, 3], [0, 0, 0], [0, 4, 0]]).unwrap();
        let run = Run::new(&());
        let mut votes = VertexLabels::new(&mesh, &[3, 3, 1, 2], &run).unwrap();
        assert_eq!([0, 4].map(|vertex| votes.get(vertex).unwrap()), [Some(3), Some(2)]);
    }

    #[test]
    fn the_most_frequent_label_wins_whatever_the_blocks() {
        // A fan around vertex 0, and many vertices of no face.
        let faces: Vec<[u32; 3]> = (1..7).map(|k| [0, k, k % 6 + 1]).collect();
        let mesh = Mesh::from_slices(&vec![[0.; 3]; 3 * LEAST], &faces).unwrap();
        let labels = [5, 5, 7, 9, 7, 7];
        let narrow = Run { budget: Budget::new((size_of::<Tally>() * LEAST) as u64), ..Run::new(&()) };
        for run in [Run::new(&()), narrow] {
            let mut votes = VertexLabels::new(&mesh, &labels, &run).unwrap();
            let all: Vec<_> = (0..3 * LEAST).map(|v| votes.get(v).unwrap()).collect();
            assert_eq!(all[..7], [7, 5, 5, 5, 7, 7, 7].map(Some));
            assert!(all[7..].iter().all(Option::is_none));
        }
    }
}
