//! External sorts of small records, and scattering of values: the basis of every order.
//!
//! Both use a shuffle within the budget, on disk where memory does not suffice. Records of W numbers take 4 W bytes,
//! values 8 bytes and 4 more in the finished array.

use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::printable::counted;
use crate::base::{Error, Result};
use crate::store::npy::ArrayMut;
use crate::store::shuffle::Producer;
use crate::store::shuffle::{BudgetedShuffle, Splitters};
use crate::store::{Context, MappedSlice, Run};
use std::ops::Range;

const CHUNK: usize = 1 << 14;

/// Rejects an array `name` of another number of items than there are vertices or faces.
pub(super) fn check_items(name: &str, items: usize, wanted: usize) -> Result<()> {
    if items == wanted {
        return Ok(());
    }
    Err(Error::parameter(
        name,
        format!("{} instead of {wanted}", counted(items, "item")),
        "give those of the same mesh",
    ))
}

/// Receives records as they are made.
pub(super) type Push<'a, const W: usize> = &'a mut dyn FnMut([u32; W]) -> Result<()>;

/// Sorts the records that `fill` makes of `items` items, about `records` in all, and passes them to `each` in ascending
/// order, bucket by bucket. Repeatable if records that differ in meaning are never equal.
pub(super) fn sorted<const W: usize>(
    what: &'static str,
    (items, records): (usize, u64),
    fill: impl Fn(Range<usize>, Push<'_, W>) -> Result<()> + Sync,
    context: Context<'_>,
    mut each: impl FnMut(&[[u32; W]]) -> Result<()>,
) -> Result<()> {
    // Sorted buckets wait for their turn: `in_order` holds four per thread, and one is being sorted.
    let copies = 6 * context.run.threads as u64;
    let sized = BudgetedShuffle::<[u32; W]>::new(
        context.work.spill("sequence_sort.tmp"),
        what,
        records,
        copies,
        2,
        context.run,
    )?;
    let shuffle = &sized.shuffle;
    let step = (items / (shuffle.buckets() * Splitters::<W>::SAMPLES)).max(1);
    let mut sample = Vec::new();
    for item in (0..items).step_by(step) {
        fill(item..item + 1, &mut |record| {
            sample.push(record);
            Ok(())
        })?;
    }
    let splitters = Splitters::new(sample, shuffle.buckets());
    context.run.each_chunk(
        chunk_count(items, CHUNK),
        || shuffle.producer(),
        |k, out| fill(chunk_range(items, CHUNK, k), &mut |record| out.push(splitters.bucket(record), record)),
        Producer::finish,
    )?;
    shuffle.sorted(context.run, |records| each(&records))
}

/// Scatters values to positions of an array through a shuffle, so that the array is written from front to back.
pub(super) struct Scatter<'a> {
    sized: BudgetedShuffle<[u32; 2]>,
    array: ArrayMut<u32>,
    run: &'a Run<'a>,
    n: usize,
}

impl<'a> Scatter<'a> {
    /// For an array `name` of `n` items in `work`.
    pub fn new(name: &str, n: usize, context: Context<'a>) -> Result<Self> {
        let Context { work, run } = context;
        let file = work.spill("sequence_scatter.tmp");
        let sized = BudgetedShuffle::new(file, "bringing values to their places", n as u64, 1, 3, run)?;
        Ok(Self { sized, array: work.array(name, &[n])?, run, n })
    }

    /// The producer for [`Scatter::put`].
    pub fn producer(&self) -> Producer<'_, [u32; 2]> {
        self.sized.shuffle.producer()
    }

    /// Sets the item at `place` to `value`.
    pub fn put(&self, out: &mut Producer<'_, [u32; 2]>, place: u32, value: u32) -> Result<()> {
        let bucket = u64::from(place) * self.sized.shuffle.buckets() as u64 / self.n.max(1) as u64;
        out.push(bucket as usize, [place, value])
    }

    /// Writes the array; the producer must be finished.
    pub fn finish(mut self) -> Result<MappedSlice<u32>> {
        let out = &mut self.array.data()[..];
        for bucket in 0..self.sized.shuffle.buckets() {
            self.run.cancel.check()?;
            self.sized.shuffle.take(bucket)?.into_iter().for_each(|[place, value]| out[place as usize] = value);
        }
        self.array.finish(false)
    }
}

/// The places of `n` items in ascending order of the records that `fill` makes of them, one each, which end with the
/// number of the item: the array `name` of `work`. `advance` is called with the number of records that are placed.
pub(super) fn places_by_record<const W: usize>(
    name: &str,
    what: &'static str,
    n: usize,
    fill: impl Fn(Range<usize>, Push<'_, W>) -> Result<()> + Sync,
    advance: impl Fn(u64),
    context: Context<'_>,
) -> Result<MappedSlice<u32>> {
    let scatter = Scatter::new(name, n, context)?;
    let mut out = scatter.producer();
    let mut next = 0;
    sorted(what, (n, n as u64), fill, context, |records| {
        advance(records.len() as u64);
        records.iter().try_for_each(|record| {
            next += 1;
            scatter.put(&mut out, record[W - 1], next - 1)
        })
    })?;
    out.finish()?;
    scatter.finish()
}

/// Ranks of `n` items by their `key`, ties by number: the array `name` of `work`.
pub(super) fn ranks_by_key(
    name: &str,
    n: usize,
    key: impl Fn(usize) -> [u32; 4] + Sync,
    context: Context<'_>,
) -> Result<MappedSlice<u32>> {
    let fill = |range: Range<usize>, push: Push<'_, 5>| {
        range.into_iter().try_for_each(|i| {
            let [a, b, c, d] = key(i);
            push([a, b, c, d, i as u32])
        })
    };
    places_by_record(name, "ranking vertices", n, fill, |_| (), context)
}

/// Two words that are ordered like `x`; NaN comes last.
pub(super) fn ordered(x: f64) -> [u32; 2] {
    if x.is_nan() {
        return [u32::MAX; 2];
    }
    // Both zeros are equal.
    let bits = (x + 0.).to_bits();
    let bits = if bits >> 63 == 1 { !bits } else { bits | 1 << 63 };
    [(bits >> 32) as u32, bits as u32]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::WorkDir;

    #[test]
    fn numbers_keep_their_order() {
        let numbers = [f64::NEG_INFINITY, -2., -1e-300, 0., 1e-300, 1., 1. + 1e-15, f64::INFINITY, f64::NAN];
        assert!(numbers.windows(2).all(|pair| ordered(pair[0]) < ordered(pair[1])));
        assert_eq!(ordered(-0.), ordered(0.));
    }

    #[test]
    fn ranks_are_those_of_a_sort_whatever_the_memory() {
        let dir = tempfile::tempdir().unwrap();
        let work = WorkDir::temporary(dir.path()).unwrap();
        let n = 200_000;
        let key = |i: usize| [(i * 7919 % 1000) as u32, (i * 31 % 17) as u32, 0, 0];
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by_key(|&i| (key(i), i));
        for (memory, threads) in [(3 << 20, 1), (3 << 20, 3), (1 << 30, 2)] {
            let run = Run { threads, budget: crate::store::Budget::new(memory), ..Run::new(&()) };
            let ranks = ranks_by_key("r.tmp", n, key, Context::new(&work, &run)).unwrap();
            assert!(order.iter().enumerate().all(|(rank, &i)| ranks[i] as usize == rank));
        }
    }
}
