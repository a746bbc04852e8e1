//! What ends a run: an interrupt, a request to terminate, or a terminal that goes away.
//!
//! The first signal lets files be closed and temporary folders go, a second one ends at once. A signal that whoever
//! started the program has it ignore stays ignored: the terminal's under `nohup`, the interrupts of a script's
//! background jobs.

use nystrom_stream::base::Cancel;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

/// Cancels `run` on a signal, in a thread of its own.
pub fn cancel_on(run: Cancel) {
    let ignored = ignored();
    let heard = [SIGHUP, SIGINT, SIGTERM].into_iter().filter(|signal| ignored >> (signal - 1) & 1 == 0);
    let Ok(mut signals) = Signals::new(heard) else { return };
    std::thread::spawn(move || {
        for _ in signals.forever() {
            if run.is_cancelled() {
                std::process::exit(1);
            }
            run.cancel();
        }
    });
}

/// The signals that are ignored, a bit each, from 1; none where the system does not tell.
fn ignored() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    line.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0)
}
