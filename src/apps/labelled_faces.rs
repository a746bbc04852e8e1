//! Labels that faces have already: in the mesh's own file, or in a file beside it.
//!
//! Everything that takes labels reads them here, by one rule: a negative number says that a face has none. One pass;
//! what is read lies in an array of the work directory, or is used where it lies.

use super::colours::colours_for;
use super::open_labels;
use crate::base::{Error, Result};
use crate::mesh::Mesh;
use crate::mesh::ply::ElementKind;
use crate::mesh::ply::names::names_of;
use crate::store::{Context, MappedSlice, Run, WorkDir};
use std::path::Path;

/// No label.
pub const NONE: u32 = u32::MAX;
/// Labels beyond have no colour and no name of the file.
const MOST: usize = 1 << 20;

/// Labels of the faces of a mesh, and what its file tells of the parts.
#[derive(Clone, Debug)]
pub struct LabelledFaces {
    /// Label of each face (n); [`NONE`]: none.
    pub labels: MappedSlice<u32>,
    /// Names of parts by label, empty for none; may end early.
    pub names: Vec<String>,
    /// Colours by label, where all faces of a label have the same.
    colours: Option<Vec<[u8; 3]>>,
}

impl LabelledFaces {
    /// The face property `label` of the file of `mesh`, with the colours of the faces and the names in the header;
    /// nothing where there is no such property.
    ///
    /// # Errors
    /// [`Error::Malformed`] should the file have changed since it was opened; [`Error::Io`], [`Error::Cancelled`].
    pub fn of_mesh(mesh: &Mesh, context: Context<'_>) -> Result<Option<Self>> {
        let has = |name: &&str| mesh.document().is_some_and(|all| all.property(ElementKind::Faces, name).is_some());
        let Some(document) = mesh.document().filter(|_| has(&"label")) else { return Ok(None) };
        let mut writer = context.work.writer_of("labels_of_faces.npy", 1, mesh.faces.len())?;
        let mut colours: Vec<Option<[u8; 3]>> = Vec::new();
        let mut uniform = ["red", "green", "blue"].iter().all(has);
        let mut parts = 0;
        document.for_each_face(["label", "red", "green", "blue"], context.run, |_, [label, colour @ ..]| {
            let label = u32::try_from(label).unwrap_or(NONE);
            writer.push(&[label])?;
            if label == NONE {
                return Ok(());
            }
            let place = label as usize;
            parts = parts.max(place + 1);
            uniform &= place < MOST;
            if uniform {
                let colour = colour.map(|part| part.clamp(0, 255) as u8);
                if colours.len() <= place {
                    colours.resize(place + 1, None);
                }
                uniform = *colours[place].get_or_insert(colour) == colour;
            }
            Ok(())
        })?;
        let names = names_of(document, parts.min(MOST));
        let colours = uniform.then(|| colours.into_iter().map(|colour| colour.unwrap_or([128; 3])).collect());
        Ok(Some(Self { labels: writer.finish(false)?, names, colours }))
    }

    /// The labels of `mesh` in the `.seg` or `.npy` file `path` ([`open_labels`]).
    ///
    /// # Errors
    /// As [`open_labels`]; [`Error::Unusable`] where they are not one per face.
    pub fn of_file(path: &Path, mesh: &Mesh, work: &WorkDir) -> Result<Self> {
        let labels = open_labels(path, work)?;
        if labels.len() != mesh.faces.len() {
            let problem = format!("has {} labels for {} faces", labels.len(), mesh.faces.len());
            let remedy = format!("give the labels of {}", mesh.path().display());
            return Err(Error::unusable(path, problem, remedy));
        }
        Ok(Self { labels, names: Vec::new(), colours: None })
    }

    /// A colour per label: those of the file, or new ones for `labels`, which are these or made of them, on `mesh`.
    ///
    /// # Errors
    /// As [`colours_for`].
    pub fn colours(&mut self, mesh: &Mesh, labels: &[u32], run: &Run) -> Result<Vec<[u8; 3]>> {
        self.colours.take().map_or_else(|| colours_for(mesh, labels, run), Ok)
    }
}
