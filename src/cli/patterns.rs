//! Patterns of files, as in a shell: `*`, `?` and `[…]` within a name, `**` for all folders below. The crate `glob`
//! compares names; folders are walked here, since its own walk passes over those that cannot be entered, follows
//! links in circles, and panics at names that are not UTF-8.

use nystrom_stream::base::Error;
use std::ffi::{OsStr, OsString};
use std::fs::{DirEntry, FileType};
use std::io::{self, ErrorKind};
use std::os::unix::ffi::OsStrExt;
use std::path::{Component, Path, PathBuf};

/// Characters that make a name a pattern.
const WILD: [char; 3] = ['*', '?', '['];

/// Whether `word` is a pattern, unless there is a file of that name.
pub fn is_pattern(word: &Path) -> bool {
    word.to_string_lossy().contains(WILD)
}

/// A component of a pattern.
enum Part<'a> {
    Name(&'a OsStr),
    Names(glob::Pattern),
    /// `**`
    Folders,
}

/// What a pattern matches.
#[derive(Default)]
pub struct Matches {
    /// The files and folders, ascending.
    pub found: Vec<PathBuf>,
    /// What could not be looked at, and why.
    pub unseen: Vec<(PathBuf, Error)>,
}

impl Matches {
    /// The matches of `pattern`.
    ///
    /// # Errors
    /// What is wrong with the pattern.
    pub fn of(pattern: &Path) -> Result<Self, glob::PatternError> {
        let (mut start, mut parts) = (PathBuf::new(), Vec::new());
        for component in pattern.components() {
            match component {
                Component::Prefix(_) | Component::RootDir => start.push(component),
                Component::CurDir => {}
                Component::ParentDir | Component::Normal(_) => {
                    let name = component.as_os_str();
                    match name.to_string_lossy() {
                        text if text == "**" && matches!(parts.last(), Some(Part::Folders)) => {}
                        text if text == "**" => parts.push(Part::Folders),
                        text if text.contains(WILD) => parts.push(Part::Names(glob::Pattern::new(&text)?)),
                        _ => parts.push(Part::Name(name)),
                    }
                }
            }
        }
        let mut all = Self::default();
        all.walk(start, &parts, &mut Vec::new());
        if pattern.as_os_str().as_bytes().ends_with(b"/") {
            all.found.retain(|path| path.is_dir());
        }
        all.found.sort();
        all.found.dedup();
        Ok(all)
    }

    /// Adds what matches `parts` in the folder `at`; `above` are the folders that `**` has entered.
    fn walk(&mut self, at: PathBuf, parts: &[Part], above: &mut Vec<PathBuf>) {
        let Some((first, rest)) = parts.split_first() else { return self.found.push(at) };
        match first {
            Part::Name(name) => {
                let path = at.join(name);
                match std::fs::symlink_metadata(&path) {
                    Ok(_) => self.walk(path, rest, above),
                    Err(error) => self.fail(path, "open", error),
                }
            }
            Part::Names(pattern) => {
                // As in a shell.
                let options = glob::MatchOptions { require_literal_leading_dot: true, ..glob::MatchOptions::new() };
                for (name, _) in self.list(&at).unwrap_or_default() {
                    if pattern.matches_with(&name.to_string_lossy(), options) {
                        self.walk(at.join(name), rest, above);
                    }
                }
            }
            Part::Folders => {
                let Some(entries) = self.list(&at) else { return };
                // A link to a folder around it shows nothing new.
                let Ok(real) = at_or_here(&at).canonicalize() else { return };
                if above.contains(&real) {
                    return;
                }
                above.push(real);
                if rest.is_empty() {
                    self.found.push(at.clone());
                } else {
                    self.walk(at.clone(), rest, &mut Vec::new());
                }
                for (name, kind) in entries {
                    let path = at.join(&name);
                    let is_folder = kind.is_dir() || kind.is_symlink() && path.is_dir();
                    if is_folder && !name.as_bytes().starts_with(b".") {
                        self.walk(path, parts, above);
                    }
                }
                above.pop();
            }
        }
    }

    /// The entries of the folder `at`; `None` if it is none, or cannot be listed.
    fn list(&mut self, at: &Path) -> Option<Vec<(OsString, FileType)>> {
        let folder = at_or_here(at);
        let entry = |entry: DirEntry| Ok((entry.file_name(), entry.file_type()?));
        let listed = std::fs::read_dir(folder).and_then(|all| all.map(|found| found.and_then(entry)).collect());
        listed.map_err(|error| self.fail(folder.into(), "list", error)).ok()
    }

    /// Records that `path` could not be looked at, unless it is not there.
    fn fail(&mut self, path: PathBuf, action: &'static str, error: io::Error) {
        let is_absent = matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory);
        // A link to itself leads nowhere, as a dangling one.
        if !is_absent && error.raw_os_error() != Some(libc::ELOOP) {
            let error = Error::io(&path, action)(error);
            self.unseen.push((path, error));
        }
    }
}

/// The folder `at`, which is the current one if it has no name.
fn at_or_here(at: &Path) -> &Path {
    if at.as_os_str().is_empty() { Path::new(".") } else { at }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    /// Regression: a name that is not UTF-8 ended the program with a panic, and a link to a folder around it listed
    /// each mesh forty times.
    #[test]
    fn names_of_any_bytes_are_found_once_each_whatever_links_there_are() {
        let dir = tempfile::tempdir().unwrap();
        let odd = OsStr::from_bytes(b"m\xff.ply");
        let folders = ["a", "a/deep", ".hidden", "b[1]"].map(|name| dir.path().join(name));
        for folder in &folders {
            std::fs::create_dir(folder).unwrap();
            [OsStr::new("m.ply"), odd, OsStr::new(".m.ply")].iter().for_each(|name| {
                std::fs::write(folder.join(name), "").unwrap();
            });
        }
        symlink(dir.path(), dir.path().join("a/around")).unwrap();
        symlink("itself", dir.path().join("itself")).unwrap();
        let found = |pattern: &[u8]| {
            let Matches { found, unseen } = Matches::of(&dir.path().join(OsStr::from_bytes(pattern))).unwrap();
            assert!(unseen.is_empty(), "{unseen:?}");
            let relative = |path: PathBuf| path.strip_prefix(dir.path()).unwrap().as_os_str().as_bytes().to_vec();
            found.into_iter().map(relative).collect::<Vec<_>>()
        };
        let names = |names: &[&'static [u8]]| names.iter().map(|name| name.to_vec()).collect::<Vec<_>>();
        assert_eq!(found(b"a/*.ply"), names(&[b"a/m.ply", b"a/m\xff.ply"]));
        assert_eq!(found(b"*/m\xff.ply"), names(&[b"a/m\xff.ply", b"b[1]/m\xff.ply"]));
        assert_eq!(found(b"a/m?.ply"), names(&[b"a/m\xff.ply"]));
        let all: [&[u8]; 6] =
            [b"a/deep/m.ply", b"a/deep/m\xff.ply", b"a/m.ply", b"a/m\xff.ply", b"b[1]/m.ply", b"b[1]/m\xff.ply"];
        assert_eq!(found(b"**/*.ply"), names(&all));
        assert_eq!(found(b"**/**/./*.ply"), names(&all));
        assert_eq!(found(b"**/deep/../m.ply"), names(&[b"a/deep/../m.ply"]));
        assert_eq!(found(b"b[[]*/m.ply"), names(&[b"b[1]/m.ply"]));
        assert_eq!(found(b".h*/.*.ply"), names(&[b".hidden/.m.ply"]));
        assert_eq!(found(b"*/deep*/"), names(&[b"a/deep"]));
        assert_eq!(found(b"a/m.ply/*"), names(&[]));
        assert_eq!(found(b"**"), names(&[b"", b"a", b"a/deep", b"b[1]"]));
        assert!(Matches::of(Path::new("a/[m")).is_err());
    }
}
