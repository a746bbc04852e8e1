//! Distances along the surface between cells, independent of the pose.
//!
//! Edges lead to the neighbours of a cell and to their neighbours, with the length of the chord, so that paths hardly
//! zigzag. Turning does not count: it changes with the pose. Sixteen sources are swept together, back and forth in the
//! order of the distance from an end of the surface, until nothing changes: about ten sweeps, the later ones over few
//! cells, in less than 1 ms for 2,000 cells.

use crate::base::dijkstra::shortest_paths;
use crate::base::simd::{SimdKernel, dispatch};
use crate::base::vector::distance;
use crate::cluster::parts::cell_graph::CellGraph;
use std::sync::Arc;

/// Number of sources swept together.
const LANES: usize = 16;
/// Maximum number of sweeps; cells not settled by then count as too far.
const SWEEPS: usize = 100;
/// Distance of unreachable cells.
pub const UNREACHED: f32 = 1e9;

/// A row of distances from one cell to all others (S), in units of √(total area).
pub type Row = Arc<Vec<f32>>;

/// The graph of paths between cells.
#[derive(Clone, Debug)]
pub struct CellPaths {
    starts: Vec<u32>,
    ends: Vec<u32>,
    length: Vec<f32>,
    /// Cells in sweep order (S).
    order: Vec<u32>,
}

impl CellPaths {
    /// The paths between `cells`.
    pub fn new(cells: &CellGraph) -> Self {
        let n = cells.len();
        let beside = cells.neighbours();
        let (mut starts, mut ends, mut length) = (vec![0], Vec::new(), Vec::new());
        for (i, near) in beside.iter().enumerate() {
            let mut all: Vec<u32> = near.iter().flat_map(|&j| beside[j as usize].iter().copied().chain([j])).collect();
            all.sort_unstable();
            all.dedup();
            all.retain(|&j| j as usize != i);
            length.extend(all.iter().map(|&j| distance(cells.centre[i], cells.centre[j as usize]) as f32));
            ends.append(&mut all);
            starts.push(ends.len() as u32);
        }
        Self { starts, ends, length, order: (0..n as u32).collect() }
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.starts.len() - 1
    }

    /// Sets the sweep order of all cells.
    pub fn sweep_in(&mut self, order: Vec<u32>) {
        self.order = order;
    }

    /// The cells one edge from `i`, with the lengths of the edges.
    #[inline(always)]
    pub fn steps(&self, i: u32) -> impl Iterator<Item = (u32, f32)> {
        let range = self.starts[i as usize] as usize..self.starts[i as usize + 1] as usize;
        let (ends, length) = (&self.ends[range.clone()], &self.length[range]);
        (0..ends.len()).map(|k| (ends[k], length[k]))
    }

    /// Lowers `field` (S) to the distances from `source` where those are smaller and below `limit`; returns the settled
    /// cells, nearest first.
    pub fn lower(&self, source: u32, limit: f32, field: &mut [f32]) -> Vec<u32> {
        let mut settled = Vec::new();
        shortest_paths(&[source], |i| self.steps(i), limit, field, |i| settled.push(i));
        settled
    }

    /// The row of each of `sources`.
    pub fn rows(&self, sources: &[u32]) -> Vec<Row> {
        sources.chunks(LANES).flat_map(|sources| dispatch(Sweeps { paths: self, sources })).collect()
    }
}

/// Rows of up to [`LANES`] sources, on wide vectors.
struct Sweeps<'a> {
    paths: &'a CellPaths,
    sources: &'a [u32],
}

impl SimdKernel for Sweeps<'_> {
    type Output = Vec<Row>;

    #[inline(always)]
    fn run(self) -> Vec<Row> {
        let Self { paths, sources } = self;
        let n = paths.len();
        let mut field = vec![[UNREACHED; LANES]; n];
        sources.iter().enumerate().for_each(|(k, &source)| field[source as usize][k] = 0.0);
        // Cells with a neighbour that changed since they were processed: few after the first sweeps.
        let mut stale = vec![true; n];
        for sweep in 0..SWEEPS {
            let mut changed = false;
            for at in 0..n {
                let i = paths.order[if sweep % 2 == 0 { at } else { n - 1 - at }];
                if !std::mem::take(&mut stale[i as usize]) {
                    continue;
                }
                let (mut here, mut lower) = (field[i as usize], false);
                for (j, step) in paths.steps(i) {
                    let there = &field[j as usize];
                    for k in 0..LANES {
                        let d = there[k] + step;
                        lower |= d < here[k];
                        here[k] = if d < here[k] { d } else { here[k] };
                    }
                }
                if lower {
                    field[i as usize] = here;
                    paths.steps(i).for_each(|(j, _)| stale[j as usize] = true);
                    changed = true;
                }
            }
            if !changed {
                break;
            }
        }
        let row = |k: usize| field.iter().map(|lanes| lanes[k]).collect::<Vec<f32>>();
        (0..sources.len()).map(|k| Arc::new(row(k))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{below, stream, unit};

    #[test]
    fn sweeps_and_fronts_find_the_shortest_paths() {
        let (mut random, n) = (stream(5, "test"), 120);
        let mut pairs: Vec<[u32; 2]> = (1..n as u32 - 1).map(|i| [below(&mut random, i as usize) as u32, i]).collect();
        pairs.extend((0..60).map(|_| [0; 2].map(|_| below(&mut random, n - 1) as u32)).filter(|[i, j]| i != j));
        let centre: Vec<[f64; 3]> = (0..n).map(|_| [0; 3].map(|_| unit(&mut random))).collect();
        let cells = CellGraph { area: vec![1.0; n], centre, pairs, ..CellGraph::default() };
        let mut paths = CellPaths::new(&cells);
        // Floyd–Warshall, on all edges and pairs of edges.
        let mut far = vec![vec![UNREACHED; n]; n];
        let beside = |i: u32, j: u32| cells.pairs.contains(&[i, j]) || cells.pairs.contains(&[j, i]);
        for i in 0..n as u32 {
            for j in 0..n as u32 {
                if i != j && (beside(i, j) || (0..n as u32).any(|k| beside(i, k) && beside(k, j))) {
                    far[i as usize][j as usize] = distance(cells.centre[i as usize], cells.centre[j as usize]) as f32;
                }
            }
            far[i as usize][i as usize] = 0.0;
        }
        for k in 0..n {
            for i in 0..n {
                for j in 0..n {
                    far[i][j] = far[i][j].min(far[i][k] + far[k][j]);
                }
            }
        }
        let sources: Vec<u32> = (0..n as u32).collect();
        for order in [sources.clone(), sources.iter().rev().copied().collect()] {
            paths.sweep_in(order);
            for (&source, row) in sources.iter().zip(paths.rows(&sources)) {
                let mut field = vec![UNREACHED; n];
                let settled = paths.lower(source, f32::INFINITY, &mut field);
                assert!(settled.windows(2).all(|w| row[w[0] as usize] <= row[w[1] as usize]));
                assert_eq!(field, *row);
                assert!(row.iter().zip(&far[source as usize]).all(|(a, b)| (a - b).abs() <= 1e-5 * b), "{source}");
            }
        }
        assert_eq!(paths.rows(&[0])[0][n - 1], UNREACHED, "the last cell touches no other");
    }
}
