//! Integer properties of the faces side by side, such as labels and colours of a labelled file.
//!
//! Read in one pass in file order without holding anything: some 10 ns a face in binary files, 100 ns in text.

use super::cursor::{Binary, Cursor, Fault, Text};
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
/// Those of `visit`; [`Error::Malformed`] should the file have changed since it was opened; [`Error::Cancelled`].
pub fn for_each<const N: usize>(
    document: &Document,
    names: [&str; N],
    run: &Run,
    visit: impl FnMut(usize, [i64; N]) -> Result<()>,
) -> Result<()> {
    let places = names.map(|name| place(document, name));
    match document.header.encoding {
        Encoding::Ascii => walk::<Text, N>(document, places, run, visit),
        Encoding::Little => walk::<Binary<false>, N>(document, places, run, visit),
        Encoding::Big => walk::<Binary<true>, N>(document, places, run, visit),
    }
}

fn walk<'a, C: Cursor<'a>, const N: usize>(
    document: &'a Document,
    places: [Option<usize>; N],
    run: &Run,
    mut visit: impl FnMut(usize, [i64; N]) -> Result<()>,
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
            read.map_err(|fault| {
                let problem = match fault {
                    Fault::End => "the file ends here".to_owned(),
                    Fault::Text(text) => format!("{text} is not a number of the right type"),
                    Fault::Length(length) => format!("a list has {length} items"),
                };
                Error::malformed(&document.path, format!("face {face}"), problem, CUT_SHORT)
            })?;
        }
        visit(face, numbers)?;
    }
    Ok(())
}
