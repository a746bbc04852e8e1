//! A web page for viewing a segmented mesh and correcting its parts: one HTML file that needs no network.
//!
//! The mesh is decimated to [`TRIANGLES`] ([`decimate`]), quantised to 16 bits per coordinate, and embedded with its
//! labels, the cuts of the merge tree into other numbers of parts, and the run's report; `viewer.js` draws it with
//! WebGL, `editor.js` applies edits on cells as `pipeline::edits` does, and `refine.js` moves boundaries onto creases.
//! Cost: three passes over the mesh and 40 MB; the file has 3–4 MB.

pub mod decimate;

use super::edits::{Edit, Edits};
use super::picture;
use crate::base::tally::tally;
use crate::base::{Error, Result};
use crate::cluster::parts::PartTree;
use crate::cluster::parts::hints::Affinities;
use crate::mesh::Mesh;
use crate::mesh::geometry::one_per_face;
use crate::mesh::output::publish;
use crate::mesh::ply::labelled::GREY;
use crate::store::Run;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use decimate::Decimated;
use serde_json::json;
use std::io::Write;
use std::path::Path;

/// Approximate maximum number of triangles of the page's mesh.
pub const TRIANGLES: usize = 120_000;
/// Labels must be below: the page stores each in two bytes.
const MOST_PARTS: usize = 1 << 16;

const TEMPLATE: &str = include_str!("page.html");
/// Edits on cells, boundaries, drawing, corrections by clicks, and view control: one script.
const SCRIPT: &str = concat!(
    include_str!("editor.js"),
    include_str!("refine.js"),
    include_str!("viewer.js"),
    include_str!("correct.js"),
    include_str!("controls.js")
);
const STYLE: &str = include_str!("page.css");

/// The parts of a `report` that are the same for every run of the same cut.
fn repeatable(report: &serde_json::Value) -> serde_json::Value {
    let mut report = report.clone();
    for (place, names) in [("", &["seconds", "bytes"][..]), ("/decision", &["seconds"]), ("/options", &["threads"])] {
        if let Some(fields) = report.pointer_mut(place).and_then(serde_json::Value::as_object_mut) {
            fields.retain(|name, _| !names.contains(&name.as_str()));
        }
    }
    report
}

/// The content of a page.
///
/// ```
/// use nystrom_stream::apps::colours::palette;
/// use nystrom_stream::apps::page::Page;
/// use nystrom_stream::mesh::Mesh;
/// use nystrom_stream::store::Run;
/// let corners = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]];
/// let mesh = Mesh::from_slices(&corners, &[[0, 1, 2], [0, 2, 3]])?;
/// let report = serde_json::json!({"eigenvalues": [2.0, 0.5]});
/// let page = Page {
///     title: "A square",
///     mesh: &mesh,
///     labels: &[0, 1],
///     colours: &palette(2),
///     names: &[],
///     cuts: None,
///     edits: None,
///     report: &report,
/// };
/// assert!(page.html(&Run::new(&()))?.contains("<title>A square"));
/// # Ok::<(), nystrom_stream::base::Error>(())
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Page<'a> {
    /// Its title.
    pub title: &'a str,
    /// The mesh (n faces).
    pub mesh: &'a Mesh,
    /// Part of each face (n).
    pub labels: &'a [u32],
    /// Colour of each part.
    pub colours: &'a [[u8; 3]],
    /// Name of each part, or none.
    pub names: &'a [String],
    /// Other numbers of parts, if there is a merge tree. Not used if the report says that tiny components or walls have
    /// a label of their own: the page cuts and corrects parts alone, and would lose a label that is none of them.
    pub cuts: Option<Cuts<'a>>,
    /// The edits that produced the labels.
    pub edits: Option<&'a Edits>,
    /// The run's report; missing fields are not shown. Times, memory and threads are left out, so that the same cut is
    /// the same page.
    pub report: &'a serde_json::Value,
}

/// The mesh in other numbers of parts.
#[derive(Clone, Copy, Debug)]
pub struct Cuts<'a> {
    /// Cell of each face (n).
    pub cells: &'a [u32],
    /// The part of each cell, for each number of parts.
    pub parts: &'a [Vec<u32>],
    /// The data for computing edits: without it parts cannot be corrected on the page.
    pub model: Option<CellModel<'a>>,
}

/// The data for computing edits.
#[derive(Clone, Copy, Debug)]
pub struct CellModel<'a> {
    /// How strongly cells belong together.
    pub affinities: Affinities<'a>,
    /// The hierarchy of the cells.
    pub tree: &'a PartTree,
    /// Part of each cell (S) before boundaries were refined. If empty, the most frequent part of its faces.
    pub start: &'a [u32],
}

/// Little-endian bytes as base64.
fn packed<T: bytemuck::NoUninit>(items: &[T]) -> String {
    STANDARD.encode(bytemuck::cast_slice(items))
}

/// Labels below [`MOST_PARTS`], or cells, as two bytes each.
fn short(labels: impl Iterator<Item = u32>) -> String {
    packed(&labels.map(|label| label as u16).collect::<Vec<_>>())
}

/// `template` with each of the `places` replaced by its text. Replaced text is not scanned again: a mesh may have the
/// same name as a place.
fn filled(template: &str, places: &[(&str, &str)]) -> String {
    let mut out = String::with_capacity(template.len() + places.iter().map(|(_, text)| text.len()).sum::<usize>());
    let mut rest = template;
    while let Some((at, place, text)) =
        places.iter().filter_map(|(place, text)| Some((rest.find(place)?, place, text))).min_by_key(|found| found.0)
    {
        out.push_str(&rest[..at]);
        out.push_str(text);
        rest = &rest[at + place.len()..];
    }
    out + rest
}

impl Page<'_> {
    /// Writes the page to `path`, under a temporary name first.
    ///
    /// # Errors
    /// [`Error::Parameter`] for labels that do not match the faces or are above 65,535; [`Error::Unusable`] for a mesh
    /// without a finite face; [`Error::Memory`]; [`Error::Io`]; [`Error::Cancelled`].
    pub fn write(&self, path: &Path, run: &Run) -> Result<()> {
        let text = self.html(run)?;
        publish(path, text.len() as u64, |file| file.write_all(text.as_bytes()).map_err(Error::io(path, "write")))
    }

    /// The page's text.
    ///
    /// # Errors
    /// As [`Page::write`], except for [`Error::Io`].
    pub fn html(&self, run: &Run) -> Result<String> {
        let n = self.mesh.faces.len();
        one_per_face("labels", self.labels.len(), n)?;
        one_per_face("cells", self.cuts.map_or(n, |cuts| cuts.cells.len()), n)?;
        if let Some(label) = self.labels.iter().find(|label| **label as usize >= MOST_PARTS) {
            let problem = format!("label {label} is too large for a page, which holds {MOST_PARTS} parts");
            return Err(Error::parameter("labels", problem, "cut into fewer parts, or write another format"));
        }
        // The mesh as used by the program, so that places and box mean the same on the page.
        let mesh = &self.mesh.without_strays(run)?;
        // Edits from a file may be in other units. Those made on the page are saved after them, with the box of this
        // mesh.
        let edits = self.edits.map(|edits| edits.in_units_of(mesh, run)).transpose()?.map(|edits| self.started(edits));
        let separate = ["tiny_components_label", "walls_label"].iter().any(|&name| self.report[name].is_number());
        let shown = &Page { mesh, edits: edits.as_ref(), cuts: self.cuts.filter(|_| !separate), ..*self };
        let axes = picture::best_view(shown.mesh, Some(self.labels), self.colours.len(), run)?;
        let bytes = decimate::bytes(shown.mesh, TRIANGLES);
        let _grant = run.budget.take("the page's mesh", bytes / 4, bytes)?;
        let decimated = Decimated::of(shown.mesh, TRIANGLES, run)?;
        let marked = shown.marked(run)?;
        // No text in the data can close the script element or start a comment there.
        let data = shown.data(&decimated, axes, marked).to_string().replace('<', "\\u003c");
        let title = self.title.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
        let places = [("/*STYLE*/", STYLE), ("{{TITLE}}", &title), ("/*SCRIPT*/", SCRIPT), ("\"DATA\"", &data)];
        Ok(filled(TEMPLATE, &places))
    }

    /// `edits` with the number of parts or the detail that the run was asked for, which took precedence over those of
    /// the file: the page saves them and shows a command. Protected parts are those of the file's cut, so that stays.
    fn started(&self, mut edits: Edits) -> Edits {
        let asked = &self.report["options"]["parts"];
        let parts = asked["count"]["exactly"].as_u64().and_then(|parts| usize::try_from(parts).ok());
        let detail = asked["detail"].as_f64().filter(|_| asked["count"] == "found");
        if !edits.protects() && (parts.is_some() || detail.is_some()) {
            (edits.parts, edits.detail) = (parts, detail.filter(|&detail| detail != 0.));
        }
        edits
    }

    /// The parts that the edits have dropped, and those that they protect: edits on the page keep them so.
    fn marked(&self, run: &Run) -> Result<[Vec<u32>; 2]> {
        let Some(edits) = self.edits else { return Ok(Default::default()) };
        // Dropped parts become the last one. It is missing here if boundaries left it no face.
        let drops = edits.edits.iter().any(|edit| matches!(edit, Edit::Drop { .. }));
        let last = (0..).zip(self.colours).last().filter(|(_, colour)| drops && **colour == GREY);
        let protects = edits.edits.iter().filter(|edit| matches!(edit, Edit::Protect { .. })).cloned().collect();
        let protects = Edits { edits: protects, ..edits.clone() };
        let faces = protects.on(self.mesh, run)?.faces;
        let mut kept: Vec<u32> = faces.iter().flatten().map(|&face| self.labels[face as usize]).collect();
        kept.sort_unstable();
        kept.dedup();
        Ok([last.map(|(part, _)| part).into_iter().collect(), kept])
    }

    /// The data for the script.
    fn data(&self, decimated: &Decimated, axes: [[f64; 3]; 3], marked: [Vec<u32>; 2]) -> serde_json::Value {
        let [dropped, kept] = marked;
        let [low, high] = decimated.bounds;
        let side = (0..3).map(|k| high[k] - low[k]).fold(0., f64::max).max(f64::MIN_POSITIVE);
        let quantised = |p: [f64; 3]| [0, 1, 2].map(|k| ((p[k] - low[k]) / side * 65535.).round() as u16);
        let positions: Vec<[u16; 3]> = decimated.positions.iter().map(|&p| quantised(p)).collect();
        let of_faces = |values: &[u32]| short(decimated.faces.iter().map(|&face| values[face as usize]));
        let cuts = self.cuts.map(|cuts| {
            json!({
                "cells": of_faces(cuts.cells),
                "parts": cuts.parts.iter().map(|part| short(part.iter().copied())).collect::<Vec<_>>(),
                "model": cuts.model.map(|model| self.model(cuts.cells, model)),
            })
        });
        let extent = [0, 1, 2].map(|k| (high[k] - low[k]) / side);
        let landmarks: Vec<[u16; 3]> = self.landmarks().into_iter().map(quantised).collect();
        json!({
            "title": self.title,
            "axes": axes,
            "faces": self.mesh.faces.len(),
            "extent": extent,
            "positions": packed(&positions),
            "triangles": packed(&decimated.triangles),
            "labels": of_faces(self.labels),
            "colours": self.colours.get(..MOST_PARTS).unwrap_or(self.colours),
            "names": self.names,
            "edits": self.edits,
            "dropped": dropped,
            "kept": kept,
            "whole": decimated.faces.iter().copied().eq(0..self.mesh.faces.len() as u32),
            "low": low,
            "side": side,
            "cuts": cuts,
            "landmarks": packed(&landmarks),
            "report": repeatable(self.report),
        })
    }

    /// The data for computing edits: the hierarchy, the step lengths between cells, the co-association in 16 bits
    /// (above the diagonal, row by row), and the part of each cell.
    fn model(&self, cells: &[u32], CellModel { affinities, tree, start }: CellModel<'_>) -> serde_json::Value {
        let start = if start.len() == tree.cells() { start.to_vec() } else { self.most_faces(cells, tree.cells()) };
        let together = affinities.co_association;
        let rows = 0..together.len();
        let above = rows.flat_map(|i| together.row(i)[i + 1..].iter().map(|c| (c * 65535.).round() as u16));
        let steps: Vec<f32> = (0..tree.pairs.len()).map(|edge| affinities.step(edge) as f32).collect();
        let flat = |pairs: &[[u32; 2]]| short(pairs.iter().flatten().copied());
        json!({
            "start": short(start.into_iter()),
            "unions": flat(&tree.unions),
            "area": packed(&tree.area),
            "pairs": flat(&tree.pairs),
            "length": packed(&tree.length),
            "steps": packed(&steps),
            "superfaces": short(affinities.superfaces.of_cell.iter().copied()),
            "together": packed(&above.collect::<Vec<_>>()),
            "small": tree.small_part,
        })
    }

    /// The most frequent part of the faces of each of `n` cells.
    fn most_faces(&self, cells: &[u32], n: usize) -> Vec<u32> {
        let counts = tally(cells.iter().copied().zip(self.labels.iter().copied()));
        let mut most = vec![(0, 0); n];
        for ((cell, label), count) in counts {
            if let Some(best) = most.get_mut(cell as usize).filter(|best| count > best.0) {
                *best = (count, label);
            }
        }
        most.into_iter().map(|best| best.1).collect()
    }

    /// Centroids of the landmark faces listed in the report.
    fn landmarks(&self) -> Vec<[f64; 3]> {
        let faces = self.report["landmarks"].as_array().map_or(&[][..], Vec::as_slice);
        let numbers = faces.iter().filter_map(serde_json::Value::as_u64);
        let centre = |face: u64| {
            self.mesh.faces.with(face as usize, |corners| {
                let mut sum = [0.; 3];
                for &v in corners {
                    let p = self.mesh.positions.get(v);
                    (0..3).for_each(|k| sum[k] += p[k] / corners.len() as f64);
                }
                sum
            })
        };
        numbers.filter(|&face| (face as usize) < self.mesh.faces.len()).map(centre).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Budget;

    /// Regression: pages held the times and the memory of the run, so that the same cut made different files.
    #[test]
    fn what_differs_between_runs_is_left_out() {
        let report = |seconds: f64, threads: u32| {
            json!({
                "seconds": {"total": seconds}, "bytes": {"peak_allocated": threads}, "options": {"seed": 1, "threads": threads},
                "decision": {"cells": 7, "seconds": seconds}, "parts": [{"seconds": 1}],
            })
        };
        assert_eq!(repeatable(&report(1., 1)), repeatable(&report(2., 2)));
        let kept = json!({"options": {"seed": 1}, "decision": {"cells": 7}, "parts": [{"seconds": 1}]});
        assert_eq!(repeatable(&report(1., 1)), kept);
        assert_eq!(repeatable(&json!({})), json!({}));
    }

    /// Regression: a page of a few faces asked for as much memory as one of 120,000.
    #[test]
    fn a_small_mesh_needs_little_memory() {
        let mesh = Mesh::from_slices(&[[0., 0., 0.], [1., 0., 0.], [0., 1., 0.]], &[[0u32, 1, 2]]).unwrap();
        let page = Page {
            title: "",
            mesh: &mesh,
            labels: &[0],
            colours: &[[0; 3]],
            names: &[],
            cuts: None,
            edits: None,
            report: &json!({}),
        };
        let run = Run { budget: Budget::new(decimate::bytes(&mesh, TRIANGLES)), ..Run::new(&()) };
        assert!(page.html(&run).unwrap().contains("\"faces\":1"));
    }
}
