//! How a shuffle is cut to a share of the budget: how many buckets, how large their staging blocks.
//!
//! A bucket has to fit memory once for every copy that its consumers hold, and producers stage a block a bucket
//! each. Both shrink with the room there is, so that 64 MiB sort a billion records as well, in smaller
//! writes. Results never depend on it: consumers sort by total orders.

use super::shuffle::{BLOCK_BYTES, Shuffle};
use super::{Run, budget::Grant};
use crate::base::Result;
use bytemuck::Pod;
use std::path::Path;

/// Bytes of a bucket where there is room: what a core's cache holds.
const BUCKET_BYTES: u64 = 1 << 20;
/// Buckets at the most while buckets fit their room.
const MOST_BUCKETS: u64 = 512;
/// Bytes of the smallest staging block.
const LEAST_BLOCK: u64 = 256;

/// The shape of a shuffle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sizing {
    /// Buckets.
    pub buckets: usize,
    /// Bytes of a staging block.
    pub block: usize,
    /// Bytes staged by all producers.
    pub staging: u64,
    /// Bytes of the buckets in consumers' hands.
    pub reading: u64,
    /// Bytes of all records.
    pub bytes: u64,
}

impl Sizing {
    /// For `records` of `size` bytes, `threads` producers, and consumers that hold `copies` times a bucket's bytes in
    /// all, within `room` bytes where that is possible.
    pub fn new(records: u64, size: usize, copies: u64, threads: usize, room: u64) -> Self {
        let bytes = records.saturating_mul(size as u64);
        let fitting = (room / 2 / copies.max(1)).max(1 << 12);
        let buckets = match bytes.div_ceil(BUCKET_BYTES.min(fitting)).max(1) {
            many if many <= MOST_BUCKETS => many,
            _ => bytes.div_ceil(fitting).clamp(MOST_BUCKETS, 1 << 16),
        };
        let share = room / 2 / (threads.max(1) as u64 * buckets);
        let block = share.clamp(LEAST_BLOCK, BLOCK_BYTES as u64).max(size as u64);
        let staging = (threads as u64 * buckets * block).min(bytes + threads as u64 * block);
        Self {
            buckets: buckets as usize,
            block: block as usize,
            staging,
            reading: copies * bytes.div_ceil(buckets),
            bytes,
        }
    }

    /// Bytes needed besides the records that are kept in memory.
    pub fn fixed(&self) -> u64 {
        self.staging + self.reading
    }
}

/// A shuffle with what it takes from the budget; see [`Sizing`].
#[derive(Debug)]
pub struct Sized<T> {
    /// The shuffle.
    pub shuffle: Shuffle<T>,
    _grant: Grant,
}

impl<T: Pod + Send> Sized<T> {
    /// A shuffle of `records` records that spills to `path`, within the `part`-th part of what the budget has left.
    ///
    /// # Errors
    /// [`crate::base::Error::Memory`].
    pub fn new(path: &Path, what: &'static str, records: u64, copies: u64, part: u64, run: &Run) -> Result<Self> {
        let room = run.budget.left() / part.max(1);
        let sizing = Sizing::new(records, size_of::<T>(), copies, run.threads, room / 2);
        let fixed = sizing.fixed();
        let grant = run.budget.take(what, fixed, (fixed + sizing.bytes).min(room))?;
        let shuffle = Shuffle::with_block(path, sizing.buckets, sizing.block, grant.bytes() - fixed);
        Ok(Self { shuffle, _grant: grant })
    }
}

/// Bounds between buckets, from a sample of keys: buckets of about equal size whatever the keys' distribution.
#[derive(Clone, Debug)]
pub struct Splitters<K> {
    bounds: Vec<K>,
}

impl<K: Ord + Copy> Splitters<K> {
    /// Sampled keys a bucket.
    pub const SAMPLES: usize = 48;

    /// Bounds for `buckets` buckets by the quantiles of `sample`.
    pub fn new(mut sample: Vec<K>, buckets: usize) -> Self {
        sample.sort_unstable();
        let bounds = (1..buckets).filter_map(|b| sample.get(b * sample.len() / buckets).copied()).collect();
        Self { bounds }
    }

    /// The bucket of a key; ascends with the key.
    #[inline]
    pub fn bucket(&self, key: K) -> usize {
        self.bounds.partition_point(|bound| *bound <= key)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shuffle_fits_its_room_at_any_size() {
        for room in [16u64 << 20, 64 << 20, 1 << 30] {
            for records in [0u64, 1000, 1_000_000, 300_000_000] {
                let sizing = Sizing::new(records, 12, 10, 2, room);
                assert!(sizing.fixed() <= room + (1 << 20), "{sizing:?} in {room}");
            }
        }
    }

    #[test]
    fn splitters_balance_skewed_keys() {
        let keys: Vec<u64> = (0..10_000u64).map(|i| i * i * i).collect();
        let splitters = Splitters::new(keys.iter().copied().step_by(7).collect(), 10);
        let mut counts = [0; 10];
        for &key in &keys {
            counts[splitters.bucket(key)] += 1;
        }
        assert!(counts.iter().all(|&count| (900..1100).contains(&count)), "{counts:?}");
        assert_eq!(Splitters::<u32>::new(vec![], 4).bucket(7), 0);
    }
}
