//! Progress on standard error: one bar per stage on a terminal, one line per stage otherwise (and one every ten seconds
//! while a stage runs), JSON events or nothing on request. For several meshes: one overall bar and one per running
//! mesh, or one line per mesh. No colours, so `NO_COLOR` is respected.
//!
//! The library names stages by short words, which are also keys of reports and JSON events; people see the words in
//! [`STAGES`].

use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use nystrom_stream::base::printable::{self, human};
use nystrom_stream::base::{Progress, RunLog};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::{IsTerminal, Write};
use std::path::Path;
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Minimum time between two JSON events of a stage.
const EVENT: Duration = Duration::from_millis(100);
/// Interval of lines for a stage that is still running, if there are no bars.
const STILL: Duration = Duration::from_secs(10);

/// Stages of the library and their names for people.
const STAGES: [(&str, &str); 27] = [
    ("alignment", "alignment"),
    ("assign", "assigning faces"),
    ("boundaries", "boundaries"),
    ("cell rows", "patch distances"),
    ("cells", "surface patches"),
    ("compare", "comparison"),
    ("contraction", "coarser mesh"),
    ("coordinates", "coordinates"),
    ("distances", "all distances"),
    ("draw", "drawing"),
    ("evaluate", "evaluation"),
    ("graph", "dual graph"),
    ("march", "distances"),
    ("match", "matching"),
    ("merge", "merging rows"),
    ("normals", "surface normals"),
    ("order", "face order"),
    ("parts", "parts"),
    ("read", "reading"),
    ("rows", "distance rows"),
    ("runs", "trials"),
    ("surface", "surface patches"),
    ("sweeps", "smoothing"),
    ("verify", "verification"),
    ("vertices", "vertex order"),
    ("weights", "edge weights"),
    ("write", "writing"),
];

/// The name of `stage` for people.
pub fn words(stage: &str) -> &str {
    STAGES.iter().find(|(name, _)| *name == stage).map_or(stage, |(_, words)| words)
}

/// The name of a unit for people.
fn unit_words(unit: &str) -> &str {
    match unit {
        "guesses" => "alignments",
        unit => unit,
    }
}

/// The same for `count` of them.
fn unit_of(count: u64, unit: &str) -> &str {
    match (count, unit_words(unit)) {
        (1, "meshes") => "mesh",
        (1, "vertices") => "vertex",
        (1, words) => words.strip_suffix('s').unwrap_or(words),
        (_, words) => words,
    }
}

/// How progress is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// One bar per stage.
    Terminal,
    /// One line per stage.
    Lines,
    /// One JSON object per line.
    Json,
    /// Nothing.
    Quiet,
}

impl Style {
    /// Bars on a terminal, lines elsewhere.
    pub fn of_terminal() -> Self {
        if std::io::stderr().is_terminal() { Self::Terminal } else { Self::Lines }
    }
}

/// The listener of a run.
pub struct Bars {
    style: Style,
    /// The mesh of a batch, with its bar, for which this listens.
    mesh: Option<(String, ProgressBar)>,
    log: RunLog,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    bars: BTreeMap<String, ProgressBar>,
    stages: BTreeMap<String, Stage>,
}

/// A stage that is running.
struct Stage {
    unit: &'static str,
    total: u64,
    done: u64,
    start: Instant,
    reported: Instant,
}

impl Stage {
    /// A line about the stage `name` while it runs.
    fn still(&self, name: &str) -> String {
        let seconds = self.start.elapsed().as_secs_f64();
        let done = human(self.done as f64);
        let of = if self.total > 0 { format!(" of {}", human(self.total as f64)) } else { String::new() };
        let unit = unit_of(if self.total > 0 { self.total } else { self.done }, self.unit);
        format!("{:16} {seconds:8.0} s  {done}{of} {unit} so far", words(name))
    }
}

/// A bar of `total` units (0: unknown) with the given `template`.
fn bar(target: ProgressDrawTarget, total: u64, template: &str) -> ProgressBar {
    let bar = ProgressBar::with_draw_target((total > 0).then_some(total), target);
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar
}

/// Prints text on standard error, made safe for terminals; a failure to write is ignored.
pub fn tell(text: &str) {
    let _ = writeln!(std::io::stderr(), "{}", printable::lines(text));
}

/// Reports an error in the given `style`: a line of text, or an event with the `file` concerned and the further fields
/// `has`.
pub fn tell_error(style: Style, text: &str, file: Option<&Path>, has: Value) {
    if style != Style::Json {
        return tell(&format!("nystrom-stream: {text}"));
    }
    let mut event = json!({"error": text});
    if let Some(file) = file {
        event["file"] = file.to_string_lossy().into();
    }
    if let (Some(event), Value::Object(has)) = (event.as_object_mut(), has) {
        event.extend(has);
    }
    tell_json(&event);
}

/// Prints a line of JSON, which escapes control characters itself.
fn tell_json(event: &Value) {
    let _ = writeln!(std::io::stderr(), "{event}");
}

impl Bars {
    /// A listener.
    pub fn new(style: Style) -> Self {
        Self { style, mesh: None, log: RunLog::default(), state: Mutex::default() }
    }

    /// Its style.
    pub fn style(&self) -> Style {
        self.style
    }

    fn state(&self) -> std::sync::MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(|poison| poison.into_inner())
    }

    /// The seconds and notes so far, whether or not they were shown.
    pub fn log(&self) -> &RunLog {
        &self.log
    }

    /// Prints a separate line above the bars.
    fn say(&self, text: &str) {
        match (&self.mesh, self.state().bars.values().next()) {
            (Some((_, bar)), _) | (None, Some(bar)) => bar.suspend(|| tell(text)),
            _ => tell(text),
        }
    }

    /// Prints a JSON event.
    fn event(&self, mut event: Value) {
        if let (Some((mesh, _)), Some(fields)) = (&self.mesh, event.as_object_mut()) {
            fields.insert("mesh".into(), mesh.as_str().into());
        }
        tell_json(&event);
    }
}

impl Bars {
    /// Shows a note whose text needs no other words.
    fn show_note(&self, text: &str) {
        let text = &*printable::line(text);
        match (self.style, &self.mesh) {
            (Style::Quiet, _) => {}
            (Style::Json, _) => self.event(json!({"note": text})),
            // For several meshes, reused stages are not reported.
            (_, Some(_)) if text.ends_with(": reused") => {}
            // Most notes about a file already start with its name.
            (_, Some((mesh, _))) if text.starts_with(&*printable::line(mesh)) => self.say(text),
            (_, Some((mesh, _))) => self.say(&format!("{}: {text}", printable::line(mesh))),
            (_, None) => self.say(text),
        }
    }
}

impl Progress for Bars {
    fn begin(&self, stage: &str, unit: &'static str, total: u64) {
        let now = Instant::now();
        let mut state = self.state();
        state.stages.insert(stage.to_string(), Stage { unit, total, done: 0, start: now, reported: now });
        match (self.style, &self.mesh) {
            (Style::Terminal, Some((_, bar))) => {
                if total > 0 {
                    bar.set_length(total)
                } else {
                    bar.unset_length()
                }
                bar.set_position(0);
                bar.set_message(words(stage).to_string());
            }
            (Style::Terminal, None) => {
                let template = format!(
                    "{{msg:16}} {{bar:32}} {{human_pos}}/{{human_len}} {}  {{per_sec}}  {{eta}} left",
                    unit_words(unit)
                );
                let bar = bar(ProgressDrawTarget::stderr(), total, &template);
                bar.set_message(words(stage).to_string());
                bar.enable_steady_tick(Duration::from_millis(200));
                state.bars.insert(stage.to_string(), bar);
            }
            (Style::Json, _) => {
                self.event(json!({"stage": stage, "unit": unit, "done": 0, "total": total, "seconds": 0.}));
            }
            _ => {}
        }
    }

    fn advance(&self, stage: &str, done: u64) {
        let mut state = self.state();
        if let Some((_, bar)) = &self.mesh {
            bar.inc(done);
        } else if let Some(bar) = state.bars.get(stage) {
            bar.inc(done);
        }
        let Some(known) = state.stages.get_mut(stage) else { return };
        known.done = known.done.saturating_add(done);
        let patience = if self.style == Style::Lines { STILL } else { EVENT };
        if !matches!(self.style, Style::Json | Style::Lines) || known.reported.elapsed() < patience {
            return;
        }
        if self.style == Style::Lines {
            known.reported = Instant::now();
            let line = known.still(stage);
            match &self.mesh {
                Some((mesh, _)) => tell(&format!("{}: {line}", printable::line(mesh))),
                None => tell(&line),
            }
        } else {
            known.reported = Instant::now();
            let (done, seconds) = (known.done, known.start.elapsed().as_secs_f64());
            let (unit, total) = (known.unit, known.total);
            self.event(json!({"stage": stage, "unit": unit, "done": done, "total": total, "seconds": seconds}));
        }
    }

    fn end(&self, stage: &str, seconds: f64) {
        self.log.end(stage, seconds);
        let mut state = self.state();
        if let Some(bar) = state.bars.remove(stage) {
            bar.finish_and_clear();
        }
        let (total, unit) = state.stages.remove(stage).map_or((0, ""), |known| (known.total, known.unit));
        match self.style {
            Style::Json => {
                self.event(json!({"stage": stage, "unit": unit, "done": total, "total": total, "seconds": seconds}));
            }
            Style::Terminal | Style::Lines if self.mesh.is_none() => {
                let (stage, unit) = (words(stage), unit_words(unit));
                let rate = if total > 0 && seconds > 0. {
                    format!(", {} {unit}/s", human(total as f64 / seconds))
                } else {
                    String::new()
                };
                let one = unit_of(total, unit);
                let amount = if total > 0 { format!("  {} {one}{rate}", human(total as f64)) } else { String::new() };
                tell(&format!("{stage:16} {seconds:8.3} s{amount}"));
            }
            _ => {}
        }
    }

    fn note(&self, text: &str) {
        self.log.note(text);
        self.show_note(text);
    }

    fn note_of_work(&self, text: &str) {
        // Notes about a stage start with its name; those about a mesh may start with the same word as a file's name.
        let in_words = text.split_once(": ").map(|(stage, rest)| format!("{}: {rest}", words(stage)));
        self.show_note(match self.style {
            Style::Json => text,
            _ => in_words.as_deref().unwrap_or(text),
        });
    }
}

/// The listener of a batch: one overall bar; its meshes have their own listeners.
pub struct BatchBars {
    style: Style,
    multi: MultiProgress,
    all: ProgressBar,
    start: Instant,
    total: u64,
}

impl BatchBars {
    /// A listener to `total` meshes.
    pub fn new(style: Style, total: u64) -> Self {
        let terminal = style == Style::Terminal;
        let target = if terminal { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
        let multi = MultiProgress::with_draw_target(target);
        let all =
            bar(ProgressDrawTarget::hidden(), total, "meshes           {bar:32} {pos}/{len}  {elapsed}, {eta} left");
        let all = multi.add(all);
        all.tick();
        Self { style, multi, all, start: Instant::now(), total }
    }

    /// The listener of one mesh.
    pub fn of_mesh(&self, name: &str) -> Bars {
        let file = Path::new(name).file_name().map_or(name.into(), |name| name.to_string_lossy());
        let mesh = bar(ProgressDrawTarget::hidden(), 0, "  {prefix:20!} {msg:16} {bar:24} {human_pos}/{human_len}");
        let mesh = self.multi.add(mesh);
        mesh.set_prefix(printable::line(&file).into_owned());
        Bars { mesh: Some((name.to_string(), mesh)), ..Bars::new(self.style) }
    }

    /// A mesh is finished; `line` describes the result.
    pub fn end(&self, bars: &Bars, line: &str) {
        if let Some((_, bar)) = &bars.mesh {
            bar.finish_and_clear();
            self.multi.remove(bar);
        }
        self.all.inc(1);
        match self.style {
            Style::Terminal | Style::Lines if !line.is_empty() => self.multi.suspend(|| tell(line)),
            Style::Json => {
                let (done, seconds) = (self.all.position(), self.start.elapsed().as_secs_f64());
                let event =
                    json!({"stage": "meshes", "unit": "meshes", "done": done, "total": self.total, "seconds": seconds});
                tell_json(&event);
            }
            _ => {}
        }
    }

    /// Prints `text` whatever the style.
    pub fn say(&self, text: &str) {
        self.multi.suspend(|| tell(text));
    }

    /// Reports why `mesh` failed: `text`, about `file`.
    pub fn complain(&self, mesh: &Path, text: &str, file: Option<&Path>) {
        let has = json!({"mesh": mesh.to_string_lossy()});
        self.multi.suspend(|| tell_error(self.style, text, file, has));
    }

    /// Removes the bar.
    pub fn finish(&self) {
        self.all.finish_and_clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_that_takes_long_is_told_of() {
        let now = Instant::now();
        let stage = Stage { unit: "rows", total: 30, done: 12, start: now, reported: now };
        assert_eq!(stage.still("rows"), "distance rows           0 s  12 of 30 rows so far");
        let stage = Stage { unit: "faces", total: 0, done: 2_500_000, start: now, reported: now };
        assert_eq!(stage.still("graph"), "dual graph              0 s  2.50 M faces so far");
        assert_eq!(["faces", "meshes", "vertices"].map(|unit| unit_of(1, unit)), ["face", "mesh", "vertex"]);
    }
}
