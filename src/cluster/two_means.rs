//! Iterative 2-means: parts are halved one at a time, the one with the greatest gain first.
//!
//! The paper's other method (§7). For each part, the best split by 2-means and its reduction of the cost (the weighted
//! sum of squared distances to the means) are computed; the split with the greatest gain is made, until there are as
//! many parts as requested. If only bounds are given, splitting continues between them as long as a split reduces the
//! cost by [`TwoMeansParams::share`] of that of the whole. The means of the parts are then centres like those of
//! K-means: every face goes to the nearest, in the same single pass. Cost: two 2-means per split, on the part's sampled
//! columns only; about that of K-means in all.

use super::kmeans::{KMeans, KMeansParams, WeightedPoints};
use crate::base::Result;
use crate::store::Run;
use serde::{Deserialize, Serialize};

/// Dimensions of the embedding if the number of parts is unknown.
pub const DIMENSIONS: usize = 10;
/// Maximum number of parts if their number is not given.
pub const MOST: usize = 30;

/// When splitting stops.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TwoMeansParams {
    /// Minimum number of parts.
    pub least: usize,
    /// Maximum number of parts.
    pub most: usize,
    /// Between these bounds a split must reduce the cost by at least this share of that of the undivided whole.
    pub share: f64,
}

impl TwoMeansParams {
    /// Between `least` and `most` parts, with the best measured share: on half of the benchmark's even models, 1 − Rand
    /// is .189, .171, .165, .193, .251 with shares of .015, .03, .06, .1, .15.
    pub fn between(least: usize, most: usize) -> Self {
        Self { least, most, share: 0.06 }
    }
}

/// A part: some of the points, their mean, and their cost around it.
struct Part {
    members: Vec<u32>,
    mean: Vec<f32>,
    cost: f64,
}

impl Part {
    fn of(points: WeightedPoints<'_>, members: Vec<u32>) -> Self {
        let s = points.weights.len();
        let mass: f64 = members.iter().map(|&j| points.weights[j as usize]).sum();
        let (mut mean, mut cost) = (Vec::new(), 0.);
        for row in points.coordinates.chunks_exact(s.max(1)) {
            let moment: f64 = members.iter().map(|&j| points.weights[j as usize] * f64::from(row[j as usize])).sum();
            let centre = if mass > 0. { moment / mass } else { 0. };
            mean.push(centre as f32);
            let square = |&j: &u32| points.weights[j as usize] * (f64::from(row[j as usize]) - centre).powi(2);
            cost += members.iter().map(square).sum::<f64>();
        }
        Self { members, mean, cost }
    }

    /// The best split found; `None` if all points coincide.
    fn split(&self, points: WeightedPoints<'_>, dimensions: usize, run: &Run) -> Result<Option<Halving>> {
        let m = self.members.len();
        if m < 2 || self.cost <= 0. {
            return Ok(None);
        }
        let mut coordinates = Vec::with_capacity(dimensions * m);
        for row in points.coordinates.chunks_exact(points.weights.len()) {
            coordinates.extend(self.members.iter().map(|&j| row[j as usize]));
        }
        let weights: Vec<f64> = self.members.iter().map(|&j| points.weights[j as usize]).collect();
        let own = WeightedPoints { coordinates: &coordinates, weights: &weights };
        let fitted = KMeans::fit(own, dimensions, KMeansParams::new(2), run)?;
        let (mut label, mut first, mut second) = (vec![0; m], vec![0.; m], vec![0.; m]);
        let row = |e: usize| &coordinates[e * m..(e + 1) * m];
        fitted.centres().nearest(row, &mut label, &mut first, &mut second);
        let half = |side: u32| self.members.iter().zip(&label).filter(move |(_, l)| **l == side).map(|(&j, _)| j);
        let (one, other): (Vec<u32>, Vec<u32>) = (half(0).collect(), half(1).collect());
        if one.is_empty() || other.is_empty() {
            return Ok(None);
        }
        let halves = [Self::of(points, one), Self::of(points, other)];
        Ok(Some(Halving { gain: self.cost - halves[0].cost - halves[1].cost, halves }))
    }
}

/// A part divided in two, and the reduction of the cost.
struct Halving {
    gain: f64,
    halves: [Part; 2],
}

/// Splits weighted points with `dimensions` coordinates; the means of the parts are the centres. There are always as
/// many as requested: if the points have fewer distinct positions, the last centre is repeated.
///
/// ```
/// use nystrom_stream::cluster::kmeans::WeightedPoints;
/// use nystrom_stream::cluster::two_means::{TwoMeansParams, fit};
/// use nystrom_stream::store::Run;
///
/// # fn main() -> nystrom_stream::base::Result<()> {
/// let points = WeightedPoints { coordinates: &[0., 1., 8., 9.], weights: &[0.25; 4] };
/// // As many parts as the gains warrant, 1 to 4.
/// let fitted = fit(points, 1, TwoMeansParams::between(1, 4), &Run::new(&()))?;
/// assert_eq!(fitted.centres.len(), 2);
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn fit(points: WeightedPoints<'_>, dimensions: usize, params: TwoMeansParams, run: &Run) -> Result<KMeans> {
    let whole = Part::of(points, (0..points.weights.len() as u32).collect());
    let least_gain = params.share * whole.cost;
    let split = whole.split(points, dimensions, run)?;
    let mut parts = vec![(whole, split)];
    while parts.len() < params.most {
        let gain = |part: &(Part, Option<Halving>)| part.1.as_ref().map_or(f64::NEG_INFINITY, |split| split.gain);
        let mut best = 0;
        for k in 1..parts.len() {
            if gain(&parts[k]) > gain(&parts[best]) {
                best = k;
            }
        }
        if parts.len() >= params.least && gain(&parts[best]) < least_gain {
            break;
        }
        let Some(Halving { halves: [one, other], .. }) = parts[best].1.take() else { break };
        let splits = [one.split(points, dimensions, run)?, other.split(points, dimensions, run)?];
        let [first, second] = splits;
        parts[best] = (one, first);
        parts.push((other, second));
    }
    let mut centres: Vec<f32> = parts.iter().flat_map(|(part, _)| part.mean.iter().copied()).collect();
    for _ in parts.len()..params.least {
        centres.extend_from_within(centres.len() - dimensions..);
    }
    Ok(KMeans { centres, dimensions, cost: parts.iter().map(|(part, _)| part.cost).sum() })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Blobs at 0, 10, 30 and 31 on a line, the last two nearer to each other than to the rest.
    fn blobs() -> (Vec<f32>, Vec<f64>) {
        let at = [0., 10., 30., 31.];
        ((0..400).map(|i| at[i / 100] + (i % 100) as f32 * 0.001).collect(), vec![1. / 400.; 400])
    }

    fn sorted(mut centres: Vec<f32>) -> Vec<f32> {
        centres.sort_by(f32::total_cmp);
        centres
    }

    #[test]
    fn the_part_that_gains_most_is_split_first() {
        let (coordinates, weights) = blobs();
        let points = WeightedPoints { coordinates: &coordinates, weights: &weights };
        let expected: [&[f32]; 4] = [&[17.8], &[5.05, 30.55], &[0.05, 10.05, 30.55], &[0.05, 10.05, 30.05, 31.05]];
        for (k, expected) in (1..).zip(expected) {
            let fitted = fit(points, 1, TwoMeansParams::between(k, k), &Run::new(&())).unwrap();
            let centres = sorted(fitted.centres);
            assert_eq!(centres.len(), k);
            assert!(centres.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-2), "{centres:?}");
        }
    }

    #[test]
    fn without_a_number_small_gains_end_it() {
        let (coordinates, weights) = blobs();
        let points = WeightedPoints { coordinates: &coordinates, weights: &weights };
        let fitted = fit(points, 1, TwoMeansParams::between(1, MOST), &Run::new(&())).unwrap();
        assert_eq!(fitted.centres.len(), 3);
        let bounded = fit(points, 1, TwoMeansParams::between(1, 2), &Run::new(&())).unwrap();
        assert_eq!(bounded.centres.len(), 2);
        let at_least = fit(points, 1, TwoMeansParams::between(4, 9), &Run::new(&())).unwrap();
        assert_eq!(at_least.centres.len(), 4);
    }

    #[test]
    fn fewer_places_than_parts_still_give_all_centres() {
        let points = WeightedPoints { coordinates: &[1., 1., 2.], weights: &[0.4, 0.3, 0.3] };
        let fitted = fit(points, 1, TwoMeansParams::between(3, 3), &Run::new(&())).unwrap();
        assert_eq!(sorted(fitted.centres), [1., 2., 2.]);
    }
}
