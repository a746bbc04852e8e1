//! How often pairs of numbers occur: parts against cells, labels against labels.
//!
//! Neighbours in mesh order mostly have the same pair, so runs of equal pairs are counted before the map is updated.
//! Cost: one comparison per pair, one look-up per run.

use std::collections::BTreeMap;

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
