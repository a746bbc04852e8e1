//! Integer properties of faces, as the labels and colours that a labelled file carries.
//!
//! Read in one pass in file order without holding anything: some 10 ns a face in binary files, 100 ns in text.

use super::cursor::{Binary, Cursor, Text};
use super::document::Document;
use super::header::CUT_SHORT;
use super::model::{Encoding, Kind};
use crate::base::{Error, Result};
use crate::store::Run;

/// Faces between two looks at the stop flag.
const CHUNK: usize = 1 << 14;

/// Whether faces have a number called `name` each. Triangle strips have none: their faces are made here.
pub fn has(document: &Document, name: &str) -> bool {
    place(document, name).is_some()
}

fn place(document: &Document, name: &str) -> Option<usize> {
    let properties = &document.header.elements[document.face].properties;
    properties
        .iter()
        .position(|property| property.name == name && matches!(property.kind, Kind::One(_)))
        .filter(|_| !document.strips)
}

/// Calls `visit(face, numbers)` for every face in order, with the values of the properties called `names`; a name that
/// no property has gives 0.
///
/// # Errors
/// [`Error::Malformed`] should the file have changed since it was opened; [`Error::Cancelled`].
pub fn for_each<const N: usize>(
    document: &Document,
    names: [&str; N],
    run: &Run,
    visit: impl FnMut(usize, [i64; N]),
) -> Result<()> {
    let places = names.map(|name| place(document, name));
    match document.header.encoding {
        Encoding::Ascii => walk::<Text, N>(document, places, run, visit),
        Encoding::Little => walk::<Binary<false>, N>(document, places, run, visit),
        Encoding::Big => walk::<Binary<true>, N>(document, places, run, visit),
    }
}

impl Document {
    /// The values of the face property `name`, a number from 0 on for each face in the order of the file.
    ///
    /// # Errors
    /// [`Error::Unusable`] where there is no such property, [`Error::Malformed`] naming the first face whose
    /// value is negative or beyond 32 bits, [`Error::Cancelled`].
    pub fn face_property(&self, name: &str, run: &Run) -> Result<Vec<u32>> {
        if !has(self, name) {
            let remedy = "label the mesh first, or give the labels in a file of their own";
            return Err(Error::unusable(&self.path, format!("its faces have no number called {name}"), remedy));
        }
        let (mut values, mut wrong) = (Vec::new(), None);
        for_each(self, [name], run, |face, [value]| match u32::try_from(value) {
            Ok(value) => values.push(value),
            Err(_) => wrong = wrong.or(Some((face, value))),
        })?;
        match wrong {
            None => Ok(values),
            Some((face, value)) => {
                let problem = format!("{name} is {value}, no label from 0 to 4,294,967,295");
                Err(Error::malformed(&self.path, format!("face {face}"), problem, "correct the file"))
            }
        }
    }
}

fn walk<'a, C: Cursor<'a>, const N: usize>(
    document: &'a Document,
    places: [Option<usize>; N],
    run: &Run,
    mut visit: impl FnMut(usize, [i64; N]),
) -> Result<()> {
    let element = &document.header.elements[document.face];
    let range = document.ranges[document.face].clone();
    let mut cursor = C::new(&document.bytes[..range.end], range.start);
    for face in 0..element.count {
        if face % CHUNK == 0 {
            run.cancel.check()?;
        }
        let mut numbers = [0; N];
        for (number, property) in element.properties.iter().enumerate() {
            let wanted = places.iter().position(|&place| place == Some(number));
            let read = match (wanted, property.kind) {
                (Some(k), Kind::One(scalar)) => cursor.integer(scalar).map(|value| numbers[k] = value),
                _ => cursor.skip_value(property.kind),
            };
            read.map_err(|_| {
                let problem = format!("its {} cannot be read", property.name.escape_debug());
                Error::malformed(&document.path, format!("face {face}"), problem, CUT_SHORT)
            })?;
        }
        visit(face, numbers);
    }
    Ok(())
}
