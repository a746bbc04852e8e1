//! A partial Cholesky factorisation on a sample of columns: what greedy sampling and pivoted Cholesky share.
//!
//! With the columns C (s) and landmarks among them, K ≈ GGᵀ on C; a new landmark c has the residual column
//! r = k_c − G G_cᵀ, and Γ grows by Σ r_j²/r_c. O(s i) a candidate. Memory: 8 s l bytes.

use super::{PILOTS, SamplingParams, Space, distinct};
use crate::base::Result;
use crate::distance::kernel::Kernel;

/// Pivots below this share of an affinity's greatest value, 1, are rounding.
pub const LEAST_PIVOT: f64 = 1e-6;

/// The factor so far.
pub struct Factor {
    /// Nodes of the sampled columns (s).
    pub columns: Vec<u32>,
    /// Rows of G (i × s).
    rows: Vec<Vec<f64>>,
    /// Diagonal of K − GGᵀ (s).
    pub residual: Vec<f64>,
    kernel: Kernel,
    /// The kernel's width, known once rows are.
    pub sigma: Option<f64>,
}

impl Factor {
    /// A factor of rank 0 over up to `params.columns` columns of `n`, at least `l`.
    pub fn new(n: usize, l: usize, params: SamplingParams, seed: u64) -> Self {
        let mut columns = distinct(n, params.columns.max(l), seed, "columns of samplers");
        columns.sort_unstable();
        let residual = vec![1.; columns.len()];
        Self { columns, rows: Vec::new(), residual, kernel: params.kernel, sigma: params.sigma }
    }

    /// The distances from column `c` to all columns (s): a front.
    pub fn distances(&self, c: usize, space: &mut dyn Space, field: &mut [f32]) -> Result<Vec<f32>> {
        space.row(self.columns[c], field)?;
        Ok(self.columns.iter().map(|&node| field[node as usize]).collect())
    }

    /// The width: as given, or the mean of rows from [`PILOTS`] columns.
    pub fn find_width(&mut self, space: &mut dyn Space, field: &mut [f32], seed: u64) -> Result<()> {
        if self.sigma.is_none() {
            let pilots = distinct(self.columns.len(), PILOTS, seed, "pilots");
            let rows: Result<Vec<_>> = pilots.iter().map(|&c| self.distances(c as usize, space, field)).collect();
            self.sigma = Some(mean(&rows?));
        }
        Ok(())
    }

    /// Affinities of `distances` (s).
    pub fn affinities(&self, distances: &[f32]) -> Vec<f64> {
        let sigma = self.sigma.unwrap_or(1.);
        let mut out = vec![0f32; distances.len()];
        self.kernel.apply(sigma as f32, distances, &mut out);
        out.into_iter().map(f64::from).collect()
    }

    /// The residual column of column `c`, whose affinities are given (s).
    pub fn residual_of(&self, c: usize, mut affinities: Vec<f64>) -> Vec<f64> {
        for row in &self.rows {
            let factor = row[c];
            affinities.iter_mut().zip(row).for_each(|(r, g)| *r -= factor * g);
        }
        affinities
    }

    /// What landmark `c` with this residual column adds to Γ over the columns; nothing below [`LEAST_PIVOT`].
    pub fn gain(c: usize, residual: &[f64]) -> Option<f64> {
        let pivot = residual[c];
        (pivot > LEAST_PIVOT).then(|| residual.iter().map(|r| r * r).sum::<f64>() / pivot)
    }

    /// Adds column `c` with its residual column to the factor; one within rounding of the others adds nothing.
    pub fn push(&mut self, c: usize, mut residual: Vec<f64>) {
        let pivot = residual[c];
        if pivot > LEAST_PIVOT {
            let inverse = 1. / pivot.sqrt();
            residual.iter_mut().for_each(|r| *r *= inverse);
            for (d, g) in self.residual.iter_mut().zip(&residual) {
                *d = (*d - g * g).max(0.);
            }
            self.rows.push(residual);
        }
        self.residual[c] = 0.;
    }
}

/// Mean of the finite distances in `rows`.
pub fn mean(rows: &[Vec<f32>]) -> f64 {
    let finite = || rows.iter().flatten().filter(|d| d.is_finite());
    finite().map(|&d| f64::from(d)).sum::<f64>() / finite().count().max(1) as f64
}
