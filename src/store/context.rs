//! Where a stage works and how: its directory and what all stages of a run share.

use super::{Run, WorkDir};

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
