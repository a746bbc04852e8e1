//! The labelling that agrees best, in expectation, with the people the probabilities speak of.
//!
//! With C_xy the probability that atoms x and y belong together, the expected Rand index of a
//! labelling is, up to a constant, the sum over pairs in one part of A_x A_y (C_xy − ½). It is
//! maximised by local moves and greedy joins in turn. Another threshold in place of ½ gives
//! finer (above) or coarser (below) parts; where it stands is all there is of a "detail".

use super::cells::compact;
use super::matrix::Square;

/// The threshold of the Rand index.
pub const HALF: f64 = 0.5;
/// Gains below this are rounding.
const LEAST: f64 = 1e-14;
/// Rounds of local moves at most, between joins.
const ROUNDS: usize = 30;

/// Atoms to be grouped: areas (R) and C (R × R).
#[derive(Clone, Copy, Debug)]
pub struct Pull<'a> {
    /// Area of each atom.
    pub area: &'a [f64],
    /// Probability that two atoms belong together.
    pub together: &'a Square,
}

impl Pull<'_> {
    /// Sum over pairs of distinct atoms in one part of A_x A_y (C_xy − threshold).
    pub fn objective(&self, label: &[u32], threshold: f64) -> f64 {
        let mut sum = 0.0;
        for i in 0..label.len() {
            for j in (0..i).filter(|&j| label[j] == label[i]) {
                sum += self.area[i] * self.area[j] * (self.together[(i, j)] - threshold);
            }
        }
        sum
    }

    /// The best labelling found of the atoms in `some`, at a threshold: a label below the number
    /// of parts for each of `some`, numbered by first appearance.
    pub fn best(&self, some: &[u32], threshold: f64) -> Vec<u32> {
        let n = some.len();
        let mut gain = Square::zeros(n);
        for (i, &x) in some.iter().enumerate() {
            let (area, from) = (self.area[x as usize], self.together.row(x as usize));
            for (slot, &y) in gain.row_mut(i).iter_mut().zip(some) {
                *slot = area * self.area[y as usize] * (from[y as usize] - threshold);
            }
            gain[(i, i)] = 0.0;
        }
        let mut label: Vec<u32> = (0..n as u32).collect();
        let mut before = usize::MAX;
        loop {
            local_moves(&gain, &mut label);
            let (moved, classes) = compact(&label);
            label = moved;
            let joined = greedy_joins(&gain, &mut label, classes);
            if joined == classes || joined == before {
                return compact(&label).0;
            }
            before = joined;
        }
    }
}

/// Moves single atoms to the class (or an empty one) of greatest gain until none moves.
fn local_moves(gain: &Square, label: &mut [u32]) {
    let n = label.len();
    let mut count = vec![0usize; n + 1];
    // Pull of class k on atom i, a row a class: a move changes two rows.
    let mut pull = Square::zeros(n);
    for (i, &k) in label.iter().enumerate() {
        count[k as usize] += 1;
        pull.row_mut(k as usize).iter_mut().zip(gain.row(i)).for_each(|(sum, g)| *sum += g);
    }
    let mut live: Vec<usize> = (0..n).filter(|&k| count[k] > 0).collect();
    for _ in 0..ROUNDS {
        let mut moved = false;
        for i in 0..n {
            let old = label[i] as usize;
            let (mut value, mut new) = (pull[(old, i)], old);
            for &k in &live {
                let v = pull[(k, i)];
                if v > value + LEAST {
                    (value, new) = (v, k);
                }
            }
            if value < -LEAST
                && let Some(empty) = (0..n).find(|&k| count[k] == 0)
            {
                new = empty;
                pull.row_mut(empty).fill(0.0);
            }
            if new == old {
                continue;
            }
            moved = true;
            label[i] = new as u32;
            count[old] -= 1;
            count[new] += 1;
            pull.row_mut(old).iter_mut().zip(gain.row(i)).for_each(|(sum, g)| *sum -= g);
            pull.row_mut(new).iter_mut().zip(gain.row(i)).for_each(|(sum, g)| *sum += g);
            if count[old] == 0 || count[new] == 1 {
                live.retain(|&k| count[k] > 0 && k != new);
                live.push(new);
            }
        }
        if !moved {
            return;
        }
    }
}

/// Joins the two classes of greatest gain while it is positive; returns how many are left.
fn greedy_joins(gain: &Square, label: &mut [u32], classes: usize) -> usize {
    let mut sums = between(gain, label, classes);
    let mut alive: Vec<usize> = (0..classes).collect();
    loop {
        let mut top = (LEAST, 0, 0);
        for (k, &i) in alive.iter().enumerate() {
            for &j in &alive[k + 1..] {
                if sums[(i, j)] > top.0 {
                    top = (sums[(i, j)], i, j);
                }
            }
        }
        let (_, i, j) = top;
        if i == j {
            return alive.len();
        }
        sums.fold(i, j);
        alive.retain(|&k| k != j);
        label.iter_mut().filter(|k| **k == j as u32).for_each(|k| *k = i as u32);
    }
}

/// Sums of `m` between the classes of a labelling.
pub(super) fn between(m: &Square, label: &[u32], classes: usize) -> Square {
    let mut out = Square::zeros(classes);
    let mut row = vec![0.0; classes];
    for (i, &k) in label.iter().enumerate() {
        row.fill(0.0);
        for (x, &c) in m.row(i).iter().zip(label) {
            row[c as usize] += x;
        }
        out.row_mut(k as usize).iter_mut().zip(&row).for_each(|(sum, x)| *sum += x);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn blocks(n: usize, parts: usize, inside: f64, across: f64) -> Square {
        let value = |k: usize| if (k / n) % parts == (k % n) % parts { inside } else { across };
        Square::from_values(n, (0..n * n).map(value).collect())
    }

    #[test]
    fn clear_blocks_are_found_and_the_threshold_moves_them() {
        let c = blocks(30, 3, 0.9, 0.3);
        let area = vec![1.0 / 30.0; 30];
        let pull = Pull { area: &area, together: &c };
        let all: Vec<u32> = (0..30).collect();
        let label = pull.best(&all, HALF);
        assert!((0..30).all(|i| label[i] == (i % 3) as u32));
        assert!(pull.best(&all, 0.2).iter().all(|&k| k == 0));
        assert_eq!(pull.best(&all, 0.95), all);
    }

    #[test]
    fn the_optimum_of_small_problems_is_reached() {
        // All labellings of six atoms, for pseudo-random probabilities.
        let (mut random, n) = (crate::base::random::stream(1, "test"), 6);
        let mut missed = 0;
        for _ in 0..50 {
            let mut c = Square::zeros(n);
            for i in 0..n {
                for j in 0..=i {
                    let x = crate::base::random::unit(&mut random);
                    (c[(i, j)], c[(j, i)]) = (x, x);
                }
            }
            let area: Vec<f64> = (0..n).map(|_| crate::base::random::unit(&mut random) + 0.1).collect();
            let pull = Pull { area: &area, together: &c };
            let found = pull.objective(&pull.best(&[0, 1, 2, 3, 4, 5], HALF), HALF);
            let best = (0..6u32.pow(6))
                .map(|code| (0..6).map(|k| code / 6u32.pow(k) % 6).collect::<Vec<_>>())
                .map(|label| pull.objective(&label, HALF))
                .fold(f64::NEG_INFINITY, f64::max);
            missed += usize::from(found < best - 1e-12);
        }
        assert!(missed <= 10, "{missed} of 50 missed");
    }

    #[test]
    fn nothing_and_one_atom() {
        let (area, c) = ([1.0], blocks(1, 1, 1.0, 0.0));
        let pull = Pull { area: &area, together: &c };
        assert_eq!(pull.best(&[], HALF), Vec::<u32>::new());
        assert_eq!(pull.best(&[0], HALF), [0]);
    }
}
