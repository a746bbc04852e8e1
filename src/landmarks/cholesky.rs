//! Randomly pivoted Cholesky: each landmark is drawn with a probability proportional to what the previous ones leave
//! unexplained at it.
//!
//! The residual diagonal of the affinities, d_j = k_jj − w̃_jj, is a squared distance in feature space; drawing in
//! proportion to it is what D² seeding is for K-means. One row per landmark, no candidates: between random and farthest
//! in cost and quality. After Chen, Epperly, Tropp and Webber, *Randomly pivoted Cholesky* (2023).
//!
//! [`Factor`], the factorisation on a sample of columns, is shared with greedy sampling: with the columns C (s) and
//! landmarks among them, K ≈ GGᵀ on C; a new landmark c has the residual column r = k_c − G G_cᵀ, and Γ grows by
//! Σ r_j²/r_c ([`Factor::gain`]). O(s i) per candidate. Memory: 8 s l bytes.

use super::{Found, PILOTS, Sampler, SamplingParams, Space, distinct};
use crate::base::Result;
use crate::base::random::{stream, unit};
use crate::spectral::Kernel;

/// Minimum pivot, relative to the maximum affinity, 1. Below it there is nothing to gain, and the division would
/// amplify the indefiniteness of geodesic affinities.
pub const LEAST_PIVOT: f64 = 1e-2;

/// Nodes of the columns that a sampler of `l` landmarks considers, ascending: up to `params.columns` of `n`, at least
/// `l`.
pub fn sampled_columns(n: usize, l: usize, params: SamplingParams, seed: u64) -> Vec<u32> {
    let mut columns = distinct(n, params.columns.max(l), seed, "columns of samplers");
    columns.sort_unstable();
    columns
}

/// The factorisation so far.
pub struct Factor {
    /// Nodes of the sampled columns (s).
    pub columns: Vec<u32>,
    /// Rows of G (i × s).
    rows: Vec<Vec<f64>>,
    /// Diagonal of K − GGᵀ (s); negative only if the kernel is not positive definite.
    pub residual: Vec<f64>,
    kernel: Kernel,
    /// The kernel's width, once rows are known.
    pub sigma: Option<f64>,
}

impl Factor {
    /// A factor of rank 0 over [`sampled_columns`].
    pub fn new(n: usize, l: usize, params: SamplingParams, seed: u64) -> Self {
        let columns = sampled_columns(n, l, params, seed);
        let residual = vec![1.; columns.len()];
        Self { columns, rows: Vec::new(), residual, kernel: params.kernel, sigma: params.sigma }
    }

    /// The distances from column `c` to all columns (s); costs one front.
    pub fn distances(&self, c: usize, space: &mut dyn Space, field: &mut [f32]) -> Result<Vec<f32>> {
        space.row(self.columns[c], field)?;
        Ok(self.columns.iter().map(|&node| field[node as usize]).collect())
    }

    /// Sets the width: as given, or the mean over the rows of [`PILOTS`] columns.
    fn find_width(&mut self, space: &mut dyn Space, field: &mut [f32], seed: u64) -> Result<()> {
        if self.sigma.is_none() {
            let pilots = distinct(self.columns.len(), PILOTS, seed, "pilots");
            let rows: Result<Vec<_>> = pilots.iter().map(|&c| self.distances(c as usize, space, field)).collect();
            self.sigma = Some(mean(&rows?));
        }
        Ok(())
    }

    /// The affinities for `distances` (s).
    pub fn affinities(&self, distances: &[f32]) -> Vec<f64> {
        let sigma = self.sigma.unwrap_or(1.);
        let mut out = vec![0f32; distances.len()];
        self.kernel.apply(sigma as f32, distances, &mut out);
        out.into_iter().map(f64::from).collect()
    }

    /// The residual column of column `c`, given its affinities (s).
    pub fn residual_of(&self, c: usize, mut affinities: Vec<f64>) -> Vec<f64> {
        for row in &self.rows {
            let factor = row[c];
            affinities.iter_mut().zip(row).for_each(|(r, g)| *r -= factor * g);
        }
        affinities
    }

    /// The increase of Γ* over the columns by landmark `c` with this residual column; `None` for a pivot below
    /// [`LEAST_PIVOT`].
    ///
    /// For a positive kernel this is the increase of Γ, Σ r_j²/r_c. Even the exponential of geodesic distances has a
    /// few negative eigenvalues; a pivot near 0 then raises Γ without bound (to 9.8 n, measured), and maximising Γ
    /// would select exactly that. Γ* penalises overshoot.
    pub fn gain(&self, c: usize, residual: &[f64]) -> Option<f64> {
        let pivot = residual[c];
        let added = |(d, r): (&f64, &f64)| d.abs() - (d - r * r / pivot).abs();
        (pivot > LEAST_PIVOT).then(|| self.residual.iter().zip(residual).map(added).sum::<f64>())
    }

    /// Adds column `c` with its residual column to the factor; a column dependent on the others up to rounding adds
    /// nothing.
    pub fn push(&mut self, c: usize, mut residual: Vec<f64>) {
        let pivot = residual[c];
        if pivot > LEAST_PIVOT {
            let inverse = 1. / pivot.sqrt();
            residual.iter_mut().for_each(|r| *r *= inverse);
            for (d, g) in self.residual.iter_mut().zip(&residual) {
                *d -= g * g;
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

/// The sampler.
pub struct Cholesky(pub SamplingParams);

impl Sampler for Cholesky {
    fn choose(
        &self,
        l: usize,
        seed: u64,
        space: &mut dyn Space,
        field: &mut [f32],
        found: &mut Found<'_>,
    ) -> Result<()> {
        let mut draw = stream(seed, "pivots");
        let mut factor = Factor::new(field.len(), l, self.0, seed);
        factor.find_width(space, field, seed)?;
        let mut chosen = vec![false; factor.columns.len()];
        for k in 0..l {
            let c = pivot(&factor.residual, &chosen, unit(&mut draw));
            chosen[c] = true;
            found(factor.columns[c], None)?;
            if k + 1 < l {
                let affinities = factor.affinities(&factor.distances(c, space, field)?);
                let residual = factor.residual_of(c, affinities);
                factor.push(c, residual);
            }
        }
        Ok(())
    }
}

/// The column where the cumulative sum of residuals reaches the share `at`; the first free one if all is explained.
fn pivot(residual: &[f64], chosen: &[bool], at: f64) -> usize {
    let weight = |j: usize| if chosen[j] { 0. } else { residual[j].max(0.) };
    let target = at * (0..residual.len()).map(weight).sum::<f64>();
    let mut sum = 0.;
    for j in 0..residual.len() {
        sum += weight(j);
        if sum > target {
            return j;
        }
    }
    chosen.iter().position(|chosen| !chosen).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::pivot;

    #[test]
    fn a_column_is_drawn_in_proportion_to_its_residual() {
        // The second is already chosen; negative residuals come from rounding and an indefinite kernel.
        let (residual, chosen) = ([0.1, 0.5, 0.3, -0.2, 0., 0.6], [false, true, false, false, false, false]);
        let mut hits = [0; 6];
        (0..1000).for_each(|k| hits[pivot(&residual, &chosen, (f64::from(k) + 0.5) / 1000.)] += 1);
        assert_eq!(hits, [100, 0, 300, 0, 0, 600]);
        // If nothing remains to be explained, any free column is drawn.
        assert_eq!(pivot(&[0., 0., -1.], &[true, false, false], 0.7), 1);
    }
}
