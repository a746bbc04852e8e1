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

/// A uniform number below `n` (0 where `n` is 0); the bias is below `n / 2^64`.
pub fn below(random: &mut Random, n: usize) -> usize {
    ((u128::from(random.next_u64()) * n as u128) >> 64) as usize
}
