//! One over-segmentation of the cells: embedding, K-means, connected pieces, islands dissolved.

use super::anchor::{Rows, anchor_embedding};
use super::cell_kmeans::KMeans;
use super::cells::{CellGraph, connected_pieces, join_small};
use crate::base::random::{Random, below};

/// Islands below this share of the area join the neighbour with the longest common boundary.
const ISLAND: f64 = 0.001;
/// s of the embedding over the mean distance: one of these a member, wider loses small parts.
pub const SCALES: [f64; 3] = [0.2, 0.25, 0.3];
/// Clusters of a member, both ends included: more than any object has parts.
const CLUSTERS: [usize; 2] = [22, 33];
/// A member uses at least so many rows where there are as many.
const FEWEST_ROWS: usize = 30;

/// The random choices of one over-segmentation.
#[derive(Clone, Debug, PartialEq)]
pub struct Recipe {
    /// Landmarks used, ascending.
    pub rows: Vec<usize>,
    /// Width of the embedding's kernel over the mean distance.
    pub scale: f64,
    /// K-means clusters.
    pub clusters: usize,
}

impl Recipe {
    /// All rows, the middle scale, 28 clusters (fewer where rows are few): the single run.
    pub fn single(rows: usize) -> Recipe {
        Recipe { rows: (0..rows).collect(), scale: SCALES[1], clusters: 28.min(rows.saturating_sub(1)).max(1) }
    }

    /// Draws a member: 30 to all of `rows` landmarks, a scale, 22 to 33 clusters.
    pub fn draw(rows: usize, random: &mut Random) -> Recipe {
        let fewest = FEWEST_ROWS.min(rows.saturating_sub(1)).max(1);
        let count = (fewest + below(random, (rows + 1).saturating_sub(fewest))).min(rows);
        let mut all: Vec<usize> = (0..rows).collect();
        for i in 0..count {
            let j = i + below(random, rows - i);
            all.swap(i, j);
        }
        all.truncate(count);
        all.sort_unstable();
        let scale = SCALES[below(random, SCALES.len())];
        let clusters = CLUSTERS[0] + below(random, CLUSTERS[1] - CLUSTERS[0] + 1);
        Recipe { rows: all, scale, clusters: clusters.min(count.saturating_sub(1)).max(1) }
    }
}

/// The K-means of an over-segmentation: it need not be the best, members average its chances out.
pub fn kmeans(clusters: usize) -> KMeans {
    KMeans { clusters, restarts: 2, rounds: 20, candidates: 3, tolerance: 1e-6 }
}

/// Region of each cell (S), numbered 0, 1, …, each region connected; and how many.
pub fn over_segment(cells: &CellGraph, rows: &Rows, recipe: &Recipe, random: &mut Random) -> (Vec<u32>, usize) {
    let shares = cells.area_shares();
    let x = anchor_embedding(rows, &recipe.rows, &shares, recipe.clusters, recipe.scale);
    let label = kmeans(recipe.clusters).run(&x.values, &shares, random);
    let (piece, _) = connected_pieces(&cells.pairs, &label);
    join_small(&cells.pairs, &cells.length, &shares, &piece, ISLAND, 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::stream;

    #[test]
    fn recipes_stay_within_the_rows() {
        let mut random = stream(0, "test");
        for rows in [1, 2, 3, 30, 31, 60] {
            for _ in 0..50 {
                let r = Recipe::draw(rows, &mut random);
                assert!(!r.rows.is_empty() && r.rows.len() <= rows && r.rows.len() >= FEWEST_ROWS.min(rows - 1));
                assert!(r.rows.windows(2).all(|w| w[0] < w[1]) && r.rows.iter().all(|&j| j < rows));
                assert!(r.clusters >= 1 && r.clusters <= 33);
            }
        }
    }
}
