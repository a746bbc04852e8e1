//! Refusals by clap in the form of all errors: one line, which begins with the option or the word
//! and ends with what to do.

use clap::Error;
use clap::error::{ContextKind, ContextValue, ErrorKind as Kind};

/// What `error` says, in one line; nothing where it is help or the version, which clap prints itself. `known` tells
/// whether a word is a subcommand.
pub fn line(error: &Error, known: impl Fn(&str) -> bool) -> Option<String> {
    if [Kind::DisplayHelp, Kind::DisplayVersion, Kind::DisplayHelpOnMissingArgumentOrSubcommand].contains(&error.kind())
    {
        return None;
    }
    let subcommand = std::env::args().nth(1).filter(|word| known(word));
    let subcommand = subcommand.map_or(String::new(), |word| word + " ");
    Some(format!("{}; see nystrom-stream {subcommand}--help", message(error).unwrap_or_else(|| rendered(error))))
}

/// Words of the context of `error`.
fn words(error: &Error, kind: ContextKind) -> Option<Vec<String>> {
    match error.get(kind)? {
        ContextValue::String(word) => Some(vec![word.clone()]),
        ContextValue::Strings(words) if !words.is_empty() => Some(words.clone()),
        _ => None,
    }
}

/// Option or argument without the name of its value: "--parts <K>" is `--parts`, "<MESH>..." is `MESH`.
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
                "invalid digit found in string" => "not a whole number".into(),
                "cannot parse integer from empty string" => "no number".into(),
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

/// The words of clap on one line.
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
