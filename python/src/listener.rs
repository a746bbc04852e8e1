//! Progress as a Python callback, and Ctrl-C as a stop.
//!
//! Python gives signals to its main thread alone, and stages of the library run on threads of their own. So a call works on another
//! thread, and the one that called waits there, calls back, and looks for signals: also in stages that tell nothing of themselves.

use super::raised;
use nystrom_stream::store::Run;
use nystrom_stream::{Cancel, Progress};
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;
use std::collections::BTreeMap;
use std::ffi::CString;
use std::sync::mpsc::{self, Sender};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Time between looks at Python.
const PATIENCE: Duration = Duration::from_millis(100);
/// Bytes of stack of a thread, as many as the main one has.
const STACK: usize = 8 << 20;

/// What the waiting thread hears.
enum Event {
    /// A stage, what of it is done, and what there is to do.
    Stage(String, u64, u64),
    /// The work is over.
    Over,
}

/// Hears of stages; tells the waiting thread.
pub struct Listener {
    events: Sender<Event>,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    /// Done and total by stage.
    stages: BTreeMap<String, (u64, u64)>,
    told: Option<Instant>,
}

impl Listener {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn tell(&self, stage: &str, (done, total): (u64, u64)) {
        // Nobody may hear it any more: a result can hold its listener.
        let _ = self.events.send(Event::Stage(stage.to_string(), done, total));
    }
}

impl Progress for Listener {
    fn begin(&self, stage: &str, _: &'static str, total: u64) {
        self.state().stages.insert(stage.to_string(), (0, total));
        self.tell(stage, (0, total));
    }

    fn advance(&self, stage: &str, done: u64) {
        let counts = {
            let mut state = self.state();
            let counts = state.stages.entry(stage.to_string()).or_default();
            counts.0 += done;
            let counts = *counts;
            if state.told.is_some_and(|told| told.elapsed() < PATIENCE) {
                return;
            }
            state.told = Some(Instant::now());
            counts
        };
        self.tell(stage, counts);
    }

    fn end(&self, stage: &str, _: f64) {
        let counts = {
            let state = self.state();
            let total = state.stages.get(stage).map_or(0, |counts| counts.1.max(counts.0));
            (total, total)
        };
        self.tell(stage, counts);
    }
}

/// Runs `work` without Python's lock. `callback` is called on this thread; what it or Ctrl-C raises stops the work, and comes before
/// its own error.
pub fn watched<T: Send>(
    py: Python<'_>,
    callback: Option<Py<PyAny>>,
    work: impl FnOnce(&Arc<Listener>, &Cancel) -> nystrom_stream::Result<T> + Send,
) -> PyResult<T> {
    let (events, heard) = mpsc::channel();
    let (cancel, over) = (Cancel::default(), events.clone());
    let listener = Arc::new(Listener { events, state: Mutex::default() });
    let mut failure = None;
    let wait = || {
        // Moved here: it is for one thread alone.
        let heard = heard;
        std::thread::scope(|scope| -> std::io::Result<_> {
            let work = || {
                let result = work(&listener, &cancel);
                let _ = over.send(Event::Over);
                result
            };
            let worker = std::thread::Builder::new().stack_size(STACK).spawn_scoped(scope, work)?;
            loop {
                let stage = match heard.recv_timeout(PATIENCE) {
                    Ok(Event::Stage(stage, done, total)) => Some((stage, done, total)),
                    Ok(Event::Over) => break,
                    // A panic says nothing.
                    Err(_) if worker.is_finished() => break,
                    Err(_) => None,
                };
                if failure.is_none()
                    && let Err(error) = Python::attach(|py| look(py, callback.as_ref(), stage))
                {
                    cancel.cancel();
                    failure = Some(error);
                }
            }
            Ok(worker.join())
        })
    };
    let joined = py.detach(wait);
    match (failure, joined) {
        (Some(error), _) => Err(error),
        (None, Err(error)) => Err(PyErr::from(error)),
        (None, Ok(Err(panic))) => std::panic::resume_unwind(panic),
        (None, Ok(Ok(result))) => result.map_err(raised),
    }
}

/// Looks for Ctrl-C, and calls back where there is something to tell.
fn look(py: Python<'_>, callback: Option<&Py<PyAny>>, stage: Option<(String, u64, u64)>) -> PyResult<()> {
    py.check_signals()?;
    callback.zip(stage).map_or(Ok(()), |(callback, told)| callback.call1(py, told).map(drop))
}

/// Keeps notes.
#[derive(Default)]
struct Notes(Mutex<Vec<String>>);

impl Progress for Notes {
    fn note(&self, text: &str) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(text.to_string());
    }
}

/// [`watched`] for work that takes a run and tells no progress. Its notes become warnings: what a form of file loses is told there.
pub fn run<T: Send>(py: Python<'_>, work: impl FnOnce(&Run) -> nystrom_stream::Result<T> + Send) -> PyResult<T> {
    let (result, notes) = watched(py, None, |_, cancel| {
        let notes = Notes::default();
        let result = work(&Run { cancel: cancel.clone(), ..Run::new(&notes) })?;
        Ok((result, notes.0.into_inner().unwrap_or_else(PoisonError::into_inner)))
    })?;
    for note in notes {
        // Of the line that called the package, not of the package's own.
        PyErr::warn(py, &py.get_type::<PyUserWarning>(), &CString::new(note.replace('\0', " "))?, 2)?;
    }
    Ok(result)
}
