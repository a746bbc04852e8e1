//! Existing labels of faces: in the mesh's own file, or in a separate file.
//!
//! Everything that takes labels reads them here, by one rule: a negative number means that a face has none. One pass;
//! the result is an array of the work directory, or is used in place.

use super::colours::colours_for;
use super::open_labels;
use crate::base::printable::counted;
use crate::base::{Error, Result};
use crate::mesh::ply::ElementKind;
use crate::mesh::ply::labelled::GREY;
use crate::mesh::ply::names::names_of;
use crate::mesh::{Mesh, UNLABELLED};
use crate::store::{Context, MappedSlice, Run, WorkDir};
use std::path::Path;

/// The properties of a colour.
const COLOUR: [&str; 3] = ["red", "green", "blue"];
/// Labels above this have no colour or name from the file.
const MOST: usize = 1 << 20;

/// Labels of the faces of a mesh, with the names and colours of parts in its file.
#[derive(Clone, Debug)]
pub struct LabelledFaces {
    /// Label of each face (n); [`UNLABELLED`]: none.
    pub labels: MappedSlice<u32>,
    /// Names of parts by label, empty for none; may be shorter than the number of labels.
    pub names: Vec<String>,
    /// Colours by label, if all faces of a label have the same colour.
    colours: Option<Vec<[u8; 3]>>,
}

impl LabelledFaces {
    /// The face property `label` in the file of `mesh`, with the colours of the faces and the names in the header;
    /// `None` if there is no such property.
    ///
    /// # Errors
    /// [`Error::Malformed`] if the file has changed since it was opened; [`Error::Io`], [`Error::Cancelled`].
    pub fn of_mesh(mesh: &Mesh, context: Context<'_>) -> Result<Option<Self>> {
        let property = |name: &str| mesh.document()?.property(ElementKind::Faces, name);
        let Some(document) = mesh.document().filter(|_| property("label").is_some()) else { return Ok(None) };
        let mut writer = context.work.writer_of("labels_of_faces.npy", 1, mesh.faces.len())?;
        let mut colours: Vec<Option<[u8; 3]>> = Vec::new();
        let channels = COLOUR.map(property);
        let mut uniform = channels.iter().all(Option::is_some);
        let real = uniform && channels.iter().flatten().any(|channel| channel.scalar.is_real());
        let mut parts = 0;
        let mut add = |label: i64, colour: [u8; 3]| {
            let label = u32::try_from(label).unwrap_or(UNLABELLED);
            writer.push(&[label])?;
            if label == UNLABELLED {
                return Ok(());
            }
            let place = label as usize;
            parts = parts.max(place + 1);
            uniform &= place < MOST;
            if uniform {
                if colours.len() <= place {
                    colours.resize(place + 1, None);
                }
                uniform = *colours[place].get_or_insert(colour) == colour;
            }
            Ok(())
        };
        let [red, green, blue] = COLOUR;
        if real {
            // Floating-point colours are usually from 0 to 1.
            let mut most = 0f64;
            document.for_each_face_real(COLOUR, context.run, |_, colour| {
                most = colour.into_iter().fold(most, f64::max);
                Ok(())
            })?;
            let scale = if most <= 1. { 255. } else { 1. };
            document.for_each_face_real(["label", red, green, blue], context.run, |_, [label, colour @ ..]| {
                let label = if label.is_nan() { -1 } else { label as i64 };
                add(label, colour.map(|part| (part * scale).round() as u8))
            })?;
        } else {
            document.for_each_face(["label", red, green, blue], context.run, |_, [label, colour @ ..]| {
                add(label, colour.map(|part| part.clamp(0, 255) as u8))
            })?;
        }
        let names = names_of(document, parts.min(MOST));
        let colours = uniform.then(|| colours.into_iter().map(|colour| colour.unwrap_or(GREY)).collect());
        Ok(Some(Self { labels: writer.finish(false)?, names, colours }))
    }

    /// The same where labels are needed.
    ///
    /// # Errors
    /// As [`LabelledFaces::of_mesh`], and [`Error::Unusable`], with this `remedy`, if there is no such property.
    pub fn needed_of_mesh(mesh: &Mesh, remedy: &str, context: Context<'_>) -> Result<Self> {
        let missing = || Error::unusable(mesh.path(), "has no face property `label`", remedy);
        Self::of_mesh(mesh, context)?.ok_or_else(missing)
    }

    /// The labels of `mesh` in the `.seg` or `.npy` file `path` ([`open_labels`]).
    ///
    /// # Errors
    /// As [`open_labels`]; [`Error::Unusable`] if there is not one per face.
    pub fn of_file(path: &Path, mesh: &Mesh, work: &WorkDir) -> Result<Self> {
        let labels = open_labels(path, work)?;
        if labels.len() != mesh.faces.len() {
            let problem = format!("has {} for {}", counted(labels.len(), "label"), counted(mesh.faces.len(), "face"));
            let remedy = format!("give the labels of {}", mesh.path().display());
            return Err(Error::unusable(path, problem, remedy));
        }
        Ok(Self { labels, names: Vec::new(), colours: None })
    }

    /// A colour per label: those in the file, or new ones for `labels`, which are these labels or derived from them, on
    /// `mesh`.
    ///
    /// # Errors
    /// As [`colours_for`].
    pub fn colours(&mut self, mesh: &Mesh, labels: &[u32], run: &Run) -> Result<Vec<[u8; 3]>> {
        self.colours.take().map_or_else(|| colours_for(mesh, labels, run), Ok)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Regression: colours from 0 to 1 were black.
    #[test]
    fn colours_of_floating_point_are_those_of_integers() {
        let dir = tempfile::tempdir().unwrap();
        let (run, path) = (Run::new(&()), dir.path().join("a.ply"));
        let colours = |scalar: &str, colours: [&str; 2]| {
            let text = format!(
                "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
                 element face 2\nproperty list uchar int vertex_indices\nproperty int label\nproperty {scalar} red\n\
                 property {scalar} green\nproperty {scalar} blue\nend_header\n\
                 0 0 0\n1 0 0\n0 1 0\n1 1 0\n3 0 1 2 1 {}\n3 1 3 2 0 {}\n",
                colours[0], colours[1]
            );
            std::fs::write(&path, text).unwrap();
            let work = WorkDir::temporary(dir.path()).unwrap();
            let labelled = LabelledFaces::of_mesh(&Mesh::open(&path).unwrap(), Context::new(&work, &run));
            let labelled = labelled.unwrap().unwrap();
            assert_eq!(labelled.labels[..], [1, 0]);
            labelled.colours.unwrap()
        };
        let expected = [[0, 51, 255], [255, 102, 0]];
        assert_eq!(colours("uchar", ["255 102 0", "0 51 255"]), expected);
        assert_eq!(colours("float", ["1 .4 0", "0 .2 1"]), expected);
        assert_eq!(colours("double", ["255 102 -1", "0 51 300"]), expected);
    }
}
