//! Merging neighbouring regions, greatest cost first, down to one a connected component.

use super::cost::{MEASURES, Model, measures};
use super::matrix::Square;
use super::regions::Regions;

/// One union: region `j` goes into region `i` < `j`, which keeps its name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Merge {
    /// The region that stays.
    pub i: usize,
    /// The region that ends.
    pub j: usize,
    /// Natural logarithm of the cost at which they merged.
    pub log_cost: f64,
    /// What the probability is made from.
    pub measures: [f64; MEASURES],
    /// Probability that people keep them in one part.
    pub probability: f64,
}

/// All merges in order, until no two regions touch or `stop(ln cost, regions left)` says so.
pub fn merges(mut r: Regions, model: &Model, mut stop: impl FnMut(f64, usize) -> bool) -> Vec<Merge> {
    let n = r.len();
    let mut alive = vec![true; n];
    let mut cost = Square::from_values(n, vec![f64::NEG_INFINITY; n * n]);
    for i in 0..n {
        for j in (i + 1..n).filter(|&j| r.length[(i, j)] > 0.0) {
            cost[(i, j)] = model.log_cost(&r, i, j);
        }
    }
    // The greatest of each row right of the diagonal; rows are rescanned only when theirs changes.
    let scan = |cost: &Square, i: usize| {
        let mut best = (f64::NEG_INFINITY, n);
        for (j, &c) in cost.row(i).iter().enumerate().skip(i + 1) {
            if c > best.0 {
                best = (c, j);
            }
        }
        best
    };
    let mut best: Vec<(f64, usize)> = (0..n).map(|i| scan(&cost, i)).collect();
    let mut out = Vec::new();
    loop {
        let mut top = (f64::NEG_INFINITY, n, n);
        for (i, &(c, j)) in best.iter().enumerate() {
            if c > top.0 {
                top = (c, i, j);
            }
        }
        let (c, i, j) = top;
        if j == n || stop(c, n - out.len()) {
            return out;
        }
        let measures = measures(&r, i, j, c);
        out.push(Merge { i, j, log_cost: c, measures, probability: model.probability(&measures) });
        r.merge(i, j);
        alive[j] = false;
        for k in 0..n {
            for e in [i, j] {
                cost[(e.min(k), e.max(k))] = f64::NEG_INFINITY;
            }
        }
        for k in (0..n).filter(|&k| k != i && alive[k] && r.length[(i, k)] > 0.0) {
            cost[(i.min(k), i.max(k))] = model.log_cost(&r, i, k);
        }
        best[j] = (f64::NEG_INFINITY, n);
        best[i] = scan(&cost, i);
        for k in (0..n).filter(|&k| k != i && alive[k]) {
            let fresh = if k < i { cost[(k, i)] } else { f64::NEG_INFINITY };
            if best[k].1 == i || best[k].1 == j {
                best[k] = scan(&cost, k);
            } else if fresh > best[k].0 || (fresh == best[k].0 && fresh > f64::NEG_INFINITY && i < best[k].1) {
                best[k] = (fresh, i);
            }
        }
    }
}

/// The probability at the lowest common merge of any two of `n` regions: 1 on the diagonal, 0
/// for regions that never meet.
pub fn meeting_probability(n: usize, merges: &[Merge]) -> Square {
    let mut p = Square::zeros(n);
    let mut members: Vec<Vec<usize>> = (0..n).map(|i| vec![i]).collect();
    for i in 0..n {
        p[(i, i)] = 1.0;
    }
    for m in merges {
        let joined = std::mem::take(&mut members[m.j]);
        for &a in &members[m.i] {
            for &b in &joined {
                p[(a, b)] = m.probability;
                p[(b, a)] = m.probability;
            }
        }
        members[m.i].extend(joined);
    }
    p
}

/// The class of each of `n` regions after the first merges, named by its least member.
pub fn classes(n: usize, merges: &[Merge]) -> Vec<u32> {
    let mut into: Vec<u32> = (0..n as u32).collect();
    for m in merges {
        into.iter_mut().filter(|k| **k == m.j as u32).for_each(|k| *k = m.i as u32);
    }
    into
}
