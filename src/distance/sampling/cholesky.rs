//! Randomly pivoted Cholesky: each landmark drawn with a chance in proportion to what is not yet explained at it.
//!
//! The residual diagonal of the affinities, d_j = k_jj − w̃_jj, is a distance in feature space; drawing by it is as
//! D² seeding is for K-means. One row a landmark, no candidates: between random and farthest in cost and quality.
//! After Chen, Epperly, Tropp and Webber, *Randomly pivoted Cholesky* (2023).

use super::factor::Factor;
use super::{Found, Sampler, SamplingParams, Space};
use crate::base::Result;
use crate::base::random::{stream, unit};

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

/// The column at the share `at` of the residuals' sum; the first free one where all is explained.
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
