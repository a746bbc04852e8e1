//! Wavefront OBJ with one object and group per part, `part_0` or its name.
//!
//! Of an OBJ input everything that faces use stays: positions with their colours, texture coordinates, normals,
//! materials and smoothing groups, each line as it stands; its own groups give way to those of the parts. A mesh of
//! another format, or one without materials, gets a material per part in the colours of the labels, in a `.mtl` beside
//! the `.obj`. Cost: one pass over the vertices and one per part over the labels; of an OBJ input three passes over its
//! text and 24 bytes per face, and the text of faces whose numbers count backwards.

use super::split::plain_name;
use super::{CHUNK, parts};
use crate::base::{Error, Result};
use crate::mesh::import::statements;
use crate::mesh::output::{Gather, by_rename};
use crate::mesh::ply::{Encoder, Encoding, Scalar};
use crate::mesh::{Labelling, Mesh};
use crate::store::{MappedBytes, Run};
use std::io::Write as _;
use std::path::Path;

/// Bytes kept per face of an OBJ input.
const PER_FACE: u64 = 24;

/// A face of the input: its line, and the statements in force.
#[derive(Clone, Copy)]
struct Face {
    start: u64,
    len: u32,
    /// Whether the line lies in [`Source::rewritten`].
    rewritten: bool,
    /// One more than the number of the line `usemtl`, and of `s`; 0: none yet.
    material: u32,
    smoothing: u32,
}

/// The text of an OBJ input, with its faces.
struct Source<'a> {
    bytes: &'a [u8],
    faces: Vec<Face>,
    rewritten: Vec<u8>,
    materials: Vec<&'a [u8]>,
    smoothings: Vec<&'a [u8]>,
}

/// The numbers of a face's corners, absolute where they count back from the `counts` of v, vt and vn so far.
fn absolute(text: &[u8], counts: [u64; 3], out: &mut Vec<u8>) {
    out.push(b'f');
    for word in text.split(|&byte| byte <= b' ' || byte == b'\\').filter(|word| !word.is_empty()).skip(1) {
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

impl<'a> Source<'a> {
    /// The faces of the text `bytes`; nothing where they are not `n`, since it is not the mesh then.
    fn of(bytes: &'a [u8], n: usize, run: &Run) -> Result<Option<Self>> {
        let mut source = Self {
            bytes,
            faces: Vec::with_capacity(n),
            rewritten: Vec::new(),
            materials: Vec::new(),
            smoothings: Vec::new(),
        };
        let mut counts = [0u64; 3];
        for (keyword, text) in statements(bytes) {
            match keyword {
                b"v" => counts[0] += 1,
                b"vt" => counts[1] += 1,
                b"vn" => counts[2] += 1,
                b"usemtl" => source.materials.push(text),
                b"s" => source.smoothings.push(text),
                b"f" | b"fo" => {
                    if source.faces.len().is_multiple_of(CHUNK) {
                        run.cancel.check()?;
                    }
                    let (material, smoothing) = (source.materials.len() as u32, source.smoothings.len() as u32);
                    let rewritten = text.contains(&b'-');
                    let (start, len) = if rewritten {
                        let start = source.rewritten.len();
                        absolute(text, counts, &mut source.rewritten);
                        (start, source.rewritten.len() - start)
                    } else {
                        (text.as_ptr() as usize - bytes.as_ptr() as usize, text.len())
                    };
                    let (start, len) = (start as u64, len as u32);
                    source.faces.push(Face { start, len, rewritten, material, smoothing });
                }
                _ => {}
            }
        }
        Ok((source.faces.len() == n).then_some(source))
    }

    fn line(&self, face: Face) -> &[u8] {
        let text = if face.rewritten { &self.rewritten[..] } else { self.bytes };
        &text[face.start as usize..face.start as usize + face.len as usize]
    }
}

/// Writes `path`, by rename, and where the input has no materials the file of the same name with `.mtl` before it.
///
/// # Errors
/// [`Error::Parameter`] for labels that do not fit the faces; [`Error::Memory`] for an OBJ input whose faces find no
/// room; [`Error::Io`]; [`Error::Cancelled`].
pub fn write(path: &Path, mesh: &Mesh, labelling: &Labelling, durable: bool, run: &Run) -> Result<()> {
    let parts = parts(mesh, labelling)?;
    let n = mesh.faces.len();
    let bytes = match MappedBytes::open(mesh.path()) {
        Ok(bytes) if crate::mesh::import::name(mesh.path(), &bytes) == "OBJ" => Some(bytes),
        _ => None,
    };
    let room = bytes.as_ref().map_or(0, |_| PER_FACE * n as u64);
    let _grant = run.budget.take("lines of the OBJ file", room, room)?;
    let source = bytes.as_ref().map(|bytes| Source::of(bytes, n, run)).transpose()?.flatten();
    let own = source.as_ref().is_none_or(|source| source.materials.is_empty());
    let materials = path.with_extension("mtl");
    if own {
        by_rename(&materials, 0, durable, |file| {
            let mut text = String::from("# colours of parts, by nystrom-stream\n");
            for part in 0..parts {
                let colour = labelling.colours.get(part).copied().unwrap_or([128; 3]);
                let [r, g, b] = colour.map(|part| f64::from(part) / 255.);
                text += &format!("newmtl part_{part}\nKd {r:.4} {g:.4} {b:.4}\nKa 0 0 0\nKs 0 0 0\nillum 1\n");
            }
            file.write_all(text.as_bytes()).map_err(Error::io(&materials, "write"))
        })?;
    }
    by_rename(path, 0, durable, |file| {
        let mut out = Gather::new(path, file);
        out.buffer.extend_from_slice(b"# parts by nystrom-stream, an object and a group each\n");
        if own {
            let name = materials.file_name().unwrap_or_default().to_string_lossy().into_owned();
            out.buffer.extend_from_slice(format!("mtllib {name}\n").as_bytes());
        }
        match &source {
            Some(source) => vertices_of(source, mesh.path(), path, &mut out, run)?,
            None => vertices(mesh, &mut out)?,
        }
        for part in 0..parts {
            let (part, source) = (part as u32, source.as_ref());
            ObjPart { mesh, labelling, source, own, part, material: 0, smoothing: 0 }.write(&mut out, run)?;
        }
        out.finish()
    })
}

/// Everything of the input but faces and what is said of them.
fn vertices_of(source: &Source, from: &Path, to: &Path, out: &mut Gather, run: &Run) -> Result<()> {
    let folder = |path: &Path| std::path::absolute(path).ok().and_then(|path| path.parent().map(Path::to_path_buf));
    for (k, (keyword, text)) in statements(source.bytes).enumerate() {
        if k % CHUNK == 0 {
            run.cancel.check()?;
        }
        match keyword {
            // From another folder, the materials and their pictures are found where they lie.
            b"mtllib" if folder(from) != folder(to) => {
                let name = String::from_utf8_lossy(&text[keyword.len()..]).trim().to_string();
                let place = folder(from).unwrap_or_default().join(name);
                out.buffer.extend_from_slice(format!("mtllib {}\n", place.display()).as_bytes());
            }
            b"v" | b"vt" | b"vn" | b"vp" | b"mtllib" => {
                out.buffer.extend_from_slice(text);
                out.buffer.push(b'\n');
            }
            _ => {}
        }
        out.settle()?;
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
        out.settle()?;
    }
    Ok(())
}

/// Writes the faces of a part, one line each, after the statements of the input that hold for them.
struct ObjPart<'a> {
    mesh: &'a Mesh,
    labelling: &'a Labelling<'a>,
    source: Option<&'a Source<'a>>,
    /// Whether each part gets a material of ours.
    own: bool,
    part: u32,
    /// The statements in force, as in [`Face`].
    material: u32,
    smoothing: u32,
}

impl ObjPart<'_> {
    /// Writes the part, if it has faces: one pass over the labels.
    fn write(&mut self, out: &mut Gather, run: &Run) -> Result<()> {
        let part = self.part;
        let mut begun = false;
        for (chunk, labels) in self.labelling.labels.chunks(CHUNK).enumerate() {
            run.cancel.check()?;
            for at in (0..labels.len()).filter(|&at| labels[at] == part) {
                if !begun {
                    begun = true;
                    self.begin(out);
                }
                self.face(chunk * CHUNK + at, out);
                out.settle()?;
            }
        }
        Ok(())
    }

    fn begin(&self, out: &mut Gather) {
        let part = self.part;
        let name = plain_name(self.labelling.name(part as usize));
        let name = if name.is_empty() { format!("part_{part}") } else { name };
        out.buffer.extend_from_slice(format!("o {name}\ng {name}\n").as_bytes());
        if self.own {
            out.buffer.extend_from_slice(format!("usemtl part_{part}\n").as_bytes());
        }
    }

    fn face(&mut self, face: usize, out: &mut Gather) {
        if let Some(source) = self.source {
            let face = source.faces[face];
            if !self.own && face.material != self.material && face.material > 0 {
                out.buffer.extend_from_slice(source.materials[face.material as usize - 1]);
                out.buffer.push(b'\n');
            }
            if face.smoothing != self.smoothing && face.smoothing > 0 {
                out.buffer.extend_from_slice(source.smoothings[face.smoothing as usize - 1]);
                out.buffer.push(b'\n');
            }
            (self.material, self.smoothing) = (face.material, face.smoothing);
            out.buffer.extend_from_slice(source.line(face));
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
        let labelling = Labelling { labels, colours: &[[255, 0, 0], [0, 0, 255]], quality: None, names: &[] };
        write(&out, &mesh, &labelling, false, &run).unwrap();
        // It reads back as the same faces, in the order of the parts.
        assert_eq!(Mesh::open(&out).unwrap().faces.len(), mesh.faces.len());
        (std::fs::read_to_string(&out).unwrap(), std::fs::read_to_string(dir.path().join("out.mtl")).ok())
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
        assert!(own.unwrap().contains("newmtl part_1\nKd 0.0000 0.0000 1.0000\n"));
    }
}
