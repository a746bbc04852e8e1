//! What ends a run: an interrupt, a request to terminate, or a terminal that goes away.
//!
//! After the first signal, files are closed and temporary folders removed; a second one ends the program at once. Both
//! end it by the signal itself rather than by an exit code, so that the parent process sees the cause: a shell leaves
//! its loop after Ctrl-C only if the command died of it. A signal that the parent has set to be ignored stays ignored:
//! the terminal's under `nohup`, interrupts in background jobs of a script.

use nystrom_stream::base::Cancel;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use signal_hook::low_level::emulate_default_handler;
use std::sync::Arc;
use std::sync::atomic::{AtomicI32, Ordering};

/// The signal that requested the end of the run.
pub struct ReceivedSignal(Arc<AtomicI32>);

impl ReceivedSignal {
    /// The signal that ends the program after a run that was `done` or not. A finished run has its own exit code, but
    /// Ctrl-C is also meant for the shell's loop.
    pub fn exit_signal(&self, done: bool) -> Option<i32> {
        match self.0.load(Ordering::SeqCst) {
            0 => None,
            signal if done && signal != SIGINT => None,
            signal => Some(signal),
        }
    }
}

/// Cancels `run` on a signal, in a separate thread.
pub fn cancel_on(run: Cancel) -> ReceivedSignal {
    let first = Arc::new(AtomicI32::new(0));
    let received = ReceivedSignal(first.clone());
    let ignored = ignored();
    let handled = [SIGHUP, SIGINT, SIGTERM].into_iter().filter(|signal| ignored >> (signal - 1) & 1 == 0);
    let Ok(mut signals) = Signals::new(handled) else { return received };
    // If the system refuses a thread, the workers will report that too.
    let _ = std::thread::Builder::new().spawn(move || {
        for signal in signals.forever() {
            if run.is_cancelled() {
                end_by(signal);
            }
            first.store(signal, Ordering::SeqCst);
            run.cancel();
        }
    });
    received
}

/// Ends the program as `signal` does by default.
pub fn end_by(signal: i32) -> ! {
    // The first process of a container is not killed by its own signals; raising one would only lead to an abort.
    if std::process::id() != 1 {
        let _ = emulate_default_handler(signal);
    }
    std::process::exit(code(signal))
}

/// The exit code that a shell reports for a process killed by `signal`.
pub fn code(signal: i32) -> i32 {
    128 + signal
}

/// The ignored signals, one bit each, from 1; none if the system does not say.
fn ignored() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    line.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0)
}
