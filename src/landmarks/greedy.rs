//! Greedy best-candidate sampling (§6.1): of 90 random candidates, the one whose row raises Γ most.
//!
//! The paper uses 90 candidates for "one of the best 1 % with 95 %"; ⌈ln .01 / ln .95⌉ = 90 actually gives one of the
//! best *5 %* with *99 %*. A candidate costs a front. Rows are reused if that does not change the result: fresh
//! candidates that are drawn again ([`KEPT`] rows are kept), and, *pooled*, all of them: the 90 candidates stay from
//! landmark to landmark, and only the chosen one is replaced. That takes 90 + l fronts instead of 90 l.
//!
//! If the kernel is positive, or nearly so, the gain of a candidate follows from its residual column
//! ([`Factor::gain`]); otherwise a factorisation would overflow, and Γ is recomputed from the kept eigenpairs of each
//! candidate's A.

use super::cholesky::{Factor, LEAST_PIVOT, mean};
use super::{Found, Sampler, SamplingParams, Space};
use crate::base::random::{Random, below, stream};
use crate::base::vector::axpy;
use crate::base::{Result, eigen};
use nalgebra::DMatrix;
use std::collections::BTreeMap;

/// Maximum number of rows kept for candidates that are drawn again.
pub const KEPT: usize = 1024;

/// The sampler.
pub struct Greedy {
    /// Kernel, candidates, columns.
    pub params: SamplingParams,
    /// Whether candidates are kept from landmark to landmark.
    pub pooled: bool,
}

/// State of the search.
struct Search {
    factor: Factor,
    params: SamplingParams,
    /// Rows of distances by column.
    rows: BTreeMap<usize, Vec<f32>>,
    chosen: Vec<usize>,
    free: Vec<bool>,
    draw: Random,
}

impl Sampler for Greedy {
    fn choose(
        &self,
        l: usize,
        seed: u64,
        space: &mut dyn Space,
        field: &mut [f32],
        found: &mut Found<'_>,
    ) -> Result<()> {
        let factor = Factor::new(field.len(), l, self.params, seed);
        let free = vec![true; factor.columns.len()];
        let mut search = Search {
            factor,
            params: self.params,
            rows: BTreeMap::new(),
            chosen: Vec::new(),
            free,
            draw: stream(seed, "candidates"),
        };
        let mut candidates = Vec::new();
        for k in 0..l {
            if !self.pooled {
                candidates.clear();
            }
            search.fill_up(&mut candidates);
            search.compute_rows(&candidates, space, field)?;
            let best = search.best(&candidates, space)?;
            let c = candidates.swap_remove(best);
            found(search.factor.columns[c], None)?;
            if k + 1 < l {
                search.take(c);
            }
        }
        Ok(())
    }
}

impl Search {
    /// Draws free columns until there are as many candidates as wanted, or no more columns.
    fn fill_up(&mut self, candidates: &mut Vec<usize>) {
        let n = self.free.len();
        let wanted = self.params.candidates.max(1).min(n - self.chosen.len());
        // Nearly all columns are needed: take all, in order.
        if 2 * (wanted + self.chosen.len()) > n {
            candidates.extend((0..n).filter(|&c| self.free[c]).filter(|c| !candidates.contains(c)).collect::<Vec<_>>());
            candidates.truncate(wanted);
            return;
        }
        while candidates.len() < wanted {
            let c = below(&mut self.draw, n);
            if self.free[c] && !candidates.contains(&c) {
                candidates.push(c);
            }
        }
    }

    /// Computes the candidates' rows, and σ from the first ones.
    fn compute_rows(&mut self, candidates: &[usize], space: &mut dyn Space, field: &mut [f32]) -> Result<()> {
        if self.rows.len() > KEPT {
            let chosen = &self.chosen;
            self.rows.retain(|c, _| candidates.contains(c) || chosen.contains(c));
        }
        for &c in candidates {
            if !self.rows.contains_key(&c) {
                let row = self.factor.distances(c, space, field)?;
                self.rows.insert(c, row);
            }
        }
        if self.factor.sigma.is_none() {
            let rows: Vec<Vec<f32>> = candidates.iter().map(|c| self.rows[c].clone()).collect();
            self.factor.sigma = Some(mean(&rows));
        }
        Ok(())
    }

    /// The index of the best candidate; the first if equal.
    fn best(&self, candidates: &[usize], space: &dyn Space) -> Result<usize> {
        let mut best = (f64::NEG_INFINITY, 0);
        for (place, &c) in candidates.iter().enumerate() {
            space.check()?;
            let value = if self.params.kernel.nearly_positive() {
                let residual = self.factor.residual_of(c, self.factor.affinities(&self.rows[&c]));
                self.factor.gain(c, &residual).unwrap_or(f64::MIN)
            } else {
                self.gamma(c)
            };
            if value > best.0 {
                best = (value, place);
            }
        }
        Ok(best.1)
    }

    /// Γ over the columns for the landmarks so far plus `c`, from the kept eigenpairs of their affinities.
    fn gamma(&self, c: usize) -> f64 {
        let landmarks: Vec<usize> = self.chosen.iter().copied().chain([c]).collect();
        let rows: Vec<Vec<f64>> = landmarks.iter().map(|c| self.factor.affinities(&self.rows[c])).collect();
        let l = landmarks.len();
        let a = DMatrix::from_fn(l, l, |i, j| 0.5 * (rows[i][landmarks[j]] + rows[j][landmarks[i]]));
        let (values, vectors) = eigen::symmetric(a);
        let cut = self.params.kernel.tolerance(l) * values[0];
        let mut sum = 0.;
        for e in (0..l).filter(|&e| values[e] > cut && values[e] > LEAST_PIVOT) {
            let mut dot = vec![0f64; self.free.len()];
            for (k, row) in rows.iter().enumerate() {
                axpy(&mut dot, vectors[(k, e)], row);
            }
            landmarks.iter().for_each(|&j| dot[j] = 0.);
            sum += dot.iter().map(|d| d * d).sum::<f64>() / values[e];
        }
        sum
    }

    /// Makes column `c` a landmark.
    fn take(&mut self, c: usize) {
        let residual = self.factor.residual_of(c, self.factor.affinities(&self.rows[&c]));
        self.factor.push(c, residual);
        self.chosen.push(c);
        self.free[c] = false;
    }
}
