//! How often pairs of numbers occur: parts against cells, labels against labels; weights of a few numbers.
//!
//! Neighbours in mesh order mostly have the same pair, so runs of equal pairs are counted before the map is updated.
//! Cost: one comparison per pair, one look-up per run.

use std::collections::BTreeMap;
use std::ops::AddAssign;

/// Adds `weight` to that of `number` in a list of different numbers with their weights, which is searched from the
/// start: for lists of a few, in the order of their first appearance.
#[inline]
pub fn add_weight<T: AddAssign>(list: &mut Vec<(u32, T)>, number: u32, weight: T) {
    match list.iter_mut().find(|entry| entry.0 == number) {
        Some((_, sum)) => *sum += weight,
        None => list.push((number, weight)),
    }
}

/// How often each of `pairs` occurs.
///
/// ```
/// use nystrom_stream::base::tally::tally;
/// let counts = tally([(0, 7), (0, 7), (1, 7), (0, 7)]);
/// assert_eq!(counts.into_iter().collect::<Vec<_>>(), [((0, 7), 3), ((1, 7), 1)]);
/// ```
pub fn tally(pairs: impl IntoIterator<Item = (u32, u32)>) -> BTreeMap<(u32, u32), u64> {
    let mut counts: BTreeMap<(u32, u32), u64> = BTreeMap::new();
    let mut run: Option<((u32, u32), u64)> = None;
    for pair in pairs {
        match &mut run {
            Some((last, count)) if *last == pair => *count += 1,
            _ => {
                if let Some((last, count)) = run.replace((pair, 1)) {
                    *counts.entry(last).or_default() += count;
                }
            }
        }
    }
    if let Some((last, count)) = run {
        *counts.entry(last).or_default() += count;
    }
    counts
}
