//! Wavefront OBJ with one object and group per part, `part_0` or its name.
//!
//! If the input is an OBJ, everything that faces use is kept: positions with their colours, texture coordinates,
//! normals, materials and smoothing groups, each line verbatim; its own groups are replaced by those of the parts. A
//! mesh of another format, or one without materials, gets a material per part in the colours of the labels, in a `.mtl`
//! beside the `.obj`. Cost: one pass over the vertices and a few over the labels ([`by_part`](super::by_part)); for an
//! OBJ input two passes over its text, and 24 bytes per face, 48 if numbers are relative, in memory or in a temporary
//! file.

use super::by_part::{PartFaces, each_part};
use super::split::plain_name;
use super::{CHUNK, parts, work_beside};
use crate::base::{Error, Result};
use crate::mesh::import::{self, is_face, statements, words};
use crate::mesh::output::{Gather, publish};
use crate::mesh::ply::labelled::colour_of;
use crate::mesh::ply::{Encoder, Encoding, Scalar};
use crate::mesh::{Labelling, Mesh};
use crate::store::npy::ArrayMut;
use crate::store::{MappedBytes, MappedSlice, Run, WorkDir, folder_of};
use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::io::{Read as _, Write as _};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

/// First line of a material file written by this program.
const OURS: &str = "# colours of parts, by nystrom-stream\n";
/// A material that no library contains; it resets faces to the state before the first `usemtl`.
const NO_MATERIAL: &[u8] = b"usemtl no_material";
/// Keywords of textures in a material library, besides those that begin with `map_`.
const TEXTURES: [&[u8]; 5] = [b"bump", b"decal", b"disp", b"norm", b"refl"];
/// Maximum number of bytes of a path.
const LONGEST_PATH: usize = 4096;

/// The text of an OBJ input, with its faces.
struct Source<'a> {
    bytes: &'a [u8],
    /// For each face (n, 3) the offset of its line, and the offsets plus one of the `usemtl` and `s` lines in force; 0:
    /// none yet.
    lines: MappedSlice<u64>,
    /// The number of v, vt and vn before each face (n, 3), if any face uses relative numbers.
    counts: Option<MappedSlice<u64>>,
    has_materials: bool,
}

/// The corner numbers of a face, with relative ones made absolute by the `counts` of v, vt and vn so far.
fn absolute(text: &[u8], counts: [u64; 3], out: &mut Vec<u8>) {
    out.push(b'f');
    for word in words(text).skip(1) {
        for (k, number) in word.split(|&byte| byte == b'/').enumerate() {
            out.push(if k == 0 { b' ' } else { b'/' });
            let back = std::str::from_utf8(number).ok().and_then(|number| number.parse::<i64>().ok());
            match back.filter(|&number| number < 0) {
                Some(back) => {
                    let number = counts[k.min(2)] as i64 + 1 + back;
                    out.extend_from_slice(number.to_string().as_bytes());
                }
                None => out.extend_from_slice(number),
            }
        }
    }
}

/// Three numbers of a face.
fn three(numbers: &[u64], face: usize) -> [u64; 3] {
    [numbers[3 * face], numbers[3 * face + 1], numbers[3 * face + 2]]
}

impl<'a> Source<'a> {
    /// The faces of the text `bytes`; `None` if there are not `n`, since it is then another mesh.
    fn of(bytes: &'a [u8], n: usize, work: &WorkDir, run: &Run) -> Result<Option<Self>> {
        let mut lines = work.array::<u64>("lines.npy", &[n, 3])?;
        let mut relative: Option<ArrayMut<u64>> = None;
        let (mut faces, mut counts, mut in_force) = (0, [0u64; 3], [0u64; 2]);
        for (keyword, text) in statements(bytes) {
            let start = (text.as_ptr() as usize - bytes.as_ptr() as usize) as u64;
            match keyword {
                b"v" => counts[0] += 1,
                b"vt" => counts[1] += 1,
                b"vn" => counts[2] += 1,
                b"usemtl" => in_force[0] = start + 1,
                b"s" => in_force[1] = start + 1,
                _ if is_face(keyword) => {
                    if faces % CHUNK == 0 {
                        run.cancel.check()?;
                    }
                    if faces == n {
                        return Ok(None);
                    }
                    let own = 3 * faces..3 * faces + 3;
                    lines.data()[own.clone()].copy_from_slice(&[start, in_force[0], in_force[1]]);
                    if text.contains(&b'-') {
                        if relative.is_none() {
                            relative = Some(work.array::<u64>("counts.npy", &[n, 3])?);
                        }
                        relative.iter_mut().for_each(|all| all.data()[own.clone()].copy_from_slice(&counts));
                    }
                    faces += 1;
                }
                _ => {}
            }
        }
        if faces < n {
            return Ok(None);
        }
        let counts = relative.map(|all| all.finish(false)).transpose()?;
        Ok(Some(Self { bytes, lines: lines.finish(false)?, counts, has_materials: in_force[0] > 0 }))
    }

    /// The statement that starts at `start`.
    fn statement(&self, start: u64) -> &'a [u8] {
        statements(&self.bytes[start as usize..]).next().map_or(&[][..], |(_, text)| text)
    }

    /// Appends the line of `face`, which starts at `start`.
    fn line(&self, face: usize, start: u64, out: &mut Vec<u8>) {
        let text = self.statement(start);
        match self.counts.as_ref().filter(|_| text.contains(&b'-')) {
            Some(counts) => absolute(text, three(counts, face), out),
            None => out.extend_from_slice(text),
        }
    }
}

/// Whether the file `path` does not exist or is one of our material files.
fn is_free(path: &Path) -> bool {
    let mut begin = vec![0; OURS.len()];
    match std::fs::File::open(path) {
        Ok(mut file) => file.read_exact(&mut begin).is_ok() && begin == OURS.as_bytes(),
        Err(error) => error.kind() == std::io::ErrorKind::NotFound,
    }
}

/// The material file of the OBJ file `path`, if the input has no materials: never overwrites one of another program.
///
/// # Errors
/// [`Error::Unusable`] if a thousand names that it could have are taken.
pub fn material_file(path: &Path) -> Result<PathBuf> {
    let endings = (2..).map(|k| format!("parts{k}.mtl"));
    let all = ["mtl".to_string(), "parts.mtl".into()].into_iter().chain(endings).map(|end| path.with_extension(end));
    all.take(1000).find(|place| is_free(place)).ok_or_else(|| {
        let problem = "its materials have no name: all up to .parts999.mtl are files that cannot be replaced";
        Error::unusable(path, problem, "give it another name or folder")
    })
}

/// The names of objects, all different: a number is appended if another part has the same name.
fn names(parts: usize, labelling: &Labelling) -> Vec<String> {
    let mut taken = BTreeSet::new();
    let free = |part: usize| {
        let mut name = plain_name(labelling.name(part));
        if name.is_empty() {
            name = format!("part_{part}");
        }
        while !taken.insert(name.clone()) {
            name += &format!("_{part}");
        }
        name
    };
    (0..parts).map(free).collect()
}

/// Writes `path`, by rename, and, if the input has no materials, the file of the same name with `.mtl`; if that belongs
/// to another program, `.parts.mtl` with a note.
///
/// # Errors
/// [`Error::Parameter`] for labels that do not match the faces; [`Error::Io`]; [`Error::Cancelled`].
pub fn write(path: &Path, mesh: &Mesh, labelling: &Labelling, run: &Run) -> Result<()> {
    let parts = parts(mesh, labelling)?;
    let n = mesh.faces.len();
    let bytes = match MappedBytes::open(mesh.path()) {
        Ok(bytes) if import::name(mesh.path(), &bytes) == "OBJ" => Some(bytes),
        _ => None,
    };
    let work = work_beside(path, run);
    let source = bytes.as_ref().map(|bytes| Source::of(bytes, n, &work, run)).transpose()?.flatten();
    let own = source.as_ref().is_none_or(|source| !source.has_materials);
    let materials = material_file(path)?;
    let is_new = own && !materials.exists();
    if own {
        if materials != path.with_extension("mtl") {
            let kept = path.with_extension("mtl");
            run.progress.note(&format!("{} is kept: the materials go to {}", kept.display(), materials.display()));
        }
        publish(&materials, 0, |file| {
            let mut text = String::from(OURS);
            for part in 0..parts {
                let colour = colour_of(labelling.colours, part as u32);
                // Rounded up, since MeshLab rounds down when it converts them to bytes.
                let [r, g, b] = colour.map(|part| (f64::from(part) / 255. * 1e6).ceil() / 1e6);
                text += &format!("newmtl part_{part}\nKd {r:.6} {g:.6} {b:.6}\nKa 0 0 0\nKs 0 0 0\nd 1\nillum 1\n");
            }
            file.write_all(text.as_bytes()).map_err(Error::io(&materials, "write"))
        })?;
    }
    let written = publish(path, 0, |file| {
        let mut out = Gather::new(path, file);
        out.buffer.extend_from_slice(b"# parts by nystrom-stream, an object and a group each\n");
        if own {
            let name = materials.file_name().unwrap_or_default().as_bytes();
            out.buffer.extend_from_slice(&[b"mtllib ", name, b"\n"].concat());
        }
        match &source {
            Some(source) => vertices_of(source, mesh.path(), path, &mut out, run)?,
            None => vertices(mesh, &mut out)?,
        }
        let mut writer = ObjParts { mesh, source: source.as_ref(), own, in_force: [0; 2] };
        let names = names(parts, labelling);
        each_part(labelling.labels, parts, run, |faces| writer.write(faces, &names[faces.part as usize], &mut out))?;
        out.finish()
    });
    if written.is_err() && is_new {
        // Materials of nothing; the error that counts is the first.
        std::fs::remove_file(&materials).ok();
    }
    written
}

/// The files in `folder` named by the words after `mtllib`: a single one if such a file exists, with blanks in its
/// name. A comment may follow. Names are bytes: files of other programs may be in any encoding.
fn libraries(names: &[u8], folder: &Path) -> Vec<PathBuf> {
    let place = |name: &[u8]| folder.join(OsStr::from_bytes(name.trim_ascii()));
    let plain = names.windows(2).position(|two| two == b" #").map_or(names, |at| &names[..at]);
    let whole = [names, plain].map(place).into_iter().find(|place| place.exists());
    let words = || plain.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
    whole.map_or_else(|| words().map(place).collect(), |place| vec![place])
}

/// The content of the file `path`; `None` if it cannot be read, or is a pipe or a device.
fn content(path: &Path) -> Option<MappedBytes> {
    path.is_file().then(|| MappedBytes::open(path).ok()).flatten()
}

/// The material libraries that the OBJ file `path` names, in one pass over its text; none if it is no OBJ, or
/// compressed.
pub fn material_libraries(path: &Path) -> BTreeSet<PathBuf> {
    let Some(bytes) = content(path).filter(|bytes| import::name(path, bytes) == "OBJ") else { return BTreeSet::new() };
    let lines = statements(&bytes).filter(|(keyword, _)| *keyword == b"mtllib");
    lines.flat_map(|(keyword, text)| libraries(&text[keyword.len()..], folder_of(path))).collect()
}

/// Whether the OBJ file `path` assigns materials, which are kept; one pass over its text up to the first. False if it
/// is no OBJ, or compressed.
pub fn uses_materials(path: &Path) -> bool {
    let bytes = content(path).filter(|bytes| import::name(path, bytes) == "OBJ");
    bytes.is_some_and(|bytes| statements(&bytes).any(|(keyword, _)| keyword == b"usemtl"))
}

/// Whether the material library `path` names the existing `file` as a texture. Its name is the end of the line, after
/// options, and may have blanks.
pub fn has_texture(path: &Path, file: &Path) -> bool {
    let (Some(bytes), Some(name), Ok(place)) = (content(path), file.file_name(), file.canonicalize()) else {
        return false;
    };
    statements(&bytes).any(|(keyword, text)| {
        let keyword = keyword.to_ascii_lowercase();
        let is_texture = keyword.starts_with(b"map_") || TEXTURES.contains(&&keyword[..]);
        let from = keyword.len().max(text.len().saturating_sub(LONGEST_PATH));
        let ends = || (from..text.len()).filter(|&k| text[k].is_ascii_whitespace()).map(|k| text[k..].trim_ascii());
        let at = |end: &[u8]| folder_of(path).join(OsStr::from_bytes(end)).canonicalize();
        is_texture && text.ends_with(name.as_bytes()) && ends().any(|end| at(end).is_ok_and(|at| at == place))
    })
}

/// Everything in the input except faces and their attributes; material libraries only if faces use materials.
fn vertices_of(source: &Source, from: &Path, to: &Path, out: &mut Gather, run: &Run) -> Result<()> {
    let folder = |path: &Path| std::path::absolute(path).ok().and_then(|path| path.parent().map(Path::to_path_buf));
    for (k, (keyword, text)) in statements(source.bytes).enumerate() {
        if k % CHUNK == 0 {
            run.cancel.check()?;
        }
        match keyword {
            b"mtllib" if !source.has_materials => {}
            // In another folder, materials and their textures must still be found at their original location.
            b"mtllib" if folder(from) != folder(to) => {
                for place in libraries(&text[keyword.len()..], &folder(from).unwrap_or_default()) {
                    out.buffer.extend_from_slice(&[b"mtllib ", place.as_os_str().as_bytes(), b"\n"].concat());
                }
            }
            b"v" | b"vt" | b"vn" | b"vp" | b"mtllib" => {
                out.buffer.extend_from_slice(text);
                out.buffer.push(b'\n');
            }
            _ => {}
        }
        out.flush_if_full()?;
    }
    Ok(())
}

fn vertices(mesh: &Mesh, out: &mut Gather) -> Result<()> {
    let encoder = Encoder { target: Encoding::Ascii };
    let scalar = Scalar::coordinate(mesh.positions.is_double());
    for v in 0..mesh.positions.len() as u32 {
        out.buffer.extend_from_slice(b"v ");
        mesh.positions.get(v).into_iter().for_each(|x| encoder.real(scalar, x, &mut out.buffer));
        encoder.end(&mut out.buffer);
        out.flush_if_full()?;
    }
    Ok(())
}

/// Writes the faces of parts, one line each, after the statements of the input that apply to them.
struct ObjParts<'a> {
    mesh: &'a Mesh,
    source: Option<&'a Source<'a>>,
    /// Whether parts get our own materials.
    own: bool,
    /// The `usemtl` and `s` that were written last, as in [`Source::lines`].
    in_force: [u64; 2],
}

impl ObjParts<'_> {
    /// Writes a part, if it has faces.
    fn write(&mut self, faces: &PartFaces<'_>, name: &str, out: &mut Gather) -> Result<()> {
        let mut begun = false;
        faces.each(|face| {
            if !begun {
                out.buffer.extend_from_slice(format!("o {name}\ng {name}\n").as_bytes());
                if self.own {
                    out.buffer.extend_from_slice(format!("usemtl part_{}\n", faces.part).as_bytes());
                }
            }
            self.face(face, !begun, out);
            begun = true;
            out.flush_if_full()
        })
    }

    /// Writes a face, preceded by the statements that apply to it, if they changed or the face is the `first` of its
    /// part.
    fn face(&mut self, face: usize, first: bool, out: &mut Gather) {
        if let Some(source) = self.source {
            let [start, holding @ ..] = three(&source.lines, face);
            for (k, none) in [NO_MATERIAL, b"s off"].into_iter().enumerate().skip(usize::from(self.own)) {
                let (now, before) = (holding[k], self.in_force[k]);
                // A statement that was never set needs no reset.
                if now != before || first && now > 0 {
                    out.buffer.extend_from_slice(if now > 0 { source.statement(now - 1) } else { none });
                    out.buffer.push(b'\n');
                }
            }
            self.in_force = holding;
            source.line(face, start, &mut out.buffer);
        } else {
            out.buffer.push(b'f');
            self.mesh.faces.with(face, |corners| {
                for &corner in corners {
                    out.buffer.push(b' ');
                    out.decimal(u64::from(corner) + 1);
                }
            });
        }
        out.buffer.push(b'\n');
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXTURED: &str = "mtllib scan.mtl\no old\nv 0 0 0 1 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\n\
         vn 0 0 1\nusemtl skin\ns 1\nf 1/1/1 2/2/1 3/1/1\ng other\nusemtl cloth\nv 2 0 0\n\
         f -5/1/-1 -3/2/-1 -2/-1/-1\nf 2//1 5//1 3//1 # last\n";

    fn written(name: &str, text: &str, labels: &[u32]) -> (String, Option<String>) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(name);
        std::fs::write(&path, text).unwrap();
        let (run, mesh) = (Run::new(&()), Mesh::open(&path).unwrap());
        let out = dir.path().join("out.obj");
        let labelling =
            Labelling { labels, colours: &[[255, 0, 0], [0, 0, 255]], quality: None, names: &[], fine: None };
        write(&out, &mesh, &labelling, &run).unwrap();
        // It is read back as the same faces, in the order of the parts.
        assert_eq!(Mesh::open(&out).unwrap().faces.len(), mesh.faces.len());
        (std::fs::read_to_string(&out).unwrap(), std::fs::read_to_string(dir.path().join("out.mtl")).ok())
    }

    /// Material and smoothing group of each face of an OBJ text, keyed by its line; `None` if there is none, or no such
    /// material in a library.
    fn in_force(text: &str) -> Vec<(&str, Option<&str>, Option<&str>)> {
        let (mut material, mut smoothing, mut all) = (None, None, Vec::new());
        for line in text.lines() {
            match line.split_once(' ') {
                Some(("usemtl", name)) => material = Some(name).filter(|name| *name != "no_material"),
                Some(("s", group)) => smoothing = Some(group).filter(|group| *group != "off"),
                Some(("f", corners)) => all.push((corners, material, smoothing)),
                _ => {}
            }
        }
        all.sort_unstable();
        all
    }

    /// Regression: where the disk became full, the materials of no file stayed.
    #[test]
    fn without_the_file_there_are_no_new_materials() {
        let dir = tempfile::tempdir().unwrap();
        let [out, materials] = ["out.obj", "out.mtl"].map(|name| dir.path().join(name));
        let mesh = Mesh::from_slices(&[[0., 0., 0.], [1., 0., 0.], [0., 1., 0.]], &[[0, 1, 2]]).unwrap();
        let labelling = Labelling { labels: &[0], colours: &[[255, 0, 0]], quality: None, names: &[], fine: None };
        let stopped = Run::new(&());
        stopped.cancel.cancel();
        assert!(write(&out, &mesh, &labelling, &stopped).is_err());
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
        // Those of an earlier file stay with it.
        write(&out, &mesh, &labelling, &Run::new(&())).unwrap();
        assert!(write(&out, &mesh, &labelling, &stopped).is_err());
        assert!(out.exists() && materials.exists());
    }

    #[test]
    fn faces_before_the_first_statement_keep_having_none() {
        // Regression: such faces had the material and the smoothing group of the previously written face.
        let fan: String = (0..12).map(|k| format!("v {k} {} 0\n", k * k)).collect();
        let face = |k: usize| format!("f 1 {} {}\n", k + 2, k + 3);
        let [a, b, c, d, e] = [0, 2, 4, 6, 8].map(|k| face(k) + &face(k + 1));
        let text = format!("{fan}{a}usemtl red\n{b}s 1\n{c}usemtl blue\n{d}s off\n{e}");
        for labels in [[0, 1, 0, 1, 0, 1, 0, 1, 0, 1], [1, 1, 1, 0, 0, 1, 1, 0, 0, 0], [0; 10]] {
            let (out, _) = written("scan.obj", &text, &labels);
            assert_eq!(in_force(&out), in_force(&text), "{labels:?}\n{out}");
        }
    }

    #[test]
    fn objects_of_parts_have_names_of_their_own() {
        // Regression: "left arm" and "left_arm" became one object.
        let names = ["left arm", "left_arm", "", "part 2", "left_arm_1"].map(String::from);
        let labelling = Labelling { labels: &[], colours: &[], quality: None, names: &names, fine: None };
        let found = super::names(6, &labelling);
        assert_eq!(found, ["left_arm", "left_arm_1", "part_2", "part_2_3", "left_arm_1_4", "part_5"]);
    }

    #[test]
    fn every_library_of_a_line_is_found_from_another_folder() {
        // Regression: only the first of them was used.
        let dir = tempfile::tempdir().unwrap();
        let place = |name: &str| dir.path().join(name);
        assert_eq!(libraries(b" a.mtl  b.mtl", dir.path()), [place("a.mtl"), place("b.mtl")]);
        std::fs::write(place("of a scan.mtl"), "").unwrap();
        assert_eq!(libraries(b" of a scan.mtl", dir.path()), [place("of a scan.mtl")]);
        assert_eq!(libraries(b" of a scan.mtl # of it", dir.path()), [place("of a scan.mtl")]);
        assert_eq!(libraries(b" a.mtl b.mtl # c", dir.path()), [place("a.mtl"), place("b.mtl")]);
        std::fs::write(place("no #1.mtl"), "").unwrap();
        assert_eq!(libraries(b" no #1.mtl", dir.path()), [place("no #1.mtl")]);
    }

    #[test]
    fn materials_with_a_hash_in_their_names_stay_apart() {
        // Regression: names ended at the hash, so that all such materials became one, which no library had.
        let text = "mtllib a#1.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nusemtl Material #1\nf 1 2 3\n\
             usemtl Material #2\nf 2 4 3\n";
        let (out, _) = written("scan.obj", text, &[0, 0]);
        assert!(out.contains("\nmtllib a#1.mtl\n"), "{out}");
        assert_eq!(in_force(&out), in_force(text));
    }

    #[test]
    fn materials_of_others_are_not_written_over() {
        // Regression: an unrelated file x.mtl was overwritten when x.obj was written.
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("x.obj");
        let mesh = Mesh::from_slices(&[[0f32, 0., 0.], [1., 0., 0.], [0., 1., 0.]], &[[0u32, 1, 2]]).unwrap();
        let labelling = Labelling { labels: &[0], colours: &[[255, 0, 0]], quality: None, names: &[], fine: None };
        let text = || std::fs::read_to_string(&out).unwrap();
        for _ in 0..2 {
            write(&out, &mesh, &labelling, &Run::new(&())).unwrap();
            assert!(text().contains("mtllib x.mtl\n"), "our own are");
        }
        let theirs = dir.path().join("x.mtl");
        std::fs::write(&theirs, "newmtl brass\n").unwrap();
        for _ in 0..2 {
            write(&out, &mesh, &labelling, &Run::new(&())).unwrap();
            assert_eq!(std::fs::read_to_string(&theirs).unwrap(), "newmtl brass\n");
            assert!(text().contains("mtllib x.parts.mtl\n") && dir.path().join("x.parts.mtl").exists());
        }
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 3);
    }

    #[test]
    fn a_mesh_beyond_the_budget_goes_through_a_file() {
        // Regression: rewritten lines were held in memory, and a budget without room for the faces was refused.
        let mut text = String::new();
        for k in 0..3000 {
            text += &format!("v {k} 0 0\nv {k} 1 0\nv {k} 0 1\nf -3 -2 -1\n");
        }
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("scan.obj");
        std::fs::write(&path, &text).unwrap();
        let mesh = Mesh::open(&path).unwrap();
        let labelling =
            Labelling { labels: &[0; 3000], colours: &[[255, 0, 0]], quality: None, names: &[], fine: None };
        let [small, large] = [1 << 14, 1 << 28].map(|bytes| {
            let run = Run { budget: crate::store::Budget::new(bytes), ..Run::new(&()) };
            let out = dir.path().join("out.obj");
            write(&out, &mesh, &labelling, &run).unwrap();
            std::fs::read_to_string(&out).unwrap()
        });
        assert!(small == large && small.ends_with("\nf 8998 8999 9000\n"));
    }

    #[test]
    fn texture_coordinates_and_materials_stay() {
        let (text, own) = written("scan.obj", TEXTURED, &[0, 1, 0]);
        assert!(own.is_none(), "the input's materials");
        let expected = "# parts by nystrom-stream, an object and a group each\nmtllib scan.mtl\n\
             v 0 0 0 1 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\nvn 0 0 1\nv 2 0 0\n\
             o part_0\ng part_0\nusemtl skin\ns 1\nf 1/1/1 2/2/1 3/1/1\nusemtl cloth\nf 2//1 5//1 3//1\n\
             o part_1\ng part_1\nusemtl cloth\ns 1\nf 1/1/1 3/2/1 4/2/1\n";
        assert_eq!(text, expected);
    }

    #[test]
    fn other_meshes_get_a_material_per_part() {
        let off = "OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 0 2 3\n";
        let (text, own) = written("square.off", off, &[1, 0]);
        assert!(text.contains("mtllib out.mtl\nv 0.0 0.0 0.0\n"), "{text}");
        assert!(
            text.ends_with("o part_0\ng part_0\nusemtl part_0\nf 1 3 4\no part_1\ng part_1\nusemtl part_1\nf 1 2 3\n")
        );
        assert!(own.unwrap().contains("newmtl part_1\nKd 0.000000 0.000000 1.000000\n"));
    }

    /// Regression: a library that no face uses was taken for ours, and a name that is not UTF-8 was corrupted.
    #[test]
    fn libraries_are_those_of_the_materials_byte_for_byte() {
        let text = "mtllib in.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n";
        let (out, own) = written("in.obj", text, &[0, 1]);
        assert!(out.contains("mtllib out.mtl\n") && !out.contains("in.mtl") && own.is_some(), "{out}");
        let dir = tempfile::tempdir().unwrap();
        let place = dir.path().join(OsStr::from_bytes(b"l\xe9 mat.mtl"));
        std::fs::write(&place, "").unwrap();
        assert_eq!(libraries(b" l\xe9 mat.mtl # ours", dir.path()), [place]);
        assert_eq!(libraries(b" a.mtl b.mtl", dir.path()), ["a.mtl", "b.mtl"].map(|name| dir.path().join(name)));
    }
}
