//! Seeded randomness that stays the same across versions and machines.
//!
//! Everything random in the library draws from [`stream`], named by purpose: adding a draw in
//! one place never shifts those of another.

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

/// A stratified draw: a point at random in each of `count` equal shares of `total`, the sum of `weights`. Gives the items
/// that points fall into, ascending, and how many points fall into each. One pass.
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
