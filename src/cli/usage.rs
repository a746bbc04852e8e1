//! Errors of clap in the form of all errors: one line, which starts with the option or the word and ends with what to
//! do.

use clap::error::{ContextKind, ContextValue, ErrorKind as Kind};
use clap::{Arg, Command, Error};

/// Options and what they require; clap reports the latter as missing without saying which option needs it.
const TOGETHER: [(&str, &str); 10] = [
    ("--carried", "--carry"),
    ("--carry", "--carried"),
    ("--detail", "--tree"),
    ("--force", "--work-dir"),
    ("--matches", "--mesh"),
    ("--names", "--output"),
    ("--parts", "--tree"),
    ("--plot", "LABELS"),
    ("-k", "--tree"),
    ("--samples", "--matches"),
];

/// The message of `error`, in one line; `None` for help or the version, which clap prints itself. `command` is the
/// parsed command.
pub fn line(error: &Error, command: &Command) -> Option<String> {
    if [Kind::DisplayHelp, Kind::DisplayVersion, Kind::DisplayHelpOnMissingArgumentOrSubcommand].contains(&error.kind())
    {
        return None;
    }
    let subcommand = given().nth(1).and_then(|word| command.find_subcommand(word));
    let name = subcommand.map_or(String::new(), |subcommand| format!("{} ", subcommand.get_name()));
    let text = without_its_companion(error, subcommand).or_else(|| message(error)).unwrap_or_else(|| rendered(error));
    Some(format!("{text}; see nystrom-stream {name}--help"))
}

/// The words of the command line, for comparison; some need not be UTF-8.
fn given() -> impl Iterator<Item = String> {
    std::env::args_os().map(|word| word.to_string_lossy().into_owned())
}

/// Whether the command line requests progress as events, whatever else is wrong with it.
pub fn asks_for_events() -> bool {
    let words: Vec<String> = given().take_while(|word| word != "--").collect();
    words.contains(&"--progress=json".to_string()) || words.windows(2).any(|two| two == ["--progress", "json"])
}

/// The option given without the one that it requires; `None` if everything missing is required in any case.
fn without_its_companion(error: &Error, subcommand: Option<&Command>) -> Option<String> {
    if error.kind() != Kind::MissingRequiredArgument {
        return None;
    }
    let missing: Vec<String> = words(error, ContextKind::InvalidArg)?.iter().map(|word| option(word)).collect();
    let is_given = |name: &str| {
        let of_it = |word: &str| word == name || word.starts_with(&format!("{name}="));
        given().skip(2).take_while(|word| word != "--").any(|word| of_it(&word))
    };
    let is_needed = |name: &str| {
        let long = name.trim_start_matches('-');
        let named = |arg: &&Arg| arg.get_long() == Some(long);
        subcommand.and_then(|subcommand| subcommand.get_arguments().find(named)).is_some_and(Arg::is_required_set)
    };
    let pair = TOGETHER
        .iter()
        .find(|(given, other)| is_given(given) && missing.iter().any(|name| name == other) && !is_needed(other));
    pair.map(|(given, other)| format!("{given} requires {other}; give both"))
}

/// Words of the context of `error`.
fn words(error: &Error, kind: ContextKind) -> Option<Vec<String>> {
    match error.get(kind)? {
        ContextValue::String(word) => Some(vec![word.clone()]),
        ContextValue::Strings(words) if !words.is_empty() => Some(words.clone()),
        _ => None,
    }
}

/// Option or argument without its value name: "--parts <K>" gives `--parts`, "<MESH>..." gives `MESH`.
fn option(word: &str) -> String {
    let first = word.split([' ', '=']).next().unwrap_or(word);
    if first.starts_with('-') {
        first.trim_end_matches('[').into()
    } else {
        word.replace(['<', '>', '[', ']'], "").replace("...", "")
    }
}

fn message(error: &Error) -> Option<String> {
    let one = |kind| words(error, kind).and_then(|words| words.into_iter().next());
    let named = || one(ContextKind::InvalidArg).map(|word| option(&word));
    let options = |kind| words(error, kind).map(|all| all.iter().map(|word| option(word)).collect::<Vec<_>>());
    let like = |kind| one(kind).map_or(String::new(), |word| format!("; did you mean {word}?"));
    Some(match error.kind() {
        Kind::UnknownArgument => {
            format!("{}: unexpected argument{}", named()?, like(ContextKind::SuggestedArg))
        }
        Kind::InvalidSubcommand => {
            let word = one(ContextKind::InvalidSubcommand)?;
            if std::path::Path::new(&word).exists() {
                return Some(format!("{word}: is a file, not a command; did you mean nystrom-stream segment {word}?"));
            }
            format!("{word}: unknown command{}", like(ContextKind::SuggestedSubcommand))
        }
        Kind::MissingRequiredArgument => format!("{}: missing", options(ContextKind::InvalidArg)?.join(", ")),
        Kind::ArgumentConflict => {
            let with = options(ContextKind::PriorArg)?;
            let name = named()?;
            if with == [name.clone()] {
                format!("{name}: given more than once; give it once")
            } else {
                format!("{name}: cannot be used with {}", with.join(", "))
            }
        }
        Kind::NoEquals => format!("{0}: takes its value after =; write {0}=VALUE", named()?),
        Kind::InvalidValue => match (one(ContextKind::InvalidValue), words(error, ContextKind::ValidValue)) {
            (Some(value), Some(valid)) if !value.is_empty() => {
                let like = like(ContextKind::SuggestedValue);
                format!("{}: invalid value '{value}'{like}; choose from {}", named()?, valid.join(", "))
            }
            _ => format!("{}: its value is missing", named()?),
        },
        Kind::ValueValidation => {
            let reason = std::error::Error::source(error).map_or(String::new(), |source| source.to_string());
            let reason = match reason.as_str() {
                "invalid digit found in string" => "not a whole number of 0 or more".into(),
                "number too large to fit in target type" => "too large".into(),
                "cannot parse integer from empty string" => "a number is missing".into(),
                "invalid float literal" => "not a number".into(),
                _ => match reason.split_once(" is not in ").and_then(|(_, range)| range.split_once("..=")) {
                    Some((least, most)) => format!("out of range; choose from {least} to {most}"),
                    None => reason,
                },
            };
            format!("{}: invalid value '{}': {reason}", named()?, one(ContextKind::InvalidValue)?)
        }
        _ => return None,
    })
}

/// The message of clap on one line.
fn rendered(error: &Error) -> String {
    let text = error.render().to_string();
    let mut message = String::new();
    for line in text.lines().map(str::trim).filter(|line| !line.is_empty()) {
        if let Some(tip) = line.strip_prefix("tip: ") {
            message += &format!("; {tip}");
        } else if !line.starts_with("Usage: ") && !line.starts_with("For more information") {
            message += if message.is_empty() { "" } else { " " };
            message += line.strip_prefix("error: ").unwrap_or(line);
        }
    }
    message
}
