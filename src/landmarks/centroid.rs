//! Farthest points moved to the middle of their cells: one step of Lloyd's algorithm in the space of distance vectors.
//!
//! A node's position is its vector of l distances. In each cell (the nodes nearest to one landmark) the mean position
//! is computed, and the node nearest to it becomes the landmark. Farthest points alone lie at tips, which are not
//! representative of their surroundings. Cost: l rows besides those of the result. Memory: 4 l s bytes.

use super::cholesky::sampled_columns;
use super::farthest::Farthest;
use super::{Found, Sampler, SamplingParams, Space};
use crate::base::Result;
use crate::store::mapped::Access;

/// The sampler.
pub struct Centroids(pub SamplingParams);

impl Sampler for Centroids {
    fn choose(
        &self,
        l: usize,
        seed: u64,
        space: &mut dyn Space,
        field: &mut [f32],
        found: &mut Found<'_>,
    ) -> Result<()> {
        let columns = sampled_columns(field.len(), l, self.0, seed);
        let mut first = Vec::with_capacity(l);
        Farthest.choose(l, seed, &mut Unfinished(space), field, &mut |node, _| {
            first.push(node);
            Ok(())
        })?;
        let mut rows: Vec<Vec<f32>> = Vec::with_capacity(l);
        for &node in &first {
            space.row(node, field)?;
            rows.push(columns.iter().map(|&c| field[c as usize]).collect());
        }
        middles(&first, &columns, &rows).into_iter().try_for_each(|node| found(node, None))
    }
}

/// Hides the rows of an earlier run: those belong to the final landmarks, not to the intermediate farthest points.
struct Unfinished<'a>(&'a mut dyn Space);

impl Space for Unfinished<'_> {
    fn nodes(&self) -> crate::graph::NodeView<'_> {
        self.0.nodes()
    }
    fn row(&mut self, node: u32, field: &mut [f32]) -> Result<()> {
        self.0.row(node, field)
    }
    fn lower(&mut self, _: usize, node: u32, field: &mut [f32]) -> Result<()> {
        self.0.lower(usize::MAX, node, field)
    }
    fn lower_by_length(&mut self, node: u32, field: &mut [f32]) -> Result<()> {
        self.0.lower_by_length(node, field)
    }
    fn threads(&self) -> usize {
        self.0.threads()
    }
    fn advise(&self, field: &[f32], access: Access) {
        self.0.advise(field, access);
    }
}

/// For each landmark the column nearest to the mean position of its cell; the landmark itself if its cell is empty.
fn middles(landmarks: &[u32], columns: &[u32], rows: &[Vec<f32>]) -> Vec<u32> {
    let l = rows.len();
    let cell: Vec<usize> = (0..columns.len())
        .map(|j| (1..l).fold(0, |best, k| if rows[k][j] < rows[best][j] { k } else { best }))
        .collect();
    let mut sums = vec![vec![0f64; l]; l];
    let mut counts = vec![0u32; l];
    for (j, &k) in cell.iter().enumerate() {
        counts[k] += 1;
        (0..l).for_each(|i| sums[k][i] += f64::from(rows[i][j]));
    }
    let mut best: Vec<(f64, u32)> = landmarks.iter().map(|&node| (f64::INFINITY, node)).collect();
    for (j, &k) in cell.iter().enumerate() {
        let away = |i: usize| (f64::from(rows[i][j]) - sums[k][i] / f64::from(counts[k])).powi(2);
        let square: f64 = (0..l).map(away).sum();
        if square < best[k].0 {
            best[k] = (square, columns[j]);
        }
    }
    best.into_iter().map(|(_, node)| node).collect()
}

#[cfg(test)]
mod tests {
    use super::middles;

    #[test]
    fn the_middle_of_each_half_of_a_path_is_found() {
        let columns: Vec<u32> = (0..20).collect();
        let row = |from: f32| (0..20).map(|i| (i as f32 - from).abs()).collect::<Vec<_>>();
        assert_eq!(middles(&[0, 19], &columns, &[row(0.), row(19.)]), [4, 14]);
    }
}
