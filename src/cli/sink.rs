//! Destinations of text and files: standard output, a pipe or an open file of a process, or a file that appears by
//! rename when it is complete. Also the checks, before any work, that all of them can be written and none overwrites
//! another.

use super::options::CliError;
use nystrom_stream::apps::export::Form;
use nystrom_stream::apps::export::obj::{has_texture, material_file, material_libraries, uses_materials};
use nystrom_stream::base::parallel::lock;
use nystrom_stream::base::{Error, Result};
use nystrom_stream::mesh::ends_with;
use nystrom_stream::store::{folder_of, json, partial_name};
use serde::de::IgnoredAny;
use std::cell::LazyCell;
use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// Maximum number of bytes of a file name.
const LONGEST_NAME: usize = 255;
/// Bytes at the end of a file of lines in which its last one is looked for.
const LONGEST_LINE: u64 = 1 << 20;
/// Where this run has outputs: the places of outputs, of which some are folders, and the folders that they lie in.
static PLACES: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());
/// How each line of a batch begins.
const LINE_START: &[u8] = b"{\"mesh\":";

/// A destination of text.
#[derive(Clone, Debug)]
pub enum Sink {
    /// Standard output, named `-`.
    Stdout,
    /// Written to directly, after existing content: a device, a pipe or an open file of a process (`/dev/stdout`).
    Stream(PathBuf),
    /// A file.
    File(PathBuf),
}

impl Sink {
    /// The destination named by `path`.
    pub fn of(path: &Path) -> Self {
        let is_stream = || std::fs::metadata(path).is_ok_and(|there| !there.is_file() && !there.is_dir());
        match path {
            _ if path == Path::new("-") => Self::Stdout,
            _ if is_open_file(path) || is_stream() => Self::Stream(path.into()),
            _ => Self::File(path.into()),
        }
    }

    /// Rejects a file whose folder is missing or not writable, before any work.
    pub fn check(&self) -> Result<()> {
        let Self::File(path) = self else { return Ok(()) };
        if path.is_dir() {
            return Err(Error::unusable(path, "is a folder", "give a file"));
        }
        if path.as_os_str().as_encoded_bytes().ends_with(b"/") {
            return Err(Error::unusable(path, "is the name of a folder", "leave out the / at its end"));
        }
        self.check_place()
    }

    /// Rejects a file or a folder of parts whose own folder is missing or not writable, before any work.
    pub fn check_place(&self) -> Result<()> {
        let Self::File(path) = self else { return Ok(()) };
        if partial_name(path).file_name().is_some_and(|name| name.len() > LONGEST_NAME) {
            return Err(Error::unusable(path, "its name is too long: it has more than 247 bytes", "shorten it"));
        }
        let folder = folder_of(path);
        if !folder.is_dir() {
            let there = folder.exists();
            let (problem, remedy) =
                if there { ("is not a folder", "choose another") } else { ("does not exist", "create it first") };
            return Err(Error::unusable(path, format!("its folder {} {problem}", folder.display()), remedy));
        }
        tempfile::tempfile_in(folder).map(drop).map_err(Error::io(path, "create"))
    }

    /// Writes `text`; a file appears complete or not at all.
    pub fn write(&self, text: &str) -> Result<()> {
        match self {
            Self::File(path) => json::publish(path, text.as_bytes()),
            stream => stream.open(false)?.write(text.as_bytes()),
        }
    }

    /// Opens it for incremental writing. A file is truncated first unless it is to be `continued`, and rejected while
    /// another run writes to it.
    pub fn open(&self, continued: bool) -> Result<OpenSink> {
        let path = match self {
            Self::Stdout => return Ok(OpenSink::Stdout),
            Self::Stream(path) | Self::File(path) => path,
        };
        let is_file = matches!(self, Self::File(_));
        // Opened for reading too, a named pipe would not wait for its reader.
        let opened = OpenOptions::new().read(is_file && continued).append(true).create(is_file).open(path);
        let file = opened.map_err(Error::io(path, "open"))?;
        if is_file {
            if matches!(file.try_lock(), Err(TryLockError::WouldBlock)) {
                return Err(Error::unusable(path, "is being written by another run", "give each run its own file"));
            }
            if continued {
                end_last_line(&file).map_err(Error::io(path, "read"))?;
            } else {
                file.set_len(0).map_err(Error::io(path, "truncate"))?;
            }
        }
        Ok(OpenSink::File(path.into(), file))
    }
}

/// Removes the last line of JSON in `file` if a full disk or the end of the machine cut it short; whatever else does
/// not end with a newline gets one.
fn end_last_line(mut file: &File) -> std::io::Result<()> {
    let start = file.metadata()?.len().saturating_sub(LONGEST_LINE);
    let mut tail = Vec::new();
    file.seek(SeekFrom::Start(start))?;
    file.take(LONGEST_LINE).read_to_end(&mut tail)?;
    let last = tail.iter().rposition(|byte| *byte == b'\n').map_or(0, |at| at + 1);
    let line = &tail[last..];
    let is_ours = line.starts_with(LINE_START) || LINE_START.starts_with(line);
    match serde_json::from_slice::<IgnoredAny>(line) {
        _ if line.is_empty() => Ok(()),
        Err(_) if is_ours => file.set_len(start + last as u64),
        _ => file.write_all(b"\n"),
    }
}

/// An open [`Sink`].
pub enum OpenSink {
    /// Standard output.
    Stdout,
    /// A file or a stream, and its name.
    File(PathBuf, File),
}

impl OpenSink {
    /// Writes and flushes `bytes`.
    pub fn write(&mut self, bytes: &[u8]) -> Result<()> {
        match self {
            Self::Stdout => print(bytes),
            Self::File(path, file) => file.write_all(bytes).map_err(Error::io(path, "write")),
        }
    }
}

/// Rejects a pipe or a device for the `option`, which must be a file: a rename would replace it, and its reader would
/// wait for ever.
pub fn check_is_no_stream(option: &str, path: &Path) -> Result<(), CliError> {
    match Sink::of(path) {
        Sink::Stream(_) => {
            let text =
                format!("{option} {}: is a pipe or a device; write to a file, or to - and redirect", path.display());
            Err(CliError::Usage(text))
        }
        _ => Ok(()),
    }
}

/// Rejects `outputs` inside the work directory `folder`, whose files they could overwrite.
pub fn check_outside<'a>(
    folder: Option<&Path>,
    outputs: impl IntoIterator<Item = &'a PathBuf>,
) -> Result<(), CliError> {
    let Some(folder) = folder.and_then(|folder| folder.canonicalize().ok()) else { return Ok(()) };
    let inside =
        |path: &&PathBuf| path.as_path() != Path::new("-") && place(path).is_some_and(|at| at.starts_with(&folder));
    match outputs.into_iter().find(inside) {
        Some(path) => {
            Err(CliError::Usage(format!("{}: lies in the work directory; choose another folder", path.display())))
        }
        None => Ok(()),
    }
}

/// Whether `path` is an open file of a process, or a link to one: a rename would replace the link.
fn is_open_file(path: &Path) -> bool {
    let names_one = |path: &Path| {
        let numbered = path.parent().is_some_and(|folder| folder.ends_with("fd"));
        let named = ["/dev/stdout", "/dev/stderr"].map(Path::new).contains(&path);
        named || numbered && (path.starts_with("/dev/fd") || path.starts_with("/proc"))
    };
    names_one(path) || std::fs::read_link(path).is_ok_and(|to| names_one(&to))
}

/// Writes `bytes` to standard output.
pub fn print(bytes: &[u8]) -> Result<()> {
    let mut out = std::io::stdout().lock();
    out.write_all(bytes).and_then(|()| out.flush()).map_err(Error::io("<stdout>", "write"))
}

/// The location of the file or folder `path`, existing or not; `-` for standard output; `None` for pipes and devices,
/// where nothing can be overwritten.
fn place(path: &Path) -> Option<PathBuf> {
    match std::fs::metadata(path) {
        _ if path == Path::new("-") => Some(path.into()),
        Ok(there) if there.is_file() || there.is_dir() => path.canonicalize().ok(),
        Ok(_) => None,
        Err(_) => own_place(path),
    }
}

/// The location of `path` itself, even if it is a link.
fn own_place(path: &Path) -> Option<PathBuf> {
    Some(folder_of(path).canonicalize().ok()?.join(path.file_name()?))
}

/// Rejects outputs that would overwrite an input, each other, or files in the work directory `folder`, or that cannot
/// be written.
pub fn check_places<'a>(
    inputs: impl IntoIterator<Item = &'a PathBuf>,
    folder: Option<&Path>,
    outputs: impl IntoIterator<Item = &'a PathBuf> + Clone,
) -> Result<(), CliError> {
    check_places_or_folders(inputs, folder, outputs.clone())?;
    Ok(outputs.into_iter().try_for_each(|path| Sink::of(path).check())?)
}

/// The same, where outputs may be folders of parts.
pub fn check_places_or_folders<'a>(
    inputs: impl IntoIterator<Item = &'a PathBuf>,
    folder: Option<&Path>,
    outputs: impl IntoIterator<Item = &'a PathBuf> + Clone,
) -> Result<(), CliError> {
    check_distinct(inputs, outputs.clone())?;
    check_outside(folder, outputs.clone())?;
    Ok(outputs.into_iter().try_for_each(|path| match Sink::of(path) {
        sink if path.as_os_str().as_encoded_bytes().ends_with(b"/") => sink.check_place(),
        sink => sink.check(),
    })?)
}

/// Rejects outputs that would overwrite an input, a material library or a texture of one, or each other, also by a file
/// that is written on the way to one, or beside it.
pub fn check_distinct<'a>(
    inputs: impl IntoIterator<Item = &'a PathBuf>,
    outputs: impl IntoIterator<Item = &'a PathBuf>,
) -> Result<(), CliError> {
    let stdout = Path::new("-");
    let given: Vec<&PathBuf> = inputs.into_iter().collect();
    // An OBJ with materials keeps them, and gets no others.
    let keeps_materials = LazyCell::new(|| !given.is_empty() && given.iter().all(|path| uses_materials(path)));
    let given: Vec<&PathBuf> = given.iter().copied().filter(|path| *path != stdout).collect();
    let inputs: HashSet<PathBuf> = given.iter().filter_map(|path| place(path)).collect();
    let libraries = LazyCell::new(|| given.iter().flat_map(|path| material_libraries(path)).collect::<Vec<_>>());
    // Finding the libraries takes a pass over each OBJ, so other names are not looked up.
    let is_named = |path: &Path| ["mtl", "png"].iter().any(|ending| ends_with(path, ending)) && path.is_file();
    let is_library = |at: &Path| libraries.iter().any(|library| place(library).is_some_and(|place| place == at));
    let is_texture = |path: &Path| libraries.iter().any(|library| has_texture(library, path));
    let mut seen = BTreeMap::new();
    for path in outputs {
        let partial = place(&partial_name(path)).unwrap_or_default();
        let Some(place) = place(path) else { continue };
        let problem = match () {
            () if inputs.contains(&place) => "is an input, and would be overwritten; choose another file",
            () if is_named(path) && (is_library(&place) || is_texture(path)) => {
                "is a material library or a texture of an input, and would be overwritten; choose another file"
            }
            () if inputs.contains(&partial) => {
                "is written to a .partial file first, which is an input; choose another file"
            }
            () if seen.insert(place, path).is_none() => continue,
            () if path == stdout => {
                let text = "-: two outputs cannot both go to standard output; give one of them a file";
                return Err(CliError::Usage(text.into()));
            }
            () => "two outputs cannot have the same name; choose another file",
        };
        return Err(CliError::Usage(format!("{}: {problem}", path.display())));
    }
    let mut implied = BTreeSet::new();
    for path in seen.values().filter(|path| **path != stdout) {
        let materials = (Form::of(path) == Some(Form::Obj)).then(|| material_file(path)).transpose()?;
        for (file, is_material) in [(partial_name(path), false)].into_iter().chain(materials.map(|file| (file, true))) {
            // Links in their places are replaced, not followed.
            let Some(place) = own_place(&file) else { continue };
            if (seen.contains_key(&place) || !implied.insert(place)) && !(is_material && *keeps_materials) {
                let (file, path) = (file.display(), path.display());
                let text = format!("{path}: {file} is written with it, and is another output; choose another file");
                return Err(CliError::Usage(text));
            }
        }
    }
    let places = seen.into_keys().flat_map(|place| [place.parent().map(Path::to_path_buf), Some(place)]);
    lock(&PLACES).extend(places.flatten());
    Ok(())
}

/// Brings the names of outputs to the disk, as their content already is. This is done once for all of them: after each
/// of hundreds of small files it would take as long as all the rest. File systems that cannot do it are left alone.
pub fn sync_names() {
    for folder in lock(&PLACES).iter().filter(|place| place.is_dir()) {
        let _ = File::open(folder).and_then(|open| open.sync_all());
    }
}

/// The scratch folder of a command without outputs: beside the mesh at `path`, where there is usually room, or the
/// system's temporary folder if that is not writable, as in an archive.
pub fn scratch_beside(path: &Path) -> PathBuf {
    let folder = folder_of(path);
    if tempfile::tempfile_in(folder).is_ok() { folder.to_path_buf() } else { std::env::temp_dir() }
}
