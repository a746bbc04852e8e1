//! The sampled block `[A B]` as a source of columns, in `f64`: what preprocessing, embeddings and measures work on.
//!
//! A block has l rows (landmarks) and n columns in node order, A's among them. Columns are made in chunks and
//! forgotten; nothing of the size of the mesh is held. Cost of a pass: n·l affinities.

use crate::spectral::kernel::Kernel;
use nalgebra::DMatrix;
use std::ops::Range;

/// Columns a chunk; part of the results, since sums are added up by chunks.
pub const CHUNK: usize = 2048;

/// The sampled block.
pub trait Block: Sync {
    /// Nodes of the landmarks (l).
    fn landmarks(&self) -> &[u32];

    /// Number of columns n.
    fn nodes(&self) -> usize;

    /// Columns `range` of `[A B]` (m of them): row k at `k * m` of `out` (l × m).
    fn columns(&self, range: Range<usize>, out: &mut [f64]);

    /// What coordinates of the columns `range` are multiplied by after extrapolation; nothing by default.
    fn scale(&self, _range: Range<usize>) -> Option<Vec<f64>> {
        None
    }

    /// Number of landmarks l.
    fn len(&self) -> usize {
        self.landmarks().len()
    }

    /// Whether there are no landmarks.
    fn is_empty(&self) -> bool {
        self.landmarks().is_empty()
    }

    /// The columns of the given nodes (l × count).
    fn columns_of(&self, nodes: &[u32]) -> DMatrix<f64> {
        let mut out = DMatrix::zeros(self.len(), nodes.len());
        for (to, &node) in nodes.iter().enumerate() {
            let at = node as usize;
            self.columns(at..at + 1, out.column_mut(to).as_mut_slice());
        }
        out
    }

    /// A (l × l), made symmetric.
    fn sampled(&self) -> DMatrix<f64> {
        let a = self.columns_of(self.landmarks());
        0.5 * (&a + a.transpose())
    }
}

/// A block that lies in memory, for small sets and points that have no mesh.
#[derive(Clone, Debug)]
pub struct Dense {
    /// Nodes of the landmarks (l).
    pub landmarks: Vec<u32>,
    /// Their rows (l × n).
    pub rows: DMatrix<f64>,
}

impl Block for Dense {
    fn landmarks(&self) -> &[u32] {
        &self.landmarks
    }

    fn nodes(&self) -> usize {
        self.rows.ncols()
    }

    fn columns(&self, range: Range<usize>, out: &mut [f64]) {
        let m = range.len();
        for (j, column) in range.enumerate() {
            for k in 0..self.len() {
                out[k * m + j] = self.rows[(k, column)];
            }
        }
    }
}

/// The kernel's width.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bandwidth {
    /// σ, the same everywhere.
    Global(f64),
    /// √(σ_i σ_j), σ_j the distance of j to its q-th nearest landmark (self-tuning, after Zelnik-Manor and Perona 2004,
    /// with landmarks for neighbours).
    Local(usize),
}

/// A block of distances under a kernel.
#[derive(Clone, Debug)]
pub struct Affinities<'a> {
    landmarks: &'a [u32],
    /// Distances, a row a landmark (l × n).
    rows: Vec<&'a [f32]>,
    kernel: Kernel,
    bandwidth: Bandwidth,
    /// σ_i of the landmarks, where local.
    own: Vec<f64>,
}

impl<'a> Affinities<'a> {
    /// The affinities of `rows`, the distances from `landmarks`; both of one length, at least 1.
    pub fn new(landmarks: &'a [u32], rows: Vec<&'a [f32]>, kernel: Kernel, bandwidth: Bandwidth) -> Self {
        let mut block = Self { landmarks, rows, kernel, bandwidth, own: Vec::new() };
        if let Bandwidth::Local(q) = bandwidth {
            block.own = landmarks.iter().map(|&node| block.nearest(node as usize, q)).collect();
        }
        block
    }

    /// The distance of column `j` to its `q`-th nearest landmark.
    fn nearest(&self, j: usize, q: usize) -> f64 {
        let mut column: Vec<f32> = self.rows.iter().map(|row| row[j]).collect();
        column.sort_unstable_by(f32::total_cmp);
        f64::from(column[q.clamp(1, column.len()) - 1]).max(1e-30)
    }
}

impl Block for Affinities<'_> {
    fn landmarks(&self) -> &[u32] {
        self.landmarks
    }

    fn nodes(&self) -> usize {
        self.rows.first().map_or(0, |row| row.len())
    }

    fn columns(&self, range: Range<usize>, out: &mut [f64]) {
        let m = range.len();
        let local: Vec<f64> = match self.bandwidth {
            Bandwidth::Global(_) => Vec::new(),
            Bandwidth::Local(q) => range.clone().map(|j| self.nearest(j, q)).collect(),
        };
        for ((k, row), out) in self.rows.iter().enumerate().zip(out.chunks_exact_mut(m)) {
            for (j, (w, &d)) in out.iter_mut().zip(&row[range.clone()]).enumerate() {
                let sigma = match self.bandwidth {
                    Bandwidth::Global(sigma) => sigma,
                    Bandwidth::Local(_) => (self.own[k] * local[j]).sqrt(),
                };
                *w = self.kernel.of(sigma, f64::from(d));
            }
        }
    }
}
