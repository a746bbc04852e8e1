//! Fewer parts than found, alike on both sides: where two parts are joined, their twins are joined next.
//!
//! Joins by gain alone would leave one leg and join the other, or join one foreleg to the chest and the other to the
//! trunk, since a class with two legs agrees less with itself. Here the best of these changes comes first: two classes
//! without twins are joined; or twins; or a class joins each of two twins; or two classes and their twins are joined on
//! either side. A change of two joins counts with the gain of both. Only a number of parts between the two is not alike
//! on both sides.
//!
//! Cost for P parts: P² per change, so twins count only up to [`MOST`] parts.

use crate::cluster::parts::hierarchy::HALF;
use crate::cluster::parts::linkage::{ClassJoin, Linkage, LinkageRank};
use std::iter;

/// Maximum number of parts for which twins count: more are fragments.
const MOST: usize = 100;

/// One or two joins that leave both sides alike.
struct Change {
    first: [usize; 2],
    second: Option<[usize; 2]>,
    /// Whether the classes are adjacent.
    is_adjacent: bool,
    /// Sums of A_x A_y C_xy and of A_x A_y over the pairs that it joins.
    together: f64,
    pairs: f64,
}

/// All joins of `linkage` until one class is left, in order; joins of one change have the same mean and gain. `twin`
/// (P) has the twin of each class, or the class itself.
pub fn twin_joins(mut linkage: Linkage, mut twin: Vec<usize>) -> Vec<ClassJoin> {
    let n = twin.len();
    if n > MOST || twin.iter().enumerate().all(|(i, &j)| i == j) {
        return linkage.joins(LinkageRank::Gain, 1);
    }
    let mut alive: Vec<usize> = (0..n).collect();
    let mut out = Vec::new();
    while let Some(change) = best_change(&linkage, &twin, &alive) {
        let (mean, gain) = (change.together / change.pairs.max(1e-300), change.gain());
        // The class in which each one is now.
        let mut now: Vec<usize> = (0..n).collect();
        for [a, b] in iter::once(change.first).chain(change.second) {
            let (i, j) = (now[a].min(now[b]), now[a].max(now[b]));
            out.push(ClassJoin { i, j, mean, gain });
            linkage.fold(i, j);
            alive.retain(|&k| k != j);
            now.iter_mut().filter(|k| **k == j).for_each(|k| *k = i);
        }
        twin = (0..n).map(|k| now[twin[k]]).collect();
    }
    out
}

/// The change of greatest gain, those of adjacent classes before others; of equal ones the first.
fn best_change(linkage: &Linkage, twin: &[usize], alive: &[usize]) -> Option<Change> {
    let mut best: Option<Change> = None;
    for (at, &i) in alive.iter().enumerate() {
        for &j in &alive[at + 1..] {
            let change = Change::joining(linkage, twin, i, j);
            let value = |change: &Change| (change.is_adjacent, change.gain());
            if best.as_ref().is_none_or(|best| value(&change) > value(best)) {
                best = Some(change);
            }
        }
    }
    best
}

impl Change {
    /// The change that joins classes `i` and `j`.
    fn joining(linkage: &Linkage, twin: &[usize], i: usize, j: usize) -> Change {
        let (i2, j2) = (twin[i], twin[j]);
        let of = |first, second, pairs: &[[usize; 2]], adjacent: &[[usize; 2]]| Change {
            first,
            second,
            is_adjacent: adjacent.iter().all(|&[a, b]| !linkage.is_apart(a, b)),
            together: pairs.iter().map(|&[a, b]| linkage.sums[(a, b)]).sum(),
            pairs: pairs.iter().map(|&[a, b]| linkage.area[a] * linkage.area[b]).sum(),
        };
        if i2 == j || (i2 == i && j2 == j) {
            return of([i, j], None, &[[i, j]], &[[i, j]]);
        }
        if i2 != i && j2 != j {
            let both = [[i, j], [i2, j2]];
            return of(both[0], Some(both[1]), &both, &both);
        }
        let (middle, one, two) = if i2 == i { (i, j, j2) } else { (j, i, i2) };
        let both = [[middle, one], [middle, two]];
        of(both[0], Some(both[1]), &[both[0], both[1], [one, two]], &both)
    }

    fn gain(&self) -> f64 {
        self.together - HALF * self.pairs
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{below, stream, unit};
    use crate::cluster::parts::matrix::Square;

    /// Classes of the given areas, all adjacent, with C between them.
    fn linkage(area: &[f64], c: impl Fn(usize, usize) -> f64) -> Linkage {
        let n = area.len();
        let mut sums = Square::zeros(n);
        for i in 0..n {
            for j in 0..i {
                sums.add_both(i, j, area[i] * area[j] * c(i, j));
            }
        }
        Linkage { sums, area: area.to_vec(), touching: None }
    }

    /// The classes left after each number of joins.
    fn cuts(n: usize, joins: &[ClassJoin]) -> Vec<Vec<usize>> {
        let mut now: Vec<usize> = (0..n).collect();
        let each = joins.iter().map(|join| {
            now.iter_mut().filter(|k| **k == join.j).for_each(|k| *k = join.i);
            now.clone()
        });
        each.collect()
    }

    /// Regression: with eight of nine parts, a horse had lost one foreleg; with six, one had joined the chest and the
    /// other the trunk.
    #[test]
    fn both_legs_are_joined_or_neither() {
        // Chest, trunk, neck, two legs: a leg belongs to the chest or the trunk, slightly more to the chest, and legs
        // are clearly apart and do not touch.
        let c = |i: usize, j: usize| match (j.min(i), j.max(i)) {
            (0, 3 | 4) => 0.4,
            (1, 3 | 4) => 0.39,
            (0, 2) => 0.3,
            _ => 0.0,
        };
        let touching = (0..25).map(|k| ![(3, 4), (4, 3)].contains(&(k / 5, k % 5))).collect();
        let legs = Linkage { touching: Some(touching), ..linkage(&[0.3, 0.3, 0.3, 0.05, 0.05], c) };
        let one_by_one = cuts(5, &legs.clone().joins(LinkageRank::Gain, 1));
        assert_eq!(one_by_one[1], [0, 1, 2, 0, 1], "each foreleg joins another part");
        let alike = twin_joins(legs, vec![0, 1, 2, 4, 3]);
        assert_eq!(cuts(5, &alike)[1], [0, 1, 2, 0, 0]);
        assert_eq!((alike[0].gain, alike[0].mean), (alike[1].gain, alike[1].mean));
    }

    /// In every case, each class is the image of a class after at least every other join.
    #[test]
    fn both_sides_are_alike_except_within_a_change() {
        let mut random = stream(3, "twins");
        for case in 0..200 {
            let (pairs, singles) = (1 + below(&mut random, 5), below(&mut random, 5));
            let n = 2 * pairs + singles;
            let twin: Vec<usize> = (0..n).map(|k| if k < 2 * pairs { k ^ 1 } else { k }).collect();
            let random_square = |random: &mut _| Square::from_values(n, (0..n * n).map(|_| unit(random)).collect());
            let raw = random_square(&mut random);
            let size = random_square(&mut random);
            let area: Vec<f64> = (0..n).map(|k| 0.1 + size[(0, k.min(twin[k]))]).collect();
            let c = |i: usize, j: usize| {
                let (i2, j2) = (twin[i], twin[j]);
                raw[(i, j)] + raw[(j, i)] + raw[(i2, j2)] + raw[(j2, i2)]
            };
            let mut linkage = linkage(&area, |i, j| c(i, j) / 4.0);
            let touch = random_square(&mut random);
            let touching = |i: usize, j: usize| touch[(i, j)].max(touch[(j, i)]).max(touch[(twin[i], twin[j])]) > 0.8;
            if case % 2 == 0 {
                linkage.touching = Some((0..n * n).map(|k| touching(k / n, k % n)).collect());
            }
            let joins = twin_joins(linkage, twin.clone());
            assert_eq!(joins.len(), n - 1, "case {case}");
            let is_alike = |label: &Vec<usize>| {
                let same = |i: usize, j: usize| label[i] == label[j];
                (0..n).all(|i| (0..n).all(|j| same(i, j) == same(twin[i], twin[j])))
            };
            let alike: Vec<bool> = cuts(n, &joins).iter().map(is_alike).collect();
            assert!(alike.windows(2).all(|two| two[0] || two[1]) && alike[n - 2], "case {case}: {alike:?}");
        }
    }

    #[test]
    fn without_twins_the_joins_are_those_by_gain() {
        let (mut random, n) = (stream(4, "twins"), 9);
        let raw = Square::from_values(n, (0..n * n).map(|_| unit(&mut random)).collect());
        let one_sided = linkage(&[0.1; 9], |i, j| raw[(i.max(j), i.min(j))]);
        let all = twin_joins(one_sided.clone(), (0..n).collect());
        assert_eq!(all, one_sided.clone().joins(LinkageRank::Gain, 1));
        // The same by changes of one join each.
        let mut rest = one_sided;
        for join in all {
            let alive: Vec<usize> = (0..n).filter(|&k| rest.area[k] > 0.0).collect();
            let change = best_change(&rest, &(0..n).collect::<Vec<_>>(), &alive).unwrap();
            assert_eq!((change.first, change.second), ([join.i, join.j], None));
            rest.fold(join.i, join.j);
            rest.area[join.j] = 0.0;
        }
    }
}
