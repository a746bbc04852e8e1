//! What is done to affinities before the eigenproblem, each as a function of `[A B]`'s columns.
//!
//! - [`Preprocess::Degree`]: D^-½ W D^-½ with the degrees of the Nyström approximation, d_j = B_jᵀ A⁺ (W 1): the row
//!   sums W 1 of the landmarks take one pass, d_j then follows from column j.
//! - [`Preprocess::RowStochastic`]: D⁻¹W is not symmetric; its eigenvectors are D^-½ times those of the above, so
//!   coordinates are scaled after extrapolation.
//! - [`Preprocess::Centred`]: kernel PCA centred on the training set, k̃(x_r, y) = k(x_r, y) − mean_s k(x_s, y) −
//!   mean_s k(x_r, x_s) + mean_st k(x_s, x_t): a function of A and of column y.
//!
//! The anchor graph is a normalisation of [`super::embedding`]: it replaces A instead of preparing it.

use super::block::{Block, CHUNK};
use super::measures::Kept;
use crate::base::Result;
use crate::base::parallel::{chunk_count, chunk_range, map_chunks};
use crate::store::Run;
use std::ops::Range;

/// What is done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Preprocess {
    /// Nothing.
    #[default]
    None,
    /// Division by the roots of both degrees.
    Degree,
    /// Division by the degree of the row.
    RowStochastic,
    /// Double centring.
    Centred,
}

/// A block after preprocessing.
pub struct Prepared<'a> {
    block: &'a dyn Block,
    kind: Preprocess,
    /// A⁺ (W 1) (l), for degrees.
    toward_degrees: Vec<f64>,
    /// Least degree.
    floor: f64,
    /// Roots of the landmarks' degrees, or means of A's rows (l).
    own: Vec<f64>,
    /// Mean of A.
    mean: f64,
}

impl<'a> Prepared<'a> {
    /// Prepares `block`. `tolerance`: eigenvalues of A up to this share of the greatest are dropped.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn new(block: &'a dyn Block, kind: Preprocess, tolerance: f64, run: &Run) -> Result<Self> {
        let mut prepared = Self { block, kind, toward_degrees: Vec::new(), floor: 0., own: Vec::new(), mean: 0. };
        let l = block.len();
        match kind {
            Preprocess::None => {}
            Preprocess::Centred => {
                prepared.own = block.sampled().row_mean().iter().copied().collect();
                prepared.mean = prepared.own.iter().sum::<f64>() / l as f64;
            }
            Preprocess::Degree | Preprocess::RowStochastic => {
                let sums = row_sums(block, run)?;
                let kept = Kept::of(block.sampled(), tolerance);
                prepared.floor = 1e-3 * sums.iter().sum::<f64>() / l as f64;
                prepared.toward_degrees = kept.solve(&sums);
                prepared.own = sums.iter().map(|sum| sum.max(prepared.floor).sqrt()).collect();
            }
        }
        Ok(prepared)
    }

    /// Degrees of the m columns in `columns` (l × m).
    fn degrees(&self, m: usize, columns: &[f64]) -> Vec<f64> {
        let mut degrees = vec![0.; m];
        for (row, c) in columns.chunks_exact(m).zip(&self.toward_degrees) {
            degrees.iter_mut().zip(row).for_each(|(d, w)| *d += c * w);
        }
        degrees.iter_mut().for_each(|d| *d = d.max(self.floor));
        degrees
    }
}

/// W 1 for the landmarks (l): one pass.
fn row_sums(block: &dyn Block, run: &Run) -> Result<Vec<f64>> {
    let (l, n) = (block.len(), block.nodes());
    let parts = map_chunks(run.threads, &run.cancel, chunk_count(n, CHUNK), Vec::new, |k, out: &mut Vec<f64>| {
        let range = chunk_range(n, CHUNK, k);
        out.resize(l * range.len(), 0.);
        block.columns(range.clone(), out);
        Ok(out.chunks_exact(range.len()).map(|row| row.iter().sum()).collect::<Vec<f64>>())
    })?;
    Ok((0..l).map(|k| parts.iter().map(|part| part[k]).sum()).collect())
}

impl Block for Prepared<'_> {
    fn landmarks(&self) -> &[u32] {
        self.block.landmarks()
    }

    fn nodes(&self) -> usize {
        self.block.nodes()
    }

    fn columns(&self, range: Range<usize>, out: &mut [f64]) {
        let m = range.len();
        self.block.columns(range, out);
        match self.kind {
            Preprocess::None => {}
            Preprocess::Centred => {
                let mut means = vec![0.; m];
                for row in out.chunks_exact(m) {
                    means.iter_mut().zip(row).for_each(|(mean, w)| *mean += w / self.own.len() as f64);
                }
                for (row, own) in out.chunks_exact_mut(m).zip(&self.own) {
                    row.iter_mut().zip(&means).for_each(|(w, mean)| *w += self.mean - mean - own);
                }
            }
            Preprocess::Degree | Preprocess::RowStochastic => {
                let roots: Vec<f64> = self.degrees(m, out).into_iter().map(f64::sqrt).collect();
                for (row, own) in out.chunks_exact_mut(m).zip(&self.own) {
                    row.iter_mut().zip(&roots).for_each(|(w, root)| *w /= own * root);
                }
            }
        }
    }

    fn scale(&self, range: Range<usize>) -> Option<Vec<f64>> {
        let inner = self.block.scale(range.clone());
        if self.kind != Preprocess::RowStochastic {
            return inner;
        }
        let m = range.len();
        let mut out = vec![0.; self.len() * m];
        self.block.columns(range, &mut out);
        let mut scale: Vec<f64> = self.degrees(m, &out).into_iter().map(|d| 1. / d.sqrt()).collect();
        if let Some(inner) = inner {
            scale.iter_mut().zip(inner).for_each(|(s, i)| *s *= i);
        }
        Some(scale)
    }
}
