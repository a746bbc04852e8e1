//! Progress on standard error: a bar a stage on a terminal, a line a stage otherwise, nothing when quiet.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use nystrom_stream::base::Progress;
use std::collections::BTreeMap;
use std::io::{IsTerminal, Write};
use std::sync::Mutex;

/// The listener of a run.
pub struct Bars {
    quiet: bool,
    terminal: bool,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    bars: BTreeMap<String, ProgressBar>,
    totals: BTreeMap<String, (u64, &'static str)>,
    seconds: BTreeMap<String, f64>,
}

impl Bars {
    /// A listener; silent where `quiet`.
    pub fn new(quiet: bool) -> Self {
        let terminal = std::io::stderr().is_terminal();
        Self { quiet, terminal, state: Mutex::default() }
    }

    fn state(&self) -> std::sync::MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(|poison| poison.into_inner())
    }

    /// Seconds by stage so far; emptied.
    pub fn take_seconds(&self) -> BTreeMap<String, f64> {
        std::mem::take(&mut self.state().seconds)
    }
}

/// 1234567 as 1.23 M.
pub fn human(x: f64) -> String {
    match x {
        x if x >= 1e9 => format!("{:.2} G", x / 1e9),
        x if x >= 1e6 => format!("{:.2} M", x / 1e6),
        x if x >= 1e4 => format!("{:.1} k", x / 1e3),
        x => format!("{x:.0}"),
    }
}

impl Progress for Bars {
    fn begin(&self, stage: &str, unit: &'static str, total: u64) {
        let mut state = self.state();
        state.totals.insert(stage.to_string(), (total, unit));
        if self.quiet || !self.terminal {
            return;
        }
        let bar = ProgressBar::with_draw_target((total > 0).then_some(total), ProgressDrawTarget::stderr());
        let template = format!("{{msg:10}} {{bar:32}} {{human_pos}}/{{human_len}} {unit}  {{per_sec}}  {{eta}} left");
        if let Ok(style) = ProgressStyle::with_template(&template) {
            bar.set_style(style);
        }
        bar.set_message(stage.to_string());
        bar.enable_steady_tick(std::time::Duration::from_millis(200));
        state.bars.insert(stage.to_string(), bar);
    }

    fn advance(&self, stage: &str, done: u64) {
        if let Some(bar) = self.state().bars.get(stage) {
            bar.inc(done);
        }
    }

    fn end(&self, stage: &str, seconds: f64) {
        let mut state = self.state();
        *state.seconds.entry(stage.to_string()).or_default() += seconds;
        if let Some(bar) = state.bars.remove(stage) {
            bar.finish_and_clear();
        }
        if !self.quiet {
            let (total, unit) = state.totals.remove(stage).unwrap_or((0, ""));
            let rate = if total > 0 && seconds > 0. {
                format!(", {}{unit}/s", human(total as f64 / seconds))
            } else {
                String::new()
            };
            let _ = writeln!(std::io::stderr(), "{stage:10} {seconds:8.3} s  {} {unit}{rate}", human(total as f64));
        }
    }

    fn note(&self, text: &str) {
        if !self.quiet {
            let _ = writeln!(std::io::stderr(), "{text}");
        }
    }
}
