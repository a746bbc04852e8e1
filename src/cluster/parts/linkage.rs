//! Agglomeration of a few hundred classes by what pulls them together, all the way to one.

use super::labelling::HALF;
use super::matrix::Square;

/// What is greatest is joined first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rank {
    /// The mean of C between two classes: average linkage by area.
    Mean,
    /// The gain of the expected Rand index, Σ A A (C − ½).
    Gain,
}

/// One join: class `j` goes into class `i` < `j`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Join {
    /// The class that stays.
    pub i: usize,
    /// The class that ends.
    pub j: usize,
    /// Mean of C between the two, by area.
    pub mean: f64,
    /// What the join adds to the expected Rand index: Σ A A (C − ½) over the pairs it joins.
    pub gain: f64,
}

/// Classes to agglomerate.
#[derive(Clone, Debug)]
pub struct Linkage {
    /// Sums of A_x A_y C_xy between classes.
    pub sums: Square,
    /// Areas of the classes.
    pub area: Vec<f64>,
    /// Length of common boundaries; neighbours are joined before others. `None`: no matter.
    pub touch: Option<Square>,
}

/// Subtracted from the value of classes that do not touch.
const APART: f64 = 1e3;

impl Linkage {
    fn mean(&self, i: usize, j: usize) -> f64 {
        self.sums[(i, j)] / (self.area[i] * self.area[j]).max(1e-300)
    }

    fn value_of(&self, i: usize, j: usize, rank: Rank) -> f64 {
        match rank {
            Rank::Mean => self.mean(i, j),
            Rank::Gain => self.sums[(i, j)] - HALF * self.area[i] * self.area[j],
        }
    }

    fn value(&self, i: usize, j: usize, rank: Rank) -> f64 {
        let value = self.value_of(i, j, rank);
        if self.touch.as_ref().is_some_and(|t| t[(i, j)] <= 0.0) { value - APART } else { value }
    }

    /// All joins in order while more than `down_to` classes are left.
    pub fn joins(mut self, rank: Rank, down_to: usize) -> Vec<Join> {
        let n = self.area.len();
        let mut alive = vec![true; n];
        let scan = |this: &Self, alive: &[bool], i: usize| {
            let mut best = (f64::NEG_INFINITY, n);
            for j in (i + 1..n).filter(|&j| alive[j]) {
                let v = this.value(i, j, rank);
                if v > best.0 {
                    best = (v, j);
                }
            }
            best
        };
        let mut best: Vec<(f64, usize)> = (0..n).map(|i| scan(&self, &alive, i)).collect();
        let mut out = Vec::new();
        while n - out.len() > down_to.max(1) {
            let mut top = (f64::NEG_INFINITY, n, n);
            for i in (0..n).filter(|&i| alive[i]) {
                if best[i].0 > top.0 {
                    top = (best[i].0, i, best[i].1);
                }
            }
            let (_, i, j) = top;
            if j == n {
                break;
            }
            let gain = self.value_of(i, j, Rank::Gain);
            out.push(Join { i, j, mean: self.mean(i, j), gain });
            alive[j] = false;
            self.sums.fold(i, j);
            if let Some(touch) = &mut self.touch {
                touch.fold(i, j);
            }
            self.area[i] += self.area[j];
            best[i] = scan(&self, &alive, i);
            for k in (0..n).filter(|&k| k != i && alive[k]) {
                if best[k].1 == i || best[k].1 == j {
                    best[k] = scan(&self, &alive, k);
                } else if k < i {
                    let v = self.value(k, i, rank);
                    if v > best[k].0 {
                        best[k] = (v, i);
                    }
                }
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_go_first_and_all_end_as_one() {
        // Three classes of area 1; 0 and 2 agree most, but only 0–1 and 1–2 touch.
        let c = vec![0.0, 0.4, 0.9, 0.4, 0.0, 0.3, 0.9, 0.3, 0.0];
        let touch = vec![0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0];
        for rank in [Rank::Mean, Rank::Gain] {
            let plain = Linkage { sums: Square::from_values(3, c.clone()), area: vec![1.0; 3], touch: None };
            let order: Vec<_> = plain.joins(rank, 1).iter().map(|j| (j.i, j.j)).collect();
            assert_eq!(order, [(0, 2), (0, 1)]);
            let touch = Some(Square::from_values(3, touch.clone()));
            let near = Linkage { sums: Square::from_values(3, c.clone()), area: vec![1.0; 3], touch };
            let joins = near.joins(rank, 1);
            assert_eq!(joins.iter().map(|j| (j.i, j.j)).collect::<Vec<_>>(), [(0, 1), (0, 2)]);
            assert!((joins[1].mean - 0.6).abs() < 1e-12);
        }
    }
}
