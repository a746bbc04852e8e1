//! An integer property of the faces, such as the labels that another run wrote into a mesh.
//!
//! One pass over the face records of an opened [`Document`], every encoding; a face costs about 10 ns and 4 bytes
//! of memory.

use super::document::Document;
use super::face_columns;
use super::model::Kind;
use crate::base::{Error, Result};
use crate::store::Run;

impl Document {
    /// The values of the face property `name`, a number from 0 on for each face in the order of the file.
    ///
    /// # Errors
    /// [`Error::Unusable`] where there is no such property or it is no integer, [`Error::Malformed`] naming the face
    /// whose value is negative or beyond 32 bits, [`Error::Cancelled`].
    pub fn face_property(&self, name: &str, run: &Run) -> Result<Vec<u32>> {
        let element = &self.header.elements[self.face];
        let property = element.find(name).filter(|_| !self.strips);
        let integer =
            |&number: &usize| matches!(element.properties[number].kind, Kind::One(scalar) if !scalar.is_real());
        if property.filter(integer).is_none() {
            let problem = format!("its faces have no integer property {name:?}");
            return Err(Error::unusable(
                &self.path,
                problem,
                "give a mesh that was written with labels, or a .seg file",
            ));
        }
        let mut values = Vec::with_capacity(element.count);
        face_columns::for_each(self, [name], run, |face, [value]| {
            let value = u32::try_from(value).map_err(|_| {
                Error::malformed(
                    &self.path,
                    format!("face {face}"),
                    format!("{} is {value}", name.escape_debug()),
                    "use numbers from 0 to 4294967295",
                )
            })?;
            values.push(value);
            Ok(())
        })?;
        Ok(values)
    }
}

#[cfg(test)]
mod tests {
    use crate::mesh::{Labelling, PlyForm, open, write_labelled};
    use crate::store::Run;

    const MESH: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
        element face 2\nproperty list uchar int vertex_indices\nproperty float heat\nproperty short kind\nend_header\n\
        0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 2 .5 7\n3 0 2 3 .25 -1\n";

    #[test]
    fn labels_written_into_a_mesh_come_back() {
        let dir = tempfile::tempdir().unwrap();
        let run = Run::new(&());
        let path = dir.path().join("a.ply");
        std::fs::write(&path, MESH).unwrap();
        let opened = open(&path, dir.path(), &run).unwrap();
        let labelling = Labelling { labels: &[3, 70000], colours: &[], quality: None };
        for form in [PlyForm::Ascii, PlyForm::Binary] {
            let labelled = dir.path().join("b.ply");
            write_labelled(&opened.document, &opened.mesh, &labelled, &labelling, form, false, &run).unwrap();
            let again = open(&labelled, dir.path(), &run).unwrap();
            assert_eq!(again.document.face_property("label", &run).unwrap(), [3, 70000]);
        }
    }

    #[test]
    fn what_is_no_label_is_said() {
        let dir = tempfile::tempdir().unwrap();
        let run = Run::new(&());
        let path = dir.path().join("a.ply");
        std::fs::write(&path, MESH).unwrap();
        let document = open(&path, dir.path(), &run).unwrap().document;
        for (name, part) in
            [("label", "no integer property"), ("heat", "no integer property"), ("kind", "face 1: kind is -1")]
        {
            let message = document.face_property(name, &run).unwrap_err().to_string();
            assert!(message.contains(part) && !message.contains('\n'), "{message}");
        }
    }
}
