//! Examples for the long help; man pages, completions and `docs/reference.md`, generated from the same definitions as
//! the help.

use super::options::CliError;
use super::sink::{Sink, print};
use clap::{Arg, Command};
use clap_complete::Shell;
use nystrom_stream::base::Error;
use nystrom_stream::store::json;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::PathBuf;

/// After the help of the program.
pub const PROGRAM: &str = "\
Examples:
  nystrom-stream segment scan.ply                      finds the number of parts, writes scan.segmented.ply
  nystrom-stream segment scan.ply -k 6 -o parts.seg    exactly six parts; one label per line
  nystrom-stream segment scans/ --jobs 2 --resume      a folder of meshes, skipping those already done
  nystrom-stream demo                                  a first look, without a mesh of your own

Exit codes: 0 success; 1 a file cannot be used, or the system failed; 2 invalid command line. An interrupted run cleans
up and ends by the signal: a shell reports 130 after Ctrl-C, 143 after SIGTERM.";

/// After the help of `segment`.
pub const SEGMENT: &str = "\
Examples:
  nystrom-stream segment scan.ply --parts-range 4..12
  nystrom-stream segment scan.ply -o out.ply -o out.seg -o out.png --json=report.json
  nystrom-stream segment scan.ply -k 6 --cluster kmeans --metric paper --normalise none
  nystrom-stream segment scans/ -o 'labels/{}.seg' --jobs 2 --json-lines=all.jsonl --resume
  zcat scan.ply.gz | nystrom-stream segment - -k 6 > labelled.ply
  find scans -name '*.ply' ! -name '*.segmented.ply' -print0 | xargs -0 nystrom-stream segment";

/// After the help of `graph`, `rows`, `embed`, `cluster` and `export`.
pub const STAGES: &str = "\
Examples, the stages of `segment` one by one:
  nystrom-stream graph scan.ply --work-dir work
  nystrom-stream rows --work-dir work -l 40
  nystrom-stream cluster --work-dir work -k 9          changing the number of parts takes a moment
  nystrom-stream cluster --work-dir work --detail 0.5 -o finer.seg
  nystrom-stream export --work-dir work -o parts.ply --tree tree.json
  nystrom-stream embed --work-dir work -d 8            embedding.npy, for other programs";

/// After the help of `share`.
pub const SHARE: &str = "\
Examples, on two machines that share a folder; start each step when the one before is done on both:
  nystrom-stream share normals scan.ply --work-dir work --shard 0/2         the other machine: --shard 1/2
  nystrom-stream share contraction scan.ply --work-dir work --shard 0/2
  nystrom-stream share rows scan.ply --work-dir work --shard 0/2
  nystrom-stream share depths scan.ply --work-dir work --shard 0/2          from here on with -k or --detail, if segment has them
  nystrom-stream share bands scan.ply --work-dir work --shard 0/2
  nystrom-stream segment scan.ply --work-dir work -o parts.ply              on one of them: the rest";

/// After the help of `sequence`.
pub const SEQUENCE: &str = "\
Examples:
  nystrom-stream sequence scan.ply                     scan.sequenced.ply, in an order that keeps few vertices in use
  nystrom-stream sequence scan.ply -o out.ply -o order.png --smooth 20 --original
  nystrom-stream sequence scan.ply --order bfs -o out.ply
  nystrom-stream sequence scan.ply --compare           a table of all orders, nothing written";

/// After the help of `transfer-labels`.
pub const TRANSFER: &str = "\
Examples:
  nystrom-stream transfer-labels scan.segmented.ply decimated.ply -o decimated.segmented.ply
  nystrom-stream transfer-labels scan.ply remeshed.obj --labels scan.seg -o remeshed.seg --json";

/// Arguments of `completions`.
#[derive(Clone, Debug, clap::Args)]
pub struct CompletionArgs {
    /// The shell
    #[arg(value_name = "SHELL")]
    pub shell: Shell,
}

/// Arguments of `man`.
#[derive(Clone, Debug, clap::Args)]
pub struct ManArgs {
    /// The folder for the pages, one page per subcommand
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
    /// Write docs/reference.md instead, to DIR as a file; `-` for standard output
    #[arg(long, hide = true)]
    pub markdown: bool,
}

/// Writes completions to standard output.
pub fn completions(args: &CompletionArgs, mut program: Command) -> Result<(), CliError> {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut program, "nystrom-stream", &mut text);
    print(&text)?;
    Ok(())
}

/// Writes man pages, or all of them as one page of Markdown.
pub fn man(args: &ManArgs, program: Command) -> Result<(), CliError> {
    let folder = &args.folder;
    if args.markdown {
        return Ok(Sink::of(folder).write(&markdown(program))?);
    }
    if folder.as_os_str() == "-" {
        return Err(CliError::Usage("-: man pages are several files; give a folder".into()));
    }
    std::fs::create_dir_all(folder).map_err(Error::io(folder, "create"))?;
    let mut program = program.disable_help_subcommand(true);
    program.build();
    let commands = program.get_subcommands().filter(|command| !command.is_hide_set()).cloned();
    for command in commands.collect::<Vec<_>>().into_iter().chain([program]) {
        let page = clap_mangen::Man::new(command);
        let (path, mut text) = (folder.join(page.get_filename()), Vec::new());
        page.render(&mut text).map_err(Error::io(&path, "write"))?;
        json::publish(&path, &text)?;
    }
    Ok(())
}

/// The reference of all subcommands as Markdown. A group of options that an earlier subcommand also has is not
/// repeated.
fn markdown(mut program: Command) -> String {
    program.build();
    let mut text =
        "# Command-line reference\n\nEvery subcommand with its arguments and options, as shown by `--help`. \
        This page is generated from the definitions: `cargo run -- man --markdown docs/reference.md`.\n\n"
            .to_string();
    let commands = || program.get_subcommands().filter(|command| command.get_name() != "help");
    for command in commands() {
        let (name, about) = (command.get_name(), command.get_about().map(ToString::to_string).unwrap_or_default());
        let _ = writeln!(text, "- [`{name}`](#{name}): {about}");
    }
    let mut known: BTreeMap<(String, String), String> = BTreeMap::new();
    for command in commands() {
        let (name, about) = (command.get_name(), command.get_about().map(ToString::to_string).unwrap_or_default());
        let usage = command.clone().render_usage().to_string();
        let usage = usage.trim_start_matches("Usage:").lines().map(str::trim).collect::<Vec<_>>().join("\n");
        let _ = write!(text, "\n## {name}\n\n{about}.\n\n```\n{usage}\n```\n");
        for (heading, rows) in groups(command) {
            let title = if heading.is_empty() { "Arguments and options" } else { &heading };
            match known.get(&(heading.clone(), rows.clone())) {
                Some(first) => {
                    let _ = write!(text, "\n**{title}**: the same as those of [`{first}`](#{first}).\n");
                }
                None => {
                    let _ = write!(text, "\n| {title} | |\n| --- | --- |\n{rows}");
                    known.insert((heading, rows), name.to_string());
                }
            }
        }
        if let Some(examples) = command.get_after_long_help() {
            let _ = write!(text, "\n```\n{}\n```\n", examples.to_string().trim_end());
        }
    }
    text
}

/// The arguments of `command` by heading, in help order, as rows of a table.
fn groups(command: &Command) -> Vec<(String, String)> {
    let mut groups: Vec<(String, String)> = Vec::new();
    let shown = |arg: &&Arg| !arg.is_hide_set() && !["help", "version"].contains(&arg.get_id().as_str());
    let (positional, options): (Vec<&Arg>, Vec<&Arg>) =
        command.get_arguments().filter(shown).partition(|arg| arg.is_positional());
    for arg in positional.into_iter().chain(options) {
        let heading = arg.get_help_heading().unwrap_or_default();
        let place = groups.iter().position(|(known, _)| known == heading).unwrap_or_else(|| {
            groups.push((heading.to_string(), String::new()));
            groups.len() - 1
        });
        groups[place].1 += &row(arg);
    }
    groups
}

/// An argument as a row: its syntax, help, default and values.
fn row(arg: &Arg) -> String {
    let mut help = arg.get_long_help().or(arg.get_help()).map(ToString::to_string).unwrap_or_default();
    if arg.get_action().takes_values() {
        let defaults: Vec<_> = arg.get_default_values().iter().map(|value| value.to_string_lossy()).collect();
        if !defaults.is_empty() {
            let _ = write!(help, " [default: {}]", defaults.join(","));
        }
        for value in arg.get_possible_values().iter().filter(|value| !value.is_hide_set()) {
            let description = value.get_help().map(|help| format!(": {help}")).unwrap_or_default();
            let _ = write!(help, "<br>`{}`{description}", value.get_name());
        }
    }
    let short = arg.get_short().map(|short| format!("-{short}, ")).unwrap_or_default();
    let cell = |text: String| text.replace('\n', " ").replace('|', "\\|");
    format!("| `{}` | {} |\n", cell(format!("{short}{arg}")), cell(help))
}
