//! The columns of `[A B]` that fits run on: every face of a small mesh, else a sample by area.
//!
//! A fit (degrees, anchor shares, K-means) is an average over the surface, so it needs a constant number
//! of columns: [`MOST`] faces, one per equal quantum of area in node order, stratified and seeded. Only what
//! must cover every face (labels, Γ) streams over all columns. Memory: 4 (l + d) [`MOST`] bytes. Cost: one pass
//! over areas, `MOST · l` random reads.

use crate::base::random::{stream, unit};
use crate::distance::DistanceRows;
use crate::graph::Node;

/// Columns at the most.
pub const MOST: usize = 1 << 14;

/// A sample of columns.
#[derive(Clone, Debug)]
pub struct Columns {
    /// Their nodes (s), ascending.
    pub nodes: Vec<u32>,
    /// Their shares of the area (s), summing to 1.
    pub shares: Vec<f64>,
    /// Their distances: row k at `k * s` (l × s).
    pub distances: Vec<f32>,
}

impl Columns {
    /// Samples the columns of `rows`.
    pub fn sample(rows: &DistanceRows, nodes: &[Node], seed: u64) -> Self {
        let n = nodes.len();
        let total: f64 = nodes.iter().map(|node| f64::from(node.area)).sum();
        let (chosen, mut shares): (Vec<u32>, Vec<f64>) = if n <= MOST {
            // Areas are floored so that faces without area have a say where nothing else does.
            let floor = 1e-6 * total.max(1e-30) / n as f64;
            (0..n as u32).map(|i| (i, f64::from(nodes[i as usize].area).max(floor))).unzip()
        } else if total > 0. {
            by_area(nodes, total, seed)
        } else {
            (0..MOST).map(|k| ((k as u128 * n as u128 / MOST as u128) as u32, 1.)).unzip()
        };
        let sum: f64 = shares.iter().sum();
        shares.iter_mut().for_each(|share| *share /= sum);
        let mut distances = Vec::with_capacity(rows.len() * chosen.len());
        for k in 0..rows.len() {
            let row = rows.row(k);
            distances.extend(chosen.iter().map(|&node| row[node as usize]));
        }
        Self { nodes: chosen, shares, distances }
    }

    /// Number of columns s.
    pub fn len(&self) -> usize {
        self.nodes.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// Row `k` of the distances (s).
    pub fn row(&self, k: usize) -> &[f32] {
        &self.distances[k * self.len()..(k + 1) * self.len()]
    }
}

/// One node per quantum of area, at a random place in it; a node hit several times counts as often.
fn by_area(nodes: &[Node], total: f64, seed: u64) -> (Vec<u32>, Vec<f64>) {
    let mut draw = stream(seed, "columns");
    let quantum = total / MOST as f64;
    let (mut chosen, mut shares) = (Vec::with_capacity(MOST), Vec::<f64>::with_capacity(MOST));
    let (mut sum, mut k) = (0f64, 0usize);
    let mut target = unit(&mut draw) * quantum;
    for (node, geometry) in nodes.iter().enumerate() {
        sum += f64::from(geometry.area);
        let mut hits = 0;
        while k < MOST && target < sum {
            hits += 1;
            k += 1;
            target = (k as f64 + unit(&mut draw)) * quantum;
        }
        if hits > 0 {
            chosen.push(node as u32);
            shares.push(f64::from(hits));
        }
    }
    (chosen, shares)
}
