//! Meshes in other formats than PLY: OBJ, OFF and STL become a PLY in the scratch folder.
//!
//! The format is recognised by the content where possible, else by the file's name. The mesh is streamed through one
//! buffer into a binary PLY of double coordinates (floats for STL, as in the file), which is then read in place. So
//! whatever holds for PLY holds for these too, and labelled meshes are written as PLY. Text is read three times, to
//! count, for vertices and for faces: some 40 ns per number in all. On disk 24 bytes per vertex and 13 per triangle.

mod stl;
mod target;
mod text;

pub use target::Counts;

use crate::base::{Cancel, Error, Result};
use crate::mesh::output::Gather;
use crate::store::leftovers::CONVERTED;
use crate::store::new_file::by_rename;
use crate::store::{MappedBytes, Run};
use std::path::Path;
use target::Target;
use text::{Lines, obj, off, without_mark};
pub(crate) use text::{obj::is_face, words};

/// A supported input format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::mesh) enum Format {
    Ply,
    Obj,
    Off,
    Stl,
}

/// Lines examined to recognise a format.
const LINES_EXAMINED: usize = 64;

/// First bytes of unsupported formats.
const FOREIGN: [(&[u8], &str); 15] = [
    (b"glTF", "glTF"),
    (b"BZh", "bzip2 (gzip is decompressed)"),
    (b"\xfd7zXZ\0", "xz (gzip is decompressed)"),
    (b"\x28\xb5\x2f\xfd", "zstd (gzip is decompressed)"),
    (b"PK\x03\x04", "zip (3MF, USDZ or an archive)"),
    (b"Kaydara FBX", "FBX"),
    (b"BLENDER", "Blender"),
    (b"# vtk", "VTK"),
    (b"# .PCD", "PCD point cloud"),
    (b"LASF", "LAS point cloud"),
    (b"ISO-10303", "STEP"),
    (b"$MeshFormat", "Gmsh"),
    (b"#VRML", "VRML"),
    (b"<", "XML (COLLADA, X3D, VTK)"),
    (b"{", "JSON (glTF)"),
];
/// File extensions of unsupported formats.
const UNSUPPORTED_EXTENSIONS: [&str; 25] = [
    "gltf", "glb", "fbx", "dae", "3mf", "3ds", "blend", "step", "stp", "iges", "igs", "vtk", "vtp", "vtu", "las",
    "laz", "pcd", "xyz", "pts", "e57", "msh", "usd", "usdz", "wrl", "x3d",
];

/// Those of them that hold points without faces.
const POINT_CLOUDS: [&str; 6] = ["las", "laz", "pcd", "xyz", "pts", "e57"];

/// The file extension in lower case, not counting `.gz`.
fn extension(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let name = name.strip_suffix(".gz").unwrap_or(&name);
    name.rsplit_once('.').map_or("", |(_, extension)| extension).to_string()
}

/// Whether `bytes` start with gzip's magic number.
pub(in crate::mesh) fn is_compressed(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0x1f, 0x8b])
}

/// The name of the format of the file `path` with content `bytes`: "OBJ", "STL, text".
pub fn name(path: &Path, bytes: &[u8]) -> String {
    if is_compressed(bytes) {
        return "compressed (gzip)".into();
    }
    match recognise(path, bytes) {
        Ok(Format::Ply) => "PLY".into(),
        Ok(Format::Obj) => "OBJ".into(),
        Ok(Format::Off) => "OFF".into(),
        Ok(Format::Stl) if stl::is_text(bytes) => "STL, text".into(),
        Ok(Format::Stl) => "STL, binary".into(),
        Err(_) => "unknown".into(),
    }
}

/// The format of `bytes`, the uncompressed content of `path`.
///
/// # Errors
/// [`Error::Unusable`] for known but unsupported formats, and for files named as PLY that are of another format.
pub(in crate::mesh) fn recognise(path: &Path, bytes: &[u8]) -> Result<Format> {
    let start = without_mark(bytes).trim_ascii_start();
    let extension = extension(path);
    let is_ply = start.get(..3).is_some_and(|word| word.eq_ignore_ascii_case(b"ply"))
        && start.get(3).is_none_or(u8::is_ascii_whitespace);
    if is_ply || bytes.is_empty() {
        return Ok(Format::Ply);
    }
    let head = &start[..start.len().min(1 << 14)];
    if extension == "ply" {
        let misnamed =
            [(is_off(head), "OFF", ".off"), (stl::is_text(bytes), "STL", ".stl"), (is_obj(head), "OBJ", ".obj")];
        return match misnamed.iter().find(|(is_it, ..)| *is_it) {
            Some((_, name, extension)) => {
                let problem = format!("is named as PLY, but its content is {name}");
                Err(Error::unusable(path, problem, format!("rename it to end with {extension}")))
            }
            None => Ok(Format::Ply),
        };
    }
    match extension.as_str() {
        "obj" => return Ok(Format::Obj),
        "off" => return Ok(Format::Off),
        "stl" => return Ok(Format::Stl),
        _ => {}
    }
    let refuse = |name: &str| {
        let problem = format!("is a {name} file, which is not supported");
        // Converted, points would be refused again: they have no faces.
        let remedy = if POINT_CLOUDS.contains(&extension.as_str()) || name.ends_with("point cloud") {
            "reconstruct a surface from its points first, as with MeshLab or Open3D"
        } else {
            "convert it to PLY, OBJ, OFF or STL, as with MeshLab or trimesh"
        };
        Err(Error::unusable(path, problem, remedy))
    };
    if let Some((_, name)) = FOREIGN.iter().find(|(magic, _)| start.starts_with(magic)) {
        return refuse(name);
    }
    if is_off(head) {
        return Ok(Format::Off);
    }
    if stl::has_binary_size(bytes) || stl::is_text(bytes) {
        return Ok(Format::Stl);
    }
    if is_obj(head) {
        return Ok(Format::Obj);
    }
    if UNSUPPORTED_EXTENSIONS.contains(&extension.as_str()) {
        return refuse(&format!(".{extension}"));
    }
    Ok(Format::Ply)
}

/// Whether `head`, the first bytes of a file, begin as OFF does.
fn is_off(head: &[u8]) -> bool {
    Lines::new(head, false).next().is_some_and(|line| line.words().next().is_some_and(off::is_keyword))
}

/// Whether all lines of `head`, the first bytes of a file, are statements of OBJ.
fn is_obj(head: &[u8]) -> bool {
    let mut lines = Lines::new(head, true).take(LINES_EXAMINED).peekable();
    // The last line examined may be cut off.
    lines.peek().is_some() && lines.all(|line| line.words().next().is_some_and(obj::is_keyword))
}

/// Writes the mesh in `bytes`, the content of `path`, to `scratch` as PLY and maps that file; oddities are added to
/// `notes`.
///
/// # Errors
/// [`Error::Malformed`] naming the line, or the byte, that is wrong; [`Error::Unusable`]; [`Error::Io`];
/// [`Error::Cancelled`].
pub(super) fn convert(
    format: Format,
    path: &Path,
    bytes: &[u8],
    scratch: &Path,
    notes: &mut Vec<String>,
    run: &Run,
) -> Result<MappedBytes> {
    let to = scratch.join(CONVERTED);
    by_rename(&to, 0, false, |file| {
        let mut out = Gather::new(&to, file);
        let mut target = Target { out: &mut out, run, path, counts: Counts::default(), records: 0 };
        match format {
            Format::Obj => obj::convert(bytes, &mut target)?,
            Format::Off => off::convert(bytes, &mut target)?,
            Format::Stl => stl::convert(bytes, &mut target, notes)?,
            Format::Ply => target.out.pass(bytes)?,
        }
        out.finish()
    })?;
    MappedBytes::open(&to)
}

/// The statements of an OBJ file: keyword and whole line, without comments.
pub(crate) fn statements(bytes: &[u8]) -> impl Iterator<Item = (&[u8], &[u8])> {
    Lines::new(bytes, true).filter_map(|line| line.words().next().map(|word| (word, line.text)))
}

/// Counts the elements of the mesh in `bytes`, the content of `path`, in one pass over its text; `None` for a PLY,
/// whose header has the counts.
///
/// # Errors
/// [`Error::Malformed`], [`Error::Unusable`], [`Error::Cancelled`].
pub fn count(path: &Path, bytes: &[u8], cancel: &Cancel) -> Result<Option<Counts>> {
    Ok(match recognise(path, bytes)? {
        Format::Ply => None,
        Format::Obj => Some(obj::count(path, bytes, cancel)?),
        Format::Off => Some(off::count(path, bytes, cancel)?),
        Format::Stl => Some(stl::count(path, bytes, cancel)?),
    })
}

/// Whether `head`, the first bytes of `path`, are those of a PLY.
pub fn is_ply(path: &Path, head: &[u8]) -> bool {
    recognise(path, head).is_ok_and(|format| format == Format::Ply)
}
