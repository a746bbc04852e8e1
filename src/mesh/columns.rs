//! A number of each vertex or face of a file, whatever its type: what correspondence carries from mesh to mesh.
//!
//! One pass over the element's records, held by nobody: 10 ns a number in binary files, 100 ns in text. All numbers come as
//! `f64`, which holds every type of the format exactly.

use super::cursor::{Binary, Cursor, Fault, Text};
use super::document::Document;
use super::header::CUT_SHORT;
use super::model::{Encoding, Kind, Scalar};
use crate::base::{Error, Result};
use crate::store::Run;

/// Records between two looks at the stop flag.
const CHUNK: usize = 1 << 14;

/// Vertices or faces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Of {
    /// The vertices.
    Vertices,
    /// The faces; triangle strips have no properties a face.
    Faces,
}

/// Where a property stands in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// Number of the element.
    element: usize,
    /// Number of the property.
    property: usize,
    /// Its type.
    pub scalar: Scalar,
}

/// The property called `name`, if each record has one number of it.
pub fn find(document: &Document, of: Of, name: &str) -> Option<Place> {
    let element = match of {
        Of::Vertices => document.header.elements.iter().position(|element| element.is("vertex"))?,
        Of::Faces if document.strips => return None,
        Of::Faces => document.face,
    };
    let property = document.header.elements[element].find(name)?;
    match document.header.elements[element].properties[property].kind {
        Kind::One(scalar) => Some(Place { element, property, scalar }),
        Kind::List { .. } => None,
    }
}

/// Calls `visit(record, number)` for every record in order.
///
/// # Errors
/// Those of `visit`; [`Error::Malformed`] should the file have changed since it was opened; [`Error::Cancelled`].
pub fn for_each(
    document: &Document,
    place: Place,
    run: &Run,
    visit: impl FnMut(usize, f64) -> Result<()>,
) -> Result<()> {
    match document.header.encoding {
        Encoding::Ascii => walk::<Text>(document, place, run, visit),
        Encoding::Little => walk::<Binary<false>>(document, place, run, visit),
        Encoding::Big => walk::<Binary<true>>(document, place, run, visit),
    }
}

fn walk<'a, C: Cursor<'a>>(
    document: &'a Document,
    place: Place,
    run: &Run,
    mut visit: impl FnMut(usize, f64) -> Result<()>,
) -> Result<()> {
    let element = &document.header.elements[place.element];
    let range = document.ranges[place.element].clone();
    let mut cursor = C::new(&document.bytes[..range.end], range.start);
    for record in 0..element.count {
        if record % CHUNK == 0 {
            run.cancel.check()?;
        }
        let mut number = 0.;
        for (k, property) in element.properties.iter().enumerate() {
            let read = match property.kind {
                Kind::One(scalar) if k == place.property => cursor.real(scalar).map(|value| number = value),
                kind => cursor.skip_value(kind),
            };
            read.map_err(|fault: Fault| {
                let place = format!("{} {record}", element.name.escape_debug());
                Error::malformed(&document.path, place, format!("cannot be read again ({fault:?})"), CUT_SHORT)
            })?;
        }
        visit(record, number)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::open;

    #[test]
    fn numbers_of_vertices_and_faces_are_read() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.ply");
        let text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
            property double heat\nelement face 1\nproperty list uchar int vertex_indices\nproperty short kind\nend_header\n\
            0 0 0 1.5\n1 0 0 -2\n0 1 0 1e300\n3 0 1 2 -7\n";
        std::fs::write(&path, text).unwrap();
        let run = Run::new(&());
        let document = open(&path, dir.path(), &run).unwrap().document;
        let read = |of, name| {
            let mut all = Vec::new();
            for_each(&document, find(&document, of, name).unwrap(), &run, |k, x| {
                assert_eq!(k, all.len());
                all.push(x);
                Ok(())
            })
            .unwrap();
            all
        };
        assert_eq!(read(Of::Vertices, "heat"), [1.5, -2., 1e300]);
        assert_eq!(read(Of::Faces, "kind"), [-7.]);
        assert_eq!(find(&document, Of::Faces, "vertex_indices"), None);
        assert_eq!(find(&document, Of::Vertices, "kind"), None);
    }
}
