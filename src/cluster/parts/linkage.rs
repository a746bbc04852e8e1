//! Agglomerative clustering: the best pair of classes is joined until the wanted number is left.
//!
//! Each class stores the best partner among those after it. If that partner grows or disappears, the stored value
//! becomes an upper bound, and the class is re-examined only when it would come first. Scattered pieces need that: by
//! gain, the smallest class is everybody's best partner, so without it each join would re-examine all others (2,000
//! classes took 3 s).
//!
//! Cost for R classes: R² initially; R per join, and R for each class that is re-examined. 9 R² bytes.

use super::hierarchy::HALF;
use super::matrix::Square;

/// The criterion by which pairs are joined, greatest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkageRank {
    /// The mean of C between two classes: average linkage by area.
    Mean,
    /// The gain of the expected Rand index, Σ A A (C − ½).
    Gain,
}

/// One join: class `j` is merged into class `i` < `j`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClassJoin {
    /// The class that stays.
    pub i: usize,
    /// The class that disappears.
    pub j: usize,
    /// Area-weighted mean of C between the two.
    pub mean: f64,
    /// The gain in the expected Rand index: Σ A A (C − ½) over the pairs it joins.
    pub gain: f64,
}

/// Classes to agglomerate.
#[derive(Clone, Debug)]
pub struct Linkage {
    /// Sums of A_x A_y C_xy between classes; symmetric.
    pub sums: Square,
    /// Areas of the classes.
    pub area: Vec<f64>,
    /// Which classes are adjacent (R × R, row by row): adjacent ones are joined before others. `None`: adjacency is
    /// ignored.
    pub touching: Option<Vec<bool>>,
}

/// Subtracted from the value of classes that are not adjacent.
const APART: f64 = 1e3;

/// The best partner of a class among those after it.
#[derive(Clone, Copy, Debug)]
struct Best {
    value: f64,
    partner: usize,
    /// Whether the value is only an upper bound, since the partner has changed.
    stale: bool,
}

impl Linkage {
    fn mean(&self, i: usize, j: usize) -> f64 {
        self.sums[(i, j)] / (self.area[i] * self.area[j]).max(1e-300)
    }

    fn value_of(&self, i: usize, j: usize, rank: LinkageRank) -> f64 {
        match rank {
            LinkageRank::Mean => self.mean(i, j),
            LinkageRank::Gain => self.sums[(i, j)] - HALF * self.area[i] * self.area[j],
        }
    }

    /// Whether two classes must not be joined before others, since they are not adjacent.
    pub fn is_apart(&self, i: usize, j: usize) -> bool {
        self.touching.as_ref().is_some_and(|touching| !touching[i * self.area.len() + j])
    }

    fn value(&self, i: usize, j: usize, rank: LinkageRank) -> f64 {
        let value = self.value_of(i, j, rank);
        if self.is_apart(i, j) { value - APART } else { value }
    }

    /// Merges class `j` into class `i`.
    pub fn fold(&mut self, i: usize, j: usize) {
        let n = self.area.len();
        self.sums.fold(i, j);
        self.area[i] += self.area[j];
        if let Some(touching) = &mut self.touching {
            for k in 0..n {
                touching[i * n + k] |= touching[j * n + k];
                touching[k * n + i] |= touching[k * n + j];
            }
        }
    }

    /// The first of the best partners of `i` among those of `alive` (R) after it.
    fn best(&self, i: usize, alive: &[bool], rank: LinkageRank) -> Best {
        let mut best = Best { value: f64::NEG_INFINITY, partner: alive.len(), stale: false };
        for j in (i + 1..alive.len()).filter(|&j| alive[j]) {
            let value = self.value(i, j, rank);
            if value > best.value {
                best = Best { value, partner: j, stale: false };
            }
        }
        best
    }

    /// All joins in order while more than `down_to` classes are left. Of equal pairs the first is joined.
    pub fn joins(mut self, rank: LinkageRank, down_to: usize) -> Vec<ClassJoin> {
        let n = self.area.len();
        let mut alive = vec![true; n];
        let mut best: Vec<Best> = (0..n).map(|i| self.best(i, &alive, rank)).collect();
        let mut out = Vec::new();
        while n - out.len() > down_to.max(1) {
            let (i, j) = loop {
                let first = |top: usize, i: usize| if best[i].value > best[top].value { i } else { top };
                let Some(i) = (0..n).filter(|&i| alive[i]).reduce(first) else { return out };
                if !best[i].stale {
                    break (i, best[i].partner);
                }
                best[i] = self.best(i, &alive, rank);
            };
            if j == n {
                break;
            }
            let gain = self.value_of(i, j, LinkageRank::Gain);
            out.push(ClassJoin { i, j, mean: self.mean(i, j), gain });
            alive[j] = false;
            self.fold(i, j);
            best[i] = self.best(i, &alive, rank);
            for k in (0..j).filter(|&k| k != i && alive[k]) {
                let partner = best[k].partner;
                best[k].stale |= partner == i || partner == j;
                if k < i {
                    let value = self.value(i, k, rank);
                    // At least as good as the bound, with a partner that does not come later: nothing before it can be
                    // as good.
                    if value > best[k].value || (value == best[k].value && i <= partner) {
                        best[k] = Best { value, partner: i, stale: false };
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
    use crate::base::random::{below, stream, unit};

    /// Reference: examines all pairs before each join.
    fn slowly(mut linkage: Linkage, rank: LinkageRank, down_to: usize) -> Vec<(usize, usize)> {
        let n = linkage.area.len();
        let (mut alive, mut out) = (vec![true; n], Vec::new());
        while n - out.len() > down_to.max(1) {
            let mut top = (f64::NEG_INFINITY, 0, 0);
            for i in (0..n).filter(|&i| alive[i]) {
                for j in (i + 1..n).filter(|&j| alive[j]) {
                    let value = linkage.value(i, j, rank);
                    if value > top.0 {
                        top = (value, i, j);
                    }
                }
            }
            let (_, i, j) = top;
            out.push((i, j));
            alive[j] = false;
            linkage.fold(i, j);
        }
        out
    }

    /// With values from a small set, so that many are equal, and with arbitrary ones.
    #[test]
    fn joins_are_those_of_looking_at_all_pairs() {
        let mut random = stream(7, "linkage");
        for case in 0..120 {
            let (n, few) = (2 + case % 23, case % 3);
            let mut draw = |steps: usize| match few {
                0 => unit(&mut random),
                _ => below(&mut random, steps + 1) as f64 / steps as f64,
            };
            let area: Vec<f64> = (0..n).map(|_| if few == 2 { 1.0 } else { draw(4) + 0.25 }).collect();
            let (mut sums, mut touching) = (Square::zeros(n), vec![false; n * n]);
            for i in 0..n {
                for j in 0..i {
                    sums.add_both(i, j, area[i] * area[j] * draw(2));
                    let touches = draw(4) > 0.5;
                    (touching[i * n + j], touching[j * n + i]) = (touches, touches);
                }
            }
            let linkage = Linkage { sums, area, touching: Some(touching) };
            for rank in [LinkageRank::Mean, LinkageRank::Gain] {
                let down_to = case % 5;
                let joins = linkage.clone().joins(rank, down_to);
                let pairs: Vec<_> = joins.iter().map(|join| (join.i, join.j)).collect();
                assert_eq!(pairs, slowly(linkage.clone(), rank, down_to), "case {case}, {rank:?}");
            }
        }
    }

    #[test]
    fn neighbours_go_first_and_all_end_as_one() {
        // Three classes of area 1; 0 and 2 agree most, but only 0–1 and 1–2 touch.
        let c = vec![0.0, 0.4, 0.9, 0.4, 0.0, 0.3, 0.9, 0.3, 0.0];
        let touching = (0..9).map(|k| k % 2 == 1).collect::<Vec<bool>>();
        for rank in [LinkageRank::Mean, LinkageRank::Gain] {
            let plain = Linkage { sums: Square::from_values(3, c.clone()), area: vec![1.0; 3], touching: None };
            let order: Vec<_> = plain.clone().joins(rank, 1).iter().map(|j| (j.i, j.j)).collect();
            assert_eq!(order, [(0, 2), (0, 1)]);
            let near = Linkage { touching: Some(touching.clone()), ..plain.clone() };
            let joins = near.joins(rank, 1);
            assert_eq!(joins.iter().map(|j| (j.i, j.j)).collect::<Vec<_>>(), [(0, 1), (0, 2)]);
            assert!((joins[1].mean - 0.6).abs() < 1e-12);
        }
    }
}
