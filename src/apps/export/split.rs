//! One mesh per part: `part_000.ply` … in a folder, each with the vertices that it uses and open borders where it was
//! cut off.
//!
//! Faces keep their corners' order and winding and get `int original_face`, their number in the input, `int label`,
//! colour and quality; positions keep their precision. The files can be binary STL instead, for programs that read
//! nothing else. On request parts are closed ([`caps`](super::caps)); triangles of caps have the `original_face` −1 and
//! the quality 0. The list `parts.json`, written last, names the files. Cost: a [`RankedSet`] of vertices for those
//! that a part uses and their new numbers, and a few passes over the labels ([`by_part`](super::by_part)).

use super::by_part::{PartFaces, each_part};
use super::caps::{Caps, Corner, EdgesAtCuts};
use super::parts;
use crate::base::bit_set::{BitSet, RankedSet};
use crate::base::vector::{distance, dot, double_area, narrow, unit, wide};
use crate::base::{Error, Result};
use crate::mesh::output::{Gather, ends_with, publish};
use crate::mesh::ply::{Encoder, Encoding, HeaderWriter, Scalar};
use crate::mesh::{Labelling, Mesh};
use crate::store::Run;
use crate::store::new_file::{by_rename, sync_file_system};
use serde_json::json;
use std::collections::BTreeSet;
use std::io::Write as _;
use std::path::Path;

/// The list of the parts' files.
pub const LIST: &str = "parts.json";
/// Maximum number of bytes of a name within a file name.
const LONGEST: usize = 200;
/// Maximum number of files that are synced one by one, some 6 ms each. More are synced together, which waits for other
/// programs' files, too.
const SYNCED_ALONE: usize = 100;
/// Spacing of floats, in mean edges, above which the loss of precision is visible.
const LOST: f64 = 0.01;

/// The format of the files in a folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PartForm {
    /// Little-endian PLY.
    Binary,
    /// Text PLY.
    Text,
    /// Binary STL: only triangles, coordinates as floats.
    Stl,
}

/// Options for a folder of parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Folder {
    /// The format of its files.
    pub form: PartForm,
    /// Whether parts are closed where they were cut off, and at holes.
    pub cap: bool,
}

impl From<PartForm> for Folder {
    fn from(form: PartForm) -> Self {
        Self { form, cap: false }
    }
}

/// `name` made safe for any file system: letters and digits are kept, as many as fit into 255 bytes together with the
/// rest of the file name and `.partial`.
pub(super) fn plain_name(name: Option<&str>) -> String {
    let plain = |c: char| if c.is_alphanumeric() || c == '-' { c } else { '_' };
    let mut bytes = 0;
    let fits = |c: &char| {
        bytes += c.len_utf8();
        bytes <= LONGEST
    };
    let name: String = name.unwrap_or_default().chars().take(60).map(plain).take_while(fits).collect();
    name.trim_matches('_').to_string()
}

/// The file name of a part, which may have a name: `part_003.ply`, `part_003_left_arm.ply`.
pub fn file_name(part: usize, name: Option<&str>, form: PartForm) -> String {
    let (name, extension) = (plain_name(name), if form == PartForm::Stl { "stl" } else { "ply" });
    format!("part_{part:03}{}{name}.{extension}", if name.is_empty() { "" } else { "_" })
}

/// Whether a folder of parts may contain a file called `name`: its list, or the file of a part.
pub fn is_file_name(name: &str) -> bool {
    name == LIST || is_of_part(name)
}

/// Whether `name` can be the file of a part.
fn is_of_part(name: &str) -> bool {
    let number = name.strip_prefix("part_").map_or("", |rest| rest.split(['_', '.']).next().unwrap_or_default());
    let numbered = number.len() > 2 && number.bytes().all(|byte| byte.is_ascii_digit());
    numbered && (ends_with(name.as_ref(), "ply") || ends_with(name.as_ref(), "stl"))
}

/// Writes all parts that have faces to `folder`, which is created if missing, as files of one format. Files of an
/// earlier, finer cut stay there; a note says so, and another one names the parts that are not solids despite caps.
///
/// # Errors
/// [`Error::Parameter`] for labels that do not match the faces; [`Error::Memory`] if the budget has no room for a bit
/// per vertex, or for the edges of a part that is to be closed; [`Error::Io`]; [`Error::Cancelled`].
pub fn write(folder: &Path, mesh: &Mesh, labelling: &Labelling, form: impl Into<Folder>, run: &Run) -> Result<()> {
    let Folder { form, cap } = form.into();
    let parts = parts(mesh, labelling)?;
    let vertices = mesh.positions.len();
    let bytes = RankedSet::bytes(vertices);
    let _grant = run.budget.take("vertices of a part", bytes, bytes)?;
    std::fs::create_dir_all(folder).map_err(Error::io(folder, "create"))?;
    let list = folder.join(LIST);
    // A missing list marks the folder as incomplete.
    if list.exists() {
        std::fs::remove_file(&list).map_err(Error::io(&list, "remove"))?;
    }
    let encoder = Encoder { target: if form == PartForm::Text { Encoding::Ascii } else { Encoding::Little } };
    let mut writer = Splitter { mesh, labelling, encoder, run, used: RankedSet::of(BitSet::new(vertices)) };
    let (mut listed, mut open, mut files) = (Vec::new(), Vec::new(), BTreeSet::new());
    let rounds = form == PartForm::Stl && mesh.positions.is_double();
    let mut facets = Facets::default();
    let at_cuts = if cap { Some(EdgesAtCuts::of(mesh, labelling.labels, run)?) } else { None };
    each_part(labelling.labels, parts, run, |of_part| {
        let part = of_part.part as usize;
        let name = file_name(part, labelling.name(part), form);
        let size = writer.mark(of_part)?;
        if size.faces == 0 {
            return Ok(());
        }
        let path = folder.join(&name);
        let mut own = Facets::default();
        let caps = at_cuts
            .as_ref()
            .map_or(Ok(Caps::default()), |edges| writer.caps(of_part, edges, (size.corners, form == PartForm::Stl)))?;
        by_rename(&path, 0, parts <= SYNCED_ALONE, |file| {
            let mut out = Gather::new(&path, file);
            if form == PartForm::Stl {
                own = writer.solid(of_part, &caps, &mut out)?;
            } else {
                writer.part(of_part, size, &caps, &mut out)?;
            }
            out.finish()
        })?;
        let colour = labelling.colours.get(part);
        let PartSize { faces, vertices, .. } = size;
        let mut entry = json!({"file": &name, "label": part, "faces": faces, "vertices": vertices, "colour": colour});
        if let Some(title) = labelling.name(part) {
            entry["name"] = title.into();
        }
        if cap {
            let solid = caps.flaws == 0 && own.turned == 0;
            entry["caps"] = json!({"loops": caps.loops, "triangles": caps.triangles.len(), "solid": solid});
            open.extend((!solid).then(|| part.to_string()));
        }
        facets.add(own);
        listed.push(entry);
        files.insert(name);
        Ok(())
    })?;
    if parts > SYNCED_ALONE {
        sync_file_system(folder)?;
    }
    // Formatting a JSON value cannot fail; `#` indents it.
    let listed = json!({"faces": mesh.faces.len(), "parts": listed});
    publish(&list, 0, |file| writeln!(file, "{listed:#}").map_err(Error::io(&list, "write")))?;
    if !open.is_empty() {
        let (parts, verb) = if open.len() == 1 { ("part", "is") } else { ("parts", "are") };
        let why = "edges with three faces or more, inconsistently wound faces, or triangles flipped by rounding; in \
                   an STL also edges that touch";
        run.progress.note(&format!("{parts} {} {verb} not solid in spite of caps: {why}", open.join(", ")));
    }
    if let Some(share) = facets.lost().filter(|_| rounds) {
        let text = format!(
            "{}: STL coordinates are 32-bit floats, spaced {share:.2} mean edge lengths apart there: write .ply \
             files, or move the mesh to the origin first",
            folder.display()
        );
        run.progress.note(&text);
    }
    if others(folder, &files) {
        let text = format!("{}: also holds parts of an earlier cut; {LIST} lists those of this one", folder.display());
        run.progress.note(&text);
    }
    Ok(())
}

/// Whether `folder` has files of parts other than `files`.
fn others(folder: &Path, files: &BTreeSet<String>) -> bool {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
    names.filter(|name| is_of_part(name)).any(|name| !files.contains(&name))
}

/// The loss of precision of an STL's triangles, whose coordinates are floats.
#[derive(Clone, Copy, Debug, Default)]
struct Facets {
    /// The greatest coordinate.
    most: f64,
    /// Sum of the edge lengths, and their number.
    edges: [f64; 2],
    /// Triangles that become flat or flipped as floats.
    turned: u64,
}

impl Facets {
    /// Adds a triangle, whose corners in the file are `written`.
    fn triangle(&mut self, at: [[f64; 3]; 3], written: [[f32; 3]; 3]) {
        self.most = at.iter().flatten().fold(self.most, |most, x| most.max(x.abs()));
        let sum = distance(at[0], at[1]) + distance(at[1], at[2]) + distance(at[2], at[0]);
        self.edges = [self.edges[0] + sum, self.edges[1] + 3.];
        let [normal, new] = [double_area(at), double_area(written.map(wide))].map(unit);
        self.turned += u64::from(normal != [0.; 3] && dot(normal, new) <= 0.);
    }

    fn add(&mut self, other: Self) {
        self.most = self.most.max(other.most);
        (0..2).for_each(|k| self.edges[k] += other.edges[k]);
        self.turned += other.turned;
    }

    /// The spacing of floats at the greatest coordinate, in mean edges, if it is more than [`LOST`].
    fn lost(&self) -> Option<f64> {
        let step = f64::from(f32::EPSILON) * self.most.max(f64::from(f32::MIN_POSITIVE));
        let share = step / (self.edges[0] / self.edges[1]);
        (share > LOST).then_some(share)
    }
}

struct Splitter<'a> {
    mesh: &'a Mesh,
    labelling: &'a Labelling<'a>,
    encoder: Encoder,
    run: &'a Run<'a>,
    /// The vertices that the part uses.
    used: RankedSet,
}

/// Counts of a part.
#[derive(Clone, Copy, Default)]
struct PartSize {
    faces: u64,
    vertices: u64,
    /// Corners of all faces.
    corners: u64,
    /// Number of corners of the largest face.
    most_corners: u64,
}

impl Splitter<'_> {
    /// Calls `visit` with the faces of `part` and their corners.
    fn each(&self, part: &PartFaces<'_>, mut visit: impl FnMut(usize, &[u32]) -> Result<()>) -> Result<()> {
        part.each(|face| self.mesh.faces.with(face, |corners| visit(face, corners)))
    }

    /// The caps of `part`, given the number of corners of its faces, and whether edges are identified by positions
    /// alone.
    fn caps(&self, part: &PartFaces<'_>, at_cuts: &EdgesAtCuts, size: (u64, bool)) -> Result<Caps> {
        Caps::of(self.mesh, at_cuts, size, self.run, |visit_face| {
            self.each(part, |_, face| {
                visit_face(face);
                Ok(())
            })
        })
    }

    /// Marks the vertices of `part` and counts.
    fn mark(&mut self, part: &PartFaces<'_>) -> Result<PartSize> {
        let mut used = std::mem::take(&mut self.used);
        let mut size = PartSize::default();
        let marked = used.refill(|add| {
            self.each(part, |_, corners| {
                size.faces += 1;
                size.corners += corners.len() as u64;
                size.most_corners = size.most_corners.max(corners.len() as u64);
                corners.iter().for_each(|&v| add(v));
                Ok(())
            })
        });
        size.vertices = used.count().into();
        self.used = used;
        marked.map(|()| size)
    }

    /// The number of vertex `v` in the part.
    fn number(&self, v: u32) -> u32 {
        self.used.rank(v).unwrap_or_default()
    }

    /// Writes the part of that size as PLY.
    fn part(&self, part: &PartFaces<'_>, size: PartSize, caps: &Caps, out: &mut Gather) -> Result<()> {
        let PartSize { faces, vertices, most_corners, .. } = size;
        let (double, count) = (self.mesh.positions.is_double(), Scalar::counting(most_corners.max(3)));
        let number_type = Scalar::numbering(vertices + caps.centres.len() as u64);
        let mut header = HeaderWriter::new(self.encoder.target);
        header.remark(format!("comment part {}, cut by nystrom-stream", part.part));
        header.element("vertex", vertices + caps.centres.len() as u64).positions(double);
        header
            .element("face", faces + caps.triangles.len() as u64)
            .corners(count, number_type)
            .property("original_face", Scalar::I32);
        self.labelling.properties().iter().for_each(|&(name, scalar)| _ = header.property(name, scalar));
        out.buffer.append(&mut header.finish());
        for v in self.used.iter() {
            self.vertex(self.mesh.positions.get(v), &mut out.buffer);
            out.flush_if_full()?;
        }
        caps.centres.iter().for_each(|&p| self.vertex(p, &mut out.buffer));
        self.each(part, |face, corners| {
            self.face(face, corners, (count, number_type), &mut out.buffer);
            out.flush_if_full()
        })?;
        for corners in &caps.triangles {
            let number = |corner| match corner {
                Corner::Vertex(v) => self.number(v).into(),
                Corner::Centre(k) => vertices as i64 + i64::from(k),
            };
            self.encoder.integer(count, 3, &mut out.buffer);
            corners.iter().for_each(|&corner| self.encoder.integer(number_type, number(corner), &mut out.buffer));
            self.encoder.integer(Scalar::I32, -1, &mut out.buffer);
            self.labelling.append_added(part.part, self.encoder, &mut out.buffer);
            self.encoder.end(&mut out.buffer);
            out.flush_if_full()?;
        }
        Ok(())
    }

    /// Writes the part as binary STL; returns its loss of precision.
    fn solid(&self, part: &PartFaces<'_>, caps: &Caps, out: &mut Gather) -> Result<Facets> {
        let mut triangles = caps.triangles.len() as u64;
        self.each(part, |_, corners| {
            self.mesh.triangles(corners, |_, _| triangles += 1);
            Ok(())
        })?;
        let Ok(count) = u32::try_from(triangles) else {
            let problem =
                format!("part {} has {triangles} triangles, but an STL can have at most {}", part.part, u32::MAX);
            return Err(Error::parameter("part_form", problem, "write .ply"));
        };
        let mut head = format!("part {}, cut by nystrom-stream", part.part).into_bytes();
        head.resize(80, 0);
        out.buffer.append(&mut head);
        out.buffer.extend_from_slice(&count.to_le_bytes());
        let mut facets = Facets::default();
        let mut facet = |at: [[f64; 3]; 3], out: &mut Vec<u8>| {
            let written = at.map(|p| narrow(p, 1.));
            facets.triangle(at, written);
            for p in [narrow(unit(double_area(at)), 1.), written[0], written[1], written[2]] {
                p.into_iter().for_each(|x| out.extend_from_slice(&x.to_le_bytes()));
            }
            out.extend_from_slice(&[0; 2]);
        };
        self.each(part, |_, corners| {
            self.mesh.triangles(corners, |_, at| facet(at, &mut out.buffer));
            out.flush_if_full()
        })?;
        for corners in &caps.triangles {
            facet(corners.map(|corner| caps.place(self.mesh, corner)), &mut out.buffer);
            out.flush_if_full()?;
        }
        Ok(facets)
    }

    fn vertex(&self, at: [f64; 3], out: &mut Vec<u8>) {
        let scalar = Scalar::coordinate(self.mesh.positions.is_double());
        at.into_iter().for_each(|x| self.encoder.real(scalar, x, out));
        self.encoder.end(out);
    }

    /// The record of `face`, with `types` for the number of its corners and for each of them.
    fn face(&self, face: usize, corners: &[u32], types: (Scalar, Scalar), out: &mut Vec<u8>) {
        let encoder = self.encoder;
        encoder.integer(types.0, corners.len() as i64, out);
        corners.iter().for_each(|&v| encoder.integer(types.1, self.number(v).into(), out));
        encoder.integer(Scalar::I32, face as i64, out);
        self.labelling.append(face, encoder, out);
        encoder.end(out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Progress;
    use std::sync::Mutex;

    #[test]
    fn names_of_long_letters_have_room_in_a_file_name() {
        for (letter, letters) in [("a", 60), ("ж", 60), ("耳", 60), ("𝒜", 50)] {
            let name = file_name(u32::MAX as usize, Some(&letter.repeat(100)), PartForm::Binary);
            assert_eq!(name, format!("part_4294967295_{}.ply", letter.repeat(letters)));
            assert!(name.len() + ".partial".len() <= 255);
        }
    }

    /// Records notes.
    #[derive(Default)]
    struct Notes(Mutex<Vec<String>>);

    impl Progress for Notes {
        fn note(&self, text: &str) {
            self.0.lock().unwrap().push(text.into());
        }
    }

    /// Two tetrahedra with edges of about `size` at `far`, one part each, as a folder of `form` with caps; returns the
    /// list, and the notes.
    fn folder(
        folder: &Path,
        far: f64,
        size: f64,
        names: &[String],
        form: PartForm,
    ) -> (serde_json::Value, Vec<String>) {
        let corners = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]];
        let points: Vec<[f64; 3]> = [0., 2.]
            .iter()
            .flat_map(|x| corners.map(|p| [far + size * (p[0] + x), size * p[1], size * p[2]]))
            .collect();
        let sides = |v: u32| [[v, v + 2, v + 1], [v, v + 1, v + 3], [v + 1, v + 2, v + 3], [v, v + 3, v + 2]];
        let mesh = Mesh::from_slices(&points, &[sides(0), sides(4)].concat()).unwrap();
        let labelling = Labelling {
            labels: &[0, 0, 0, 0, 1, 1, 1, 1],
            colours: &[[9; 3], [99; 3]],
            quality: None,
            names,
            fine: None,
        };
        let notes = Notes::default();
        write(folder, &mesh, &labelling, Folder { form, cap: true }, &Run::new(&notes)).unwrap();
        let list = std::fs::read(folder.join(LIST)).unwrap();
        (serde_json::from_slice(&list).unwrap(), notes.0.into_inner().unwrap())
    }

    #[test]
    fn an_stl_far_from_the_origin_is_told_and_is_no_solid() {
        // Regression: triangles collapsed silently, and the list said that the part was solid.
        let dir = tempfile::tempdir().unwrap();
        let solids = |list: &serde_json::Value| [0, 1].map(|k| list["parts"][k]["caps"]["solid"] == true);
        let (list, notes) = folder(dir.path(), 5e6, 0.2, &[], PartForm::Stl);
        assert_eq!(solids(&list), [false; 2]);
        assert!(notes.iter().any(|note| note.contains("floats, spaced 2.") && note.contains("origin")), "{notes:?}");
        assert!(notes.iter().any(|note| note.contains("parts 0, 1 are not solid")), "{notes:?}");
        for (far, form) in [(0., PartForm::Stl), (100., PartForm::Stl), (5e6, PartForm::Binary)] {
            let dir = tempfile::tempdir().unwrap();
            let (list, notes) = folder(dir.path(), far, 0.3, &[], form);
            assert_eq!((solids(&list), notes.len()), ([true; 2], 0), "{far} {notes:?}");
        }
    }

    #[test]
    fn files_of_an_earlier_cut_are_told_whatever_their_names_and_forms() {
        // Regression: only one file without a name and of the same format was checked.
        let dir = tempfile::tempdir().unwrap();
        let told = |names: &[&str], form| {
            let names: Vec<String> = names.iter().map(ToString::to_string).collect();
            folder(dir.path(), 0., 1., &names, form).1.iter().any(|note| note.contains("earlier cut"))
        };
        std::fs::write(dir.path().join("part_list.ply"), "").unwrap();
        assert!(!told(&[], PartForm::Binary) && !told(&[], PartForm::Binary));
        assert!(told(&["", "left arm"], PartForm::Binary), "part_001.ply stays");
        std::fs::remove_file(dir.path().join("part_001.ply")).unwrap();
        assert!(!told(&["", "left arm"], PartForm::Binary));
        assert!(told(&[], PartForm::Stl), "all of them stay");
    }
}
