//! Which format a file has: by its content where that says so, else by its name.

use super::lines::Lines;
use super::{off, stl};
use crate::base::{Error, Result};
use std::path::Path;

/// A format that is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::mesh) enum Format {
    Ply,
    Obj,
    Off,
    Stl,
}

/// Statements of OBJ files.
const OBJ: [&[u8]; 11] = [b"v", b"vn", b"vt", b"f", b"o", b"g", b"s", b"mtllib", b"usemtl", b"l", b"vp"];
/// Lines that are looked at to recognise one.
const LOOK: usize = 64;

/// How files of other formats begin.
const FOREIGN: [(&[u8], &str); 12] = [
    (b"glTF", "glTF"),
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
/// Endings of other formats.
const ENDINGS: [&str; 24] = [
    "gltf", "glb", "fbx", "dae", "3mf", "3ds", "blend", "step", "stp", "iges", "igs", "vtk", "vtp", "vtu", "las",
    "laz", "pcd", "xyz", "pts", "msh", "usd", "usdz", "wrl", "x3d",
];

/// The ending of the name, in lower case, without `.gz`.
fn ending(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let name = name.strip_suffix(".gz").unwrap_or(&name);
    name.rsplit_once('.').map_or("", |(_, ending)| ending).to_string()
}

/// The format of `bytes`, the uncompressed content of `path`.
///
/// # Errors
/// [`Error::Unusable`] for formats that are known but not read.
pub(in crate::mesh) fn recognise(path: &Path, bytes: &[u8]) -> Result<Format> {
    let start = bytes.trim_ascii_start();
    let ending = ending(path);
    let is_ply = start.get(..3).is_some_and(|word| word.eq_ignore_ascii_case(b"ply"))
        && start.get(3).is_none_or(u8::is_ascii_whitespace);
    if is_ply || bytes.is_empty() {
        return Ok(Format::Ply);
    }
    match ending.as_str() {
        "ply" => return Ok(Format::Ply),
        "obj" => return Ok(Format::Obj),
        "off" => return Ok(Format::Off),
        "stl" => return Ok(Format::Stl),
        _ => {}
    }
    let refuse = |name: &str| {
        let problem = format!("is a {name} file, which is not read");
        Err(Error::unusable(path, problem, "convert it to PLY, OBJ, OFF or STL, as with MeshLab or trimesh"))
    };
    if let Some((_, name)) = FOREIGN.iter().find(|(magic, _)| start.starts_with(magic)) {
        return refuse(name);
    }
    let head = &start[..start.len().min(1 << 14)];
    let first = head.split(|&byte| byte <= b' ').next().unwrap_or_default();
    if off::is_keyword(first) {
        return Ok(Format::Off);
    }
    if stl::has_binary_size(bytes) || stl::is_text(bytes) {
        return Ok(Format::Stl);
    }
    let mut lines = Lines::new(head, true).take(LOOK).peekable();
    let is_obj = lines.peek().is_some() && {
        // The last line of what is looked at may be cut off.
        lines.all(|line| line.words().next().is_some_and(|word| OBJ.contains(&word)))
    };
    if is_obj {
        return Ok(Format::Obj);
    }
    if ENDINGS.contains(&ending.as_str()) {
        return refuse(&format!(".{ending}"));
    }
    Ok(Format::Ply)
}
