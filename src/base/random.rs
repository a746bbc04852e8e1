//! Seeded randomness that stays the same across versions and machines.
//!
//! All random numbers of the library come from [`stream`], keyed by purpose: an extra draw in one place never shifts
//! those of another.

use libm::log as ln;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use xxhash_rust::xxh3::xxh3_64_with_seed;

/// The generator in use.
pub type Random = Xoshiro256PlusPlus;

/// The generator for one purpose under the user's seed.
pub fn stream(seed: u64, purpose: &str) -> Random {
    Random::seed_from_u64(xxh3_64_with_seed(purpose.as_bytes(), seed))
}

/// A uniform number in `[0, 1)` with 53 bits.
pub fn unit(random: &mut Random) -> f64 {
    (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64
}

/// An item drawn in proportion to its weight; `sums` are the running sums of the weights. 0 where all weights are 0.
pub fn weighted(sums: &[f64], random: &mut Random) -> usize {
    let target = unit(random) * sums.last().copied().unwrap_or(0.);
    let found = sums.partition_point(|&sum| sum <= target);
    if found < sums.len() { found } else { 0 }
}

/// An item drawn with probability proportional to its weight, 0 where all weights are 0. Each item finishes a race at
/// −ln u / weight and the first one wins. Its u is a hash of `key` and its name, so small changes of weights, and items
/// added or removed, seldom change the winner. With running sums ([`weighted`]) a small change early in the list shifts
/// every later draw.
#[inline]
pub fn weighted_by_key(key: u64, items: impl Iterator<Item = (u64, f64)>) -> usize {
    let (mut least, mut winner) = (f64::INFINITY, 0);
    for (item, (name, weight)) in items.enumerate() {
        let u = ((splitmix_step(name ^ key) >> 11) as f64 + 0.5) / (1u64 << 53) as f64;
        // −ln u is at least 1 − u, so most logarithms can be skipped.
        if 1. - u < least * weight {
            let end = -ln(u);
            if end < least * weight {
                (least, winner) = (end / weight, item);
            }
        }
    }
    winner
}

/// A pseudo-random number computed from `x` alone: a step of SplitMix64 (Steele, Lea, Flood 2014).
pub fn splitmix_step(x: u64) -> u64 {
    splitmix_finalise(x.wrapping_add(0x9E37_79B9_7F4A_7C15))
}

/// Mixes 64 bits (the finaliser of SplitMix64).
#[inline]
pub fn splitmix_finalise(x: u64) -> u64 {
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// A stratified draw: one random point in each of `count` equal shares of `total`, the sum of `weights`. Returns the
/// items that points fall into, ascending, and the number of points in each. One pass.
pub fn stratified(
    weights: impl Iterator<Item = f64>,
    total: f64,
    count: usize,
    random: &mut Random,
) -> Vec<(u32, u32)> {
    let quantum = total / count as f64;
    let mut out = Vec::with_capacity(count);
    let (mut sum, mut points) = (0f64, 0usize);
    let mut target = unit(random) * quantum;
    for (item, weight) in weights.enumerate() {
        sum += weight;
        let mut hits = 0;
        while points < count && target < sum {
            hits += 1;
            points += 1;
            target = (points as f64 + unit(random)) * quantum;
        }
        if hits > 0 {
            out.push((item as u32, hits));
        }
    }
    out
}

/// A uniform number below `n` (0 where `n` is 0); the bias is below `n / 2^64`.
pub fn below(random: &mut Random, n: usize) -> usize {
    ((u128::from(random.next_u64()) * n as u128) >> 64) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn races_are_won_in_proportion_to_weight_and_small_changes_leave_their_winners() {
        let weights: Vec<f64> = (0..200).map(|i| f64::from(i % 4)).collect();
        let race = |key, skipped: usize, scale: f64| {
            let items = weights.iter().enumerate().filter(|(i, _)| *i != skipped);
            let items: Vec<(u64, f64)> = items.map(|(i, w)| (i as u64, w * if i == 7 { scale } else { 1. })).collect();
            items[weighted_by_key(key, items.iter().copied())].0
        };
        let mut wins = [0; 4];
        let (mut moved, mut lost) = (0, 0);
        for key in 0..6_000 {
            let winner = race(splitmix_step(key), usize::MAX, 1.);
            wins[winner as usize % 4] += 1;
            moved += usize::from(race(splitmix_step(key), usize::MAX, 1.5) != winner);
            lost += usize::from(race(splitmix_step(key), 0, 1.) != winner);
        }
        assert!(wins[0] == 0 && [1, 2, 3].iter().all(|&w| (wins[w] - 1_000 * w as i32).abs() < 150), "{wins:?}");
        assert!(moved < 60 && lost == 0, "{moved} of 6,000 winners moved with one weight, {lost} with an item of none");
        assert_eq!(weighted_by_key(1, [(0, 0.), (1, 0.)].into_iter()), 0);
    }
}
