//! A shuffle: fixed-size records scattered by key into buckets, in memory up to a limit, the rest in one file of the
//! work directory.
//!
//! This is the external sort of the program. Producers on several threads push records with a bucket number; later each
//! bucket, small enough for memory, is read as a whole, sorted by its consumer and passed on. Buckets cover ascending
//! key ranges, so concatenating the sorted buckets gives the sorted whole.
//!
//! Memory: the limit, plus a staging block of at most [`BLOCK_BYTES`] for each bucket and producer, plus the buckets
//! being read; [`Sizing`] fits all of that into a share of the budget. A bucket must fit memory once for every copy
//! that its consumers hold. Buckets and staging blocks shrink with the available room, so 64 MiB are enough to sort a
//! billion records, with smaller writes. Disk: what does not fit, written once in large blocks, read once.
//!
//! The order of records inside a bucket depends on timing; a consumer that needs repeatable results sorts by a total
//! order (tested against an in-memory sort). Then results depend neither on the budget nor on the threads.

use super::Run;
use super::budget::Grant;
pub use super::folder::DeferredFile;
use super::new_file;
use crate::base::parallel::lock;
use crate::base::sort::lexicographic;
use crate::base::{Error, Result};
use bytemuck::Pod;
use std::fs::File;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, OnceLock};

/// Bytes that a producer gathers before they go to a bucket.
pub const BLOCK_BYTES: usize = 1 << 14;
/// Bytes of a bucket where there is room: what fits a core's cache.
const BUCKET_BYTES: u64 = 1 << 20;
/// Maximum number of buckets, as long as buckets of this number fit the room.
const MOST_BUCKETS: u64 = 512;
/// Bytes of the smallest staging block.
const LEAST_BLOCK: u64 = 256;

/// Records of type `T` on their way into buckets.
#[derive(Debug)]
pub struct Shuffle<T> {
    place: DeferredFile,
    /// The spill file and its path.
    file: OnceLock<(PathBuf, File)>,
    end: AtomicU64,
    buckets: Vec<Mutex<Bucket<T>>>,
    held: AtomicU64,
    limit: u64,
    /// Records per staging block.
    block: usize,
    /// Serialises the creation of the file.
    creation: Mutex<()>,
}

#[derive(Debug)]
struct Bucket<T> {
    blocks: Vec<Vec<T>>,
    extents: Vec<(u64, usize)>,
    records: usize,
}

impl<T: Copy> Bucket<T> {
    /// Keeps `block`. Producers may hand over blocks that are hardly filled, with room for more: the last one is filled
    /// up first, so that the memory of a bucket is that of its records and of at most one block.
    fn keep(&mut self, mut block: Vec<T>) {
        let room = |block: &Vec<T>| block.capacity() - block.len();
        self.records += block.len();
        match self.blocks.last_mut() {
            Some(last) if room(last) > 0 && room(&block) > 0 => {
                let fitting = block.len().min(room(last));
                last.extend(block.drain(..fitting));
                if !block.is_empty() {
                    self.blocks.push(block);
                }
            }
            Some(last) if room(last) > 0 => self.blocks.insert(self.blocks.len() - 1, block),
            _ => self.blocks.push(block),
        }
    }
}

/// One producer's staging blocks.
#[derive(Debug)]
pub struct Producer<'a, T: Pod> {
    shuffle: &'a Shuffle<T>,
    staged: Vec<Vec<T>>,
}

impl<T: Pod + Send> Shuffle<T> {
    /// A shuffle into `buckets` buckets, with staging blocks of `block` bytes, that keeps up to `limit` bytes in memory
    /// and writes the rest to the file `place`.
    pub fn new(place: DeferredFile, buckets: usize, block: usize, limit: u64) -> Self {
        let bucket = || Mutex::new(Bucket { blocks: Vec::new(), extents: Vec::new(), records: 0 });
        Self {
            place,
            file: OnceLock::new(),
            end: AtomicU64::new(0),
            buckets: (0..buckets.max(1)).map(|_| bucket()).collect(),
            held: AtomicU64::new(0),
            limit,
            block: (block / size_of::<T>()).max(1),
            creation: Mutex::new(()),
        }
    }

    /// Number of buckets.
    pub fn buckets(&self) -> usize {
        self.buckets.len()
    }

    /// Records in all buckets.
    pub fn len(&self) -> u64 {
        (0..self.buckets.len()).map(|b| self.lock(b).records as u64).sum()
    }

    /// Whether no record was pushed.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// A producer; one per thread. Call [`Producer::finish`] at its end.
    pub fn producer(&self) -> Producer<'_, T> {
        Producer { shuffle: self, staged: (0..self.buckets.len()).map(|_| Vec::new()).collect() }
    }

    fn lock(&self, bucket: usize) -> MutexGuard<'_, Bucket<T>> {
        lock(&self.buckets[bucket])
    }

    /// The spill file, created at first use.
    fn spill_file(&self) -> Result<&(PathBuf, File)> {
        if let Some(file) = self.file.get() {
            return Ok(file);
        }
        let _guard = lock(&self.creation);
        if self.file.get().is_none() {
            let path = self.place.path()?;
            let file = new_file::create(&path)?;
            let _ = self.file.set((path, file));
        }
        Ok(self.file.get_or_init(|| unreachable!("set above under the lock")))
    }

    fn accept(&self, bucket: usize, block: Vec<T>) -> Result<()> {
        use std::os::unix::fs::FileExt;
        let bytes = size_of_val(&block[..]) as u64;
        if self.held.fetch_add(bytes, Ordering::Relaxed) + bytes <= self.limit {
            self.lock(bucket).keep(block);
            return Ok(());
        }
        self.held.fetch_sub(bytes, Ordering::Relaxed);
        let (path, file) = self.spill_file()?;
        let offset = self.end.fetch_add(bytes, Ordering::Relaxed);
        file.write_all_at(bytemuck::cast_slice(&block), offset).map_err(Error::io(path, "write"))?;
        let mut bucket = self.lock(bucket);
        bucket.records += block.len();
        match bucket.extents.last_mut() {
            Some((start, len)) if *start + (*len * size_of::<T>()) as u64 == offset => *len += block.len(),
            _ => bucket.extents.push((offset, block.len())),
        }
        Ok(())
    }

    /// Removes and returns all records of a bucket, in no particular order.
    ///
    /// # Errors
    /// [`Error::Io`] when the spill file cannot be read.
    pub fn take(&self, bucket: usize) -> Result<Vec<T>> {
        use std::os::unix::fs::FileExt;
        let (blocks, extents, records) = {
            let mut bucket = self.lock(bucket);
            (std::mem::take(&mut bucket.blocks), std::mem::take(&mut bucket.extents), bucket.records)
        };
        let mut all = Vec::with_capacity(records);
        for block in blocks {
            self.held.fetch_sub(size_of_val(&block[..]) as u64, Ordering::Relaxed);
            all.extend_from_slice(&block);
        }
        for (offset, len) in extents {
            let start = all.len();
            all.resize(start + len, T::zeroed());
            let (path, file) = self.spill_file()?;
            file.read_exact_at(bytemuck::cast_slice_mut(&mut all[start..]), offset).map_err(Error::io(path, "read"))?;
        }
        Ok(all)
    }
}

impl<const W: usize> Shuffle<[u32; W]>
where
    [u32; W]: Pod,
{
    /// Takes and sorts every bucket, on the run's threads, and passes the records to `each` bucket by bucket in order;
    /// at most `4 * threads` sorted buckets wait at a time.
    ///
    /// # Errors
    /// Those of `each`; [`Error::Io`], [`Error::Cancelled`].
    pub fn sorted(&self, run: &Run, mut each: impl FnMut(Vec<[u32; W]>) -> Result<()>) -> Result<()> {
        let take = |bucket, (): &mut ()| {
            let mut records = self.take(bucket)?;
            records.sort_unstable_by(lexicographic);
            Ok(records)
        };
        run.in_order(self.buckets(), || (), take, |_, records| each(records))
    }
}

impl<T> Drop for Shuffle<T> {
    fn drop(&mut self) {
        if let Some((path, _)) = self.file.get() {
            let _ = std::fs::remove_file(path);
        }
    }
}

impl<T: Pod + Send> Producer<'_, T> {
    /// Adds a record to a bucket.
    ///
    /// # Errors
    /// [`Error::Io`] when it has to be spilled and that fails.
    #[inline]
    pub fn push(&mut self, bucket: usize, record: T) -> Result<()> {
        let block = self.shuffle.block;
        let staged = &mut self.staged[bucket];
        if staged.capacity() == 0 {
            staged.reserve_exact(block);
        }
        staged.push(record);
        if staged.len() >= block {
            let full = std::mem::take(staged);
            return self.shuffle.accept(bucket, full);
        }
        Ok(())
    }

    /// Flushes the staging blocks.
    ///
    /// # Errors
    /// As [`Producer::push`].
    pub fn finish(mut self) -> Result<()> {
        for (bucket, staged) in std::mem::take(&mut self.staged).into_iter().enumerate() {
            if !staged.is_empty() {
                self.shuffle.accept(bucket, staged)?;
            }
        }
        Ok(())
    }
}

/// The dimensions of a shuffle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sizing {
    /// Number of buckets.
    pub buckets: usize,
    /// Bytes of a staging block.
    pub block: usize,
    /// Bytes staged by all producers.
    pub staging: u64,
    /// Bytes of the buckets that consumers hold.
    pub reading: u64,
    /// Bytes of all records.
    pub bytes: u64,
}

impl Sizing {
    /// For `records` of `size` bytes, `threads` producers, and consumers that hold `copies` times a bucket's bytes in
    /// all; fits `room` bytes where that is possible.
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

    /// Bytes needed besides the records kept in memory.
    pub fn fixed(&self) -> u64 {
        self.staging + self.reading
    }
}

/// A shuffle with its grant from the budget; see [`Sizing`].
#[derive(Debug)]
pub struct BudgetedShuffle<T> {
    /// The shuffle.
    pub shuffle: Shuffle<T>,
    _grant: Grant,
}

impl<T: Pod + Send> BudgetedShuffle<T> {
    /// A shuffle of `records` records that spills to `place`, within one `part`-th of what the budget has left.
    ///
    /// # Errors
    /// [`crate::base::Error::Memory`].
    pub fn new(
        place: DeferredFile,
        what: &'static str,
        records: u64,
        copies: u64,
        part: u64,
        run: &Run,
    ) -> Result<Self> {
        let room = run.budget.left() / part.max(1);
        let sizing = Sizing::new(records, size_of::<T>(), copies, run.threads, room / 2);
        let fixed = sizing.fixed();
        let grant = run.budget.take(what, fixed, (fixed + sizing.bytes).min(room))?;
        let shuffle = Shuffle::new(place, sizing.buckets, sizing.block, grant.bytes() - fixed);
        Ok(Self { shuffle, _grant: grant })
    }
}

/// Maps keys below n to B buckets of consecutive keys, equally many in each: key k is in bucket ⌊k·B/n⌋.
///
/// Multiplies by a precomputed inverse instead of dividing, with the same result (tested).
#[derive(Clone, Copy, Debug)]
pub struct RangeBuckets {
    keys: u64,
    buckets: u64,
    /// ⌈2⁶⁴ B / n⌉. B < n < 2³², so the rounding error times a key stays below 2⁶⁴.
    inverse: u64,
}

impl RangeBuckets {
    /// For `keys` keys, at most 2³², in `buckets` buckets. If there are at least as many buckets as keys, the last ones
    /// stay empty.
    pub fn new(keys: usize, buckets: usize) -> Self {
        let keys = keys as u64;
        let buckets = (buckets as u64).min(keys.saturating_sub(1)).max(1);
        let inverse = (u128::from(buckets) << 64).div_ceil(u128::from(keys.max(1)));
        Self { keys, buckets, inverse: inverse.min(u128::from(u64::MAX)) as u64 }
    }

    /// The bucket of a key; monotonic in the key.
    #[inline]
    pub fn bucket_of(&self, key: u32) -> usize {
        ((u128::from(key) * u128::from(self.inverse)) >> 64) as usize
    }

    /// The keys of a bucket.
    pub fn range(&self, bucket: usize) -> Range<usize> {
        let first = |bucket: usize| (bucket as u64 * self.keys).div_ceil(self.buckets).min(self.keys) as usize;
        first(bucket)..first(bucket + 1)
    }
}

/// Bounds between buckets from a sample of keys: buckets of about equal size whatever the distribution of keys.
#[derive(Clone, Debug)]
pub struct Splitters<const W: usize> {
    bounds: Vec<[u32; W]>,
}

impl<const W: usize> Splitters<W> {
    /// Sampled keys per bucket.
    pub const SAMPLES: usize = 48;

    /// Bounds for `buckets` buckets by the quantiles of `sample`.
    pub fn new(mut sample: Vec<[u32; W]>, buckets: usize) -> Self {
        sample.sort_unstable_by(lexicographic);
        let bounds = (1..buckets).filter_map(|b| sample.get(b * sample.len() / buckets).copied()).collect();
        Self { bounds }
    }

    /// The bucket of a key; monotonic in the key.
    #[inline]
    pub fn bucket(&self, key: [u32; W]) -> usize {
        self.bounds.partition_point(|bound| lexicographic(bound, &key).is_le())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::{Budget, WorkDir};
    use std::path::Path;

    #[test]
    fn sorted_buckets_are_the_sorted_whole_in_memory_and_spilled() {
        let dir = tempfile::tempdir().unwrap();
        let work = WorkDir::temporary(dir.path()).unwrap();
        for limit in [u64::MAX, 100_000, 0] {
            let shuffle = Shuffle::<u64>::new(work.spill("s"), 13, BLOCK_BYTES, limit);
            let n = 100_000u64;
            std::thread::scope(|scope| {
                for half in 0..2 {
                    let shuffle = &shuffle;
                    scope.spawn(move || {
                        let mut producer = shuffle.producer();
                        for i in (half * n / 2)..((half + 1) * n / 2) {
                            let key = i.wrapping_mul(0x9e37_79b9_7f4a_7c15) % n;
                            producer.push((key * 13 / n) as usize, key).unwrap();
                        }
                        producer.finish().unwrap();
                    });
                }
            });
            assert_eq!(shuffle.len(), n);
            assert_eq!(shuffle.file.get().is_some(), limit < u64::MAX);
            let mut whole = Vec::new();
            for bucket in 0..13 {
                let mut records = shuffle.take(bucket).unwrap();
                records.sort_unstable();
                whole.extend(records);
            }
            let mut expected: Vec<u64> = (0..n).map(|i| i.wrapping_mul(0x9e37_79b9_7f4a_7c15) % n).collect();
            expected.sort_unstable();
            assert_eq!(whole, expected);
        }
        assert!(!work.holds("s"), "the spill file is removed");
    }

    /// Regression: the spill file's own error was that its folder does not exist.
    #[test]
    fn a_folder_that_cannot_be_made_says_why() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("file"), []).unwrap();
        let work = WorkDir::in_memory(&dir.path().join("file"), &Budget::new(1 << 20));
        let shuffle = Shuffle::<u64>::new(work.spill("s"), 1, BLOCK_BYTES, 0);
        let mut producer = shuffle.producer();
        producer.push(0, 7).unwrap();
        let error = producer.finish().unwrap_err().to_string();
        assert!(error.contains("Not a directory"), "{error}");
    }

    /// Regression: a producer for every few records kept a whole block for each, ten times the budget.
    #[test]
    fn many_producers_of_few_records_keep_little_more_than_these() {
        let work = WorkDir::in_memory(Path::new("none"), &Budget::new(1 << 20));
        let shuffle = Shuffle::<u64>::new(work.spill("s"), 1, 64 * size_of::<u64>(), u64::MAX);
        for few in (0..1000).map(|k| [3, 64, 100, 1][k % 4]) {
            let mut producer = shuffle.producer();
            (0..few).for_each(|record| producer.push(0, record).unwrap());
            producer.finish().unwrap();
        }
        let capacity: usize = shuffle.lock(0).blocks.iter().map(Vec::capacity).sum();
        assert!(capacity <= shuffle.len() as usize * 9 / 8, "{capacity} for {} records", shuffle.len());
        assert_eq!(shuffle.take(0).unwrap().len(), 250 * (3 + 64 + 100 + 1));
    }

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
    fn range_buckets_are_those_of_the_division() {
        let most = u32::MAX as usize;
        for (keys, buckets) in [(1, 1), (2, 1), (3, 2), (9, 7), (1000, 999), (1 << 31, 512), (most, 3), (most, 1 << 16)]
        {
            let by_range = RangeBuckets::new(keys, buckets);
            let near = |key: usize| key.saturating_sub(3)..keys.min(key + 3);
            for key in (0..=buckets).flat_map(|bucket| near((bucket * keys).div_ceil(buckets))) {
                let bucket = by_range.bucket_of(key as u32);
                assert_eq!(bucket, key * buckets / keys, "{key} of {keys} in {buckets}");
                assert!(by_range.range(bucket).contains(&key));
            }
        }
        // More buckets than keys.
        let few = RangeBuckets::new(3, 100);
        assert_eq!([0, 1, 2].map(|key| few.range(few.bucket_of(key)).contains(&(key as usize))), [true; 3]);
        assert_eq!((0..100).map(|bucket| few.range(bucket).len()).sum::<usize>(), 3);
        assert!(RangeBuckets::new(0, 5).range(4).is_empty());
    }

    #[test]
    fn splitters_balance_skewed_keys() {
        let halves = |i: u64| [(i >> 32) as u32, i as u32];
        let keys: Vec<[u32; 2]> = (0..10_000u64).map(|i| halves(i * i * i)).collect();
        let splitters = Splitters::new(keys.iter().copied().step_by(7).collect(), 10);
        let mut counts = [0; 10];
        for &key in &keys {
            counts[splitters.bucket(key)] += 1;
        }
        assert!(counts.iter().all(|&count| (900..1100).contains(&count)), "{counts:?}");
        assert_eq!(Splitters::new(vec![], 4).bucket([7]), 0);
    }
}
