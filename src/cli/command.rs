//! The command line as parsed: adaptations of the derived one for single subcommands.
//!
//! Groups of options are shared by subcommands that continue from a work directory and by others that do not, and
//! options that take numbers must reject negative ones with a message of their own.

use super::Cli;
use clap::builder::ValueParser;
use clap::{Arg, Command, CommandFactory};
use std::any::TypeId;

/// Suffix in the help of options whose default is that of the work directory.
const KEPT: &str = ", or as in the work directory";

/// Part of the help of `--tmp` if there is an output.
const BESIDE_OUTPUT: &str = "that of the output";

/// The command with all subcommands.
pub fn parsed() -> Command {
    Cli::command().mut_subcommands(|subcommand| {
        let name = subcommand.get_name().to_string();
        subcommand.mut_args(|arg| adapted(&name, arg))
    })
}

/// `arg` adapted to `subcommand`.
fn adapted(subcommand: &str, arg: Arg) -> Arg {
    let arg = if is_number(arg.get_value_parser()) { arg.allow_negative_numbers(true) } else { arg };
    let arg = match (arg.get_id().as_str(), subcommand) {
        // The rows of `rows` are always over all faces, and those shared by others never are.
        ("exact", "rows" | "share") => arg.hide(true),
        ("landmarks", "rows") => arg.help(
            "Number of landmarks [default: 120, above 60,000 faces 60 to 20 by size; with kmeans and two-means twice the \
             parts, 10 to 60, but always more than parts, up to 512]",
        ),
        ("landmarks", "share") => arg.help(
            "Number of landmarks [default: 120, above 300,000 faces 240; with kmeans and two-means twice the parts, 10 to \
             60, above 60,000 faces 60, but always more than parts, up to 512]",
        ),
        ("sampling", "rows") => arg.help("How landmarks are chosen [default: farthest]"),
        ("sampling", "share") => with_replaced_help(arg, "with --exact, kmeans and two-means", "with kmeans and two-means"),
        ("tmp", "info" | "plan") => with_replaced_help(arg, BESIDE_OUTPUT, "beside the mesh"),
        ("tmp", "quality") => with_replaced_help(arg, BESIDE_OUTPUT, "the system's"),
        _ => arg,
    };
    // The help contains no ANSI colours that could be lost.
    match arg.get_help().map(|help| help.ansi().to_string()) {
        Some(help) if help.contains(KEPT) && !is_taken_from_work_dir(subcommand, arg.get_id().as_str()) => {
            arg.help(help.replace(KEPT, ""))
        }
        _ => arg,
    }
}

/// `arg` with `old` replaced by `new` in its help.
fn with_replaced_help(arg: Arg, old: &str, new: &str) -> Arg {
    let help = arg.get_help().map(|help| help.ansi().to_string().replace(old, new));
    arg.help(help.unwrap_or_default())
}

/// Whether `option`, if not given to `subcommand`, is taken from the work directory.
fn is_taken_from_work_dir(subcommand: &str, option: &str) -> bool {
    match subcommand {
        "cluster" => true,
        "rows" | "share" => ["order", "seed"].contains(&option),
        "embed" => option == "seed",
        _ => false,
    }
}

/// Whether values are numbers.
fn is_number(parser: &ValueParser) -> bool {
    let numbers = [
        TypeId::of::<u16>(),
        TypeId::of::<u32>(),
        TypeId::of::<u64>(),
        TypeId::of::<usize>(),
        TypeId::of::<f32>(),
        TypeId::of::<f64>(),
    ];
    numbers.iter().any(|number| parser.type_id() == *number)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_holds_together_and_defaults_are_told_where_they_hold() {
        parsed().debug_assert();
        let help = |subcommand: &str| parsed().find_subcommand_mut(subcommand).unwrap().render_long_help().to_string();
        let words = |subcommand: &str| help(subcommand).split_whitespace().collect::<Vec<_>>().join(" ");
        for subcommand in ["segment", "plan", "graph", "picture", "correspond"] {
            assert!(!words(subcommand).contains(KEPT), "{subcommand}");
        }
        for subcommand in ["cluster", "rows", "embed"] {
            assert!(words(subcommand).contains(KEPT), "{subcommand}");
        }
        for (subcommand, folder) in
            [("segment", "that of the output"), ("info", "beside the mesh"), ("quality", "the system's")]
        {
            assert!(words(subcommand).contains(&format!("temporary files [default: {folder}]")), "{subcommand}");
        }
        let landmarks = "Number of landmarks [default: 120, above ";
        assert!(words("rows").contains(&format!("{landmarks}60,000 faces 60 to 20 by size;")));
        assert!(words("share").contains(&format!("{landmarks}300,000 faces 240; with kmeans")));
        assert!(["rows", "share"].iter().all(|subcommand| !words(subcommand).contains("--exact")));
        assert!(words("segment").contains("[default: parts]") && words("cluster").contains("[default: parts, or as"));
        assert!(words("rows").contains("[default: parts]") && words("rows").contains("[default: 0, or as"));
    }
}
