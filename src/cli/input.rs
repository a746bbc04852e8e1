//! The meshes given to a command: files, folders, patterns, a pipe or standard input; and opening them.
//!
//! Standard input is copied into the work directory, since a mesh is mapped. A kept work directory is bound to its
//! mesh.

use super::options::{CliError, ForceArgs};
use super::output::MESH_EXTENSIONS;
use super::patterns::{Matches, is_pattern};
use super::provenance::is_output;
use nystrom_stream::apps::export::split;
use nystrom_stream::base::Error;
use nystrom_stream::mesh;
use nystrom_stream::mesh::size::is_pipe;
use nystrom_stream::pipeline::admission::admit;
use nystrom_stream::pipeline::input;
use nystrom_stream::store::leftovers::SPOOLED;
use nystrom_stream::store::{Context, Run, folder_of, workdir};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fs::File;
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};

/// Endings of results, which are not picked up as meshes in folders.
const RESULTS: [&str; 2] = [".segmented.ply", ".sequenced.ply"];

/// Opens the mesh at `path`, or on standard input, and returns its identity. A work directory of another mesh is
/// refused without `force`, before anything in it changes, and emptied with it.
pub fn read(path: &Path, force: ForceArgs, context: Context<'_>) -> Result<(mesh::Mesh, Value), Error> {
    let Context { work, run } = context;
    if path.as_os_str() == "-" {
        let input = std::io::stdin().as_fd().try_clone_to_owned().map_err(Error::io("<stdin>", "open"))?;
        return piped(mesh::Pipe(File::from(input)), "<stdin>", force, context);
    }
    if is_pipe(path) {
        return piped(mesh::Pipe::open(path)?, &path.to_string_lossy(), force, context);
    }
    let identity = input::identity_in(path, work)?;
    admit(path, &identity, force.force, context)?;
    Ok((open_file(path, work.path(), run)?, identity))
}

/// Opens the file at `path`; decoded arrays go to `folder`. Notes oddities.
pub fn open_file(path: &Path, folder: &Path, run: &Run) -> Result<mesh::Mesh, Error> {
    check_is_file(path)?;
    open_noting(run, || mesh::open(path, folder, run))
}

/// Rejects standard input where it is not read.
pub fn check_is_file(path: &Path) -> Result<(), Error> {
    if path.as_os_str() == "-" {
        return Err(Error::unusable(path, "standard input is not read here", "give a file, or /dev/stdin"));
    }
    Ok(())
}

/// Runs `open` as a stage, and notes oddities of the mesh.
fn open_noting(run: &Run, open: impl FnOnce() -> Result<mesh::Mesh, Error>) -> Result<mesh::Mesh, Error> {
    let (opened, _) = run.stage("read", "faces", 0, open)?;
    opened.notes().iter().for_each(|note| run.progress.note(note));
    Ok(opened)
}

/// Rejects a missing mesh, before a folder is created for it.
pub fn check_there(path: &Path) -> Result<(), Error> {
    match std::fs::metadata(path) {
        Err(error) if path.as_os_str() != "-" => Err(Error::io(path, "open")(error)),
        _ => Ok(()),
    }
}

/// The mesh streamed from `source`, standard input or a pipe, which is copied into the work directory. Its identity is
/// known only then, so it replaces the existing one once it is admitted.
fn piped(source: mesh::Pipe, name: &str, force: ForceArgs, context: Context<'_>) -> Result<(mesh::Mesh, Value), Error> {
    let Context { work, run } = context;
    let (input, spooled) = (work.file(SPOOLED), work.file("input.tmp"));
    let result = open_noting(run, || mesh::open_reader(source, name, &spooled, run)).and_then(|opened| {
        let identity = json!({"stdin": workdir::checksum(&spooled, &run.cancel)?});
        admit(Path::new("-"), &identity, force.force, context)?;
        std::fs::rename(&spooled, &input).map_err(Error::io(&input, "rename"))?;
        Ok((opened, identity))
    });
    if result.is_err() {
        work.remove("input.tmp");
        work.remove_decoded();
    }
    result
}

fn named(path: &Path, extensions: &[&str]) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    extensions.iter().any(|extension| name.ends_with(extension))
}

/// Whether `path` is a result of this program, by its name or by the record of a batch.
fn is_result(path: &Path) -> bool {
    named(path, &RESULTS) || is_output(path)
}

/// Whether `path` lies in a folder of parts.
fn is_part(path: &Path) -> bool {
    let name = path.file_name().and_then(OsStr::to_str);
    name.is_some_and(split::is_file_name) && folder_of(path).join(split::LIST).is_file()
}

/// Removes results of this program from the `found` files of a folder or pattern `word`, which must not be all.
fn without_results(word: &Path, found: &mut Vec<PathBuf>) -> Result<(), Error> {
    let all = found.len();
    found.retain(|path| !is_result(path));
    if found.is_empty() && all > 0 {
        let problem = "all meshes here are outputs of this program, which folders and patterns skip";
        return Err(Error::unusable(word, problem, "give them by name to cut them again"));
    }
    Ok(())
}

/// The meshes that a command is given.
pub struct Given {
    /// Their paths, without duplicates, in order.
    pub meshes: Vec<PathBuf>,
    /// Whether they are treated as a batch.
    pub several: bool,
    /// Files and folders that could not be looked at, and why: each counts as a mesh that failed.
    pub unlisted: Vec<(PathBuf, Error)>,
}

/// The meshes given by `words`: files, the meshes in folders, matches of patterns.
pub fn meshes(words: &[PathBuf]) -> Result<Given, CliError> {
    let (mut all, mut many, mut unlisted) = (Vec::new(), words.len() > 1, Vec::new());
    for word in words {
        let text = word.to_string_lossy();
        let before = unlisted.len();
        let mut found: Vec<PathBuf> = Vec::new();
        let nothing = if word.is_dir() && text != "-" {
            for entry in std::fs::read_dir(word).map_err(Error::io(word, "list"))? {
                match entry {
                    Ok(entry) => found.push(entry.path()),
                    Err(error) => unlisted.push((word.clone(), Error::io(word, "list")(error))),
                }
            }
            // What cannot be looked at, as a dangling link, is reported when its turn comes.
            let is_file = |path: &Path| std::fs::metadata(path).map_or(true, |there| there.is_file());
            let is_hidden =
                |path: &Path| path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."));
            found.retain(|path| named(path, &MESH_EXTENSIONS) && is_file(path) && !is_hidden(path));
            found.sort();
            ("holds no mesh (.ply, .obj, .off, .stl, or these with .gz)", "choose another folder")
        } else if is_pattern(word) && !word.exists() {
            let wrong = |error| CliError::Usage(format!("{text}: invalid pattern: {error}; write [[] for a bracket"));
            let matches = Matches::of(word).map_err(wrong)?;
            found = matches.found;
            unlisted.extend(matches.unseen);
            // Any other pattern that matches parts is meant to.
            found.retain(|path| !text.contains("**") || !is_part(path));
            ("matches no file", "check the pattern")
        } else if !word.exists() && [".json", ".jsonl"].iter().any(|extension| text.ends_with(extension)) {
            let hint = "is taken for a mesh, but there is no such file; to write a report, use --json=FILE";
            return Err(CliError::Usage(format!("{text}: {hint}")));
        } else {
            all.push(word.clone());
            continue;
        };
        many = true;
        without_results(word, &mut found)?;
        if found.is_empty() {
            let (problem, remedy) = nothing;
            let error = if unlisted.len() > before { unlisted.pop().map(|(_, error)| error) } else { None };
            return Err(error.unwrap_or_else(|| Error::unusable(word, problem, remedy)).into());
        }
        all.extend(found);
    }
    let mut seen = BTreeSet::new();
    all.retain(|path| seen.insert(path.clone()));
    Ok(Given { meshes: all, several: many, unlisted })
}
