//! Samplings: which nodes become landmarks (§6 of the paper). Each sampling is a file that implements [`Sampler`]; all
//! use the same rows through [`Space`].
//!
//! | | search, in fronts over all n nodes | |
//! | --- | --- | --- |
//! | [`random`] | 0 | by area, or uniformly |
//! | [`farthest`] | about Σ 1/i | max–min from an extremity, §6.2 |
//! | [`farthest::GeodesicFarthest`] | about Σ 1/i | the same by length only, whatever metric the rows have |
//! | [`distance_weighted`] | about Σ 1/i | at random, by area times the distance to the nearest landmark so far |
//! | [`centroid`] | l + Σ 1/i | farthest points, each moved to the middle of its cell |
//! | [`cholesky`] | l + [`PILOTS`] | randomly pivoted Cholesky |
//! | [`greedy`] | 90 l, pooled 90 + l | best of 90 candidates by Γ, §6.1 |
//!
//! The last three use distances or affinities on a random sample of columns ([`SamplingParams::columns`]), and also
//! choose from these. So apart from fronts, memory and arithmetic do not grow with n, and if n is smaller they are
//! exact.

pub mod centroid;
pub mod cholesky;
pub mod distance_weighted;
pub mod farthest;
pub mod greedy;
pub mod matrix_space;
pub mod random;

pub use crate::distance::sampler::{Found, GraphSpace, Sampler, SearchGraph, Space};
pub use matrix_space::MatrixSpace;

use crate::base::Result;
use crate::base::random::{below, stream};
use crate::spectral::Kernel;
use serde::{Deserialize, Serialize};
use std::fmt;

/// How landmarks are chosen.
///
/// ```
/// use nystrom_stream::graph::Node;
/// use nystrom_stream::landmarks::{MatrixSpace, Sampler, Sampling};
///
/// // Four nodes on a line, all of their distances known.
/// let at = [0f32, 1., 2., 10.];
/// let nodes = at.map(|x| Node { centroid: [x, 0., 0.], area: 1., ..Node::default() });
/// let distances: Vec<f32> = at.iter().flat_map(|a| at.map(|b| (a - b).abs())).collect();
/// let mut space = MatrixSpace::new(&distances, nodes[..].into(), None);
/// let mut landmarks = Vec::new();
/// Sampling::Farthest.choose(2, 0, &mut space, &mut [0.; 4], &mut |node, _row| {
///     landmarks.push(node);
///     Ok(())
/// })?;
/// landmarks.sort();
/// assert_eq!(landmarks, [0, 3]);
/// # Ok::<(), nystrom_stream::base::Error>(())
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sampling {
    /// Max–min farthest points from an extremity.
    #[default]
    Farthest,
    /// Random nodes, with probability proportional to area.
    Random,
    /// Random nodes, weighted by area times the distance to the nearest landmark so far.
    DistanceWeighted,
    /// Random nodes, uniformly: the paper's random sampling.
    Uniform,
    /// Max–min farthest points by length only, whatever metric the rows have.
    GeodesicFarthest,
    /// Farthest points, each moved to the middle of its cell.
    Centroids,
    /// Randomly pivoted Cholesky.
    Cholesky,
    /// The best of 90 fresh candidates by Γ, one landmark after the other (§6.1).
    Greedy,
    /// The same, with the 90 candidates kept from landmark to landmark.
    PooledGreedy,
}

impl Sampling {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::Uniform,
        Self::Random,
        Self::DistanceWeighted,
        Self::Cholesky,
        Self::Farthest,
        Self::GeodesicFarthest,
        Self::Centroids,
        Self::PooledGreedy,
        Self::Greedy,
    ];

    /// Whether the first l of more landmarks are the same as l landmarks: all samplings except centroids, which move.
    pub fn is_nested(self) -> bool {
        self != Self::Centroids
    }

    /// The sampler with these `params`.
    pub fn sampler(self, params: SamplingParams) -> Box<dyn Sampler> {
        match self {
            Self::Farthest => Box::new(farthest::Farthest),
            Self::Random => Box::new(random::ByArea),
            Self::DistanceWeighted => Box::new(distance_weighted::DistanceWeighted),
            Self::Uniform => Box::new(random::Uniform),
            Self::GeodesicFarthest => Box::new(farthest::GeodesicFarthest),
            Self::Centroids => Box::new(centroid::Centroids(params)),
            Self::Cholesky => Box::new(cholesky::Cholesky(params)),
            Self::Greedy => Box::new(greedy::Greedy { params, pooled: false }),
            Self::PooledGreedy => Box::new(greedy::Greedy { params, pooled: true }),
        }
    }
}

/// Its name in files, options and reports.
impl fmt::Display for Sampling {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// Samples with default parameters.
impl Sampler for Sampling {
    fn choose(
        &self,
        l: usize,
        seed: u64,
        space: &mut dyn Space,
        field: &mut [f32],
        found: &mut Found<'_>,
    ) -> Result<()> {
        self.sampler(SamplingParams::default()).choose(l, seed, space, field, found)
    }

    fn needs_lengths(&self) -> bool {
        self.sampler(SamplingParams::default()).needs_lengths()
    }

    fn is_costly(&self) -> bool {
        self.sampler(SamplingParams::default()).is_costly()
    }
}

/// Number of rows from which samplers estimate the mean distance if σ is not given.
pub const PILOTS: usize = 4;

/// Parameters of samplers that use affinities.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SamplingParams {
    /// The kernel of Γ. The exponential, because Γ of the Gaussian of geodesic distances is not a useful measure: its
    /// rank correlation with the residual was .26 (`docs/dev/sampling-and-kernels.md`).
    pub kernel: Kernel,
    /// Its width in units of distance; by default the mean of the first computed rows.
    pub sigma: Option<f64>,
    /// Candidates per landmark: 90 contain one of the best 5 % with a probability of 99 %.
    pub candidates: usize,
    /// Maximum number of columns used.
    pub columns: usize,
}

impl Default for SamplingParams {
    fn default() -> Self {
        Self { kernel: Kernel::Exponential, sigma: None, candidates: 90, columns: 4096 }
    }
}

/// `count` distinct numbers below `n`, or all if there are fewer, in the order drawn: the first of more numbers are
/// those of fewer. (Floyd's algorithm would not give a random order; this one does.)
fn distinct(n: usize, count: usize, seed: u64, purpose: &str) -> Vec<u32> {
    let mut draw = stream(seed, purpose);
    let count = count.min(n);
    // A sparse Fisher–Yates shuffle: only displaced positions are stored.
    let mut displaced = std::collections::HashMap::with_capacity(2 * count);
    let place = |displaced: &std::collections::HashMap<usize, usize>, k: usize| displaced.get(&k).copied().unwrap_or(k);
    (0..count)
        .map(|k| {
            let other = k + below(&mut draw, n - k);
            let (here, there) = (place(&displaced, k), place(&displaced, other));
            displaced.insert(other, here);
            there as u32
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::{Sampler, Sampling, SamplingParams, distinct};

    /// Regression: the samplers that [`Sampling::sampler`] returns did not ask for lengths, and all called themselves
    /// costly.
    #[test]
    fn samplers_tell_what_they_need_and_cost() {
        for sampling in Sampling::ALL {
            let sampler = sampling.sampler(SamplingParams::default());
            assert_eq!(sampler.needs_lengths(), sampling == Sampling::GeodesicFarthest, "{sampling}");
            let draws = [Sampling::Farthest, Sampling::DistanceWeighted, Sampling::Random, Sampling::Uniform];
            assert_eq!(sampler.is_costly(), !draws.contains(&sampling), "{sampling}");
            assert_eq!(sampling.needs_lengths(), sampler.needs_lengths());
            assert_eq!(sampling.is_costly(), sampler.is_costly());
        }
    }

    #[test]
    fn distinct_numbers_are_distinct_and_evenly_spread() {
        let mut hits = [0u32; 20];
        for seed in 0..4000 {
            let mut drawn = distinct(20, 5, seed, "test");
            drawn.iter().for_each(|&k| hits[k as usize] += 1);
            drawn.sort_unstable();
            drawn.dedup();
            assert_eq!(drawn.len(), 5);
        }
        assert!(hits.iter().all(|&h| (850..1150).contains(&h)), "{hits:?}");
        let mut all = distinct(3, 7, 0, "test");
        all.sort_unstable();
        assert_eq!(all, [0, 1, 2]);
    }

    /// Regression: all numbers came in ascending order, so that every smaller nested sample had the first faces of the
    /// file, under all seeds.
    #[test]
    fn the_first_of_all_numbers_are_those_of_fewer() {
        for (seed, count) in [(0, 5), (1, 5), (2, 19)] {
            assert_eq!(distinct(20, 50, seed, "test")[..count], distinct(20, count, seed, "test"));
        }
        assert_ne!(distinct(20, 20, 0, "test"), distinct(20, 20, 1, "test"));
    }
}
