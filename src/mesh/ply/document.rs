//! An opened PLY file, kept to copy what an output does not change, and to read properties of vertices and faces.
//!
//! A [`Document`] keeps the mapping alive and remembers where each element lies; it stores the header and a few numbers
//! per element. Properties are read in one pass over the element's records, in file order, without buffering: about 10
//! ns per record in binary files, 100 ns in text.

use super::element::{Encoding, Kind, Scalar};
use super::header::{CUT_SHORT, Header, HeaderWriter, Line};
use super::values::{Binary, Cursor, Fault, Text};
use crate::base::{Error, Result};
use crate::mesh::output::Gather;
use crate::store::{MappedBytes, Run};
use std::ops::Range;
use std::path::PathBuf;

/// Records between two checks of the stop flag.
const CHUNK: usize = 1 << 14;
/// Bytes copied at a time.
const COPY: usize = 1 << 22;

/// An opened PLY file: its header and where its elements lie.
#[derive(Clone, Debug)]
pub struct Document {
    /// The path as the user gave it (`<stdin>` or the like for a stream).
    pub(in crate::mesh) path: PathBuf,
    pub(in crate::mesh) header: Header,
    /// The uncompressed file.
    pub(in crate::mesh) bytes: MappedBytes,
    /// Whether `bytes` are the file at the path itself: a PLY, neither compressed nor streamed.
    pub(in crate::mesh) is_file: bool,
    /// The bytes of each element, without surrounding blanks in text.
    pub(in crate::mesh) ranges: Vec<Range<usize>>,
    /// Number of the element that holds the vertices.
    pub(in crate::mesh) vertex: usize,
    /// Numbers of its properties x, y and z.
    pub(in crate::mesh) axes: [usize; 3],
    /// Number of the element that holds the faces.
    pub(in crate::mesh) face: usize,
    /// Number of its property that lists the vertices.
    pub(in crate::mesh) list: usize,
    /// Whether that element holds triangle strips.
    pub(in crate::mesh) strips: bool,
    /// Record size of a face, if all are equal in size and layout (binary only).
    pub(in crate::mesh) face_bytes: Option<usize>,
}

/// Vertices or faces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ElementKind {
    /// The vertices.
    Vertices,
    /// The faces. Triangle strips have no property per face.
    Faces,
}

/// A property with one number per vertex or face.
#[derive(Clone, Copy, Debug)]
pub struct NumberProperty<'a> {
    document: &'a Document,
    element: usize,
    property: usize,
    /// The type of its numbers in the file.
    pub scalar: Scalar,
}

impl Document {
    /// The header.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// The number of records of `element` if there are `faces` faces, which may come from strips.
    pub(super) fn count(&self, element: usize, faces: usize) -> usize {
        if element == self.face { faces } else { self.header.elements[element].count }
    }

    /// Whether its numbers are text.
    pub fn is_text(&self) -> bool {
        self.header.encoding == Encoding::Ascii
    }

    /// The bytes of the uncompressed file, such as for a checksum.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Whether [`Document::bytes`] are the file at the path, which may have changed since it was opened.
    pub fn is_file(&self) -> bool {
        self.is_file
    }

    /// The property called `name`, if it has one number per vertex or face.
    pub fn property(&self, of: ElementKind, name: &str) -> Option<NumberProperty<'_>> {
        let element = match of {
            ElementKind::Vertices => self.vertex,
            ElementKind::Faces if self.strips => return None,
            ElementKind::Faces => self.face,
        };
        let property = self.header.elements[element].find(name)?;
        match self.header.elements[element].properties[property].kind {
            Kind::One(scalar) => Some(NumberProperty { document: self, element, property, scalar }),
            Kind::List { .. } => None,
        }
    }

    /// The values of the face property `name`: one non-negative number per face, in file order; 4 bytes per face.
    ///
    /// # Errors
    /// [`Error::Unusable`] if there is no such property or it is not an integer, [`Error::Malformed`] naming the face
    /// whose value is negative or beyond 32 bits, [`Error::Cancelled`].
    pub fn face_property(&self, name: &str, run: &Run) -> Result<Vec<u32>> {
        let mut values = Vec::with_capacity(self.header.elements[self.face].count);
        self.for_each_value(name, run, |value| {
            values.push(value);
            Ok(())
        })?;
        Ok(values)
    }

    /// Calls `visit(value)` for every face in order, with the values of [`Document::face_property`].
    ///
    /// # Errors
    /// As there, and those of `visit`.
    pub fn for_each_value(&self, name: &str, run: &Run, mut visit: impl FnMut(u32) -> Result<()>) -> Result<()> {
        if self.property(ElementKind::Faces, name).filter(|found| !found.scalar.is_real()).is_none() {
            let problem = format!("its faces have no integer property {name:?}");
            return Err(Error::unusable(
                &self.path,
                problem,
                "name an integer property of its faces, or give a mesh that was written with labels",
            ));
        }
        self.for_each_face([name], run, |face, [value]| {
            visit(u32::try_from(value).map_err(|_| {
                Error::malformed(
                    &self.path,
                    format!("face {face}"),
                    format!("{} is {value}", name.escape_debug()),
                    "use numbers from 0 to 4294967295",
                )
            })?)
        })
    }

    /// Calls `visit(face, numbers)` for every face in order, with the properties called `names` as integers, such as a
    /// label and a colour. A missing property gives 0. Floating-point numbers lose their fraction, and NaN becomes -1.
    ///
    /// # Errors
    /// Those of `visit`; [`Error::Malformed`] should the file have changed since it was opened; [`Error::Cancelled`].
    pub fn for_each_face<const N: usize>(
        &self,
        names: [&str; N],
        run: &Run,
        visit: impl FnMut(usize, [i64; N]) -> Result<()>,
    ) -> Result<()> {
        self.of_faces(names, run, visit)
    }

    /// As [`Document::for_each_face`], with floating-point numbers.
    ///
    /// # Errors
    /// As [`Document::for_each_face`].
    pub fn for_each_face_real<const N: usize>(
        &self,
        names: [&str; N],
        run: &Run,
        visit: impl FnMut(usize, [f64; N]) -> Result<()>,
    ) -> Result<()> {
        self.of_faces(names, run, visit)
    }

    fn of_faces<T: Number, const N: usize>(
        &self,
        names: [&str; N],
        run: &Run,
        visit: impl FnMut(usize, [T; N]) -> Result<()>,
    ) -> Result<()> {
        let wanted = names.map(|name| Some(self.property(ElementKind::Faces, name)?.property));
        self.numbers(self.face, wanted, run, visit)
    }

    fn numbers<T: Number, const N: usize>(
        &self,
        element: usize,
        wanted: [Option<usize>; N],
        run: &Run,
        visit: impl FnMut(usize, [T; N]) -> Result<()>,
    ) -> Result<()> {
        match self.header.encoding {
            Encoding::Ascii => self.walk::<Text, T, N>(element, wanted, run, visit),
            Encoding::Little => self.walk::<Binary<false>, T, N>(element, wanted, run, visit),
            Encoding::Big => self.walk::<Binary<true>, T, N>(element, wanted, run, visit),
        }
    }

    /// Calls `visit(record, numbers)` for every record of `element`, with the values of the properties `wanted`.
    fn walk<'a, C: Cursor<'a>, T: Number, const N: usize>(
        &'a self,
        element: usize,
        wanted: [Option<usize>; N],
        run: &Run,
        mut visit: impl FnMut(usize, [T; N]) -> Result<()>,
    ) -> Result<()> {
        let range = self.ranges[element].clone();
        let element = &self.header.elements[element];
        let mut cursor = C::new(&self.bytes[..range.end], range.start);
        for record in 0..element.count {
            if record % CHUNK == 0 {
                run.cancel.check()?;
            }
            let mut numbers = [T::default(); N];
            for (number, property) in element.properties.iter().enumerate() {
                let place = wanted.iter().position(|&wanted| wanted == Some(number));
                let read = match (place, property.kind) {
                    (Some(k), Kind::One(scalar)) => T::read(&mut cursor, scalar).map(|value| numbers[k] = value),
                    (_, kind) => cursor.skip_value(kind),
                };
                read.map_err(|fault| {
                    let (problem, remedy) = fault.explained(element.count);
                    let place = format!("{} {record}", element.name.escape_debug());
                    Error::malformed(&self.path, place, problem, remedy)
                })?;
            }
            visit(record, numbers)?;
        }
        Ok(())
    }

    /// Copies an element unchanged.
    pub(super) fn copy_element(&self, number: usize, out: &mut Gather, run: &Run) -> Result<()> {
        let range = self.ranges[number].clone();
        for piece in self.bytes[range.clone()].chunks(COPY) {
            run.cancel.check()?;
            out.pass(piece)?;
        }
        if self.is_text() && !range.is_empty() {
            out.buffer.push(b'\n');
        }
        Ok(())
    }

    /// The error for a record of element `number` that could not be copied.
    pub(super) fn changed(&self, number: usize, record: usize, fault: Fault) -> Error {
        let place = format!("{} {record}", self.header.elements[number].name.escape_debug());
        match fault {
            Fault::Length(length) => Error::malformed(
                &self.path,
                place,
                format!("a list of {length} items is too long for the type of its count"),
                "write the mesh in the input's own encoding",
            ),
            Fault::Text(text) => Error::malformed(
                &self.path,
                place,
                format!("{text} does not fit the type of its property"),
                "write the mesh as text",
            ),
            _ => Error::malformed(&self.path, place, "the file changed while it was in use", CUT_SHORT),
        }
    }

    /// The header of a copy of the file in encoding `target`, with `count` records of each element: the properties that
    /// are `kept` (element, property), and after those of an element the ones `added` to it. New comments are put
    /// before the first element, stale ones are dropped. Triangle strips become faces that have only their corners and
    /// what is added; an empty face element beside them is dropped.
    pub(super) fn header_of_copy(
        &self,
        target: Encoding,
        count: impl Fn(usize) -> usize,
        remarks: Remarks<'_>,
        kept: impl Fn(usize, usize) -> bool,
        added: impl Fn(usize) -> Vec<(&'static str, Scalar)>,
    ) -> Vec<u8> {
        let mut out = HeaderWriter::new(target);
        let close = |out: &mut HeaderWriter, element: Option<usize>| {
            for (name, scalar) in element.map(&added).unwrap_or_default() {
                out.property(name, scalar);
            }
        };
        // With strips, the face element is empty; keeping it would give two elements of the same name, which is not
        // valid PLY.
        let is_gone = |element: usize| self.strips && element != self.face && self.header.elements[element].is("face");
        let mut open = None;
        for line in &self.header.lines {
            match *line {
                Line::Element(element) | Line::Property(element, _) if is_gone(element) => {}
                Line::Remark(ref text) if (remarks.stale)(text) => {}
                Line::Remark(ref text) => {
                    out.remark(text);
                }
                Line::Element(number) => {
                    if open.is_none() {
                        remarks.added.iter().for_each(|remark| _ = out.remark(remark));
                    }
                    close(&mut out, open);
                    open = Some(number);
                    let element = &self.header.elements[number];
                    let is_face = number == self.face;
                    let name = if is_face && self.strips { "face" } else { &element.name };
                    out.element(name, count(number) as u64);
                }
                Line::Property(element, number) if element == self.face && self.strips => {
                    if number == self.list {
                        out.corners(Scalar::U8, Scalar::numbering(count(self.vertex) as u64));
                    }
                }
                Line::Property(element, number) if kept(element, number) => {
                    let property = &self.header.elements[element].properties[number];
                    out.property(&property.name, property.kind);
                }
                Line::Property(..) => {}
            }
        }
        close(&mut out, open);
        out.finish()
    }
}

impl NumberProperty<'_> {
    /// Calls `visit(record, number)` for every vertex or face in order. `f64` represents every type of the format
    /// exactly.
    ///
    /// # Errors
    /// Those of `visit`; [`Error::Malformed`] should the file have changed since it was opened; [`Error::Cancelled`].
    pub fn for_each(&self, run: &Run, mut visit: impl FnMut(usize, f64) -> Result<()>) -> Result<()> {
        self.document.numbers(self.element, [Some(self.property)], run, |record, [number]| visit(record, number))
    }
}

/// How the comments of a copy differ.
#[derive(Clone, Copy)]
pub(super) struct Remarks<'a> {
    /// Comments to put before the first element.
    pub added: &'a [Vec<u8>],
    /// Which of the file's comments to drop.
    pub stale: &'a dyn Fn(&[u8]) -> bool,
}

impl Remarks<'_> {
    /// Keeps all comments and adds none.
    pub const NONE: Remarks<'static> = Remarks { added: &[], stale: &|_| false };
}

/// The type that numbers are read as.
trait Number: Copy + Default {
    fn read<'a, C: Cursor<'a>>(cursor: &mut C, of: Scalar) -> Result<Self, Fault>;
}

impl Number for i64 {
    fn read<'a, C: Cursor<'a>>(cursor: &mut C, of: Scalar) -> Result<Self, Fault> {
        if !of.is_real() {
            return cursor.integer(of);
        }
        // NaN means no label, as do negative numbers.
        cursor.real(of).map(|x| if x.is_nan() { -1 } else { x as Self })
    }
}

impl Number for f64 {
    fn read<'a, C: Cursor<'a>>(cursor: &mut C, of: Scalar) -> Result<Self, Fault> {
        cursor.real(of)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{Labelling, PlyForm, open, write_labelled};
    use crate::store::{Budget, Context, WorkDir};

    #[test]
    fn numbers_of_vertices_and_faces_are_read() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.ply");
        let text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
            property double heat\nelement face 1\nproperty list uchar int vertex_indices\nproperty short kind\n\
            end_header\n0 0 0 1.5\n1 0 0 -2\n0 1 0 1e300\n3 0 1 2 -7\n";
        std::fs::write(&path, text).unwrap();
        let run = Run::new(&());
        let mesh = open(&path, dir.path(), &run).unwrap();
        let document = mesh.document().unwrap();
        let read = |of, name| {
            let mut all = Vec::new();
            let property = document.property(of, name).unwrap();
            let push = |k, x| {
                assert_eq!(k, all.len());
                all.push(x);
                Ok(())
            };
            property.for_each(&run, push).unwrap();
            all
        };
        assert_eq!(read(ElementKind::Vertices, "heat"), [1.5, -2., 1e300]);
        assert_eq!(read(ElementKind::Faces, "kind"), [-7.]);
        assert!(document.property(ElementKind::Faces, "vertex_indices").is_none());
        assert!(document.property(ElementKind::Vertices, "kind").is_none());
    }

    const MESH: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
        element face 2\nproperty list uchar int vertex_indices\nproperty float heat\nproperty short kind\nend_header\n\
        0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 2 .5 7\n3 0 2 3 .25 -1\n";

    #[test]
    fn labels_written_into_a_mesh_come_back() {
        let dir = tempfile::tempdir().unwrap();
        let run = Run::new(&());
        let path = dir.path().join("a.ply");
        std::fs::write(&path, MESH).unwrap();
        let mesh = open(&path, dir.path(), &run).unwrap();
        let labelling = Labelling { labels: &[3, 70000], colours: &[], quality: None, names: &[], fine: None };
        for form in [PlyForm::Ascii, PlyForm::Binary] {
            let labelled = dir.path().join("b.ply");
            write_labelled(&mesh, &labelled, &labelling, form, &run).unwrap();
            let again = open(&labelled, dir.path(), &run).unwrap();
            assert_eq!(again.face_property("label", &run).unwrap(), [3, 70000]);
        }
    }

    #[test]
    fn a_word_among_numbers_is_no_end_of_the_file() {
        // Regression: the remedy was to get the whole file.
        let dir = tempfile::tempdir().unwrap();
        let (run, path) = (Run::new(&()), dir.path().join("a.ply"));
        std::fs::write(&path, MESH.replace("-1", "seven")).unwrap();
        let said = open(&path, dir.path(), &run).unwrap().face_property("kind", &run).unwrap_err().to_string();
        assert!(said.contains("face 1: \"seven\" is not a number of the right type; correct the file"), "{said}");
    }

    #[test]
    fn values_of_faces_come_from_the_budget() {
        // Regression: hints needed another 4 bytes per face.
        let dir = tempfile::tempdir().unwrap();
        let run = Run { budget: Budget::new(1 << 20), ..Run::new(&()) };
        let path = dir.path().join("a.ply");
        std::fs::write(&path, MESH.replace("-1", "1")).unwrap();
        let mesh = open(&path, dir.path(), &run).unwrap();
        let work = WorkDir::temporary(dir.path()).unwrap().holding(&run.budget);
        let left = run.budget.left();
        let values = mesh.face_values("kind", Context::new(&work, &run)).unwrap();
        assert_eq!(values[..], [7, 1]);
        assert!(run.budget.left() < left && !work.holds("face_values.tmp"));
        drop(values);
        assert_eq!(run.budget.left(), left);
    }

    #[test]
    fn strips_beside_an_empty_element_of_faces_become_the_only_faces() {
        // Regression: the output had two elements called face, which other programs reject.
        let dir = tempfile::tempdir().unwrap();
        let (run, path, out) = (Run::new(&()), dir.path().join("a.ply"), dir.path().join("b.ply"));
        let list = "property list uchar int vertex_indices\n";
        let (strips, faces) = (format!("element tristrips 1\n{list}"), format!("element face 0\n{list}"));
        for both in [format!("{faces}{strips}"), format!("{strips}{faces}")] {
            let (front, _) = MESH.split_once("element face").unwrap();
            std::fs::write(&path, format!("{front}{both}end_header\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n4 0 1 2 3\n")).unwrap();
            let mesh = open(&path, dir.path(), &run).unwrap();
            let labelling = Labelling { labels: &[3, 7], colours: &[], quality: None, names: &[], fine: None };
            write_labelled(&mesh, &out, &labelling, PlyForm::Same, &run).unwrap();
            let text = std::fs::read_to_string(&out).unwrap();
            assert_eq!((text.matches("element").count(), text.matches("element face 2\n").count()), (2, 1), "{text}");
            assert_eq!(open(&out, dir.path(), &run).unwrap().face_property("label", &run).unwrap(), [3, 7]);
        }
    }

    #[test]
    fn vertices_beyond_the_type_of_their_list_are_refused_in_binary() {
        // Regression: 256 became 0, so the faces of the output were different.
        let dir = tempfile::tempdir().unwrap();
        let (run, path, out) = (Run::new(&()), dir.path().join("a.ply"), dir.path().join("b.ply"));
        let header = MESH.split_once("property float heat").unwrap().0.replace("vertex 4", "vertex 257");
        let header = header.replace("uchar int", "uchar uchar").replace("face 2", "face 1");
        let points: String = (0..257).map(|v| format!("{v} 0 {}\n", v % 2)).collect();
        std::fs::write(&path, format!("{header}end_header\n{points}3 0 255 256\n")).unwrap();
        let mesh = open(&path, dir.path(), &run).unwrap();
        let labelling = Labelling { labels: &[0], colours: &[], quality: None, names: &[], fine: None };
        write_labelled(&mesh, &out, &labelling, PlyForm::Ascii, &run).unwrap();
        let said = write_labelled(&mesh, &out, &labelling, PlyForm::Binary, &run).unwrap_err().to_string();
        assert!(said.contains("face 0: vertex 256 does not fit the type") && said.contains("as text"), "{said}");
    }

    #[test]
    fn labels_of_floating_point_are_read_alike_from_text_and_binary() {
        // Regression: NaN was label 0 in binary files; text with NaN or 1.5 was reported as cut short.
        let dir = tempfile::tempdir().unwrap();
        let (run, path, out) = (Run::new(&()), dir.path().join("a.ply"), dir.path().join("b.ply"));
        for (values, expected) in [("nan -3.5", [[-1, 0], [-3, 0]]), ("1.5 1e30", [[1, 0], [i64::MAX, 0]])] {
            let (first, second) = values.split_once(' ').unwrap();
            let text = MESH.replace(" .5 7", &format!(" {first} 7")).replace(" .25 -1", &format!(" {second} -1"));
            std::fs::write(&path, text).unwrap();
            let mesh = open(&path, dir.path(), &run).unwrap();
            let labelling = Labelling { labels: &[0, 0], colours: &[], quality: None, names: &[], fine: None };
            write_labelled(&mesh, &out, &labelling, PlyForm::Binary, &run).unwrap();
            for path in [&path, &out] {
                let (mesh, mut read) = (open(path, dir.path(), &run).unwrap(), Vec::new());
                let push = |_, numbers: [i64; 2]| {
                    read.push(numbers);
                    Ok(())
                };
                mesh.document().unwrap().for_each_face(["heat", "none"], &run, push).unwrap();
                assert_eq!(read, expected, "{}", path.display());
            }
        }
    }

    #[test]
    fn what_is_no_label_is_said() {
        let dir = tempfile::tempdir().unwrap();
        let run = Run::new(&());
        let path = dir.path().join("a.ply");
        std::fs::write(&path, MESH).unwrap();
        let mesh = open(&path, dir.path(), &run).unwrap();
        let document = mesh.document().unwrap();
        for (name, part) in
            [("label", "no integer property"), ("heat", "no integer property"), ("kind", "face 1: kind is -1")]
        {
            let message = document.face_property(name, &run).unwrap_err().to_string();
            assert!(message.contains(part) && !message.contains('\n'), "{message}");
        }
    }
}
