//! What ends a run: an interrupt, a request to terminate, or a terminal that goes away.
//!
//! The first signal lets files be closed and temporary folders go, a second one ends at once. Both end the program by
//! the signal itself rather than by an exit code, so that whoever started it sees why: a shell leaves its loop after
//! Ctrl-C only if the command died of it. A signal that whoever started the program has it ignore stays ignored: the
//! terminal's under `nohup`, the interrupts of a script's background jobs.

use nystrom_stream::base::Cancel;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use signal_hook::low_level::emulate_default_handler;
use std::sync::Arc;
use std::sync::atomic::{AtomicI32, Ordering};

/// The signal that has asked the run to end.
pub struct Heard(Arc<AtomicI32>);

impl Heard {
    /// The signal that ends the program after a run that was `done` or not. What is done has an exit code of its own,
    /// but Ctrl-C is meant for the shell's loop as well.
    pub fn ending(&self, done: bool) -> Option<i32> {
        match self.0.load(Ordering::SeqCst) {
            0 => None,
            signal if done && signal != SIGINT => None,
            signal => Some(signal),
        }
    }
}

/// Cancels `run` on a signal, in a thread of its own.
pub fn cancel_on(run: Cancel) -> Heard {
    let first = Arc::new(AtomicI32::new(0));
    let heard = Heard(first.clone());
    let ignored = ignored();
    let handled = [SIGHUP, SIGINT, SIGTERM].into_iter().filter(|signal| ignored >> (signal - 1) & 1 == 0);
    let Ok(mut signals) = Signals::new(handled) else { return heard };
    // Where the system gives no thread, those that work tell it.
    let _ = std::thread::Builder::new().spawn(move || {
        for signal in signals.forever() {
            if run.is_cancelled() {
                end_by(signal);
            }
            first.store(signal, Ordering::SeqCst);
            run.cancel();
        }
    });
    heard
}

/// Ends the program as `signal` does where nothing handles it.
pub fn end_by(signal: i32) -> ! {
    // The first process of a container does not die of its own signals, and would be aborted.
    if std::process::id() != 1 {
        let _ = emulate_default_handler(signal);
    }
    std::process::exit(code(signal))
}

/// The exit code that a shell tells of a process that died of `signal`.
pub fn code(signal: i32) -> i32 {
    128 + signal
}

/// The signals that are ignored, a bit each, from 1; none where the system does not tell.
fn ignored() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    line.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0)
}
