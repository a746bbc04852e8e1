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

/// How one over-segmentation is made.
#[derive(Clone, Debug, PartialEq)]
pub struct Recipe {
    /// Landmarks used, ascending.
    pub rows: Vec<usize>,
    /// Width of the embedding's kernel over the mean distance.
    pub scale: f64,
    /// The K-means; its clusters are also the coordinates of the embedding, where rows suffice.
    pub kmeans: KMeans,
}

/// A K-means by itself: two starts, run to the end.
const CAREFUL: KMeans = KMeans { clusters: 28, restarts: 2, rounds: 20, candidates: 3, tolerance: 1e-6 };
/// A K-means among many: one start, eight rounds. Measured on 190 models, the parts of twelve
/// members are as good as with careful ones, in half the time.
const BRISK: KMeans = KMeans { clusters: 28, restarts: 1, rounds: 8, candidates: 3, tolerance: 1e-3 };

impl Recipe {
    /// All rows, the middle scale, 28 clusters (fewer where rows are few): the single run.
    pub fn single(rows: usize) -> Recipe {
        let clusters = CAREFUL.clusters.min(rows.saturating_sub(1)).max(1);
        Recipe { rows: (0..rows).collect(), scale: SCALES[1], kmeans: KMeans { clusters, ..CAREFUL } }
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
        let clusters = clusters.min(count.saturating_sub(1)).max(1);
        Recipe { rows: all, scale, kmeans: KMeans { clusters, ..BRISK } }
    }
}

/// Region of each cell (S), numbered 0, 1, …, each region connected; and how many.
pub fn over_segment(cells: &CellGraph, rows: &Rows, recipe: &Recipe, random: &mut Random) -> (Vec<u32>, usize) {
    let shares = cells.area_shares();
    let x = anchor_embedding(rows, &recipe.rows, &shares, recipe.kmeans.clusters, recipe.scale);
    let label = recipe.kmeans.run(&x.values, &shares, random);
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
                assert!(r.kmeans.clusters >= 1 && r.kmeans.clusters <= 33);
            }
        }
    }
}
