//! A scene in one file for browsers, Blender and game engines: binary glTF 2.0, one primitive and one material per part.
//!
//! All primitives share the vertices, which are written once; each has its own indices (32 bits), so a triangle costs
//! 12 bytes and a vertex 12. Polygons become fans of triangles, in the order of the file. Faces with a coordinate that
//! is no finite number are left out: the format has none. Double coordinates are written relative to their middle,
//! which the node's translation adds again. Cost: one pass over the vertices and one per part over the labels.

use super::{CHUNK, parts};
use crate::base::{Error, Result};
use crate::mesh::output::{Gather, by_rename};
use crate::mesh::{Labelling, Mesh};
use crate::store::Run;
use serde_json::{Value, json};
use std::fs::File;
use std::path::Path;

/// Bytes that a file may have: its header counts them in 32 bits.
pub const MOST: u64 = u32::MAX as u64;

/// Component types and targets of glTF.
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// Writes the scene to `path`, by rename.
///
/// ```
/// use nystrom_stream::apps::{colours::palette, export::glb};
/// use nystrom_stream::mesh::{Labelling, Mesh};
/// use nystrom_stream::store::Run;
/// let corners = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]];
/// let mesh = Mesh::from_slices(&corners, &[[0, 1, 2], [0, 2, 3]])?;
/// let labelling = Labelling { labels: &[0, 1], colours: &palette(2), quality: None };
/// glb::write(&std::env::temp_dir().join("square.glb"), &mesh, &labelling, false, &Run::new(&()))?;
/// # Ok::<(), nystrom_stream::base::Error>(())
/// ```
///
/// # Errors
/// [`Error::Unusable`] for a mesh whose file would pass [`MOST`] (some 230 million triangles), or without a face in
/// space; [`Error::Parameter`] for labels that do not fit the faces; [`Error::Io`]; [`Error::Cancelled`].
pub fn write(path: &Path, mesh: &Mesh, labelling: &Labelling, durable: bool, run: &Run) -> Result<()> {
    let parts = parts(mesh, labelling)?;
    let scene = Scene::of(mesh, labelling, parts, run)?;
    let json = padded(scene.json().to_string());
    let binary = 12 * (mesh.positions.len() as u64 + scene.triangles.iter().sum::<u64>());
    let total = 12 + 8 + json.len() as u64 + 8 + binary;
    if total > MOST {
        let problem = format!("would be {total} bytes, a .glb can have {MOST}");
        return Err(Error::unusable(path, problem, "write .ply, or one mesh per part: -o folder/"));
    }
    if scene.triangles.iter().all(|&count| count == 0) {
        let problem = "would have no triangle with finite coordinates";
        return Err(Error::unusable(path, problem, "write .ply instead"));
    }
    by_rename(path, total, durable, |file| scene.write(path, file, total, &json, binary))
}

/// `text` filled up to a multiple of four bytes.
fn padded(mut text: String) -> String {
    while !text.len().is_multiple_of(4) {
        text.push(' ');
    }
    text
}

/// A part of sRGB as a linear factor, which materials have.
fn linear(part: u8) -> f64 {
    let part = f64::from(part) / 255.;
    let value = if part <= 0.04045 { part / 12.92 } else { ((part + 0.055) / 1.055).powf(2.4) };
    // Six digits tell all 256 apart and keep the file the same on every machine.
    (value * 1e6).round() / 1e6
}

struct Scene<'a> {
    mesh: &'a Mesh,
    labelling: &'a Labelling<'a>,
    run: &'a Run<'a>,
    /// What is added to all positions again.
    middle: [f64; 3],
    low: [f32; 3],
    high: [f32; 3],
    /// Triangles per part.
    triangles: Vec<u64>,
}

impl<'a> Scene<'a> {
    /// Looks at all vertices and faces.
    fn of(mesh: &'a Mesh, labelling: &'a Labelling, parts: usize, run: &'a Run) -> Result<Self> {
        let none = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        let mut scene =
            Self { mesh, labelling, run, middle: [0.; 3], low: none.0, high: none.1, triangles: vec![0; parts] };
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for v in 0..mesh.positions.len() as u32 {
            let p = mesh.positions.get(v);
            if p.iter().all(|x| x.is_finite()) {
                (0..3).for_each(|k| (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k])));
            }
        }
        if mesh.positions.is_double() && low[0] <= high[0] {
            scene.middle = [0, 1, 2].map(|k| low[k] / 2. + high[k] / 2.);
        }
        for v in 0..mesh.positions.len() as u32 {
            let p = scene.place(v);
            (0..3).for_each(|k| (scene.low[k], scene.high[k]) = (scene.low[k].min(p[k]), scene.high[k].max(p[k])));
        }
        let mut triangles = std::mem::take(&mut scene.triangles);
        scene.each(|face, corners| {
            triangles[labelling.labels[face] as usize] += (corners.len() as u64).saturating_sub(2);
            Ok(())
        })?;
        scene.triangles = triangles;
        Ok(scene)
    }

    /// Where vertex `v` is written; what is nowhere is put in the middle, where no face uses it.
    fn place(&self, v: u32) -> [f32; 3] {
        let p = self.mesh.positions.get(v);
        let p = [0, 1, 2].map(|k| (p[k] - self.middle[k]) as f32);
        if p.iter().all(|x| x.is_finite()) { p } else { [0.; 3] }
    }

    /// Calls `visit` with every face in space.
    fn each(&self, mut visit: impl FnMut(usize, &[u32]) -> Result<()>) -> Result<()> {
        let n = self.mesh.faces.len();
        for start in (0..n).step_by(CHUNK) {
            self.run.cancel.check()?;
            let mut result = Ok(());
            self.mesh.faces.for_each(start..n.min(start + CHUNK), |face, corners| {
                let is_in_space = |&v: &u32| {
                    let p = self.mesh.positions.get(v);
                    (0..3).all(|k| ((p[k] - self.middle[k]) as f32).is_finite())
                };
                if result.is_ok() && corners.iter().all(is_in_space) {
                    result = visit(face, corners);
                }
            });
            result?;
        }
        Ok(())
    }

    fn json(&self) -> Value {
        let vertices = self.mesh.positions.len() as u64;
        let mut views = vec![json!({"buffer": 0, "byteLength": 12 * vertices, "target": ARRAY_BUFFER})];
        let mut accessors = vec![json!({
            "bufferView": 0, "componentType": FLOAT, "count": vertices, "type": "VEC3", "min": self.low, "max": self.high,
        })];
        let (mut materials, mut primitives, mut offset) = (Vec::new(), Vec::new(), 12 * vertices);
        for (label, &count) in self.triangles.iter().enumerate().filter(|(_, count)| **count > 0) {
            let colour = self.labelling.colours.get(label).copied().unwrap_or([128; 3]);
            let [r, g, b] = colour.map(linear);
            primitives.push(json!({
                "attributes": {"POSITION": 0}, "indices": accessors.len(), "material": materials.len(),
                "extras": {"label": label},
            }));
            materials.push(json!({
                "name": format!("part {label}"), "doubleSided": true,
                "pbrMetallicRoughness": {"baseColorFactor": [r, g, b, 1.], "metallicFactor": 0., "roughnessFactor": 0.9},
            }));
            accessors.push(json!({
                "bufferView": views.len(), "componentType": UNSIGNED_INT, "count": 3 * count, "type": "SCALAR",
            }));
            let target = ELEMENT_ARRAY_BUFFER;
            views.push(json!({"buffer": 0, "byteOffset": offset, "byteLength": 12 * count, "target": target}));
            offset += 12 * count;
        }
        let mut node = json!({"mesh": 0, "name": "parts"});
        if self.middle != [0.; 3] {
            node["translation"] = json!(self.middle);
        }
        json!({
            "asset": {"version": "2.0", "generator": concat!("nystrom-stream ", env!("CARGO_PKG_VERSION"))},
            "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [node], "meshes": [{"primitives": primitives}],
            "materials": materials, "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": offset}],
        })
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
            out.settle()?;
        }
        for label in (0..self.triangles.len()).filter(|&label| self.triangles[label] > 0) {
            self.part(label as u32, &mut out)?;
        }
        out.finish()
    }

    /// The indices of a part.
    fn part(&self, label: u32, out: &mut Gather) -> Result<()> {
        let in_space = |v: u32| {
            let p = self.mesh.positions.get(v);
            (0..3).all(|k| ((p[k] - self.middle[k]) as f32).is_finite())
        };
        for (chunk, labels) in self.labelling.labels.chunks(CHUNK).enumerate() {
            self.run.cancel.check()?;
            for at in (0..labels.len()).filter(|&at| labels[at] == label) {
                self.mesh.faces.with(chunk * CHUNK + at, |corners| {
                    if !corners.iter().all(|&v| in_space(v)) {
                        return;
                    }
                    for k in 1..corners.len().saturating_sub(1) {
                        let triangle = [corners[0], corners[k], corners[k + 1]].map(u32::to_le);
                        out.buffer.extend_from_slice(bytemuck::cast_slice(&triangle));
                    }
                });
                out.settle()?;
            }
        }
        Ok(())
    }
}
