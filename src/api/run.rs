//! How a builder runs: threads, memory, seed, folders, progress, cancellation.
//!
//! Every builder has the same setters, made by [`run_options`], and those with stages also [`work_options`]. Cost: none
//! of the size of a mesh.

use crate::base::parallel::catch;
use crate::base::{Cancel, Progress, Result, Told};
use crate::store::{Budget, Context, Run, WorkDir};
use std::path::PathBuf;
use std::sync::Arc;

/// Options of every run. Results depend on the seed alone.
#[derive(Clone, Default)]
pub(super) struct RunOptions {
    pub(super) threads: Option<usize>,
    pub(super) memory: Option<u64>,
    pub(super) seed: u64,
    pub(super) temporary: Option<PathBuf>,
    pub(super) work_dir: Option<PathBuf>,
    pub(super) force: bool,
    pub(super) progress: Option<Arc<dyn Progress + Send + Sync>>,
    pub(super) cancel: Cancel,
}

/// Gives a builder with a field `options: RunOptions` its setters.
macro_rules! run_options {
    ($builder:ident) => {
        impl $builder {
            /// Works with `threads` threads, from 1 to 65,535; by default with one per core.
            #[must_use]
            pub fn threads(mut self, threads: usize) -> Self {
                self.options.threads = Some(threads.clamp(1, u16::MAX.into()));
                self
            }

            /// Allocates `bytes` bytes at the most; by default half of what is free. Mapped files do not count.
            #[must_use]
            pub fn memory(mut self, bytes: u64) -> Self {
                self.options.memory = Some(bytes);
                self
            }

            /// The seed of everything random; 0 by default.
            #[must_use]
            pub fn seed(mut self, seed: u64) -> Self {
                self.options.seed = seed;
                self
            }

            /// The folder for what does not fit in memory; by default the system's. Nothing is left there.
            #[must_use]
            pub fn temporary_folder(mut self, folder: impl Into<std::path::PathBuf>) -> Self {
                self.options.temporary = Some(folder.into());
                self
            }

            /// Tells `listener` of stages as they begin, advance and end; it is called from several threads.
            #[must_use]
            pub fn progress(mut self, listener: std::sync::Arc<impl $crate::base::Progress + Send + 'static>) -> Self {
                self.options.progress = Some(listener);
                self
            }

            /// Stops with [`Error::Cancelled`](crate::Error::Cancelled) soon after `cancel` is
            /// told to, from any thread.
            #[must_use]
            pub fn cancel(mut self, cancel: $crate::base::Cancel) -> Self {
                self.options.cancel = cancel;
                self
            }
        }
    };
}

/// The same for a builder with results that are worth keeping.
macro_rules! work_options {
    ($builder:ident) => {
        impl $builder {
            /// Keeps intermediate results in `folder` and reuses what is there of the same mesh and options: another
            /// number of parts then costs a fraction. An empty or new folder, or one that was used so before.
            #[must_use]
            pub fn work_dir(mut self, folder: impl Into<std::path::PathBuf>) -> Self {
                self.options.work_dir = Some(folder.into());
                self
            }

            /// Lets a work directory that is of another mesh, or of this one as it was before it changed, be made anew
            /// for this one; by default it is refused with [`Error::WorkDir`](crate::Error::WorkDir).
            #[must_use]
            pub fn force(mut self, force: bool) -> Self {
                self.options.force = force;
                self
            }
        }
    };
}
pub(super) use {run_options, work_options};

impl std::fmt::Debug for RunOptions {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let Self { threads, memory, seed, temporary, work_dir, force, progress: _, cancel: _ } = self;
        f.debug_struct("RunOptions")
            .field("threads", threads)
            .field("memory", memory)
            .field("seed", seed)
            .field("temporary", temporary)
            .field("work_dir", work_dir)
            .field("force", force)
            .finish_non_exhaustive()
    }
}

impl RunOptions {
    /// Those for what is done with a result: nobody listens, and neither what stopped the run nor whoever has its work
    /// directory by then is in the way.
    pub(super) fn afterwards(&self) -> Self {
        Self { work_dir: None, progress: None, cancel: Cancel::default(), ..self.clone() }
    }

    /// Calls `work` with the run and the work directory that the options ask for, and what the run tells.
    ///
    /// # Errors
    /// Those of `work`; [`crate::Error::WorkDir`] for a folder that is something else; [`crate::Error::Internal`] where
    /// the listener panics.
    pub(super) fn with<R>(&self, work: impl FnOnce(Context<'_>, &Told) -> Result<R>) -> Result<R> {
        let silent: &dyn Progress = &();
        let progress = self.progress.as_deref().map_or(silent, |progress| progress);
        let kept = Kept { progress, told: Told::default() };
        let mut run = Run::new(&kept);
        run.threads = self.threads.unwrap_or(run.threads);
        run.budget = self.memory.map_or(run.budget, Budget::new);
        run.cancel = self.cancel.clone();
        run.seed = self.seed;
        let place = match &self.work_dir {
            Some(folder) => WorkDir::open(folder)?,
            None => {
                let parent = self.temporary.clone().unwrap_or_else(std::env::temp_dir);
                WorkDir::in_memory(&parent, &run.budget)
            }
        };
        catch(|| work(Context::new(&place, &run), &kept.told))?
    }
}

/// A listener that keeps what reports tell, and passes everything on.
struct Kept<'a> {
    progress: &'a dyn Progress,
    told: Told,
}

impl Progress for Kept<'_> {
    fn begin(&self, stage: &str, unit: &'static str, total: u64) {
        self.progress.begin(stage, unit, total);
    }

    fn advance(&self, stage: &str, done: u64) {
        self.progress.advance(stage, done);
    }

    fn end(&self, stage: &str, seconds: f64) {
        self.told.end(stage, seconds);
        self.progress.end(stage, seconds);
    }

    fn note(&self, text: &str) {
        self.told.note(text);
        self.progress.note(text);
    }

    fn note_of_work(&self, text: &str) {
        self.progress.note_of_work(text);
    }
}
