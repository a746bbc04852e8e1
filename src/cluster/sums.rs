//! Area, centroid and direction of classes of nodes: cells, micro-cells, contracted nodes.
//!
//! Few blocks of nodes are summed side by side, since each holds all classes (56 bytes a class and block), and added up
//! in their order, so that threads do not show.

use super::area_shares::AreaShares;
use crate::base::Result;
use crate::base::parallel::{chunk_count, chunk_range, map_chunks};
use crate::graph::DualGraph;
use crate::store::Run;

const BLOCKS: usize = 8;

/// Sums over a class of nodes, in the frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ClassSum {
    /// Area shares.
    pub share: f64,
    /// Weights: area shares, but no less than the least that was asked for.
    pub weight: f64,
    /// Centroids times weights.
    pub centre: [f64; 3],
    /// Normals times weights.
    pub normal: [f64; 3],
}

impl ClassSum {
    fn add(&mut self, other: &Self) {
        self.share += other.share;
        self.weight += other.weight;
        for axis in 0..3 {
            self.centre[axis] += other.centre[axis];
            self.normal[axis] += other.normal[axis];
        }
    }

    /// The centroid; the frame's origin where nothing was summed.
    pub fn centroid(&self) -> [f64; 3] {
        self.centre.map(|x| x / self.weight.max(1e-300))
    }

    /// The mean direction, of length 1 or 0.
    pub fn direction(&self) -> [f64; 3] {
        let length = self.normal.iter().map(|x| x * x).sum::<f64>().sqrt();
        self.normal.map(|x| if length > 0. { x / length } else { 0. })
    }
}

/// Sums over the nodes of each of `classes` classes; nodes of none (beyond the last) are left out, as are those without
/// area unless `least` weight is given to each.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn class_sums(
    graph: &DualGraph,
    shares: &AreaShares,
    class: &[u32],
    classes: usize,
    least: f64,
    run: &Run,
) -> Result<Vec<ClassSum>> {
    let n = class.len();
    let block = n.div_ceil(BLOCKS).max(1);
    let sum = |k: usize, (): &mut ()| {
        let mut sums = vec![ClassSum::default(); classes];
        for i in chunk_range(n, block, k) {
            let share = f64::from(shares.share[i]);
            let weight = share.max(least);
            let Some(sum) = sums.get_mut(class[i] as usize).filter(|_| weight > 0.) else { continue };
            let node = &graph.nodes[i];
            sum.share += share;
            sum.weight += weight;
            for axis in 0..3 {
                sum.centre[axis] += weight * f64::from(node.centroid[axis]);
                sum.normal[axis] += weight * f64::from(node.normal[axis]);
            }
        }
        Ok(sums)
    };
    let mut total = vec![ClassSum::default(); classes];
    for part in map_chunks(run.threads, &run.cancel, chunk_count(n, block), || (), sum)? {
        total.iter_mut().zip(&part).for_each(|(sum, part)| sum.add(part));
    }
    Ok(total)
}
