//! How the library reports what it is doing; the command line draws progress bars from it.
//!
//! The silent implementation is `()`. Calls come from several threads; [`Progress::advance`] is
//! called once per chunk, never once per face.

use super::parallel::lock;
use std::collections::BTreeMap;
use std::sync::Mutex;
use std::time::Instant;

/// Receives progress of stages. Every method does nothing by default.
pub trait Progress: Sync {
    /// A stage of `total` units (`unit`: "faces", "rows", "bytes") begins. `total` 0: unknown.
    fn begin(&self, _stage: &str, _unit: &'static str, _total: u64) {}
    /// `done` more units of the stage are finished.
    fn advance(&self, _stage: &str, _done: u64) {}
    /// The stage is finished after `seconds`.
    fn end(&self, _stage: &str, _seconds: f64) {}
    /// A remark about the mesh or the result: an oddity of the input, an ambiguous match. Reports list it.
    fn note(&self, _text: &str) {}
    /// A remark about the work: a stage reused, a share that is already done. Passed to [`Progress::note`] by default.
    fn note_of_work(&self, text: &str) {
        self.note(text);
    }
}

impl Progress for () {}

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
