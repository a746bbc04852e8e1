//! The log odds that people keep two regions in one part: boosted regression trees, fitted to human segmentations.
//!
//! The trees are fitted to the human segmentations of half of the Princeton benchmark (Chen, Golovinskiy, Funkhouser,
//! SIGGRAPH 2009). The target of the fit is the majority decision at a merge; its weight is the effect on the Rand
//! index: |2t − 1| times the pairs that it joins, to the power .6, so that few large merges do not dominate; t is the
//! share of people who join them. `tools/fit` repeats the fit, with LightGBM (Ke et al. 2017). Trees are better than a
//! logistic function of the same features on held-out models (docs/dev/segmentation-experiments.md), since features
//! matter differently for open patches, limbs and rims.
//!
//! Cost: a few comparisons per tree; some tens of kilobytes, read once.

use super::merge_features::FEATURES;
use serde::{Deserialize, Serialize};
use std::sync::OnceLock;

/// The trees in use.
const FITTED: &str = include_str!("merge_odds.json");

/// A sum of regression trees over the [`super::merge_features`].
///
/// The trees are full: node k of a tree of depth d, counted from 0, has the children 2k + 1 and 2k + 2; its 2ᵈ − 1
/// inner nodes are followed by 2ᵈ leaves.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BoostedTrees {
    /// Depth of all trees.
    depth: u32,
    /// For each inner node of each tree, in order: the feature that is compared.
    feature: Vec<u8>,
    /// For each inner node: greater values go right.
    threshold: Vec<f64>,
    /// For each leaf of each tree: its contribution to the log odds.
    leaf: Vec<f64>,
}

impl BoostedTrees {
    /// The trees used in all decisions.
    pub fn fitted() -> &'static BoostedTrees {
        static TREES: OnceLock<BoostedTrees> = OnceLock::new();
        // A test checks that the file can be parsed; without trees all odds would be even.
        TREES.get_or_init(|| BoostedTrees::parse(FITTED).unwrap_or_default())
    }

    /// Trees from JSON: an object with this type's fields. `None` if the text is invalid, contains features that do not
    /// exist, or has arrays of inconsistent size.
    pub fn parse(text: &str) -> Option<BoostedTrees> {
        let trees: BoostedTrees = serde_json::from_slice(text.as_bytes()).ok()?;
        let leaves = 1usize.checked_shl(trees.depth).filter(|_| trees.depth < 16)?;
        let count = trees.leaf.len() / leaves;
        let sizes = [trees.feature.len(), trees.threshold.len()].iter().all(|&len| len == count * (leaves - 1));
        let known = trees.feature.iter().all(|&k| usize::from(k) < FEATURES);
        (trees.leaf.len() == count * leaves && sizes && known).then_some(trees)
    }

    /// Log odds that people keep two regions with these features together.
    pub fn log_odds(&self, features: &[f64; FEATURES]) -> f64 {
        let (inner, leaves) = ((1usize << self.depth) - 1, 1usize << self.depth);
        let trees = self.feature.chunks_exact(inner.max(1)).zip(self.threshold.chunks_exact(inner.max(1)));
        let one = |((feature, threshold), leaf): ((&[u8], &[f64]), &[f64])| {
            let mut k = 0;
            while k < inner {
                k = 2 * k + 1 + usize::from(features[usize::from(feature[k])] > threshold[k]);
            }
            leaf[k - inner]
        };
        trees.zip(self.leaf.chunks_exact(leaves)).map(one).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_trees_in_use_are_whole_and_say_what_is_plain() {
        let trees = BoostedTrees::parse(FITTED).expect("the file of trees is broken");
        assert!(trees.leaf.len() >= 100 << trees.depth && trees.leaf.iter().all(|x| x.is_finite()));
        // Two flat patches with a long boundary, and two limbs at a sharp narrow joint.
        let mut patches = [0.0; FEATURES];
        (patches[0], patches[1], patches[2], patches[5], patches[12], patches[13], patches[14], patches[15]) =
            (6.0, 1.0, 1.0, 3.0, 1.0, 1.0, 1.0, 1.0);
        let mut limbs = patches;
        (limbs[0], limbs[1], limbs[2], limbs[5], limbs[7], limbs[8], limbs[12], limbs[18]) =
            (-4.0, 0.2, 0.2, 0.0, 1.0, 0.8, 0.2, 0.9);
        assert!(trees.log_odds(&patches) > 1.0, "{}", trees.log_odds(&patches));
        assert!(trees.log_odds(&limbs) < -1.0, "{}", trees.log_odds(&limbs));
    }

    #[test]
    fn a_tree_is_walked_and_broken_ones_are_refused() {
        let text = r#"{"depth":2,"feature":[0,1,1],"threshold":[0.5,1.0,2.0],"leaf":[1.0,2.0,3.0,4.0]}"#;
        let trees = BoostedTrees::parse(text).unwrap();
        let at = |x: f64, y: f64| {
            let mut features = [0.0; FEATURES];
            (features[0], features[1]) = (x, y);
            trees.log_odds(&features)
        };
        assert_eq!([at(0.5, 1.0), at(0.5, 1.1), at(0.6, 2.0), at(0.6, f64::INFINITY)], [1.0, 2.0, 3.0, 4.0]);
        for wrong in
            [text.replace("[0,1,1]", "[0,1]"), text.replace("[0,1,1]", "[0,1,99]"), text.replace(":2,", ":70,")]
        {
            assert_eq!(BoostedTrees::parse(&wrong), None);
        }
    }
}
