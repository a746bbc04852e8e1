//! Sorts for lists that are short compared with a mesh: candidates, parts, cells, eigenvalues.
//!
//! The standard library compiles a sort for each element type and each comparison, two thousand lines of LLVM IR each
//! time; sixty of them were a twentieth of the library's build time. Here only one sort is compiled. It sorts indices,
//! with a comparison called through a pointer; the elements are then swapped into place.
//!
//! Cost: one indirect call per comparison, and 8 bytes of memory per element. Lists of millions use the standard
//! library's sorts.

use std::cmp::Ordering;
use std::collections::BTreeMap;

/// Sorts `items` by `compare`. Equal items keep their order.
pub fn sort_by<T>(items: &mut [T], compare: impl Fn(&T, &T) -> Ordering) {
    let order = order_by(items.len(), |i, j| compare(&items[i], &items[j]));
    arrange(order, &mut |i, j| items.swap(i, j));
}

/// The numbers 0 to `n` − 1, sorted by `compare`. Equal numbers ascend.
pub fn order_by(n: usize, compare: impl Fn(usize, usize) -> Ordering) -> Vec<usize> {
    ordered(n, &compare)
}

/// The order of arrays of numbers, always inlined: the standard library compares arrays as slices, with a call for each
/// comparison.
#[inline(always)]
pub fn lexicographic<const N: usize>(a: &[u32; N], b: &[u32; N]) -> Ordering {
    for k in 0..N {
        if a[k] != b[k] {
            return a[k].cmp(&b[k]);
        }
    }
    Ordering::Equal
}

fn ordered(n: usize, compare: &dyn Fn(usize, usize) -> Ordering) -> Vec<usize> {
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|&i, &j| compare(i, j));
    order
}

/// A map of `pairs`; of equal keys the last one counts. Collecting into a map would sort the pairs first, with another
/// compiled sort; this inserts them one by one.
pub fn map_of<K: Ord, V>(pairs: impl IntoIterator<Item = (K, V)>) -> BTreeMap<K, V> {
    let mut map = BTreeMap::new();
    map.extend(pairs);
    map
}

/// Moves item `order[k]` to position k, for all k, by swaps along the cycles of `order`.
pub(super) fn arrange(mut order: Vec<usize>, swap: &mut dyn FnMut(usize, usize)) {
    for start in 0..order.len() {
        let mut at = start;
        while order[at] != start {
            let from = std::mem::replace(&mut order[at], at);
            swap(at, from);
            at = from;
        }
        order[at] = at;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn items_are_where_the_standard_library_puts_them() {
        for n in [0, 1, 2, 3, 10, 100, 1000] {
            let mut items: Vec<(u64, usize)> = (0..n).map(|i| (i as u64 * 7919 % 17, i)).collect();
            let mut expected = items.clone();
            expected.sort_by_key(|item| item.0);
            let order = order_by(n, |i, j| items[i].0.cmp(&items[j].0));
            assert_eq!(order, expected.iter().map(|item| item.1).collect::<Vec<_>>());
            sort_by(&mut items, |a, b| a.0.cmp(&b.0));
            assert_eq!(items, expected);
        }
    }
}
