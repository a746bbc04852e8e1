//! Translates errors of the library to the terms of the command line.
//!
//! The library refers to options by its parameter names, between backticks in sentences. Here they become flags.

use nystrom_stream::base::Error;
use std::path::Path;

/// Library options with another name on the command line, and their flags.
const FLAGS: [(&str, &str); 42] = [
    ("alternative", "--alternative"),
    ("beta", "--beta"),
    ("boundaries", "--boundaries"),
    ("cluster", "--cluster"),
    ("decision", "--decision"),
    ("degree", "--degree"),
    ("delta", "--delta"),
    ("detail", "--detail"),
    ("dimensions", "--vectors"),
    ("edits", "--edits"),
    ("eta", "--eta"),
    ("exact", "--exact"),
    ("faces", "--faces"),
    ("force", "--force"),
    ("hints", "--hints"),
    ("landmarks", "-l"),
    ("map", "--initial-map"),
    ("matches", "--matches"),
    ("memory", "--max-memory"),
    ("noise", "--noise"),
    ("output", "-o"),
    ("pairs", "--landmarks-file"),
    ("part_form", "--part-form"),
    ("partial", "--partial"),
    ("parts", "-k"),
    ("parts_between", "--parts-range"),
    ("refine", "--refine"),
    ("samples", "--samples"),
    ("sampling", "--sampling"),
    ("shard", "--shard"),
    ("size", "--size"),
    ("split_faces", "--split-faces"),
    ("temporary_folder", "--tmp"),
    ("threads", "--threads"),
    ("tiny_components", "--tiny-components"),
    ("transfer", "--transfer"),
    ("tree", "--tree"),
    ("turn", "--turn"),
    ("views", "--views"),
    ("walls", "--walls"),
    ("width", "--sigma"),
    ("work_dir", "--work-dir"),
];

/// Stages that the library may report as missing in a work directory, and the commands that make them.
const STAGES: [(&str, &str); 6] = [
    ("embedding", "nystrom-stream embed --work-dir …"),
    ("graph", "nystrom-stream graph MESH --work-dir …"),
    ("labels", "nystrom-stream cluster --work-dir …"),
    ("record", "nystrom-stream segment MESH --work-dir …"),
    ("rows", "nystrom-stream rows --work-dir …"),
    ("tree", "nystrom-stream export --work-dir … --tree FILE"),
];

/// The message of `error`, with flags for library options.
pub fn message(error: &Error) -> String {
    match error {
        Error::Parameter { name, problem, remedy } => {
            Error::parameter(flag(name).unwrap_or(name), with_flags(problem), with_flags(remedy)).to_string()
        }
        // A problem may quote a file.
        Error::Unusable { path, problem, remedy } => Error::unusable(path, problem, with_flags(remedy)).to_string(),
        Error::WorkDir { path, problem, remedy } => Error::work_dir(path, problem, with_flags(remedy)).to_string(),
        Error::Memory { .. } => with_flags(&error.to_string()),
        error => {
            // The text before the remedy may quote a path.
            let text = error.to_string();
            text.rsplit_once("; ")
                .map_or(text.clone(), |(problem, remedy)| format!("{problem}; {}", with_flags(remedy)))
        }
    }
}

/// The file or folder that `error` concerns, if there is one.
pub fn file_of(error: &Error) -> Option<&Path> {
    match error {
        Error::Io { path, .. } | Error::Malformed { path, .. } | Error::Unusable { path, .. } => Some(path),
        Error::Disk { path, .. } | Error::WorkDir { path, .. } => Some(path),
        _ => None,
    }
}

/// If `error` is about the parameter `name`, which was read from the file `path`: an error of that file.
pub fn of_file(error: Error, name: &str, path: Option<&Path>) -> Error {
    match (error, path) {
        (Error::Parameter { name: concerned, problem, remedy }, Some(path)) if concerned == name => {
            Error::unusable(path, problem, remedy)
        }
        (error, _) => error,
    }
}

/// The flag of the option `name`, if it differs from the name.
fn flag(name: &str) -> Option<&'static str> {
    FLAGS.iter().find(|(option, _)| *option == name).map(|(_, flag)| *flag)
}

/// `text` with a flag for each option between backticks, and a command for each stage; other words between backticks
/// are kept.
pub fn with_flags(text: &str) -> String {
    let made = |text: String, (stage, command): &(&str, &str)| text.replace(&format!("stage `{stage}`"), command);
    let named = |text: String, (option, flag): &(&str, &str)| text.replace(&format!("`{option}`"), flag);
    FLAGS.iter().fold(STAGES.iter().fold(text.to_string(), made), named)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nystrom_stream::base::error::LESS_WORK;

    #[test]
    fn options_become_flags_and_other_words_stay() {
        let error = Error::parameter("parts", "K-means needs `it`", "as in `parts` 6, or leave out `cluster` kmeans");
        assert_eq!(message(&error), "-k: K-means needs `it`; as in -k 6, or leave out --cluster kmeans");
        let error = of_file(Error::parameter("tree", "of 3 cells", "take another"), "tree", Some("x.json".as_ref()));
        assert_eq!(message(&error), "x.json: of 3 cells; take another");
        let error = Error::Memory { what: "a row", needed: 2, available: 1, remedy: LESS_WORK };
        assert!(message(&error).ends_with("raise --max-memory or lower --threads or -l"), "{}", message(&error));
        let error = Error::work_dir("w", "holds no rows", "compute them first: stage `rows`, or anew with `force`");
        let told = "w: holds no rows; compute them first: nystrom-stream rows --work-dir …, or anew with --force";
        assert_eq!(message(&error), told);
        for error in [
            Error::io("`work_dir`", "write")(std::io::ErrorKind::StorageFull.into()),
            Error::Disk { path: "`work_dir`".into(), needed: 2, available: 1 },
        ] {
            let told = message(&error);
            assert!(told.starts_with("`work_dir`: ") && told.ends_with("elsewhere with --tmp or --work-dir"), "{told}");
        }
        let error = Error::unusable("x.ply", "has no `parts`", "give `label`");
        assert_eq!(message(&error), "x.ply: has no `parts`; give `label`");
    }
}
