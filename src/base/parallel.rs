//! Deterministic parallel loops over chunks.
//!
//! Chunks are handed out by a counter, results are stored in chunk order, and sums are folded in that order. So a
//! result depends on the chunk size alone, never on the number of threads or on timing. The caller's thread is one of
//! the workers, so a single-threaded run spawns nothing: spawning costs some 50 µs a thread, as much as a small loop.
//!
//! The first error stops all threads at their next chunk. A panic in a thread also becomes an error, so no thread waits
//! for one that has died.

use super::sort::arrange;
use super::{Cancel, Error, Result};
use crossbeam_channel::{Receiver, Sender};
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread::{Scope, ScopedJoinHandle};

/// Number of chunks of `size` that cover `0..n`.
pub fn chunk_count(n: usize, size: usize) -> usize {
    n.div_ceil(size.max(1))
}

/// The `k`-th chunk of `size` of `0..n`.
pub fn chunk_range(n: usize, size: usize, k: usize) -> Range<usize> {
    let start = (k * size).min(n);
    start..(start + size).min(n)
}

/// Hands out each chunk number once, until a chunk fails, the run is cancelled or a thread panics.
///
/// Nothing here is generic: the code that starts, stops and joins threads is compiled once, not for each of a hundred
/// loops.
struct ChunkQueue<'a> {
    cancel: &'a Cancel,
    chunks: usize,
    next: AtomicUsize,
    /// The lowest chunk that failed; chunks after it are not started.
    failed: AtomicUsize,
    error: Mutex<Option<(usize, Error)>>,
}

impl<'a> ChunkQueue<'a> {
    fn new(chunks: usize, cancel: &'a Cancel) -> ChunkQueue<'a> {
        ChunkQueue {
            cancel,
            chunks,
            next: AtomicUsize::new(0),
            failed: AtomicUsize::new(usize::MAX),
            error: Mutex::default(),
        }
    }

    /// The next chunk, unless all are taken or one has failed.
    fn take(&self) -> Option<usize> {
        let k = self.next.fetch_add(1, Ordering::Relaxed);
        if k >= self.chunks || k > self.failed.load(Ordering::Relaxed) {
            return None;
        }
        self.cancel.check().map_err(|error| self.fail(k, error)).is_ok().then_some(k)
    }

    /// Runs `work` on chunk after chunk until none is left or one has failed.
    fn each(&self, work: &mut ChunkWork<'_>) {
        while let Some(k) = self.take() {
            work(k).unwrap_or_else(|error| self.fail(k, error));
        }
    }

    /// Records that chunk `k` failed; of several failures, that of the lowest chunk is reported.
    fn fail(&self, k: usize, error: Error) {
        let mut first = lock(&self.error);
        if first.as_ref().is_none_or(|(lowest, _)| k < *lowest) {
            *first = Some((k, error));
        }
        self.failed.fetch_min(k, Ordering::Relaxed);
    }

    /// Runs `worker` on up to `threads` threads, including the caller's, and returns the first failure.
    fn run_workers(
        threads: usize,
        cancel: &Cancel,
        chunks: usize,
        worker: &(dyn Fn(&ChunkQueue) + Sync),
    ) -> Result<()> {
        let queue = ChunkQueue::new(chunks, cancel);
        let guarded = || catch(|| worker(&queue)).unwrap_or_else(|error| queue.fail(0, error));
        std::thread::scope(|scope| {
            for _ in 1..threads.clamp(1, chunks.max(1)) {
                // If the system refuses a thread, the others do its work; the caller's always runs.
                drop(spawn(scope, guarded));
            }
            guarded();
        });
        let error = unlocked(queue.error);
        error.map_or(Ok(()), |(_, error)| Err(error))
    }
}

/// Starts `work` on a thread of `scope`. If the system refuses the thread, that is an error, not a panic.
///
/// # Errors
/// [`Error::Unusable`].
pub fn spawn<'scope, T: Send + 'scope>(
    scope: &'scope Scope<'scope, '_>,
    work: impl FnOnce() -> T + Send + 'scope,
) -> Result<ScopedJoinHandle<'scope, T>> {
    std::thread::Builder::new().spawn_scoped(scope, work).map_err(|error| {
        let remedy = "use fewer `threads`, or allow the process more threads or memory";
        Error::unusable("threads", format!("the system refuses another thread ({error})"), remedy)
    })
}

/// Runs `other` on its own thread beside `work` if `threads` allows more than one, else one after the other. This hides
/// a single-threaded pass behind a parallel one.
///
/// # Errors
/// [`Error::Internal`] when `other` panicked.
pub fn run_concurrently<A: Send, B>(
    threads: usize,
    other: impl FnOnce() -> A + Send,
    work: impl FnOnce() -> B,
) -> Result<(A, B)> {
    // If the system refuses a thread, the caller runs it itself.
    let other = Mutex::new(Some(other));
    let take = || lock(&other).take();
    if threads < 2 {
        let done = take().map(|other| other());
        return Ok((done.ok_or_else(|| Error::internal("work that was to be done is gone"))?, work()));
    }
    std::thread::scope(|scope| {
        let begun = spawn(scope, || catch(|| take().map(|other| other())));
        let done = work();
        let result = match begun {
            Ok(thread) => thread.join().unwrap_or_else(|_| Err(Error::internal("a thread ended early")))?,
            Err(_) => take().map(|other| other()),
        };
        Ok((result.ok_or_else(|| Error::internal("work that was to be done is gone"))?, done))
    })
}

/// Locks the mutex even if it is poisoned; a panic elsewhere is reported separately.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The content of `mutex`, even if it is poisoned.
fn unlocked<T>(mutex: Mutex<T>) -> T {
    mutex.into_inner().unwrap_or_else(PoisonError::into_inner)
}

/// Calls `work` and turns a panic in it into an error, so that other threads end and temporary files are removed.
///
/// # Errors
/// [`Error::Internal`] with the panic's message.
pub fn catch<R>(work: impl FnOnce() -> R) -> Result<R> {
    catch_unwind(AssertUnwindSafe(work)).map_err(|payload| {
        let text = payload.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| payload.downcast_ref::<&str>().copied());
        Error::internal(text.unwrap_or("a panic without a message"))
    })
}

/// Calls `work(chunk number, state)` for every chunk number below `chunks`, on up to `threads`
/// threads, each with a state of its own from `init`; returns the results in chunk order.
///
/// # Errors
/// The error of the lowest chunk that failed, [`Error::Cancelled`], or [`Error::Internal`] when a thread panicked.
pub fn map_chunks<S, R: Send>(
    threads: usize,
    cancel: &Cancel,
    chunks: usize,
    init: impl Fn() -> S + Sync,
    work: impl Fn(usize, &mut S) -> Result<R> + Sync,
) -> Result<Vec<R>> {
    Results::of(threads, cancel, chunks, &|queue, results| {
        let mut state = init();
        queue.each(&mut |k| work(k, &mut state).map(|result| results.put(k, result)));
    })
}

/// The numbers and results of chunks, in the order in which they arrive. Separate from the loops because it is compiled
/// once per result type, not once per loop.
struct Results<R>(Mutex<(Vec<usize>, Vec<R>)>);

impl<R: Send> Results<R> {
    /// Collects what the `worker`s return for all chunks, in chunk order.
    fn of(
        threads: usize,
        cancel: &Cancel,
        chunks: usize,
        worker: &(dyn Fn(&ChunkQueue, &Self) + Sync),
    ) -> Result<Vec<R>> {
        let results = Self(Mutex::new((Vec::with_capacity(chunks), Vec::with_capacity(chunks))));
        ChunkQueue::run_workers(threads, cancel, chunks, &|queue| worker(queue, &results))?;
        let (numbers, mut results) = unlocked(results.0);
        arrange(places(&numbers), &mut |i, j| results.swap(i, j));
        Ok(results)
    }

    fn put(&self, chunk: usize, result: R) {
        let mut held = lock(&self.0);
        held.0.push(chunk);
        held.1.push(result);
    }
}

/// The inverse permutation: where each of 0, 1, … stands in `numbers`.
fn places(numbers: &[usize]) -> Vec<usize> {
    let mut places = vec![0; numbers.len()];
    numbers.iter().enumerate().for_each(|(place, &number)| places[number] = place);
    places
}

/// [`map_chunks`] over the chunks of `size` of `0..n`, without states.
///
/// # Errors
/// As [`map_chunks`].
pub fn map_ranges<R: Send>(
    threads: usize,
    cancel: &Cancel,
    n: usize,
    size: usize,
    work: impl Fn(Range<usize>) -> Result<R> + Sync,
) -> Result<Vec<R>> {
    map_chunks(threads, cancel, chunk_count(n, size), || (), |k, ()| work(chunk_range(n, size, k)))
}

/// Like [`map_chunks`] for thread states that `finish` must close, such as producers of a shuffle; chunk results are
/// dropped. After an error no state is finished.
///
/// # Errors
/// As [`map_chunks`], or those of `finish`.
pub fn each_chunk<S>(
    threads: usize,
    cancel: &Cancel,
    chunks: usize,
    init: impl Fn() -> S + Sync,
    work: impl Fn(usize, &mut S) -> Result<()> + Sync,
    finish: impl Fn(S) -> Result<()> + Sync,
) -> Result<()> {
    ChunkQueue::run_workers(threads, cancel, chunks, &|queue| {
        let mut state = init();
        queue.each(&mut |k| work(k, &mut state));
        if queue.failed.load(Ordering::Relaxed) == usize::MAX {
            finish(state).unwrap_or_else(|error| queue.fail(chunks, error));
        }
    })
}

/// Computes chunks on `threads` threads and hands their results to `consume` on the calling
/// thread in chunk order; at most `4 * threads` results wait at a time.
///
/// # Errors
/// As [`map_chunks`], or those of `consume`.
pub fn in_order<S, R: Send>(
    threads: usize,
    cancel: &Cancel,
    chunks: usize,
    init: impl Fn() -> S + Sync,
    work: impl Fn(usize, &mut S) -> Result<R> + Sync,
    mut consume: impl FnMut(usize, R) -> Result<()>,
) -> Result<()> {
    let threads = threads.clamp(1, chunks.max(1));
    let slots: Vec<Mutex<Option<R>>> = (0..(4 * threads).min(chunks)).map(|_| Mutex::new(None)).collect();
    let slot = |k: usize| lock(&slots[k % slots.len()]);
    let worker = |compute: &mut dyn FnMut(&mut ChunkWork<'_>)| {
        let mut state = init();
        compute(&mut |k| work(k, &mut state).map(|result| *slot(k) = Some(result)));
    };
    ordered(threads, cancel, chunks, &worker, &mut |k| {
        let result = slot(k).take();
        consume(k, result.ok_or_else(|| Error::internal("a chunk was reported without its result"))?)
    })
}

/// A worker's report on one chunk.
type Report = (usize, Result<()>);

/// Computes a chunk, given its number.
type ChunkWork<'a> = dyn FnMut(usize) -> Result<()> + 'a;

/// A worker of [`in_order`]: creates a state and passes on the closure that computes chunks with it.
type Worker<'a> = dyn Fn(&mut dyn FnMut(&mut ChunkWork<'_>)) + Sync + 'a;

/// The threads of [`in_order`]. Workers receive chunk numbers, at most four per thread ahead of what was consumed, and
/// report each chunk; reports are consumed in order. The first error ends the work, as does a panic. With one thread,
/// computing and consuming alternate.
fn ordered(
    threads: usize,
    cancel: &Cancel,
    chunks: usize,
    worker: &Worker<'_>,
    consume: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<()> {
    if threads == 1 {
        let mut done = Ok(());
        catch(|| {
            worker(&mut |work| {
                done = (0..chunks).try_for_each(|k| cancel.check().and_then(|()| work(k)).and_then(|()| consume(k)));
            });
        })?;
        return done;
    }
    let window = (4 * threads).min(chunks);
    let (numbers, jobs) = crossbeam_channel::bounded::<usize>(window);
    let (done, reports) = crossbeam_channel::bounded::<Report>(window + threads);
    let compute = |jobs: &Receiver<usize>, done: &Sender<Report>| {
        worker(&mut |work| {
            let mut report = |k| done.send((k, cancel.check().and_then(|()| work(k))));
            // After an error nobody receives the reports.
            let _ = jobs.iter().try_for_each(&mut report);
        });
    };
    std::thread::scope(|scope| {
        let mut refused = None;
        for _ in 0..threads {
            let (jobs, done) = (jobs.clone(), done.clone());
            let compute = &compute;
            let guarded = move || {
                if let Err(error) = catch(|| compute(&jobs, &done)) {
                    drop(done.send((usize::MAX, Err(error))));
                }
            };
            refused = spawn(scope, guarded).err().or(refused);
        }
        drop((jobs, done));
        let mut issued = 0;
        let mut waiting: Vec<Option<Result<()>>> = (0..window).map(|_| None).collect();
        let mut next = 0;
        // Moved in, so that workers see the channel close when this returns, early or not.
        let (numbers, reports) = (numbers, reports);
        while next < chunks {
            while issued < chunks.min(next + window) && numbers.send(issued).is_ok() {
                issued += 1;
            }
            match waiting[next % window].take() {
                Some(result) => {
                    result.and_then(|()| consume(next))?;
                    next += 1;
                }
                None => match reports.recv() {
                    Ok((usize::MAX, panicked)) => return panicked,
                    Ok((k, result)) => waiting[k % window] = Some(result),
                    Err(_) => return Err(refused.unwrap_or_else(|| Error::internal("all threads ended early"))),
                },
            }
        }
        Ok(())
    })
}

/// Like [`map_chunks`], with one chunk for each of `pieces`, which it may modify: parts of arrays that are filled in
/// parallel.
///
/// # Errors
/// As [`map_chunks`].
pub fn fill_pieces<P: Send, S, R: Send>(
    threads: usize,
    cancel: &Cancel,
    pieces: impl Iterator<Item = P>,
    init: impl Fn() -> S + Sync,
    work: impl Fn(usize, &mut P, &mut S) -> Result<R> + Sync,
) -> Result<Vec<R>> {
    let pieces: Vec<Mutex<P>> = pieces.map(Mutex::new).collect();
    map_chunks(threads, cancel, pieces.len(), init, |k, state| work(k, &mut lock(&pieces[k]), state))
}

/// The parts of `items` that end at `ends`, which ascend.
pub fn parts_of<T>(items: &mut [T], ends: impl Iterator<Item = usize>) -> impl Iterator<Item = &mut [T]> {
    let (mut rest, mut done) = (items, 0);
    ends.map(move |end| {
        let (part, after) = std::mem::take(&mut rest).split_at_mut(end - done);
        (rest, done) = (after, end);
        part
    })
}

/// Where the entries of each `size` rows end; those of a row begin at `start` (rows + 1).
pub fn entry_ends(start: &[u32], size: usize) -> impl Iterator<Item = usize> {
    let rows = start.len().saturating_sub(1);
    (0..chunk_count(rows, size)).map(move |k| start[chunk_range(rows, size, k).end] as usize)
}

/// [`fill_pieces`] over disjoint mutable chunks of `out`, `size` items each.
///
/// # Errors
/// As [`map_chunks`].
pub fn fill_chunks<T: Send, S, R: Send>(
    threads: usize,
    cancel: &Cancel,
    out: &mut [T],
    size: usize,
    init: impl Fn() -> S + Sync,
    work: impl Fn(usize, &mut [T], &mut S) -> Result<R> + Sync,
) -> Result<Vec<R>> {
    fill_pieces(threads, cancel, out.chunks_mut(size.max(1)), init, |k, piece, state| work(k, piece, state))
}

/// Sets every item of `out` to `value(index, old value)`.
///
/// # Errors
/// [`super::Error::Cancelled`].
pub fn fill_each<T: Copy + Send>(
    threads: usize,
    cancel: &Cancel,
    out: &mut [T],
    size: usize,
    value: impl Fn(usize, T) -> T + Sync,
) -> Result<()> {
    let n = out.len();
    let fill = |k: usize, piece: &mut [T], (): &mut ()| {
        piece.iter_mut().zip(chunk_range(n, size.max(1), k)).for_each(|(item, i)| *item = value(i, *item));
        Ok(())
    };
    fill_chunks(threads, cancel, out, size, || (), fill).map(drop)
}

/// Like [`fill_chunks`] over equal chunks of two slices of one length.
///
/// # Errors
/// As [`map_chunks`].
pub fn fill_two<A: Send, B: Send, S, R: Send>(
    threads: usize,
    cancel: &Cancel,
    (a, b): (&mut [A], &mut [B]),
    size: usize,
    init: impl Fn() -> S + Sync,
    work: impl Fn(usize, &mut [A], &mut [B], &mut S) -> Result<R> + Sync,
) -> Result<Vec<R>> {
    let size = size.max(1);
    let pieces = a.chunks_mut(size).zip(b.chunks_mut(size));
    fill_pieces(threads, cancel, pieces, init, |k, (a, b), state| work(k, a, b, state))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_come_in_chunk_order_whatever_the_threads() {
        for threads in [1, 2, 7] {
            let squares = map_chunks(threads, &Cancel::default(), 100, || (), |k, ()| Ok(k * k)).unwrap();
            assert_eq!(squares, (0..100).map(|k| k * k).collect::<Vec<_>>());
        }
    }

    #[test]
    fn the_lowest_failing_chunk_is_reported() {
        for threads in [1, 3] {
            let error = map_chunks(
                threads,
                &Cancel::default(),
                50,
                || (),
                |k, ()| {
                    if k % 10 == 7 { Err(Error::parameter(format!("{k}"), "", "")) } else { Ok(()) }
                },
            )
            .unwrap_err();
            assert!(matches!(error, Error::Parameter { name, .. } if name == "7"));
        }
    }

    #[test]
    fn results_are_consumed_in_order_and_errors_end_the_work() {
        for threads in [1, 2, 5] {
            let mut seen = Vec::new();
            in_order(
                threads,
                &Cancel::default(),
                200,
                || (),
                |k, ()| Ok(k * 2),
                |k, x| {
                    seen.push((k, x));
                    Ok(())
                },
            )
            .unwrap();
            assert_eq!(seen, (0..200).map(|k| (k, k * 2)).collect::<Vec<_>>());
            let failed = in_order(
                threads,
                &Cancel::default(),
                200,
                || (),
                |k, ()| if k == 100 { Err(Error::Cancelled) } else { Ok(()) },
                |_, ()| Ok(()),
            );
            assert!(failed.is_err());
        }
    }

    /// A panic in a worker left the consumer waiting for ever; on one thread it went through.
    #[test]
    fn a_panic_in_a_thread_is_an_error_and_nothing_waits() {
        let bad = |k: usize, (): &mut ()| if k == 40 { panic!("chunk {k} is bad") } else { Ok(k) };
        for threads in [1, 2, 5] {
            let mapped = map_chunks(threads, &Cancel::default(), 100, || (), bad).unwrap_err();
            let ordered = in_order(threads, &Cancel::default(), 100, || (), bad, |_, _| Ok(())).unwrap_err();
            let each = |k: usize, state: &mut ()| bad(k, state).map(drop);
            let each = each_chunk(threads, &Cancel::default(), 100, || (), each, Ok).unwrap_err();
            for error in [mapped, ordered, each] {
                assert!(error.to_string().contains("chunk 40 is bad"), "{error}");
            }
        }
    }

    /// Other threads finished all their chunks after an error, on a full disk for instance.
    #[test]
    fn an_error_stops_all_threads_and_finishes_no_state() {
        let (begun, finished) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let work = |k: usize, (): &mut ()| {
            begun.fetch_add(1, Ordering::Relaxed);
            if k == 0 {
                return Err(Error::Cancelled);
            }
            std::thread::sleep(std::time::Duration::from_millis(1));
            Ok(())
        };
        let finish = |()| {
            finished.fetch_add(1, Ordering::Relaxed);
            Ok(())
        };
        each_chunk(4, &Cancel::default(), 1_000_000, || (), work, finish).unwrap_err();
        // A million chunks of a millisecond would be minutes; a thread that is slow to start may not have begun.
        assert!(begun.into_inner() < 10_000);
        assert_eq!(finished.into_inner(), 0);
    }

    #[test]
    fn every_thread_state_is_finished() {
        let total = AtomicUsize::new(0);
        each_chunk(
            3,
            &Cancel::default(),
            100,
            || 0,
            |k, sum| {
                *sum += k;
                Ok(())
            },
            |sum| {
                total.fetch_add(sum, Ordering::Relaxed);
                Ok(())
            },
        )
        .unwrap();
        assert_eq!(total.into_inner(), 4950);
    }

    #[test]
    fn chunks_of_a_slice_are_filled_once_each() {
        let mut out = vec![0usize; 1001];
        fill_chunks(
            3,
            &Cancel::default(),
            &mut out,
            64,
            || (),
            |k, piece, ()| {
                for (i, x) in piece.iter_mut().enumerate() {
                    *x += k * 64 + i;
                }
                Ok(())
            },
        )
        .unwrap();
        assert_eq!(out, (0..1001).collect::<Vec<_>>());
    }
}
