//! Seeds spread over the surface: one per equal quantum of area along the order of the nodes.
//!
//! As good as farthest points for cells (measured), at the price of one pass. A node that several quanta fall
//! into is taken once.

use crate::base::random::{stream, unit};

/// About `count` nodes, ascending: node `i` may be taken where `share[i] > 0`. All such nodes where they are no
/// more than `count`.
pub fn spread(share: &[f32], count: usize, seed: u64, purpose: &str) -> Vec<u32> {
    let eligible = share.iter().filter(|s| **s > 0.).count();
    if eligible <= count {
        return (0..share.len() as u32).filter(|&i| share[i as usize] > 0.).collect();
    }
    let total: f64 = share.iter().map(|&s| f64::from(s)).sum();
    let quantum = total / count as f64;
    let mut draw = stream(seed, purpose);
    let mut seeds = Vec::with_capacity(count);
    let (mut sum, mut k) = (0f64, 0usize);
    let mut target = unit(&mut draw) * quantum;
    for (node, &s) in share.iter().enumerate() {
        sum += f64::from(s);
        if k < count && target < sum {
            seeds.push(node as u32);
            while k < count && target < sum {
                k += 1;
                target = (k as f64 + unit(&mut draw)) * quantum;
            }
        }
    }
    seeds
}

#[cfg(test)]
mod tests {
    use super::spread;

    #[test]
    fn seeds_follow_the_area_and_avoid_what_counts_nothing() {
        let share: Vec<f32> = (0..10_000).map(|i| if i % 2 == 0 { 1e-4 } else { 0. }).collect();
        let seeds = spread(&share, 100, 1, "test");
        assert_eq!(seeds.len(), 100);
        assert!(seeds.iter().all(|s| s % 2 == 0) && seeds.is_sorted());
        for (k, &s) in seeds.iter().enumerate() {
            assert!((s as usize).abs_diff(k * 100) <= 101, "one in each quantum");
        }
        assert_eq!(spread(&share[..20], 100, 1, "test").len(), 10);
    }
}
