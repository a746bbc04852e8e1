//! One pass over the payload: finds where each element lies, checks it, and decodes what cannot be
//! read in place.
//!
//! Binary elements without lists are stepped over in no time, little-endian triangles are verified
//! in place, everything else streams through small buffers into arrays of the scratch folder.

use super::cursor::{Binary, Cursor, Fault, Text};
use super::header::{CUT_SHORT, Header};
use super::model::{Element, Encoding, Kind, Scalar};
use super::sink::FaceSink;
use super::strip::Strip;
use super::surface::{Faces, MOST_FACES, Positions, too_many_faces};
use crate::base::{Error, Result};
use crate::store::npy::{self, ArrayWriter, Item};
use crate::store::{MappedBytes, Run};
use std::ops::Range;
use std::path::Path;

/// Records between two looks at the stop flag.
const CHUNK: usize = 1 << 14;

/// What to look for in a file, and where to put it.
pub(super) struct Task<'a> {
    /// The path as the user gave it.
    pub path: &'a Path,
    pub scratch: &'a Path,
    pub run: &'a Run<'a>,
    pub header: &'a Header,
    pub bytes: &'a MappedBytes,
    /// Number of the vertex element, and of its properties x, y, z.
    pub vertex: usize,
    pub axes: [usize; 3],
    /// Number of the face element, and of its vertex list.
    pub face: usize,
    pub list: usize,
    /// Whether that element holds triangle strips.
    pub strips: bool,
}

/// What the pass found.
pub(super) struct Decoded {
    pub positions: Positions,
    pub faces: Faces,
    pub ranges: Vec<Range<usize>>,
    pub face_bytes: Option<usize>,
}

/// Runs the pass.
///
/// # Errors
/// [`Error::Malformed`] for payloads cut short, text that is no number, indices out of range;
/// [`Error::Io`] for the scratch folder; [`Error::Cancelled`].
pub(super) fn decode(task: &Task) -> Result<Decoded> {
    match task.header.encoding {
        Encoding::Ascii => task.walk::<Text>(),
        Encoding::Little => task.walk::<Binary<false>>(),
        Encoding::Big => task.walk::<Binary<true>>(),
    }
}

impl<'a> Task<'a> {
    fn walk<C: Cursor<'a>>(&self) -> Result<Decoded> {
        let mut cursor = C::new(self.bytes, self.header.payload);
        let mut ranges = Vec::with_capacity(self.header.elements.len());
        let (mut positions, mut faces, mut face_bytes) = (None, None, None);
        for (number, element) in self.header.elements.iter().enumerate() {
            let start = cursor.seek();
            if number == self.vertex {
                positions = Some(self.vertices(&mut cursor, element)?);
            } else if number == self.face {
                let (found, size) = self.faces(&mut cursor, element)?;
                (faces, face_bytes) = (Some(found), size);
            } else {
                self.skip(&mut cursor, element)?;
            }
            ranges.push(start..cursor.at().max(start));
        }
        match (positions, faces) {
            (Some(positions), Some(faces)) => Ok(Decoded { positions, faces, ranges, face_bytes }),
            _ => Err(Error::unusable(self.path, "has no vertices or no faces", "export the mesh again")),
        }
    }

    /// The error for a record that could not be read.
    pub(super) fn error(&self, element: &Element, record: usize, fault: Fault) -> Error {
        let place = format!("{} {record}", element.name.escape_debug());
        let (problem, remedy) = match fault {
            Fault::End => (format!("the file ends here, {} were promised", element.count), CUT_SHORT),
            Fault::Text(text) => {
                (format!("{text} is not a number of the right type"), "correct the file or export it again")
            }
            Fault::Length(length) => (format!("a list has {length} items"), "the file is damaged; get it again"),
        };
        Error::malformed(self.path, place, problem, remedy)
    }

    /// Where a binary element of fixed record size ends.
    fn end_of_fixed(&self, element: &Element, start: usize) -> Option<Result<usize>> {
        let size = element.fixed_size().filter(|_| self.header.encoding != Encoding::Ascii)?;
        let left = self.bytes.len() - start;
        Some(match element.count.checked_mul(size) {
            Some(bytes) if bytes <= left => Ok(start + bytes),
            _ => Err(self.error(element, left / size.max(1), Fault::End)),
        })
    }

    /// Calls `read(record)` for each record of `element`.
    fn each(&self, element: &Element, mut read: impl FnMut(usize) -> Result<()>) -> Result<()> {
        for start in (0..element.count).step_by(CHUNK) {
            self.run.cancel.check()?;
            for record in start..element.count.min(start + CHUNK) {
                read(record)?;
            }
        }
        Ok(())
    }

    /// Moves over an element that the mesh does not need.
    fn skip<C: Cursor<'a>>(&self, cursor: &mut C, element: &Element) -> Result<()> {
        if element.properties.is_empty() {
            return Ok(());
        }
        if let Some(end) = self.end_of_fixed(element, cursor.at()) {
            *cursor = C::new(self.bytes, end?);
            return Ok(());
        }
        self.each(element, |record| {
            let mut all = element.properties.iter();
            all.try_for_each(|property| cursor.skip_value(property.kind))
                .map_err(|fault| self.error(element, record, fault))
        })
    }

    /// The positions: in place where they are packed `float`s or `double`s, else decoded.
    fn vertices<C: Cursor<'a>>(&self, cursor: &mut C, element: &Element) -> Result<Positions> {
        let kinds = self.axes.map(|axis| element.properties[axis].kind);
        let in_place = match kinds {
            [Kind::One(Scalar::F32), Kind::One(Scalar::F32), Kind::One(Scalar::F32)] => Some(false),
            [Kind::One(Scalar::F64), Kind::One(Scalar::F64), Kind::One(Scalar::F64)] => Some(true),
            _ => None,
        };
        if let (Encoding::Little, Some(double), Some(size)) = (self.header.encoding, in_place, element.fixed_size()) {
            let start = cursor.at();
            let end = self.end_of_fixed(element, start).unwrap_or(Ok(start))?;
            *cursor = C::new(self.bytes, end);
            let at = self.axes.map(|axis| element.properties[..axis].iter().map(|p| p.kind.least_size()).sum());
            return Positions::strided(self.path, self.bytes.clone(), start, size, at, double, element.count);
        }
        let wide = [Scalar::F64, Scalar::I32, Scalar::U32].map(Kind::One);
        if kinds.iter().any(|kind| wide.contains(kind)) {
            self.decode_vertices(cursor, element, |value| value)
        } else {
            self.decode_vertices(cursor, element, |value| value as f32)
        }
    }

    fn decode_vertices<C: Cursor<'a>, T: Item>(
        &self,
        cursor: &mut C,
        element: &Element,
        narrow: impl Fn(f64) -> T,
    ) -> Result<Positions> {
        let path = self.scratch.join("vertices.npy");
        let mut writer = ArrayWriter::create(&path, 3)?;
        self.each(element, |record| {
            let mut position = [T::zeroed(); 3];
            for (number, property) in element.properties.iter().enumerate() {
                let axis = self.axes.iter().position(|&axis| axis == number);
                match (axis, property.kind) {
                    (Some(axis), Kind::One(scalar)) => cursor.real(scalar).map(|value| position[axis] = narrow(value)),
                    (_, kind) => cursor.skip_value(kind),
                }
                .map_err(|fault| self.error(element, record, fault))?;
            }
            writer.push(&position)
        })?;
        writer.finish(false)?;
        let size = size_of::<T>();
        let bytes = MappedBytes::open(&path)?;
        Positions::strided(&path, bytes, npy::HEADER, 3 * size, [0, size, 2 * size], size == 8, element.count)
    }

    /// The faces, and the size of their records where it is the same for all.
    fn faces<C: Cursor<'a>>(&self, cursor: &mut C, element: &Element) -> Result<(Faces, Option<usize>)> {
        if let Some(found) = self.triangles_in_place(cursor, element)? {
            return Ok(found);
        }
        let Kind::List { count, item } = element.properties[self.list].kind else {
            return Err(Error::malformed(
                self.path,
                "header",
                "the faces have no vertex list",
                "export the mesh again",
            ));
        };
        let vertices = self.header.elements[self.vertex].count as u64;
        let mut sink = FaceSink::create(self.scratch)?;
        let mut sizes: Option<(usize, bool)> = None;
        let mut told = 0;
        self.each(element, |record| {
            let start = cursor.at();
            for (number, property) in element.properties.iter().enumerate() {
                if number != self.list {
                    cursor.skip_value(property.kind).map_err(|fault| self.error(element, record, fault))?;
                    continue;
                }
                let size = cursor.length(count).map_err(|fault| self.error(element, record, fault))?;
                let mut strip = Strip::default();
                if !self.strips {
                    sink.begin(size)?;
                }
                for _ in 0..size {
                    let vertex = cursor.integer(item).map_err(|fault| self.error(element, record, fault))?;
                    if self.strips && vertex == -1 {
                        strip = Strip::default();
                    } else if vertex < 0 || vertex as u64 >= vertices {
                        return Err(self.out_of_range(element, record, vertex));
                    } else if !self.strips {
                        sink.corner(vertex as u32)?;
                    } else if let Some(triangle) = strip.next(vertex as u32) {
                        sink.begin(3)?;
                        triangle.into_iter().try_for_each(|corner| sink.corner(corner))?;
                    }
                }
            }
            let size = cursor.at() - start;
            sizes = Some(sizes.map_or((size, true), |(first, equal)| (first, equal && first == size)));
            if sink.faces() >= told + CHUNK as u64 || record + 1 == element.count {
                self.run.progress.advance("read", sink.faces() - told);
                told = sink.faces();
            }
            Ok(())
        })?;
        if sink.faces() > MOST_FACES {
            return Err(too_many_faces(self.path, sink.faces()));
        }
        let one_list =
            element.properties.iter().filter(|property| matches!(property.kind, Kind::List { .. })).count() == 1;
        let fixed = sizes.filter(|&(_, equal)| equal && one_list && self.header.encoding != Encoding::Ascii);
        Ok((sink.finish()?, fixed.map(|(size, _)| size)))
    }

    /// The error for a face that names a vertex there is not.
    pub(super) fn out_of_range(&self, element: &Element, record: usize, vertex: i64) -> Error {
        let vertices = self.header.elements[self.vertex].count;
        Error::malformed(
            self.path,
            format!("{} {record}", element.name.escape_debug()),
            format!("names vertex {vertex}, but there are {vertices}, counted from 0"),
            "repair the mesh or export it again",
        )
    }
}
