//! What every stage gets: the run (threads, budget, progress, cancellation, seed), and the directory that it works in.

use super::{Budget, WorkDir};
use crate::base::{Cancel, Progress};
use std::time::Instant;

/// The surroundings of a run; cheap to pass by reference.
pub struct Run<'a> {
    /// Worker threads, at least 1. Results do not depend on it.
    pub threads: usize,
    /// What may be allocated. Results do not depend on it.
    pub budget: Budget,
    /// Bytes of mapped files that the kernel can be trusted to keep in memory. Results do not depend on it.
    pub resident: u64,
    /// Who listens.
    pub progress: &'a dyn Progress,
    /// The stop flag.
    pub cancel: Cancel,
    /// Seed of everything random.
    pub seed: u64,
}

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

    /// Runs `work` as a stage: announced, timed, ended. Returns its result and its seconds.
    ///
    /// # Errors
    /// Those of `work`.
    pub fn stage<R>(
        &self,
        name: &str,
        unit: &'static str,
        total: u64,
        work: impl FnOnce() -> crate::base::Result<R>,
    ) -> crate::base::Result<(R, f64)> {
        self.cancel.check()?;
        self.progress.begin(name, unit, total);
        let start = Instant::now();
        let result = work()?;
        let seconds = start.elapsed().as_secs_f64();
        self.progress.end(name, seconds);
        Ok((result, seconds))
    }
}

/// A work directory and the run that works in it; passed by value.
#[derive(Clone, Copy)]
pub struct Context<'a> {
    /// Where arrays are made and found.
    pub work: &'a WorkDir,
    /// Threads, budget, progress, cancellation, seed.
    pub run: &'a Run<'a>,
}

impl<'a> Context<'a> {
    /// Work in `work` as `run` says.
    pub fn new(work: &'a WorkDir, run: &'a Run<'a>) -> Self {
        Self { work, run }
    }
}
