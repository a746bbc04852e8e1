//! What every stage gets: the run (threads, budget, progress, cancellation, seed), and the work directory.
//!
//! Both are passed by reference and cost nothing. Advice to the kernel is one system call per 128 KiB; the parallel
//! loops spawn their threads each time, some 50 µs per thread.

use super::WorkDir;
use super::access::reads_large_pages;
use super::budget::{Budget, Grant};
use super::mapped::will_need;
use crate::base::{Cancel, Progress, Result, parallel};
use std::ops::Range;
use std::time::Instant;

/// The settings and services of a run; cheap to pass by reference.
pub struct Run<'a> {
    /// Worker threads, at least 1. Results do not depend on it.
    pub threads: usize,
    /// What may be allocated. Results do not depend on it.
    pub budget: Budget,
    /// Bytes of mapped files that the kernel can be trusted to keep in memory. Results do not depend on it.
    pub resident: u64,
    /// Receives progress.
    pub progress: &'a dyn Progress,
    /// The stop flag.
    pub cancel: Cancel,
    /// Seed of all random numbers.
    pub seed: u64,
}

/// How many bytes per element a pass uses over all its arrays, as a multiple of those of the array passed to
/// [`Run::is_paged`].
const IN_USE: u64 = 16;
/// Chunks requested ahead of the current one, so that reading overlaps with work.
const AHEAD: usize = 4;

impl<'a> Run<'a> {
    /// A run on all cores with the machine's budget, seed 0.
    pub fn new(progress: &'a dyn Progress) -> Self {
        let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
        Self {
            threads,
            budget: Budget::of_machine(),
            resident: Budget::machine_limit().unwrap_or(1 << 30),
            progress,
            cancel: Cancel::default(),
            seed: 0,
        }
    }

    /// This run on as many of its threads as the budget has room for at `bytes` each, and the grant for them. At least
    /// one thread is kept.
    pub fn threads_within(&self, bytes: u64) -> (Run<'a>, Grant) {
        let grant = self.budget.take_up_to(bytes.saturating_mul(self.threads as u64));
        (self.with_threads(grant.bytes() / bytes.max(1)), grant)
    }

    /// The same, but one thread's bytes are required; `held` bytes are needed besides.
    ///
    /// # Errors
    /// [`crate::base::Error::Memory`] if there is no room for one thread; `what` names the purpose.
    pub fn some_threads(&self, what: &'static str, held: u64, bytes: u64) -> Result<(Run<'a>, Grant)> {
        self.threads_beside(what, (held, bytes), 0)
    }

    /// The same, but `beside` of the bytes of one thread and of what is held need no room in the budget.
    ///
    /// # Errors
    /// As there.
    pub fn threads_beside(
        &self,
        what: &'static str,
        (held, bytes): (u64, u64),
        beside: u64,
    ) -> Result<(Run<'a>, Grant)> {
        let least = held.saturating_add(bytes).saturating_sub(beside);
        let others = bytes.saturating_mul(self.threads.saturating_sub(1) as u64);
        let grant = self.budget.take(what, least, least.saturating_add(others)).map_err(|error| {
            // One thread needs as much.
            if self.threads <= 1 { error.with_remedy("") } else { error }
        })?;
        Ok((self.with_threads(1 + (grant.bytes() - least) / bytes.max(1)), grant))
    }

    /// This run on up to `most` of its threads, but at least one.
    pub fn with_threads(&self, most: u64) -> Run<'a> {
        let threads = most.clamp(1, self.threads.max(1) as u64) as usize;
        Run { threads, budget: self.budget.clone(), cancel: self.cancel.clone(), ..*self }
    }

    /// Asks the kernel to read the items `range` of `array` soon, and those of the next chunks of a pass, if arrays of
    /// the mesh exceed what it can keep in memory. By default the kernel reads megabytes around a page that is missed,
    /// and in a small control group drops them unused. Where it reads large pages it is not asked: a request puts
    /// small pages into the cache. Advice only.
    pub fn will_need<T>(&self, array: &[T], range: Range<usize>) {
        if !reads_large_pages() {
            self.will_need_pages(array, range);
        }
    }

    /// The same for one of many arrays that a pass reads side by side, in small pages everywhere: large ones of all of
    /// them might not fit in memory.
    pub fn will_need_pages<T>(&self, array: &[T], range: Range<usize>) {
        if self.is_paged(array) {
            let end = array.len().min(range.end + AHEAD * range.len());
            will_need(&array[range.start.min(end)..end]);
        }
    }

    /// The same for a few scattered ranges, without those after them.
    pub fn will_need_few<T>(&self, array: &[T], ranges: impl Iterator<Item = Range<usize>>) {
        if self.is_paged(array) {
            ranges.for_each(|range| will_need(&array[range]));
        }
    }

    /// Whether arrays of the mesh like `array` exceed what the kernel can keep in memory.
    pub fn is_paged<T>(&self, array: &[T]) -> bool {
        size_of_val(array) as u64 * IN_USE > self.resident
    }

    /// Runs `work` as a stage and reports its begin, and if it succeeds its end and time. Returns its result and its
    /// seconds.
    ///
    /// # Errors
    /// Those of `work`.
    pub fn stage<R>(
        &self,
        name: &str,
        unit: &'static str,
        total: u64,
        work: impl FnOnce() -> Result<R>,
    ) -> Result<(R, f64)> {
        let start = self.begin(name, unit, total)?;
        let result = work()?;
        Ok((result, self.end(name, start)))
    }

    fn begin(&self, name: &str, unit: &'static str, total: u64) -> Result<Instant> {
        self.cancel.check()?;
        self.progress.begin(name, unit, total);
        Ok(Instant::now())
    }

    fn end(&self, name: &str, start: Instant) -> f64 {
        let seconds = start.elapsed().as_secs_f64();
        self.progress.end(name, seconds);
        seconds
    }
}

/// The loops of [`crate::base::parallel`] on the run's threads, under its stop flag.
impl Run<'_> {
    /// [`parallel::map_chunks`].
    ///
    /// # Errors
    /// As there.
    pub fn map_chunks<S, R: Send>(
        &self,
        chunks: usize,
        init: impl Fn() -> S + Sync,
        work: impl Fn(usize, &mut S) -> Result<R> + Sync,
    ) -> Result<Vec<R>> {
        parallel::map_chunks(self.threads, &self.cancel, chunks, init, work)
    }

    /// [`parallel::map_ranges`].
    ///
    /// # Errors
    /// As there.
    pub fn map_ranges<R: Send>(
        &self,
        n: usize,
        size: usize,
        work: impl Fn(Range<usize>) -> Result<R> + Sync,
    ) -> Result<Vec<R>> {
        parallel::map_ranges(self.threads, &self.cancel, n, size, work)
    }

    /// [`parallel::each_chunk`].
    ///
    /// # Errors
    /// As there.
    pub fn each_chunk<S>(
        &self,
        chunks: usize,
        init: impl Fn() -> S + Sync,
        work: impl Fn(usize, &mut S) -> Result<()> + Sync,
        finish: impl Fn(S) -> Result<()> + Sync,
    ) -> Result<()> {
        parallel::each_chunk(self.threads, &self.cancel, chunks, init, work, finish)
    }

    /// [`parallel::in_order`].
    ///
    /// # Errors
    /// As there.
    pub fn in_order<S, R: Send>(
        &self,
        chunks: usize,
        init: impl Fn() -> S + Sync,
        work: impl Fn(usize, &mut S) -> Result<R> + Sync,
        consume: impl FnMut(usize, R) -> Result<()>,
    ) -> Result<()> {
        parallel::in_order(self.threads, &self.cancel, chunks, init, work, consume)
    }

    /// [`parallel::fill_pieces`].
    ///
    /// # Errors
    /// As there.
    pub fn fill_pieces<P: Send, S, R: Send>(
        &self,
        pieces: impl Iterator<Item = P>,
        init: impl Fn() -> S + Sync,
        work: impl Fn(usize, &mut P, &mut S) -> Result<R> + Sync,
    ) -> Result<Vec<R>> {
        parallel::fill_pieces(self.threads, &self.cancel, pieces, init, work)
    }

    /// [`parallel::fill_chunks`].
    ///
    /// # Errors
    /// As there.
    pub fn fill_chunks<T: Send, S, R: Send>(
        &self,
        out: &mut [T],
        size: usize,
        init: impl Fn() -> S + Sync,
        work: impl Fn(usize, &mut [T], &mut S) -> Result<R> + Sync,
    ) -> Result<Vec<R>> {
        parallel::fill_chunks(self.threads, &self.cancel, out, size, init, work)
    }

    /// [`parallel::fill_each`].
    ///
    /// # Errors
    /// As there.
    pub fn fill_each<T: Copy + Send>(
        &self,
        out: &mut [T],
        size: usize,
        value: impl Fn(usize, T) -> T + Sync,
    ) -> Result<()> {
        parallel::fill_each(self.threads, &self.cancel, out, size, value)
    }

    /// [`parallel::fill_two`].
    ///
    /// # Errors
    /// As there.
    pub fn fill_two<A: Send, B: Send, S, R: Send>(
        &self,
        out: (&mut [A], &mut [B]),
        size: usize,
        init: impl Fn() -> S + Sync,
        work: impl Fn(usize, &mut [A], &mut [B], &mut S) -> Result<R> + Sync,
    ) -> Result<Vec<R>> {
        parallel::fill_two(self.threads, &self.cancel, out, size, init, work)
    }
}

/// A work directory and the run that uses it; passed by value.
#[derive(Clone, Copy)]
pub struct Context<'a> {
    /// Where arrays are created and found.
    pub work: &'a WorkDir,
    /// Threads, budget, progress, cancellation, seed.
    pub run: &'a Run<'a>,
}

impl<'a> Context<'a> {
    /// Combines `work` and `run`.
    pub fn new(work: &'a WorkDir, run: &'a Run<'a>) -> Self {
        Self { work, run }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Error;
    use std::sync::Mutex;

    #[test]
    fn a_stage_that_fails_begins_and_does_not_end() {
        #[derive(Default)]
        struct Heard(Mutex<Vec<&'static str>>);
        impl Progress for Heard {
            fn begin(&self, _: &str, _: &'static str, _: u64) {
                parallel::lock(&self.0).push("begin");
            }

            fn end(&self, _: &str, _: f64) {
                parallel::lock(&self.0).push("end");
            }
        }
        let heard = Heard::default();
        let run = Run::new(&heard);
        assert!(run.stage("rows", "rows", 1, || Err::<(), _>(Error::internal("no"))).is_err());
        assert!(run.stage("rows", "rows", 1, || Ok(())).is_ok());
        run.cancel.cancel();
        assert!(run.stage("rows", "rows", 1, || Ok(())).is_err());
        assert_eq!(parallel::lock(&heard.0)[..], ["begin", "begin", "end"]);
    }

    #[test]
    fn threads_fit_the_budget_and_one_always_does() {
        let run = Run { threads: 8, budget: Budget::new(1000), ..Run::new(&()) };
        let (three, grant) = run.threads_within(300);
        assert_eq!((three.threads, grant.bytes()), (3, 1000));
        let (one, _) = run.threads_within(300);
        assert_eq!(one.threads, 1);
        assert!(run.some_threads("rows", 0, 300).is_err());
        drop(grant);
        assert_eq!(run.threads_within(10).0.threads, 8);
        assert_eq!(run.some_threads("rows", 0, 400).unwrap().0.threads, 2);
        assert_eq!(run.some_threads("rows", 100, 300).unwrap().0.threads, 3);
        for (beside, threads) in [(0, 2), (400, 3), (1000, 3)] {
            assert_eq!(run.threads_beside("rows", (100, 350), beside).unwrap().0.threads, threads);
        }
        assert!(run.threads_beside("rows", (1000, 300), 299).is_err());
    }
}
