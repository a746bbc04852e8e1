//! Translates errors of the library to the terms of the command line.
//!
//! The library refers to options by its parameter names, between backticks in sentences. Here they become flags.

use nystrom_stream::base::Error;
use std::path::Path;

/// Library options whose flags have the same words.
const SAME: &str = "\
    alternative beta boundaries cluster decision degree delta detail edits eta exact faces force hints local matches \
    noise part_form partial refine samples sampling shard size split_faces threads tilt tiny_components transfer tree \
    turn views walls work_dir";
/// Library options with another name on the command line, and their flags.
const OTHERS: [(&str, &str); 10] = [
    ("dimensions", "--vectors"),
    ("landmarks", "-l"),
    ("map", "--initial-map"),
    ("memory", "--max-memory"),
    ("output", "-o"),
    ("pairs", "--landmarks-file"),
    ("parts", "-k"),
    ("parts_between", "--parts-range"),
    ("temporary_folder", "--tmp"),
    ("width", "--sigma"),
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
            let flag = flags().find(|(option, _)| option == name).map_or_else(|| name.clone(), |(_, flag)| flag);
            Error::parameter(flag, with_flags(problem), with_flags(remedy)).to_string()
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

/// The library's options and their flags.
fn flags() -> impl Iterator<Item = (&'static str, String)> {
    let same = SAME.split(' ').map(|name| (name, format!("--{}", name.replace('_', "-"))));
    same.chain(OTHERS.iter().map(|(name, flag)| (*name, flag.to_string())))
}

/// `text` with a flag for each option between backticks, and a command for each stage; other words between backticks
/// are kept.
pub fn with_flags(text: &str) -> String {
    let made = |text: String, (stage, command): &(&str, &str)| text.replace(&format!("stage `{stage}`"), command);
    let named = |text: String, (option, flag): (&str, String)| text.replace(&format!("`{option}`"), &flag);
    flags().fold(STAGES.iter().fold(text.to_string(), made), named)
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
