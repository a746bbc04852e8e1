//! The library's errors: an enum with data, one line per message.
//!
//! A message names the file, what is wrong with it, and what to do. It is always a single line, so that the log of a
//! thousand meshes can be searched with grep, whatever a file is called or contains ([`super::printable`]). Library
//! parameters and work-directory stages are named between backticks, so that a program or a binding can substitute its
//! own terms.

use super::printable::line;
use std::io;
use std::path::{Path, PathBuf};

/// Shorthand for results of this library.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What helps in most cases besides more memory.
pub const FEWER_THREADS: &str = "lower `threads`";
/// What helps where memory grows with the number of landmarks. Much of the library has no such parameter.
pub const LESS_WORK: &str = "lower `threads` or `landmarks`";

/// What can go wrong, with the data needed to report it and to react.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused to read, write, map or rename something.
    #[error("{}: {}", shown(path), refusal(action, source))]
    Io {
        /// File or folder concerned.
        path: PathBuf,
        /// What was attempted, as a verb: "open", "map", "write".
        action: &'static str,
        /// The operating system's reason.
        #[source]
        source: io::Error,
    },
    /// A file's content is not valid.
    #[error("{}: {}: {}; {remedy}", shown(path), line(place), line(problem))]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Where in the file: "header line 4", "face 100", "byte 7613".
        place: String,
        /// What is wrong there.
        problem: String,
        /// What the user can do.
        remedy: String,
    },
    /// A readable file is unsuitable: it has no faces, or fewer faces than parts.
    #[error("{}: {}; {remedy}", shown(path), line(problem))]
    Unusable {
        /// The file.
        path: PathBuf,
        /// Why it is unsuitable.
        problem: String,
        /// What the user can do.
        remedy: String,
    },
    /// A parameter is out of range or contradicts another one.
    #[error("{}: {}; {remedy}", line(name), line(problem))]
    Parameter {
        /// The parameter's name in the library, or the name of another argument.
        name: String,
        /// What is wrong with its value.
        problem: String,
        /// What would be valid.
        remedy: String,
    },
    /// The memory budget cannot hold the minimum that is needed.
    #[error(
        "{what} needs {needed} bytes but the memory budget leaves {available}; raise `memory`{}",
        alternative(remedy)
    )]
    Memory {
        /// What was to be allocated.
        what: &'static str,
        /// Minimum number of bytes needed.
        needed: u64,
        /// Bytes left in the budget.
        available: u64,
        /// What else would help, as [`FEWER_THREADS`]; empty if nothing would.
        remedy: &'static str,
    },
    /// The disk cannot hold what the work will write.
    #[error(
        "{}: the work needs {needed} bytes of disk space, but only {available} are free; free some, or put the work \
         elsewhere with `temporary_folder` or `work_dir`",
        shown(path)
    )]
    Disk {
        /// Folder on the disk concerned.
        path: PathBuf,
        /// Bytes that will be written.
        needed: u64,
        /// Bytes free now.
        available: u64,
    },
    /// A work directory is in use, from another version, or damaged.
    #[error("{}: {}; {remedy}", shown(path), line(problem))]
    WorkDir {
        /// The work directory or a file in it.
        path: PathBuf,
        /// What is wrong.
        problem: String,
        /// What the user can do.
        remedy: String,
    },
    /// The run was cancelled.
    #[error("interrupted")]
    Cancelled,
    /// A bug in the program: a thread panicked, or an invariant failed.
    #[error("internal error: {}; this is a bug: please report it with the command and the mesh", line(problem))]
    Internal {
        /// What happened.
        problem: String,
    },
}

/// A path on one line, without control characters. An empty one is shown in quotes: the message began with a colon.
fn shown(path: &Path) -> String {
    if path.as_os_str().is_empty() { "\"\"".into() } else { line(&path.to_string_lossy()).into_owned() }
}

/// What the operating system refused, why, and what can be done: the text of an [`Error::Io`] without its path, for
/// bindings whose errors carry the path in a separate field.
pub fn refusal(action: &str, source: &io::Error) -> String {
    format!("cannot {action}: {source}{}", hint(action, source))
}

/// A remedy for the operating-system errors that users meet most.
fn hint(action: &str, error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => "; check the path",
        io::ErrorKind::InvalidFilename => "; shorten the path, or choose another name",
        io::ErrorKind::FileTooLarge => "; raise the limit of file sizes (ulimit -f), or choose another file system",
        io::ErrorKind::IsADirectory if action == "read" => "; give a file",
        io::ErrorKind::AlreadyExists | io::ErrorKind::IsADirectory => "; choose another name",
        io::ErrorKind::PermissionDenied if ["open", "read"].contains(&action) => "; check its permissions",
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => {
            "; check the permissions or choose another folder"
        }
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "; free some disk space, or put work files elsewhere with `temporary_folder` or `work_dir`"
        }
        io::ErrorKind::OutOfMemory => "; raise the limit of the address space: ulimit -v",
        // These kinds are not stable yet.
        _ => match error.raw_os_error() {
            Some(libc::ELOOP) => "; check where its links lead",
            Some(libc::EMFILE | libc::ENFILE) => "; raise the limit of open files: ulimit -n",
            Some(libc::EIO) => "; check the disk, and the system's log",
            _ => "",
        },
    }
}

/// A remedy after another one; nothing if it is empty.
fn alternative(remedy: &str) -> String {
    if remedy.is_empty() { String::new() } else { format!(" or {remedy}") }
}

/// Error texts of other libraries may span several lines.
fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

impl Error {
    /// Builds an [`Error::Io`] from an `io::Error`, for `map_err`. The path is copied only then, since some loops write
    /// a number at a time.
    pub fn io(path: impl AsRef<Path>, action: &'static str) -> impl FnOnce(io::Error) -> Error {
        move |source| Error::Io { path: path.as_ref().to_path_buf(), action, source }
    }

    /// An [`Error::Malformed`].
    pub fn malformed(
        path: impl AsRef<Path>,
        place: impl Into<String>,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Error {
        Error::Malformed {
            path: path.as_ref().to_path_buf(),
            place: place.into(),
            problem: one_line(&problem.into()),
            remedy: remedy.into(),
        }
    }

    /// An [`Error::Unusable`].
    pub fn unusable(path: impl AsRef<Path>, problem: impl Into<String>, remedy: impl Into<String>) -> Error {
        Error::Unusable { path: path.as_ref().to_path_buf(), problem: problem.into(), remedy: remedy.into() }
    }

    /// An [`Error::Parameter`].
    pub fn parameter(name: impl Into<String>, problem: impl Into<String>, remedy: impl Into<String>) -> Error {
        Error::Parameter { name: name.into(), problem: problem.into(), remedy: remedy.into() }
    }

    /// An [`Error::Parameter`] for an output whose format its extension does not tell.
    pub fn extension(name: &str, path: &Path, remedy: impl Into<String>) -> Error {
        Error::parameter(name, format!("{}: unknown extension", shown(path)), remedy)
    }

    /// This error; if it is an [`Error::Memory`], with `remedy` as what would help besides more memory: a caller may
    /// know better what its user can change.
    #[must_use]
    pub fn with_remedy(self, remedy: &'static str) -> Error {
        match self {
            Error::Memory { what, needed, available, .. } => Error::Memory { what, needed, available, remedy },
            other => other,
        }
    }

    /// An [`Error::Internal`]; its message stays one line.
    pub fn internal(problem: &str) -> Error {
        Error::Internal { problem: one_line(problem) }
    }

    /// An [`Error::WorkDir`].
    pub fn work_dir(path: impl AsRef<Path>, problem: impl Into<String>, remedy: impl Into<String>) -> Error {
        Error::WorkDir { path: path.as_ref().to_path_buf(), problem: problem.into(), remedy: remedy.into() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Regression: some refusals were told without a remedy.
    #[test]
    fn what_the_system_refuses_has_a_remedy() {
        for code in [
            libc::EACCES,
            libc::EDQUOT,
            libc::EEXIST,
            libc::EFBIG,
            libc::EIO,
            libc::EISDIR,
            libc::ELOOP,
            libc::EMFILE,
            libc::ENAMETOOLONG,
            libc::ENFILE,
            libc::ENOENT,
            libc::ENOMEM,
            libc::ENOSPC,
            libc::ENOTDIR,
            libc::EPERM,
            libc::EROFS,
        ] {
            let told = Error::io("x", "write")(io::Error::from_raw_os_error(code)).to_string();
            assert!(told.contains(&format!("(os error {code}); ")), "{told}");
        }
    }

    /// A line break or an escape sequence in a file's name, or in the file, reached the terminal.
    #[test]
    fn a_message_is_one_line_that_does_nothing_to_a_terminal() {
        let path = Path::new("a\n\x1b[2J.ply");
        for error in [
            Error::io(path, "open")(io::ErrorKind::NotFound.into()),
            Error::malformed(path, "line 1", "\x1b]0;title\x07", "correct it"),
            Error::unusable(path, "\n", "give another"),
            Error::parameter("\x1b", "\r", "choose"),
            Error::work_dir(path, "\u{9b}", "delete it"),
            Error::internal("\x1b[31m"),
        ] {
            assert!(!error.to_string().contains(char::is_control), "{error:?}");
        }
    }
}
