//! Labellings of cells, and operations on them: numbering by first appearance, intersections, sums over classes,
//! connected pieces, and the joining of pieces that are too small.
//!
//! A labelling has one number per cell, its class. Labels of superfaces are treated alike. For S cells and m pairs of
//! neighbours: S log S or S + m log m steps each.

use crate::base::sort::sort_by;
use crate::base::tally::add_weight;
use crate::base::union_find::Forest;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

/// Connected pieces of the classes of a labelling, numbered by first appearance, and their number.
pub fn connected_pieces(pairs: &[[u32; 2]], label: &[u32]) -> (Vec<u32>, usize) {
    let mut sets = Forest::new(label.len());
    for &[i, j] in pairs {
        if label[i as usize] == label[j as usize] {
            sets.join(i, j);
        }
    }
    compact(&sets.labels())
}

/// Splits each class of `label` (S), of which there are `parts`, that was joined since the labels were `before` (S):
/// into its connected pieces, and these into the earlier classes that mostly became part of it. Classes with the same
/// cells as before stay whole. The first piece of a class keeps its number, further ones are numbered after the last.
/// Also returns the class of each of the further pieces.
pub fn joined_pieces(pairs: &[[u32; 2]], label: &[u32], before: &[u32], parts: usize) -> (Vec<u32>, Vec<u32>) {
    let mut shared: BTreeMap<(u32, u32), usize> = BTreeMap::new();
    before.iter().zip(label).for_each(|(&then, &now)| *shared.entry((then, now)).or_default() += 1);
    let (mut were, mut are) = (BTreeMap::<u32, usize>::new(), BTreeMap::<u32, usize>::new());
    for (&(then, now), &cells) in &shared {
        *were.entry(then).or_default() += cells;
        *are.entry(now).or_default() += cells;
    }
    let mostly = |i: usize| 2 * shared[&(before[i], label[i])] > were[&before[i]];
    let same = |i: usize| [were[&before[i]], are[&label[i]]].iter().all(|all| shared[&(before[i], label[i])] == *all);
    let mut sets = Forest::new(label.len());
    for &[i, j] in pairs {
        let (a, b) = (i as usize, j as usize);
        if label[a] == label[b] && (before[a] == before[b] || !mostly(a) || !mostly(b)) {
            sets.join(i, j);
        }
    }
    let (piece, count) = compact(&sets.labels());
    let (mut number, mut first, mut further) = (vec![None; count], vec![true; parts], Vec::new());
    let numbered = piece.iter().zip(label).enumerate().map(|(i, (&piece, &class))| {
        *number[piece as usize].get_or_insert_with(|| {
            if std::mem::replace(&mut first[class as usize], false) || same(i) {
                return class;
            }
            further.push(class);
            (parts + further.len() - 1) as u32
        })
    });
    (numbered.collect(), further)
}

/// Joins classes from `lowest` on with less than `limit` of the area, smallest first, to the neighbour with which they
/// share the longest boundary; those without neighbours stay.
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
    let mut boundaries: Vec<(u32, u32, f64)> = Vec::new();
    for (&[i, j], &len) in pairs.iter().zip(length) {
        let (a, b) = (label[i as usize], label[j as usize]);
        if a != b {
            boundaries.push((a.min(b), a.max(b), len));
        }
    }
    sort_by(&mut boundaries, |a, b| (a.0, a.1).cmp(&(b.0, b.1)));
    boundaries.dedup_by(|next, first| {
        let same = (next.0, next.1) == (first.0, first.1);
        if same {
            first.2 += next.2;
        }
        same
    });
    // The boundaries of each class, by number; those of a class that joined another are also the other's.
    let mut bounds: Vec<Vec<u32>> = vec![Vec::new(); n];
    for (at, &(a, b, _)) in (0..).zip(&boundaries) {
        bounds[a as usize].push(at);
        bounds[b as usize].push(at);
    }
    let mut into: Vec<u32> = (0..n as u32).collect();
    // The class that `k` is part of now.
    let now = |into: &mut Vec<u32>, mut k: u32| {
        while into[k as usize] != k {
            into[k as usize] = into[into[k as usize] as usize];
            k = into[k as usize];
        }
        k as usize
    };
    // Open classes have positive sizes, so their bits are in the order of the sizes. A class whose size has changed
    // since comes a second time.
    let entry = |size: f64, k: usize| Reverse((size.to_bits(), k));
    let mut smallest: BinaryHeap<_> = (0..n).filter(|&k| open[k]).map(|k| entry(size[k], k)).collect();
    let mut shared = vec![0.0; n];
    while let Some(Reverse((bits, q))) = smallest.pop() {
        if !open[q] || size[q].to_bits() != bits {
            continue;
        }
        open[q] = false;
        let mut own = std::mem::take(&mut bounds[q]);
        // Sums in one order, whatever joined before.
        own.sort_unstable();
        let mut others = Vec::with_capacity(own.len());
        own.retain(|&at| {
            let (a, b, len) = boundaries[at as usize];
            let (a, b) = (now(&mut into, a), now(&mut into, b));
            let other = if a == q { b } else { a };
            if a != b {
                shared[other] += len;
                others.push(other);
            }
            a != b
        });
        let longest = others.iter().copied().max_by(|&a, &b| shared[a].total_cmp(&shared[b]).then(b.cmp(&a)));
        let to = longest.filter(|&k| shared[k] > 0.0);
        others.iter().for_each(|&k| shared[k] = 0.0);
        let Some(to) = to else {
            bounds[q] = own;
            continue;
        };
        size[to] += size[q];
        open[to] = open[to] && size[to] < limit;
        if open[to] {
            smallest.push(entry(size[to], to));
        }
        if bounds[to].len() < own.len() {
            std::mem::swap(&mut bounds[to], &mut own);
        }
        bounds[to].extend(own);
        into[q] = to as u32;
    }
    compact(&label.iter().map(|&k| now(&mut into, k) as u32).collect::<Vec<_>>())
}

/// Renumbers labels 0, 1, … in order of first appearance; also returns their number.
pub fn compact(label: &[u32]) -> (Vec<u32>, usize) {
    let mut number = vec![u32::MAX; label.iter().max().map_or(0, |&m| m as usize + 1)];
    let mut next = 0;
    let out = label
        .iter()
        .map(|&x| {
            let slot = &mut number[x as usize];
            if *slot == u32::MAX {
                *slot = next;
                next += 1;
            }
            *slot
        })
        .collect();
    (out, next as usize)
}

/// The intersections of two labellings of the same items, numbered by first appearance.
pub fn intersect(a: &[u32], b: &[u32]) -> (Vec<u32>, usize) {
    let mut order: Vec<(u32, u32, u32)> = a.iter().zip(b).zip(0u32..).map(|((&a, &b), i)| (a, b, i)).collect();
    order.sort_unstable();
    let mut label = vec![0; a.len()];
    for w in 0..order.len() {
        let same = w > 0 && (order[w].0, order[w].1) == (order[w - 1].0, order[w - 1].1);
        label[order[w].2 as usize] = if same { label[order[w - 1].2 as usize] } else { order[w].2 };
    }
    compact(&label)
}

/// Sum of `value` over each of `n` classes, in order.
pub fn class_sums(label: &[u32], value: &[f64], n: usize) -> Vec<f64> {
    let mut sum = vec![0.0; n];
    for (&k, v) in label.iter().zip(value) {
        sum[k as usize] += v;
    }
    sum
}

/// For each of `count` groups, `group` (n), the label of most of its area, the least of equal ones; `label` and `area`
/// (n) are those of the members.
pub fn majorities(group: &[u32], count: usize, label: &[u32], area: &[f64]) -> Vec<u32> {
    let mut sums: Vec<Vec<(u32, f64)>> = vec![Vec::new(); count];
    for ((&x, &label), area) in group.iter().zip(label).zip(area) {
        add_weight(&mut sums[x as usize], label, *area);
    }
    let most = |sums: &Vec<(u32, f64)>| sums.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)));
    sums.iter().map(|sums| most(sums).map_or(0, |(label, _)| label)).collect()
}

/// Pieces below this share of the area join the neighbour with the longest common boundary.
pub const SMALL_PART: f64 = 0.003;

/// Joins connected pieces with less than `limit` of the area to their neighbours, smallest first.
///
/// `label` is the part of each cell, `shares` its area share. With `whole_too`, parts that are small as a whole are
/// joined as well; without it, the largest piece of every part stays, and so does the number of parts. Returns labels
/// numbered by first appearance, and their number.
pub fn small_parts(
    pairs: &[[u32; 2]],
    length: &[f64],
    shares: &[f64],
    label: &[u32],
    limit: f64,
    whole_too: bool,
) -> (Vec<u32>, usize) {
    let (label, parts) = compact(label);
    let (piece, pieces) = connected_pieces(pairs, &label);
    let area = class_sums(&piece, shares, pieces);
    let mut part = vec![0u32; pieces];
    for (&p, &k) in piece.iter().zip(&label) {
        part[p as usize] = k;
    }
    let mut largest = vec![usize::MAX; parts];
    for (p, &k) in part.iter().enumerate() {
        let best = &mut largest[k as usize];
        if *best == usize::MAX || area[p] > area[*best] {
            *best = p;
        }
    }
    // Loose small pieces become classes of their own, numbered after the parts.
    let loose: Vec<bool> = (0..pieces).map(|p| area[p] < limit && largest[part[p] as usize] != p).collect();
    let apart: Vec<u32> =
        piece.iter().zip(&label).map(|(&p, &k)| if loose[p as usize] { parts as u32 + p } else { k }).collect();
    let (mut joined, classes) = join_small(pairs, length, shares, &apart, limit, if whole_too { 0 } else { parts });
    // Pieces without an adjacent part, on components of their own, return to the part that they came from: no class may
    // consist of loose pieces alone.
    let mut firm = vec![false; classes];
    let mut of_piece = vec![0u32; pieces];
    for (&k, &p) in joined.iter().zip(&piece) {
        firm[k as usize] |= !loose[p as usize];
        of_piece[p as usize] = k;
    }
    for (k, &p) in joined.iter_mut().zip(&piece).filter(|(k, _)| !firm[**k as usize]) {
        *k = of_piece[largest[part[p as usize] as usize]];
    }
    compact(&joined)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{below, stream};

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
    fn classes_fall_into_the_pieces_that_they_were_joined_of() {
        let pairs = strip(6).0;
        let label = [0, 1, 1, 0, 0, 1];
        assert_eq!(joined_pieces(&pairs, &label, &label, 2), (label.to_vec(), vec![]));
        // 0 lost its first cell to 1, whose last cell was a class of its own.
        let now = [1, 1, 1, 0, 0, 1];
        assert_eq!(joined_pieces(&pairs, &now, &[0, 1, 1, 0, 0, 2], 2), (vec![1, 1, 1, 0, 0, 2], vec![1]));
        // The first two cells were a class, all of which joined 1.
        assert_eq!(joined_pieces(&pairs, &now, &[2, 2, 1, 0, 0, 3], 2), (vec![1, 1, 2, 0, 0, 3], vec![1, 1]));
        // Renumbered classes are the same classes.
        assert_eq!(joined_pieces(&pairs, &label, &[1, 0, 0, 1, 1, 0], 2), (label.to_vec(), vec![]));
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

    /// [`join_small`] by its definition: S + m steps for each class that joins.
    fn join_small_slowly(
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
        let mut boundaries: BTreeMap<(u32, u32), f64> = BTreeMap::new();
        for (&[i, j], &len) in pairs.iter().zip(length) {
            let (a, b) = (label[i as usize], label[j as usize]);
            if a != b {
                *boundaries.entry((a.min(b), a.max(b))).or_default() += len;
            }
        }
        let mut boundaries: Vec<(u32, u32, f64)> = boundaries.into_iter().map(|((a, b), len)| (a, b, len)).collect();
        let mut into: Vec<u32> = (0..n as u32).collect();
        let mut shared = vec![0.0; n];
        while let Some(q) = (0..n).filter(|&k| open[k]).min_by(|&a, &b| size[a].total_cmp(&size[b])) {
            shared.fill(0.0);
            for &(a, b, len) in &boundaries {
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
            for r in &mut boundaries {
                let name = |k: u32| if k as usize == q { to as u32 } else { k };
                (r.0, r.1) = (name(r.0), name(r.1));
            }
            boundaries.retain(|r| r.0 != r.1);
        }
        compact(&label.iter().map(|&k| into[k as usize]).collect::<Vec<_>>())
    }

    /// Regression: joining took S + m steps per class that joined, most of the time of cuts into hundreds of parts.
    #[test]
    fn joining_is_that_of_the_slow_way_to_the_bit() {
        for seed in 0..400 {
            let mut random = stream(seed, "joining");
            let n = 2 + below(&mut random, 60);
            let mut draw = |m: usize| below(&mut random, m);
            let pairs: Vec<[u32; 2]> = (0..3 * n).map(|_| [draw(n) as u32, draw(n) as u32]).collect();
            // Few values, so that many sums tie; in one case of four also ones that no surface has.
            let odd = [0., -1., f64::NAN, f64::INFINITY];
            let mut value = |of: usize| match draw(of) {
                k if k < 4 && seed % 4 == 0 => odd[k],
                k => 0.1 * (1 + k % 7) as f64,
            };
            let length: Vec<f64> = pairs.iter().map(|_| value(60)).collect();
            let area: Vec<f64> = (0..n).map(|_| value(60)).collect();
            let classes = 1 + draw(n);
            let label = compact(&(0..n).map(|_| draw(classes) as u32).collect::<Vec<_>>()).0;
            for limit in [0.15, 0.4, 1., 3.] {
                for lowest in [0, 1 + draw(n)] {
                    let [fast, slow] =
                        [join_small, join_small_slowly].map(|join| join(&pairs, &length, &area, &label, limit, lowest));
                    assert_eq!(fast, slow, "{seed}, {limit}, {lowest}");
                }
            }
        }
    }

    #[test]
    fn intersections_are_numbered_by_first_appearance() {
        assert_eq!(intersect(&[3, 3, 1, 1, 3], &[0, 1, 1, 1, 0]), (vec![0, 1, 2, 2, 0], 3));
    }

    #[test]
    fn islands_join_and_the_number_asked_for_stays() {
        let pairs: Vec<[u32; 2]> = (1..10u32).map(|i| [i - 1, i]).collect();
        let label = [0, 0, 0, 1, 0, 0, 2, 2, 2, 3];
        let all = small_parts(&pairs, &[1.0; 9], &[0.1; 10], &label, 0.15, true);
        assert_eq!(all.1, 2);
        let kept = small_parts(&pairs, &[1.0; 9], &[0.1; 10], &label, 0.15, false);
        assert_eq!(kept, (vec![0, 0, 0, 1, 0, 0, 2, 2, 2, 3], 4));
        let loose = [0, 0, 0, 1, 0, 1, 1, 1, 2, 2];
        let kept = small_parts(&pairs, &[1.0; 9], &[0.1; 10], &loose, 0.15, false);
        assert_eq!(kept.1, 3);
        assert_eq!(kept.0[3], 0);
        // Two loose cells on a component of their own return to their parts.
        let mut pairs = pairs;
        pairs.retain(|p| *p != [7, 8]);
        let torn = [0, 0, 0, 0, 1, 1, 1, 1, 0, 1];
        for whole_too in [false, true] {
            let kept = small_parts(&pairs, &[1.0; 8], &[0.1; 10], &torn, 0.15, whole_too);
            assert_eq!(kept, (torn.to_vec(), 2));
        }
    }
}
