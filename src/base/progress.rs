//! How the library reports what it is doing; the command line draws progress bars from it.
//!
//! The silent implementation is `()`. Calls come from several threads; [`Progress::advance`] is
//! called once per chunk, never once per face.

use super::parallel::lock;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Instant;

/// Receives progress of stages. Every method does nothing by default.
///
/// A stage that fails or is cancelled begins but does not end, and its error is returned. So a listener that displays
/// stages removes what it displays of unfinished ones when it is dropped; if a stage of the same name begins again, it
/// replaces the first.
///
/// Builders take a listener, or an `Arc` or `Box` of one, also of one chosen at run time:
///
/// ```
/// use nystrom_stream::{Progress, Segmenter, Sequencer};
/// use std::sync::Arc;
/// struct Log;
/// impl Progress for Log {
///     fn note(&self, text: &str) {
///         eprintln!("{text}");
///     }
/// }
/// let verbose = true;
/// let listener: Arc<dyn Progress + Send> = if verbose { Arc::new(Log) } else { Arc::new(()) };
/// let segmenter = Segmenter::new().progress(listener.clone());
/// let sequencer = Sequencer::new().progress(listener);
/// # drop((segmenter, sequencer));
/// ```
pub trait Progress: Sync {
    /// A stage of `total` units (`unit`: "faces", "rows", "bytes") begins. `total` 0: unknown.
    fn begin(&self, _stage: &str, _unit: &'static str, _total: u64) {}
    /// `done` more units of the stage are finished.
    fn advance(&self, _stage: &str, _done: u64) {}
    /// The stage has succeeded after `seconds`.
    fn end(&self, _stage: &str, _seconds: f64) {}
    /// A remark about the mesh or the result: an oddity of the input, an ambiguous match. Reports list it.
    fn note(&self, _text: &str) {}
    /// A remark about the work: a stage reused, a share that is already done. Passed to [`Progress::note`] by default.
    fn note_of_work(&self, text: &str) {
        self.note(text);
    }
}

impl Progress for () {}

/// A pointer to a listener is one, too.
macro_rules! through {
    ($pointer:ty $(, $bound:ident)?) => {
        impl<T: Progress $(+ $bound)? + ?Sized> Progress for $pointer {
            fn begin(&self, stage: &str, unit: &'static str, total: u64) {
                (**self).begin(stage, unit, total);
            }

            fn advance(&self, stage: &str, done: u64) {
                (**self).advance(stage, done);
            }

            fn end(&self, stage: &str, seconds: f64) {
                (**self).end(stage, seconds);
            }

            fn note(&self, text: &str) {
                (**self).note(text);
            }

            fn note_of_work(&self, text: &str) {
                (**self).note_of_work(text);
            }
        }
    };
}
through!(&T);
through!(Box<T>);
through!(Arc<T>, Send);

/// What a listener keeps of a run for its report: seconds per stage, and the notes about the mesh and the result.
#[derive(Debug)]
pub struct RunLog {
    start: Instant,
    seconds: Mutex<BTreeMap<String, f64>>,
    notes: Mutex<Vec<String>>,
}

impl Default for RunLog {
    /// Nothing recorded; the clock starts now.
    fn default() -> Self {
        Self { start: Instant::now(), seconds: Mutex::default(), notes: Mutex::default() }
    }
}

impl RunLog {
    /// Adds the `seconds` of a stage that has ended.
    pub fn end(&self, stage: &str, seconds: f64) {
        *lock(&self.seconds).entry(stage.to_owned()).or_default() += seconds;
    }

    /// Keeps a note.
    pub fn note(&self, text: &str) {
        lock(&self.notes).push(text.to_owned());
    }

    /// Seconds by stage so far, and since the run began as `total`.
    pub fn seconds(&self) -> BTreeMap<String, f64> {
        let mut seconds = lock(&self.seconds).clone();
        seconds.insert("total".into(), self.start.elapsed().as_secs_f64());
        seconds
    }

    /// The notes so far.
    pub fn notes(&self) -> Vec<String> {
        lock(&self.notes).clone()
    }
}
