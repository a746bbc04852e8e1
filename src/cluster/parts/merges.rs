//! Merges the regions of an over-segmentation down to one, with a probability for each merge.
//!
//! The probability that people keep two regions in one part is computed by boosted trees ([`super::merge_odds`]) from
//! features of both regions and of their boundary ([`super::merge_features`]). One of them is the cost of the merge,
//! W / min(A)^.75 · conv³, with W the strength of the common boundary, A the areas, and conv the share of cell pairs
//! across it that see each other as convex, relative to the regions' own shares, so that the inside of a cup stays
//! whole. The merge with the greatest cost · √odds comes first. So later features are those of regions that people
//! would have, as in learned agglomeration (Nunez-Iglesias et al. 2013, *Machine learning of hierarchical clustering to
//! segment 2D and 3D images*; docs/dev/segmentation-experiments.md).
//!
//! Cost for R regions, some thirty: the priorities of one region with its neighbours per merge, at most R² comparisons.
//! For an ensemble of twelve, priorities take 1.8 % of the instructions of a run over 12,572 faces.

use super::matrix::Square;
use super::merge_features::{FEATURES, log, merge_features};
use super::merge_odds::BoostedTrees;
use super::regions::Regions;
use crate::spectral::exp::logistic;
use std::borrow::Cow;

/// Determines the order of merges and their probabilities. The decision uses the default, simpler ones
/// [`MergeModel::by_cost`]; others are for fitting (`tools/fit`).
#[derive(Clone, Debug, PartialEq)]
pub struct MergeModel {
    /// Exponent of the smaller area in the cost.
    pub area_power: f64,
    /// Exponent of the relative convexity in the cost.
    pub convexity_power: f64,
    /// Exponent of the odds in the order of merges, which is that of cost · odds^this. With 0, odds are computed only
    /// where regions merge.
    pub odds_power: f64,
    /// Log odds beyond ± this value have no further effect on the order.
    pub odds_bound: f64,
    /// How an ensemble combines the probabilities of its over-segmentations.
    pub mean: EnsembleMean,
    /// Log odds that people keep two regions together, of the [`merge_features`].
    pub odds: Cow<'static, BoostedTrees>,
}

/// How an ensemble combines the probabilities of its over-segmentations that two superfaces belong together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum EnsembleMean {
    /// Their mean.
    Probabilities,
    /// The probability at the mean of their log odds, each between ± this bound (at most 13.8, since probabilities
    /// count from 10⁻⁶ on), stretched to be 0 and 1 where all are at a bound. Doubtful ones count for less.
    LogOdds(f64),
}

impl EnsembleMean {
    /// What is averaged, for the probability `p`.
    pub fn term(self, p: f64) -> f64 {
        match self {
            EnsembleMean::Probabilities => p,
            EnsembleMean::LogOdds(bound) => (log(p) - log(1.0 - p)).clamp(-bound, bound),
        }
    }

    /// The probability at this `mean` of terms.
    pub fn probability(self, mean: f64) -> f64 {
        match self {
            EnsembleMean::Probabilities => mean,
            EnsembleMean::LogOdds(bound) => {
                let least = logistic(-bound);
                ((logistic(mean) - least) / (1.0 - 2.0 * least)).clamp(0.0, 1.0)
            }
        }
    }
}

impl Default for MergeModel {
    fn default() -> Self {
        MergeModel {
            area_power: 0.75,
            convexity_power: 3.0,
            odds_power: 0.5,
            odds_bound: f64::INFINITY,
            mean: EnsembleMean::LogOdds(3.0),
            odds: Cow::Borrowed(BoostedTrees::fitted()),
        }
    }
}

impl MergeModel {
    /// Merges in the order of cost alone, for decisions that stop at a cost.
    pub fn by_cost() -> Self {
        MergeModel { odds_power: 0.0, ..MergeModel::default() }
    }

    /// Natural logarithm of the cost of merging regions `i` and `j`: the greater, the sooner.
    pub fn log_cost(&self, r: &Regions, i: usize, j: usize) -> f64 {
        let share = |a: usize, b: usize, e: f64| (r.seen[(a, b)] + e) / (r.all[(a, b)] + e);
        let own = share(i, i, 1e-9) * share(j, j, 1e-9);
        let conv = (share(i, j, 1e-12) / own.sqrt().max(1e-12)).min(1.0);
        log(r.strength[(i, j)]) - self.area_power * log(r.area(i).min(r.area(j))) + self.convexity_power * log(conv)
    }

    /// Natural logarithm of what determines the order of merges, for regions `i` and `j`: the greater, the sooner.
    fn log_priority(&self, r: &Regions, i: usize, j: usize) -> f64 {
        let cost = self.log_cost(r, i, j);
        if self.odds_power == 0.0 {
            return cost;
        }
        let log_odds = self.odds.log_odds(&merge_features(r, i, j, cost));
        cost + self.odds_power * log_odds.clamp(-self.odds_bound, self.odds_bound)
    }

    /// Probability that people keep two regions with these [`merge_features`] in one part.
    pub fn probability(&self, features: &[f64; FEATURES]) -> f64 {
        logistic(self.odds.log_odds(features))
    }
}

/// One merge: region `j` goes into region `i` < `j`, which keeps its number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegionMerge {
    /// The region that stays.
    pub i: usize,
    /// The region that disappears.
    pub j: usize,
    /// Natural logarithm of the cost at which they merged.
    pub log_cost: f64,
    /// The features from which the probability is computed.
    pub features: [f64; FEATURES],
    /// Probability that people keep them in one part.
    pub probability: f64,
}

/// All merges in order, until no two regions are adjacent or `stop(ln cost)` returns true.
pub fn merges(mut r: Regions, model: &MergeModel, stop: impl Fn(f64) -> bool) -> Vec<RegionMerge> {
    let n = r.len();
    let mut alive = vec![true; n];
    let mut priority = Square::from_values(n, vec![f64::NEG_INFINITY; n * n]);
    for i in 0..n {
        for j in (i + 1..n).filter(|&j| r.length[(i, j)] > 0.0) {
            priority[(i, j)] = model.log_priority(&r, i, j);
        }
    }
    // The greatest entry of each row right of the diagonal; a row is rescanned only when that entry changes.
    let scan = |priority: &Square, i: usize| {
        let mut best = (f64::NEG_INFINITY, n);
        for (j, &c) in priority.row(i).iter().enumerate().skip(i + 1) {
            if c > best.0 {
                best = (c, j);
            }
        }
        best
    };
    let mut best: Vec<(f64, usize)> = (0..n).map(|i| scan(&priority, i)).collect();
    let mut out = Vec::new();
    loop {
        let mut top = (f64::NEG_INFINITY, n, n);
        for (i, &(c, j)) in best.iter().enumerate() {
            if c > top.0 {
                top = (c, i, j);
            }
        }
        let (_, i, j) = top;
        if j == n {
            return out;
        }
        let log_cost = model.log_cost(&r, i, j);
        if stop(log_cost) {
            return out;
        }
        let features = merge_features(&r, i, j, log_cost);
        out.push(RegionMerge { i, j, log_cost, features, probability: model.probability(&features) });
        r.merge(i, j);
        alive[j] = false;
        for k in 0..n {
            for e in [i, j] {
                priority[(e.min(k), e.max(k))] = f64::NEG_INFINITY;
            }
        }
        for k in (0..n).filter(|&k| k != i && alive[k] && r.length[(i, k)] > 0.0) {
            priority[(i.min(k), i.max(k))] = model.log_priority(&r, i, k);
        }
        best[j] = (f64::NEG_INFINITY, n);
        best[i] = scan(&priority, i);
        for k in (0..n).filter(|&k| k != i && alive[k]) {
            let fresh = if k < i { priority[(k, i)] } else { f64::NEG_INFINITY };
            if best[k].1 == i || best[k].1 == j {
                best[k] = scan(&priority, k);
            } else if fresh > best[k].0 || (fresh == best[k].0 && fresh > f64::NEG_INFINITY && i < best[k].1) {
                best[k] = (fresh, i);
            }
        }
    }
}

/// The probability at the lowest common merge of any two of `n` regions: 1 on the diagonal, 0 for regions that never
/// merge.
pub fn meeting_probability(n: usize, merges: &[RegionMerge]) -> Square {
    let mut p = Square::zeros(n);
    let mut merged_into: Vec<Vec<usize>> = (0..n).map(|i| vec![i]).collect();
    for i in 0..n {
        p[(i, i)] = 1.0;
    }
    for m in merges {
        let joined = std::mem::take(&mut merged_into[m.j]);
        for &a in &merged_into[m.i] {
            for &b in &joined {
                p[(a, b)] = m.probability;
                p[(b, a)] = m.probability;
            }
        }
        merged_into[m.i].extend(joined);
    }
    p
}

/// The class of each of `n` regions after the first merges, identified by its least region.
pub fn classes_after(n: usize, merges: &[RegionMerge]) -> Vec<u32> {
    let mut into: Vec<u32> = (0..n as u32).collect();
    for m in merges {
        into.iter_mut().filter(|k| **k == m.j as u32).for_each(|k| *k = m.i as u32);
    }
    into
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{stream, unit};
    use crate::cluster::parts::CellGraph;
    use crate::cluster::parts::convexity::convexity;
    use crate::cluster::parts::region_pieces::RegionPieces;
    use crate::cluster::parts::regions::{RegionLabels, cell_moments};
    use crate::spectral::anchor::AnchorEmbedding;
    use crate::store::Run;

    #[test]
    fn log_odds_are_averaged_within_their_bound() {
        let of = |how: EnsembleMean, p: &[f64]| {
            how.probability(p.iter().map(|&p| how.term(p)).sum::<f64>() / p.len() as f64)
        };
        let how = EnsembleMean::LogOdds(3.0);
        let least = 1.0 / (1.0 + 3f64.exp());
        let stretched = |p: f64| (p - least) / (1.0 - 2.0 * least);
        for p in [0.06, 0.3, 0.5, 0.94] {
            assert!((of(how, &[p; 3]) - stretched(p)).abs() < 1e-12);
        }
        // √(p q / ((1 − p) (1 − q))) are the odds of the mean of two.
        let odds = (0.8f64 * 0.3 / (0.2 * 0.7)).sqrt();
        assert!((of(how, &[0.8, 0.3]) - stretched(odds / (1.0 + odds))).abs() < 1e-12);
        assert_eq!([of(how, &[0.0]), of(how, &[1.0; 12]), of(how, &[1.0, 0.0])], [0.0, 1.0, 0.5]);
        assert_eq!(of(EnsembleMean::Probabilities, &[1.0, 0.0, 0.5]), 0.5);
    }

    /// Regression: thousands of loose pieces took two gigabytes, since sums were stored for all pairs of their regions.
    #[test]
    fn pieces_merge_on_their_own_as_they_do_together() {
        // Three separate strips with interleaved cells, each cell a region of its own.
        let (strips, long) = (3, 12);
        let n = strips * long;
        let mut random = stream(0, "strips");
        let mut some = || 0.1 + unit(&mut random);
        let pairs: Vec<[u32; 2]> = (0..(n - strips) as u32).map(|i| [i, i + strips as u32]).collect();
        let mut angles = || pairs.iter().map(|_| some()).collect::<Vec<f64>>();
        let (length, concave, convex, convex04) = (angles(), angles(), angles(), angles());
        let cells = CellGraph {
            area: (0..n).map(|_| some() / n as f64).collect(),
            centre: (0..n).map(|i| [0.1 * (i / strips) as f64, 0.12 * (i % strips) as f64, 0.02 * some()]).collect(),
            normal: vec![[0.0, 0.0, 1.0]; n],
            pairs,
            length,
            concave,
            convex,
            convex04,
            ..CellGraph::default()
        };
        let label: Vec<u32> = (0..n as u32).collect();
        let embedding = AnchorEmbedding { values: (0..n).map(|_| some()).collect(), width: 1 };
        let thickness: Vec<f64> = (0..n).map(|_| some()).collect();
        let moments = cell_moments(&cells, &embedding, &thickness);
        let model = MergeModel::default();
        let (whole, pieces) = (RegionPieces::whole(n), RegionPieces::connected(&cells, &label, n));
        let [mut all, each] = [&whole, &pieces].map(|pieces| {
            let sums = convexity(&cells, &thickness, &label, pieces, &Run::new(&())).unwrap();
            let across = sums.iter().flatten().any(|s| s.a as usize % strips != s.b as usize % strips);
            assert_eq!(across, pieces == &whole, "strips see each other");
            let labels = RegionLabels { of_cell: &label, of_superface: &label, pieces };
            Regions::gather(&cells, &moments, &sums, labels, 1)
        });
        let together = meeting_probability(n, &merges(all.remove(0), &model, |_| false));
        assert_eq!(each.len(), strips);
        for (k, regions) in each.into_iter().enumerate() {
            let own = meeting_probability(long, &merges(regions, &model, |_| false));
            let of_strip: Vec<u32> = (k as u32..n as u32).step_by(strips).collect();
            assert_eq!(pieces.regions(k), of_strip);
            for (a, &i) in of_strip.iter().enumerate() {
                assert_eq!(pieces.place(i), (k, a));
                for j in 0..n {
                    let expected = if j % strips == k { own[(a, j / strips)] } else { 0.0 };
                    assert_eq!(together[(i as usize, j)], expected, "{i} {j}");
                }
            }
        }
    }
}
