//! The graph of cells, which is all that the decisions use of a surface: some two thousand cells and six thousand
//! pairs, whatever the size of the mesh.

use crate::base::{Error, Result};
use std::f64::consts::PI;

/// A surface as a graph of some two thousand geodesic cells, all that the decisions use of it.
///
/// Lengths are in units of √(total area), so areas sum to 1; angles in radians. `S` cells,
/// `m` pairs of neighbouring cells, each pair once.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct CellGraph {
    /// The node that each cell grew from (S), which identifies it in random draws. Without it, cells are identified by
    /// their number.
    #[serde(default)]
    pub seed: Vec<u32>,
    /// Area of each cell (S).
    pub area: Vec<f64>,
    /// Area-weighted centroid of each cell (S).
    pub centre: Vec<[f64; 3]>,
    /// Outward unit normal of each cell, the area-weighted mean of its faces' (S).
    pub normal: Vec<[f64; 3]>,
    /// Whether the winding of each cell in the file is against its normal (S); empty if none is.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub flipped: Vec<bool>,
    /// Neighbouring cells (m).
    pub pairs: Vec<[u32; 2]>,
    /// Length of the common boundary of each pair (m).
    pub length: Vec<f64>,
    /// Length-weighted mean concave angle along the boundary, with convex edges counted as 0, from normals smoothed
    /// over a radius of .02 (m).
    pub concave: Vec<f64>,
    /// The same for convex angles (m).
    pub convex: Vec<f64>,
    /// Mean convex angle from normals smoothed over a radius of .04 (m).
    pub convex04: Vec<f64>,
}

/// Areas are at least this share of the mean cell's, so that none is zero.
const AREA_FLOOR: f64 = 1e-6;
/// Boundaries have at least this length, so that neighbours stay neighbours.
const LENGTH_FLOOR: f64 = 1e-9;

impl CellGraph {
    /// Number of cells S.
    pub fn len(&self) -> usize {
        self.area.len()
    }

    /// The neighbours of each cell (S), in the order of pairs.
    pub fn neighbours(&self) -> Vec<Vec<u32>> {
        let mut beside = vec![Vec::new(); self.len()];
        for &[i, j] in &self.pairs {
            beside[i as usize].push(j);
            beside[j as usize].push(i);
        }
        beside
    }

    /// Whether there are no cells.
    pub fn is_empty(&self) -> bool {
        self.area.is_empty()
    }

    /// Sum of the areas, added in cell order.
    pub fn total_area(&self) -> f64 {
        self.area.iter().sum()
    }

    /// Radius of a disc with the area of each cell (S).
    pub fn radii(&self) -> Vec<f64> {
        self.area.iter().map(|a| (a / PI).sqrt()).collect()
    }

    /// The identifier of each cell in random draws (S).
    pub fn names(&self) -> Vec<u32> {
        if self.seed.len() == self.len() { self.seed.clone() } else { (0..self.len() as u32).collect() }
    }

    /// Each cell's share of the total area (S).
    pub fn area_shares(&self) -> Vec<f64> {
        let total = self.total_area();
        self.area.iter().map(|a| a / total).collect()
    }

    /// The surface restricted to the cells `kept`, ascending, in units of its own area. Cell k is `kept[k]`.
    pub fn subset(&self, kept: &[u32]) -> CellGraph {
        let mut number = vec![None; self.len()];
        kept.iter().zip(0u32..).for_each(|(&i, k)| number[i as usize] = Some(k));
        let area: f64 = kept.iter().map(|&i| self.area[i as usize]).sum();
        let share = if area > 0.0 { self.total_area() / area } else { 1.0 };
        let unit = share.sqrt();
        let of = |values: &[f64], factor: f64| kept.iter().map(|&i| factor * values[i as usize]).collect::<Vec<f64>>();
        let mut g = CellGraph {
            seed: if self.seed.len() == self.len() {
                kept.iter().map(|&i| self.seed[i as usize]).collect()
            } else {
                kept.to_vec()
            },
            area: of(&self.area, share),
            centre: kept.iter().map(|&i| self.centre[i as usize].map(|x| x * unit)).collect(),
            normal: kept.iter().map(|&i| self.normal[i as usize]).collect(),
            flipped: kept.iter().filter_map(|&i| self.flipped.get(i as usize).copied()).collect(),
            ..CellGraph::default()
        };
        for (k, &[i, j]) in self.pairs.iter().enumerate() {
            if let (Some(i), Some(j)) = (number[i as usize], number[j as usize]) {
                g.pairs.push([i, j]);
                g.length.push(unit * self.length[k]);
                g.concave.push(self.concave[k]);
                g.convex.push(self.convex[k]);
                g.convex04.push(self.convex04[k]);
            }
        }
        g
    }

    /// A copy that is safe to compute with: minimum areas and lengths, finite numbers, normals of unit length or zero,
    /// no cell adjacent to itself.
    ///
    /// # Errors
    /// If the arrays' sizes disagree or a pair names a cell that does not exist.
    pub fn cleaned(&self) -> Result<CellGraph> {
        let (n, m) = (self.len(), self.pairs.len());
        let flipped = self.flipped.is_empty() || self.flipped.len() == n;
        let sizes = [self.centre.len() == n, self.normal.len() == n, flipped, self.length.len() == m];
        let angles = [self.concave.len() == m, self.convex.len() == m, self.convex04.len() == m];
        let known = self.pairs.iter().flatten().all(|&i| (i as usize) < n);
        if !(sizes.iter().chain(&angles).all(|x| *x) && known) {
            return Err(Error::parameter(
                "cells",
                format!("arrays of the cell graph disagree in size or name cells beyond {n}"),
                "pass one entry per cell and one entry per pair",
            ));
        }
        let positive = |x: f64| if x.is_finite() && x > 0.0 { x } else { 0.0 };
        let finite = |x: f64| if x.is_finite() { x.clamp(-1e100, 1e100) } else { 0.0 };
        let area = self.area.iter().map(|&a| positive(a)).collect();
        let mut g = CellGraph { seed: self.names(), area, flipped: self.flipped.clone(), ..CellGraph::default() };
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cleaning_leaves_no_nan_and_no_loop() {
        let g = CellGraph {
            seed: Vec::new(),
            area: vec![f64::NAN, 0.0],
            centre: vec![[f64::INFINITY, 0.0, 1.0]; 2],
            normal: vec![[0.0; 3], [0.0, 2.0, 0.0]],
            pairs: vec![[0, 1], [1, 1]],
            length: vec![0.0, 1.0],
            concave: vec![f64::NAN, 0.0],
            convex: vec![0.0; 2],
            convex04: vec![0.0; 2],
            ..CellGraph::default()
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
