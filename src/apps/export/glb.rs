//! A scene in one file for browsers, Blender and game engines: binary glTF 2.0, one node, mesh and material per part.
//!
//! Nodes are named "part 0" and so on and have label, area and number of faces, so that parts are separate objects
//! where the scene is opened. All share the vertices, which are written once; each has its own indices (32 bits), so a
//! triangle costs 12 bytes and a vertex 12, or 24 with its normal. Normals are written if the surface is smooth;
//! without them, as for a box, programs draw faces flat. Polygons become triangles, in file order. Faces with a
//! non-finite coordinate are omitted, since the format does not allow them. Double coordinates are written relative to
//! their centre, which the node's translation adds again. Cost: one pass over the vertices, a few over the labels
//! ([`by_part`](super::by_part)); [`PER_PART`] bytes per part, from the budget, and 12 bytes per vertex for normals, in
//! a file where memory is short.

use super::by_part::{PartFaces, each_part};
use super::{CHUNK, parts, work_beside};
use crate::apps::vertex_sums::VertexSums;
use crate::base::vector::{MapEach, area};
use crate::base::{Error, Result};
use crate::graph::Frame;
use crate::mesh::output::{Gather, publish};
use crate::mesh::ply::labelled::colour_of;
use crate::mesh::{Labelling, Mesh};
use crate::store::{Context, Run};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;

/// Maximum size of a file in bytes: its header stores it in 32 bits.
pub const MOST: u64 = u32::MAX as u64;

/// Component types and targets of glTF.
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// Diagonal of a mesh below which its coordinates have less than seven digits as floats.
const LEAST: f64 = 1e-38;
/// Share of the area at creases above which faces are drawn flat.
const FLAT: f64 = 0.05;
/// Bytes for the entries of a part: as lists, and once more in the whole text.
const PER_PART: u64 = 2048;
/// Vertices per chunk.
const VERTICES: usize = 1 << 14;

/// Writes the scene to `path`, by rename.
///
/// ```
/// use nystrom_stream::apps::{colours::palette, export::glb};
/// use nystrom_stream::mesh::{Labelling, Mesh};
/// use nystrom_stream::store::Run;
/// let corners = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]];
/// let mesh = Mesh::from_slices(&corners, &[[0, 1, 2], [0, 2, 3]])?;
/// let labelling = Labelling { labels: &[0, 1], colours: &palette(2), quality: None, names: &[], fine: None };
/// glb::write(&std::env::temp_dir().join("square.glb"), &mesh, &labelling, &Run::new(&()))?;
/// # Ok::<(), nystrom_stream::base::Error>(())
/// ```
///
/// # Errors
/// [`Error::Unusable`] for a mesh whose file would exceed [`MOST`] (some 230 million triangles), without a finite face,
/// or too small for floats; [`Error::Parameter`] for labels that do not match the faces; [`Error::Io`];
/// [`Error::Cancelled`].
pub fn write(path: &Path, mesh: &Mesh, labelling: &Labelling, run: &Run) -> Result<()> {
    let parts = parts(mesh, labelling)?;
    let work = work_beside(path, run);
    let mut scene = Scene::of(mesh, labelling, parts, run)?;
    if scene.is_tiny {
        let problem = "would have only zero coordinates: the mesh is too small for 32-bit floats";
        return Err(Error::unusable(path, problem, "write .ply instead, or scale the mesh"));
    }
    let vertices = mesh.positions.len() as u64;
    let bytes = VertexSums::bytes(mesh);
    let grant = run.budget.take("normals of the .glb file", bytes, bytes);
    // The size must also fit with normals.
    let fits = 24 * vertices + 12 * scene.triangles.iter().sum::<u64>() + (1 << 20) * (1 + parts as u64) < MOST;
    if fits {
        let in_file = || VertexSums::in_file(mesh, Context::new(&work, run));
        let sums = if grant.is_ok() { VertexSums::of(mesh, run)? } else { in_file()? };
        scene.normals = (sums.creased(mesh, run)? < FLAT).then_some(sums);
    }
    let bytes = PER_PART * scene.triangles.iter().filter(|count| **count > 0).count() as u64;
    let _grant_of_parts = run.budget.take("parts of the .glb file", bytes, bytes)?;
    let json = padded(scene.json());
    let width = if scene.normals.is_some() { 24 } else { 12 };
    let binary = width * vertices + 12 * scene.triangles.iter().sum::<u64>();
    let total = 12 + 8 + json.len() as u64 + 8 + binary;
    if total > MOST {
        let problem = format!("would be {total} bytes, but a .glb can have at most {MOST}");
        return Err(Error::unusable(path, problem, "write .ply, or a folder with a mesh for each part"));
    }
    if scene.triangles.iter().all(|&count| count == 0) {
        let problem = "would have no triangle with finite coordinates";
        return Err(Error::unusable(path, problem, "write .ply instead, or scale the mesh"));
    }
    publish(path, total, |file| scene.write(path, file, total, &json, binary))
}

/// Entries of a JSON array, as text with commas.
#[derive(Default)]
struct List {
    text: String,
    count: usize,
}

impl List {
    fn push(&mut self, entry: Value) {
        if self.count > 0 {
            self.text.push(',');
        }
        self.text += &entry.to_string();
        self.count += 1;
    }
}

/// `text` padded to a multiple of four bytes.
fn padded(mut text: String) -> String {
    while !text.len().is_multiple_of(4) {
        text.push(' ');
    }
    text
}

/// One sRGB channel as a linear factor, as used in materials.
fn linear(part: u8) -> f64 {
    let part = f64::from(part) / 255.;
    let value = if part <= 0.04045 { part / 12.92 } else { ((part + 0.055) / 1.055).powf(2.4) };
    // Six digits distinguish all 256 values and keep the file the same on every machine.
    (value * 1e6).round() / 1e6
}

struct Scene<'a> {
    mesh: &'a Mesh,
    labelling: &'a Labelling<'a>,
    run: &'a Run<'a>,
    /// The translation that is added to all positions again.
    middle: [f64; 3],
    /// Whether floats cannot distinguish its vertices.
    is_tiny: bool,
    /// Whether every vertex is finite, so that faces need not be checked.
    whole: bool,
    low: [f32; 3],
    high: [f32; 3],
    /// Triangles, faces and area per part.
    triangles: Vec<u64>,
    faces: Vec<u64>,
    area: Vec<f64>,
    /// Normals of the vertices, if the surface is smooth.
    normals: Option<VertexSums>,
}

impl<'a> Scene<'a> {
    /// Examines all vertices and faces.
    fn of(mesh: &'a Mesh, labelling: &'a Labelling, parts: usize, run: &'a Run) -> Result<Self> {
        let mut scene = Self {
            mesh,
            labelling,
            run,
            middle: [0.; 3],
            is_tiny: false,
            whole: false,
            low: [f32::INFINITY; 3],
            high: [f32::NEG_INFINITY; 3],
            triangles: vec![0; parts],
            faces: vec![0; parts],
            area: vec![0.; parts],
            normals: None,
        };
        let vertices = mesh.positions.len();
        if mesh.positions.is_double() {
            let frame = Frame::of(mesh, run)?;
            scene.middle = frame.origin;
            scene.is_tiny = frame.scale < LEAST;
        }
        let boxes = run.map_ranges(vertices, VERTICES, |range| {
            let (mut low, mut high, mut whole) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3], true);
            for v in range {
                whole &= scene.is_in_space(v as u32);
                let p = scene.place(v as u32);
                (0..3).for_each(|k| (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k])));
            }
            Ok((low, high, whole))
        })?;
        scene.whole = boxes.iter().all(|(.., whole)| *whole);
        for (low, high, _) in boxes {
            (0..3).for_each(|k| scene.low[k] = scene.low[k].min(low[k]));
            (0..3).for_each(|k| scene.high[k] = scene.high[k].max(high[k]));
        }
        let counts = run.map_ranges(mesh.faces.len(), CHUNK, |range| {
            let mut counts: BTreeMap<u32, (u64, u64, f64)> = BTreeMap::new();
            scene.each(range, |face, corners| {
                let count = counts.entry(labelling.labels[face]).or_default();
                count.0 += (corners.len() as u64).saturating_sub(2);
                count.1 += 1;
                mesh.triangles(corners, |_, at| count.2 += area(at));
            });
            Ok(counts)
        })?;
        for (label, (triangles, faces, area)) in counts.into_iter().flatten() {
            scene.triangles[label as usize] += triangles;
            scene.faces[label as usize] += faces;
            scene.area[label as usize] += area;
        }
        Ok(scene)
    }

    /// The position of vertex `v` in the file; a non-finite vertex is put in the centre, as no written face uses it.
    #[inline]
    fn place(&self, v: u32) -> [f32; 3] {
        let p = self.mesh.positions.get(v);
        let p = [0, 1, 2].map_each(|k| (p[k] - self.middle[k]) as f32);
        if p[0].is_finite() && p[1].is_finite() && p[2].is_finite() { p } else { [0.; 3] }
    }

    fn is_in_space(&self, v: u32) -> bool {
        let p = self.mesh.positions.get(v);
        (0..3).all(|k| ((p[k] - self.middle[k]) as f32).is_finite())
    }

    /// Calls `visit` with every finite face of `range`.
    fn each(&self, range: std::ops::Range<usize>, mut visit: impl FnMut(usize, &[u32])) {
        self.mesh.faces.for_each(range, |face, corners| {
            if self.whole || corners.iter().all(|&v| self.is_in_space(v)) {
                visit(face, corners);
            }
        });
    }

    /// The scene's description. Entries are text from the start: JSON values would take ten times as much memory.
    fn json(&self) -> String {
        let vertices = self.mesh.positions.len() as u64;
        let (mut views, mut accessors) = (List::default(), List::default());
        views.push(json!({"buffer": 0, "byteLength": 12 * vertices, "target": ARRAY_BUFFER}));
        accessors.push(json!({
            "bufferView": 0, "componentType": FLOAT, "count": vertices, "type": "VEC3",
            "min": self.low, "max": self.high,
        }));
        let mut attributes = json!({"POSITION": 0});
        let mut offset = 12 * vertices;
        if self.normals.is_some() {
            attributes["NORMAL"] = json!(1);
            views.push(json!({
                "buffer": 0, "byteOffset": offset, "byteLength": 12 * vertices, "target": ARRAY_BUFFER,
            }));
            accessors.push(json!({"bufferView": 1, "componentType": FLOAT, "count": vertices, "type": "VEC3"}));
            offset += 12 * vertices;
        }
        let (mut materials, mut meshes, mut nodes) = (List::default(), List::default(), List::default());
        for (label, &count) in self.triangles.iter().enumerate().filter(|(_, count)| **count > 0) {
            let colour = colour_of(self.labelling.colours, label as u32);
            let name = self.labelling.name(label).map_or_else(|| format!("part {label}"), String::from);
            let [r, g, b] = colour.map(linear);
            let primitive = json!({"attributes": attributes, "indices": accessors.count, "material": materials.count});
            let extras = json!({"label": label, "faces": self.faces[label], "area": self.area[label]});
            nodes.push(json!({"name": name, "mesh": meshes.count, "extras": extras}));
            meshes.push(json!({"name": name, "primitives": [primitive]}));
            let surface = json!({"baseColorFactor": [r, g, b, 1.], "metallicFactor": 0., "roughnessFactor": 0.9});
            materials.push(json!({"name": name, "doubleSided": true, "pbrMetallicRoughness": surface}));
            accessors.push(json!({
                "bufferView": views.count, "componentType": UNSIGNED_INT, "count": 3 * count, "type": "SCALAR",
            }));
            let target = ELEMENT_ARRAY_BUFFER;
            views.push(json!({"buffer": 0, "byteOffset": offset, "byteLength": 12 * count, "target": target}));
            offset += 12 * count;
        }
        let mut root = json!({"name": "parts", "children": (1..=nodes.count).collect::<Vec<_>>()});
        if self.middle != [0.; 3] {
            root["translation"] = json!(self.middle);
        }
        let asset = json!({"version": "2.0", "generator": concat!("nystrom-stream ", env!("CARGO_PKG_VERSION"))});
        let comma = if nodes.count > 0 { "," } else { "" };
        format!(
            r#"{{"asset":{asset},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{root}{comma}{}],"meshes":[{}],"materials":[{}],"accessors":[{}],"bufferViews":[{}],"buffers":[{{"byteLength":{offset}}}]}}"#,
            nodes.text, meshes.text, materials.text, accessors.text, views.text
        )
    }

    fn write(&self, path: &Path, file: &mut File, total: u64, json: &str, binary: u64) -> Result<()> {
        let mut out = Gather::new(path, file);
        let word = |out: &mut Gather, value: u64| out.buffer.extend_from_slice(&(value as u32).to_le_bytes());
        out.buffer.extend_from_slice(b"glTF");
        word(&mut out, 2);
        word(&mut out, total);
        word(&mut out, json.len() as u64);
        out.buffer.extend_from_slice(b"JSON");
        out.pass(json.as_bytes())?;
        word(&mut out, binary);
        out.buffer.extend_from_slice(b"BIN\0");
        for v in 0..self.mesh.positions.len() as u32 {
            out.buffer.extend_from_slice(bytemuck::cast_slice(&self.place(v).map(|x| x.to_bits().to_le())));
            out.flush_if_full()?;
        }
        if let Some(normals) = &self.normals {
            for v in 0..self.mesh.positions.len() as u32 {
                // A vertex without a face has no normal, but the format requires a unit vector.
                let normal = normals.normal(v).filter(|normal| *normal != [0.; 3]).unwrap_or([0., 0., 1.]);
                out.buffer.extend_from_slice(bytemuck::cast_slice(&normal.map(|x| (x as f32).to_bits().to_le())));
                out.flush_if_full()?;
            }
        }
        each_part(self.labelling.labels, self.triangles.len(), self.run, |faces| self.part(faces, &mut out))?;
        out.finish()
    }

    /// The indices of a part.
    fn part(&self, faces: &PartFaces<'_>, out: &mut Gather) -> Result<()> {
        faces.each(|face| {
            self.mesh.faces.with(face, |corners| {
                if !self.whole && !corners.iter().all(|&v| self.is_in_space(v)) {
                    return;
                }
                let mut write = |triangle: [u32; 3]| {
                    out.buffer.extend_from_slice(bytemuck::cast_slice(&triangle.map(u32::to_le)));
                };
                match *corners {
                    // Without reading its positions.
                    [a, b, c] => write([a, b, c]),
                    _ => self.mesh.triangles(corners, |triangle, _| write(triangle)),
                }
            });
            out.flush_if_full()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Budget;

    /// Regression: a scene had no normals where memory was short.
    #[test]
    fn a_scene_has_normals_whatever_the_memory() {
        const WIDTH: u32 = 30;
        let points: Vec<[f32; 3]> = (0..WIDTH * WIDTH).map(|v| [(v % WIDTH) as f32, (v / WIDTH) as f32, 0.]).collect();
        let corners = (0..WIDTH * (WIDTH - 1)).filter(|v| v % WIDTH + 1 < WIDTH);
        let quads: Vec<[u32; 4]> = corners.map(|v| [v, v + 1, v + WIDTH + 1, v + WIDTH]).collect();
        let mesh = Mesh::from_slices(&points, &quads).unwrap();
        let labelling =
            Labelling { labels: &vec![0; quads.len()], colours: &[[7; 3]], quality: None, names: &[], fine: None };
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.glb");
        let written = |budget: u64| {
            write(&path, &mesh, &labelling, &Run { budget: Budget::new(budget), ..Run::new(&()) }).unwrap();
            std::fs::read(&path).unwrap()
        };
        let bytes = written(1 << 30);
        assert!(bytes.len() > 24 * points.len() && written(2 * PER_PART) == bytes);
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    }
}
