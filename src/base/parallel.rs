//! Deterministic parallel loops over chunks.
//!
//! Chunks are handed out by a counter, results are put in chunk order, and sums are folded in
//! that order: so a result depends on the chunk size alone, never on the number of threads or
//! on timing. One of the threads is the caller, so that one thread runs in place, without spawning: a spawned
//! thread costs some 50 µs, as much as a small loop.

use super::{Cancel, Result};
use std::ops::Range;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Number of chunks of `size` that cover `0..n`.
pub fn chunk_count(n: usize, size: usize) -> usize {
    n.div_ceil(size.max(1))
}

/// The `k`-th chunk of `size` of `0..n`.
pub fn chunk_range(n: usize, size: usize, k: usize) -> Range<usize> {
    let start = (k * size).min(n);
    start..(start + size).min(n)
}

/// Calls `work(chunk number, state)` for every chunk number below `chunks`, on up to `threads`
/// threads, each with a state of its own from `init`; returns the results in chunk order.
///
/// # Errors
/// The error of the lowest chunk that failed, or [`super::Error::Cancelled`].
pub fn map_chunks<S, R: Send>(
    threads: usize,
    cancel: &Cancel,
    chunks: usize,
    init: impl Fn() -> S + Sync,
    work: impl Fn(usize, &mut S) -> Result<R> + Sync,
) -> Result<Vec<R>> {
    let threads = threads.clamp(1, chunks.max(1));
    if threads == 1 {
        let mut state = init();
        return (0..chunks)
            .map(|k| {
                cancel.check()?;
                work(k, &mut state)
            })
            .collect();
    }
    let next = AtomicUsize::new(0);
    let failed = AtomicUsize::new(usize::MAX);
    let done: Mutex<Vec<(usize, Result<R>)>> = Mutex::new(Vec::with_capacity(chunks));
    let worker = || {
        let mut state = init();
        let mut mine = Vec::new();
        loop {
            let k = next.fetch_add(1, Ordering::Relaxed);
            if k >= chunks || k > failed.load(Ordering::Relaxed) {
                break;
            }
            let result = cancel.check().and_then(|()| work(k, &mut state));
            if result.is_err() {
                failed.fetch_min(k, Ordering::Relaxed);
            }
            mine.push((k, result));
        }
        done.lock().unwrap_or_else(|poison| poison.into_inner()).append(&mut mine);
    };
    on_threads(threads, &worker);
    let mut all = done.into_inner().unwrap_or_else(|poison| poison.into_inner());
    all.sort_unstable_by_key(|(k, _)| *k);
    all.into_iter().map(|(_, result)| result).collect()
}

/// Runs `worker` on `threads` threads, the caller's among them. Not generic: what starts and joins threads is compiled
/// once, not for each of a hundred loops.
fn on_threads(threads: usize, worker: &(dyn Fn() + Sync)) {
    std::thread::scope(|scope| {
        (1..threads).for_each(|_| drop(scope.spawn(worker)));
        worker();
    });
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

/// Like [`map_chunks`] for chunks whose thread states must be closed by `finish`, such as producers
/// of a shuffle; chunk results are dropped.
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
    let next = AtomicUsize::new(0);
    let workers = threads.clamp(1, chunks.max(1));
    map_chunks(
        workers,
        cancel,
        workers,
        || (),
        |_, ()| {
            let mut state = init();
            loop {
                let k = next.fetch_add(1, Ordering::Relaxed);
                if k >= chunks {
                    return finish(state);
                }
                cancel.check()?;
                work(k, &mut state)?;
            }
        },
    )?;
    Ok(())
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
    if threads == 1 {
        let mut state = init();
        for k in 0..chunks {
            cancel.check()?;
            let result = work(k, &mut state)?;
            consume(k, result)?;
        }
        return Ok(());
    }
    let window = (4 * threads).min(chunks);
    let (tickets, jobs) = crossbeam_channel::bounded::<usize>(window);
    let (done, results) = crossbeam_channel::bounded::<(usize, Result<R>)>(window);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            let (jobs, done) = (jobs.clone(), done.clone());
            let (init, work) = (&init, &work);
            let worker: Box<dyn FnOnce() + Send + '_> = Box::new(move || {
                let mut state = init();
                for k in jobs {
                    let result = cancel.check().and_then(|()| work(k, &mut state));
                    if done.send((k, result)).is_err() {
                        return;
                    }
                }
            });
            scope.spawn(worker);
        }
        drop((jobs, done));
        let mut issued = 0;
        let mut waiting: Vec<Option<Result<R>>> = (0..chunks.min(window)).map(|_| None).collect();
        let mut next = 0;
        // Moved in so that workers see the end of the tickets when this returns, early or not.
        let (tickets, results) = (tickets, results);
        while next < chunks {
            while issued < chunks && issued < next + window {
                if tickets.send(issued).is_err() {
                    break;
                }
                issued += 1;
            }
            match waiting[next % window].take() {
                Some(result) => {
                    consume(next, result?)?;
                    next += 1;
                }
                None => match results.recv() {
                    Ok((k, result)) => waiting[k % window] = Some(result),
                    Err(_) => return Err(super::Error::Cancelled),
                },
            }
        }
        Ok(())
    })
}

/// Like [`map_chunks`] over disjoint mutable chunks of `out`, `size` items each.
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
    let pieces: Vec<Mutex<&mut [T]>> = out.chunks_mut(size.max(1)).map(Mutex::new).collect();
    map_chunks(threads, cancel, pieces.len(), init, |k, state| {
        let mut piece = pieces[k].lock().unwrap_or_else(|poison| poison.into_inner());
        work(k, &mut piece, state)
    })
}

/// Sets every item of `out` to what `value` makes of its number and its old value.
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
    type Piece<'a, A, B> = Mutex<(&'a mut [A], &'a mut [B])>;
    let size = size.max(1);
    let pieces: Vec<Piece<'_, A, B>> = a.chunks_mut(size).zip(b.chunks_mut(size)).map(Mutex::new).collect();
    map_chunks(threads, cancel, pieces.len(), init, |k, state| {
        let mut piece = pieces[k].lock().unwrap_or_else(|poison| poison.into_inner());
        let (a, b) = &mut *piece;
        work(k, a, b, state)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Error;

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
