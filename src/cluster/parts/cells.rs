//! The graph of cells, connected pieces of its labellings, and the joining of small classes.

use super::labels::Sets;
use crate::base::{Error, Result};

pub use super::labels::{class_sums, compact, intersect};

/// A surface as a graph of some two thousand geodesic cells, all that the decisions see of it.
///
/// Lengths are in units of √(total area), so areas sum to 1; angles in radians. `S` cells,
/// `m` pairs of neighbouring cells, each pair once.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct CellGraph {
    /// Area of each cell (S).
    pub area: Vec<f64>,
    /// Area-weighted centroid of each cell (S).
    pub centre: Vec<[f64; 3]>,
    /// Outward unit normal of each cell, the area-weighted mean of its faces' (S).
    pub normal: Vec<[f64; 3]>,
    /// Neighbouring cells (m).
    pub pairs: Vec<[u32; 2]>,
    /// Length of the common boundary of each pair (m).
    pub length: Vec<f64>,
    /// Length-weighted mean concave angle along the boundary, convex edges counting as 0, from
    /// normals smoothed over a radius of .02 (m).
    pub concave: Vec<f64>,
    /// The same of convex angles (m).
    pub convex: Vec<f64>,
    /// Mean convex angle from normals smoothed over .04 (m).
    pub convex04: Vec<f64>,
}

/// Areas are raised to this share of the mean cell's, so that none is zero.
const AREA_FLOOR: f64 = 1e-6;
/// Boundaries are raised to this length: a pair of neighbours stays one.
const LENGTH_FLOOR: f64 = 1e-9;

impl CellGraph {
    /// Number of cells S.
    pub fn len(&self) -> usize {
        self.area.len()
    }

    /// Whether there is no cell.
    pub fn is_empty(&self) -> bool {
        self.area.is_empty()
    }

    /// Sum of the areas, added in cell order.
    pub fn total_area(&self) -> f64 {
        self.area.iter().sum()
    }

    /// Each cell's share of the total area (S).
    pub fn area_shares(&self) -> Vec<f64> {
        let total = self.total_area();
        self.area.iter().map(|a| a / total).collect()
    }

    /// A copy that is safe to compute with: floored areas and lengths, finite numbers, normals
    /// of unit length or zero, no cell beside itself.
    ///
    /// # Errors
    /// If the arrays' sizes disagree or a pair names a cell that does not exist.
    pub fn cleaned(&self) -> Result<CellGraph> {
        let (n, m) = (self.len(), self.pairs.len());
        let sizes = [self.centre.len() == n, self.normal.len() == n, self.length.len() == m];
        let angles = [self.concave.len() == m, self.convex.len() == m, self.convex04.len() == m];
        let known = self.pairs.iter().flatten().all(|&i| (i as usize) < n);
        if !(sizes.iter().chain(&angles).all(|x| *x) && known) {
            return Err(Error::parameter(
                "cells",
                format!("arrays of the cell graph disagree in size or name cells beyond {n}"),
                "pass one entry a cell and one entry a pair",
            ));
        }
        let positive = |x: f64| if x.is_finite() && x > 0.0 { x } else { 0.0 };
        let finite = |x: f64| if x.is_finite() { x.clamp(-1e100, 1e100) } else { 0.0 };
        let mut g = CellGraph { area: self.area.iter().map(|&a| positive(a)).collect(), ..CellGraph::default() };
        let mean = g.total_area() / n.max(1) as f64;
        if mean > 0.0 && mean.is_finite() {
            g.area.iter_mut().for_each(|a| *a = a.max(AREA_FLOOR * mean));
        } else {
            g.area.fill(1.0 / n.max(1) as f64);
        }
        g.centre = self.centre.iter().map(|x| x.map(finite)).collect();
        g.normal = self
            .normal
            .iter()
            .map(|v| {
                let v = v.map(finite);
                let norm = v.iter().map(|x| x * x).sum::<f64>().sqrt();
                if (norm - 1.0).abs() < 1e-6 || norm == 0.0 { v } else { v.map(|x| x / norm) }
            })
            .collect();
        for (k, &[i, j]) in self.pairs.iter().enumerate().filter(|(_, [i, j])| i != j) {
            g.pairs.push([i, j]);
            g.length.push(positive(self.length[k]).max(LENGTH_FLOOR));
            g.concave.push(positive(self.concave[k]));
            g.convex.push(positive(self.convex[k]));
            g.convex04.push(positive(self.convex04[k]));
        }
        Ok(g)
    }
}

/// Connected pieces of the classes of a labelling, numbered by first appearance, and how many.
pub fn connected_pieces(pairs: &[[u32; 2]], label: &[u32]) -> (Vec<u32>, usize) {
    let mut sets = Sets::new(label.len());
    for &[i, j] in pairs {
        if label[i as usize] == label[j as usize] {
            sets.join(i, j);
        }
    }
    compact(&sets.labels())
}

/// Classes from `lowest` on with less than `limit` of the area join, smallest first, the
/// neighbour with which they share the longest boundary; those without neighbours stay.
///
/// `label` numbers classes 0, 1, …; so does the result.
pub fn join_small(
    pairs: &[[u32; 2]],
    length: &[f64],
    area: &[f64],
    label: &[u32],
    limit: f64,
    lowest: usize,
) -> (Vec<u32>, usize) {
    let n = label.iter().max().map_or(0, |&m| m as usize + 1);
    let mut size = class_sums(label, area, n);
    let mut open: Vec<bool> = (0..n).map(|k| k >= lowest && size[k] > 0.0 && size[k] < limit).collect();
    if !open.contains(&true) {
        return compact(label);
    }
    let mut rims: Vec<(u32, u32, f64)> = Vec::new();
    for (&[i, j], &len) in pairs.iter().zip(length) {
        let (a, b) = (label[i as usize], label[j as usize]);
        if a != b {
            rims.push((a.min(b), a.max(b), len));
        }
    }
    rims.sort_by_key(|r| (r.0, r.1));
    rims.dedup_by(|next, first| {
        let same = (next.0, next.1) == (first.0, first.1);
        if same {
            first.2 += next.2;
        }
        same
    });
    let mut into: Vec<u32> = (0..n as u32).collect();
    let mut shared = vec![0.0; n];
    while let Some(q) = (0..n).filter(|&k| open[k]).min_by(|&a, &b| size[a].total_cmp(&size[b])) {
        shared.fill(0.0);
        for &(a, b, len) in &rims {
            if a as usize == q {
                shared[b as usize] += len;
            } else if b as usize == q {
                shared[a as usize] += len;
            }
        }
        open[q] = false;
        let Some(to) = (0..n).rev().max_by(|&a, &b| shared[a].total_cmp(&shared[b])).filter(|&k| shared[k] > 0.0)
        else {
            continue;
        };
        size[to] += size[q];
        open[to] = open[to] && size[to] < limit;
        for slot in into.iter_mut().filter(|slot| **slot as usize == q) {
            *slot = to as u32;
        }
        for r in &mut rims {
            let name = |k: u32| if k as usize == q { to as u32 } else { k };
            (r.0, r.1) = (name(r.0), name(r.1));
        }
        rims.retain(|r| r.0 != r.1);
    }
    compact(&label.iter().map(|&k| into[k as usize]).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A strip of cells 0-1-2-…, boundaries of length 1, areas 1.
    fn strip(n: u32) -> (Vec<[u32; 2]>, Vec<f64>, Vec<f64>) {
        let pairs: Vec<[u32; 2]> = (1..n).map(|i| [i - 1, i]).collect();
        (pairs.clone(), vec![1.0; pairs.len()], vec![1.0; n as usize])
    }

    #[test]
    fn pieces_of_a_class_are_told_apart() {
        let (pairs, _, _) = strip(6);
        assert_eq!(connected_pieces(&pairs, &[0, 1, 1, 0, 0, 1]), (vec![0, 1, 1, 2, 2, 3], 4));
    }

    #[test]
    fn small_classes_join_their_longest_neighbour() {
        let (pairs, mut length, area) = strip(6);
        length[1] = 2.0;
        let (label, n) = join_small(&pairs, &length, &area, &[0, 0, 1, 2, 2, 2], 1.5, 0);
        assert_eq!((label, n), (vec![0, 0, 0, 1, 1, 1], 2));
        let (label, n) = join_small(&pairs, &length, &area, &[0, 0, 1, 2, 2, 2], 1.5, 2);
        assert_eq!((label, n), (vec![0, 0, 1, 2, 2, 2], 3));
        let (label, n) = join_small(&[], &[], &area, &[0, 0, 1, 2, 2, 2], 1.5, 0);
        assert_eq!((label, n), (vec![0, 0, 1, 2, 2, 2], 3));
    }

    #[test]
    fn cleaning_leaves_no_nan_and_no_loop() {
        let g = CellGraph {
            area: vec![f64::NAN, 0.0],
            centre: vec![[f64::INFINITY, 0.0, 1.0]; 2],
            normal: vec![[0.0; 3], [0.0, 2.0, 0.0]],
            pairs: vec![[0, 1], [1, 1]],
            length: vec![0.0, 1.0],
            concave: vec![f64::NAN, 0.0],
            convex: vec![0.0; 2],
            convex04: vec![0.0; 2],
        };
        let clean = g.cleaned().unwrap();
        assert_eq!(clean.area, [0.5, 0.5]);
        assert_eq!(clean.pairs, [[0, 1]]);
        assert_eq!(clean.normal[1], [0.0, 1.0, 0.0]);
        assert!(clean.length[0] > 0.0 && clean.concave[0] == 0.0);
        let mut wrong = g;
        wrong.pairs[0] = [0, 2];
        assert!(wrong.cleaned().is_err());
    }
}
