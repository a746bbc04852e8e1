//! Progress as a Python callback, and Ctrl-C as a stop.

use nystrom_stream::{Cancel, Progress};
use pyo3::prelude::*;
use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Time between looks at Python while a stage runs.
const PATIENCE: Duration = Duration::from_millis(100);

/// Hears of stages; tells Python.
pub struct Listener {
    callback: Option<Py<PyAny>>,
    cancel: Cancel,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    /// Done and total by stage.
    stages: BTreeMap<String, (u64, u64)>,
    looked: Option<Instant>,
    failure: Option<PyErr>,
}

impl Listener {
    pub fn new(callback: Option<Py<PyAny>>, cancel: Cancel) -> Self {
        Self { callback, cancel, state: Mutex::default() }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What the callback or Ctrl-C raised.
    pub fn failure(&self) -> Option<PyErr> {
        self.state().failure.take()
    }

    /// Calls back, and looks for Ctrl-C; not while another thread does.
    fn tell(&self, stage: &str, (done, total): (u64, u64)) {
        let result = Python::attach(|py| {
            py.check_signals()?;
            match &self.callback {
                Some(callback) => callback.call1(py, (stage, done, total)).map(drop),
                None => Ok(()),
            }
        });
        if let Err(error) = result {
            self.cancel.cancel();
            self.state().failure.get_or_insert(error);
        }
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
            if state.looked.is_some_and(|looked| looked.elapsed() < PATIENCE) {
                return;
            }
            state.looked = Some(Instant::now());
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
