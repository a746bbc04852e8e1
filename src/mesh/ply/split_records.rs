//! The records that are added to a labelled file where faces are split: new vertices, and pieces of faces.
//!
//! A new vertex interpolates the vertices that it lies between: the mean of floating-point properties, and the nearest
//! one's value of all others. A piece has all properties of its face; lists with the same number of floating-point
//! values for each corner (`texcoord`) are interpolated like those of vertices. Records are read again in place: 8
//! bytes of memory per vertex next to a new one. Another 100 ns per vertex of the file if its record sizes differ.

use super::document::Document;
use super::element::{Encoding, Kind, Scalar};
use super::values::{Cursor, Encoder, Fault};
use crate::base::{Error, Result};
use crate::mesh::geometry::Mesh;
use crate::mesh::output::Gather;
use crate::mesh::split_faces::{FaceSplit, NewVertex, Piece};
use crate::store::Run;

/// Records between two checks of the stop flag.
const CHUNK: usize = 1 << 14;

/// What the records are made of.
pub(super) struct SplitRecords<'a> {
    pub document: &'a Document,
    pub mesh: &'a Mesh,
    pub split: &'a FaceSplit,
    pub encoder: Encoder,
    pub run: &'a Run<'a>,
}

impl SplitRecords<'_> {
    /// Rejects files whose types cannot hold the added numbers.
    ///
    /// # Errors
    /// [`Error::Unusable`].
    pub fn check(&self) -> Result<()> {
        let (document, elements) = (self.document, &self.document.header.elements);
        let refuse = |problem: String, remedy: &str| Err(Error::unusable(&document.path, problem, remedy));
        let whole = |&axis: &usize| {
            let kind = elements[document.vertex].properties[axis].kind;
            matches!(kind, Kind::One(scalar) if !scalar.is_real())
        };
        if document.axes.iter().any(whole) && !self.split.vertices.is_empty() {
            let problem = "has integer coordinates, which cannot represent new vertices".to_owned();
            return refuse(problem, "write it with coordinates of type float, or leave out `split_faces`");
        }
        let last = self.split.vertex_count() as u64 - 1;
        match elements[document.face].properties[document.list].kind {
            Kind::List { item, .. } if !document.strips && last > item.greatest() => {
                let problem = format!("its faces index vertices by {}, which cannot hold {last}", item.word());
                refuse(problem, "write it with vertex indices of type int, or leave out `split_faces`")
            }
            _ => Ok(()),
        }
    }

    /// Writes the new vertices after those of the file, whose element has `number`.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Cancelled`]; [`Error::Malformed`] should the file have changed since it was opened.
    pub fn vertices<'b, C: Cursor<'b>>(&'b self, number: usize, out: &mut Gather) -> Result<()> {
        let document = self.document;
        let mut sources: Vec<u32> = self.split.vertices.iter().flat_map(|new| new.of).collect();
        sources.sort_unstable();
        sources.dedup();
        let places = self.places::<C>(number, &sources)?;
        let place = |v: u32| sources.binary_search(&v).map_or(usize::MAX, |k| places[k]);
        let bytes = &document.bytes[..document.ranges[number].end];
        let properties = &document.header.elements[number].properties;
        for (k, new) in self.split.vertices.iter().enumerate() {
            if k % CHUNK == 0 {
                self.run.cancel.check()?;
            }
            let mut from = new.of.map(|v| C::new(bytes, place(v)));
            let nearest = new.of.iter().position(|&v| v == new.nearest()).unwrap_or_default();
            for property in properties {
                self.mean(&mut from, *new, nearest, property.kind, &mut out.buffer)
                    .map_err(|fault| document.changed(number, new.of[nearest] as usize, fault))?;
            }
            self.encoder.end(&mut out.buffer);
            out.flush_if_full()?;
        }
        Ok(())
    }

    /// One property of a new vertex, from the records of the vertices that it lies between.
    fn mean<'b, C: Cursor<'b>>(
        &self,
        from: &mut [C; 3],
        new: NewVertex,
        nearest: usize,
        kind: Kind,
        out: &mut Vec<u8>,
    ) -> Result<(), Fault> {
        if let Kind::One(scalar) = kind
            && scalar.is_real()
        {
            let mut values = [0.; 3];
            for (value, cursor) in values.iter_mut().zip(from) {
                *value = cursor.real(scalar)?;
            }
            self.encoder.real(scalar, weighted(values, new.weights), out);
            return Ok(());
        }
        for (k, cursor) in from.iter_mut().enumerate() {
            if k == nearest {
                self.encoder.value(cursor, kind, out)?;
            } else {
                cursor.skip_value(kind)?;
            }
        }
        Ok(())
    }

    /// The offsets of the records of `sources`, ascending.
    fn places<'b, C: Cursor<'b>>(&'b self, number: usize, sources: &[u32]) -> Result<Vec<usize>> {
        let document = self.document;
        let (element, range) = (&document.header.elements[number], document.ranges[number].clone());
        if let Some(size) = element.fixed_size().filter(|_| document.header.encoding != Encoding::Ascii) {
            return Ok(sources.iter().map(|&v| range.start + v as usize * size).collect());
        }
        let mut cursor = C::new(&document.bytes[..range.end], range.start);
        let (mut places, mut record) = (Vec::with_capacity(sources.len()), 0);
        for &v in sources {
            while record < v as usize {
                if record % CHUNK == 0 {
                    self.run.cancel.check()?;
                }
                for property in &element.properties {
                    cursor.skip_value(property.kind).map_err(|fault| document.changed(number, record, fault))?;
                }
                record += 1;
            }
            places.push(cursor.seek());
        }
        Ok(places)
    }

    /// Appends the `kept` properties of a face for `piece` of it; `cursor` stands before its record.
    ///
    /// # Errors
    /// [`Error::Malformed`] should the file have changed since it was opened.
    pub fn piece<'b, C: Cursor<'b>>(
        &self,
        cursor: &mut C,
        piece: &Piece,
        kept: &[bool],
        out: &mut Vec<u8>,
    ) -> Result<()> {
        let document = self.document;
        let properties = &document.header.elements[document.face].properties;
        for (k, (property, &kept)) in properties.iter().zip(kept).enumerate() {
            let moved = match property.kind {
                kind if !kept => cursor.skip_value(kind),
                Kind::List { count, item } if k == document.list => {
                    self.corners(piece, count, item, out);
                    cursor.skip_value(property.kind)
                }
                Kind::List { count, item } if item.is_real() => self.list(cursor, piece, count, item, out),
                kind => self.encoder.value(cursor, kind, out),
            };
            moved.map_err(|fault| document.changed(document.face, piece.face as usize, fault))?;
        }
        Ok(())
    }

    /// Appends the corners of a piece.
    pub fn corners(&self, piece: &Piece, count: Scalar, item: Scalar, out: &mut Vec<u8>) {
        self.encoder.integer(count, 3, out);
        piece.corners.iter().for_each(|&v| self.encoder.scalar(item, v.into(), out));
    }

    /// Writes a list of a face for its piece.
    fn list<'b, C: Cursor<'b>>(
        &self,
        cursor: &mut C,
        piece: &Piece,
        count: Scalar,
        item: Scalar,
        out: &mut Vec<u8>,
    ) -> Result<(), Fault> {
        let length = cursor.length(count)?;
        self.encoder.length(count, length, out)?;
        let mut values = Vec::new();
        for _ in 0..length {
            values.push(cursor.real(item)?);
        }
        let width = values.len() / 3;
        if values.len() % 3 == 0 {
            self.mesh.faces.with(piece.face as usize, |corners| {
                for v in piece.corners {
                    let weights = self.split.weights(self.mesh, corners, v);
                    for j in 0..width {
                        let own = [values[j], values[width + j], values[2 * width + j]];
                        self.encoder.real(item, weighted(own, [weights[0], weights[1], weights[2]]), out);
                    }
                }
            });
        } else {
            values.into_iter().for_each(|value| self.encoder.real(item, value, out));
        }
        Ok(())
    }
}

/// The weighted mean of `values`; a value of weight 0 may be anything, even NaN.
fn weighted(values: [f64; 3], weights: [f64; 3]) -> f64 {
    (0..3).filter(|&k| weights[k] != 0.).map(|k| weights[k] * values[k]).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::ply::ElementKind;
    use crate::mesh::{Labelling, PlyForm, PlyOptions, open, write_labelled};
    use std::path::Path;

    /// A sheet of 8 × 8 squares of two triangles, of any encoding, with all kinds of properties: `heat` is linear,
    /// `texcoord` has positions, `kind` the number of the vertex or the face.
    fn sheet(path: &Path, encoding: Encoding, index: Scalar, coordinate: Scalar) {
        use crate::mesh::ply::HeaderWriter;
        let encoder = Encoder { target: encoding };
        let mut header = HeaderWriter::new(encoding);
        header.element("vertex", 81);
        ["x", "y", "z"].iter().for_each(|axis| _ = header.property(axis, coordinate));
        header.property("heat", Scalar::F64).property("kind", Scalar::U8);
        header.property("near", Kind::List { count: Scalar::U8, item: Scalar::I16 });
        header.element("face", 128).property("kind", Scalar::I16);
        header.property("vertex_indices", Kind::List { count: Scalar::U8, item: index });
        header.property("texcoord", Kind::List { count: Scalar::U8, item: Scalar::F32 });
        header.element("rest", 1).property("number", Scalar::U16);
        let mut out = header.finish();
        let at = |v: i64| [(v % 9) as f64, (v / 9) as f64];
        for v in 0..81 {
            let [x, y] = at(v);
            [x, y, 0.].into_iter().for_each(|x| encoder.scalar(coordinate, x, &mut out));
            encoder.real(Scalar::F64, 2. * x - 3. * y, &mut out);
            encoder.integer(Scalar::U8, v, &mut out);
            encoder.integer(Scalar::U8, v % 2, &mut out);
            (0..v % 2).for_each(|_| encoder.integer(Scalar::I16, v, &mut out));
            encoder.end(&mut out);
        }
        for face in 0..128 {
            let a = face / 2 % 8 + 9 * (face / 16);
            let corners = if face % 2 == 0 { [a, a + 1, a + 10] } else { [a, a + 10, a + 9] };
            encoder.integer(Scalar::I16, face, &mut out);
            encoder.integer(Scalar::U8, 3, &mut out);
            corners.into_iter().for_each(|v| encoder.integer(index, v, &mut out));
            encoder.integer(Scalar::U8, 6, &mut out);
            corners.into_iter().flat_map(at).for_each(|x| encoder.real(Scalar::F32, x, &mut out));
            encoder.end(&mut out);
        }
        encoder.integer(Scalar::U16, 77, &mut out);
        encoder.end(&mut out);
        std::fs::write(path, out).unwrap();
    }

    /// A disc.
    fn labels() -> Vec<u32> {
        (0..128).map(|f| u32::from(((f / 2 % 8) as f64 - 3.5).hypot((f / 16) as f64 - 3.5) < 2.5)).collect()
    }

    #[test]
    fn all_data_of_the_file_are_carried_along() {
        let dir = tempfile::tempdir().unwrap();
        let run = Run::new(&());
        let (labels, quality): (_, Vec<f32>) = (labels(), (0..128).map(|f| f as f32).collect());
        let labelling = Labelling { labels: &labels, colours: &[], quality: Some(&quality), names: &[], fine: None };
        let mut sizes = None;
        for encoding in [Encoding::Ascii, Encoding::Little, Encoding::Big] {
            for form in [PlyForm::Same, PlyForm::Ascii, PlyForm::Binary] {
                let [path, out] = ["in.ply", "out.ply"].map(|name| dir.path().join(name));
                sheet(&path, encoding, Scalar::I32, Scalar::F32);
                let mesh = open(&path, dir.path(), &run).unwrap();
                let options = PlyOptions { split_faces: true, ..form.into() };
                write_labelled(&mesh, &out, &labelling, options, &run).unwrap();
                let again = open(&out, dir.path(), &run).unwrap();
                let size = (again.positions.len(), again.faces.len());
                assert!(size.0 > 90 && size.1 > 150 && *sizes.get_or_insert(size) == size, "{size:?}");
                let document = again.document().unwrap();
                document
                    .property(ElementKind::Vertices, "heat")
                    .unwrap()
                    .for_each(&run, |v, heat| {
                        let [x, y, _] = again.positions.get(v as u32);
                        assert!((heat - (2. * x - 3. * y)).abs() < 1e-5);
                        Ok(())
                    })
                    .unwrap();
                document
                    .property(ElementKind::Vertices, "kind")
                    .unwrap()
                    .for_each(&run, |v, kind| {
                        let ([x, y, _], kind) = (again.positions.get(v as u32), kind as u32);
                        let near = (x - f64::from(kind % 9)).hypot(y - f64::from(kind / 9));
                        assert!(near <= 0.5_f64.hypot(0.5) + 1e-6);
                        Ok(())
                    })
                    .unwrap();
                let mut faces = Vec::new();
                again.faces.for_each(0..size.1, |_, corners| faces.push(corners.to_vec()));
                let parents = again.document().unwrap();
                parents
                    .for_each_face(["kind", "label"], &run, |face, [parent, label]| {
                        assert!(face >= 128 || parent == face as i64);
                        let (x, y) = (parent / 2 % 8, parent / 16);
                        for &v in &faces[face] {
                            let [px, py, _] = again.positions.get(v);
                            assert!(
                                (x as f64..=x as f64 + 1.).contains(&px) && (y as f64..=y as f64 + 1.).contains(&py)
                            );
                        }
                        assert!((0..2).contains(&label));
                        Ok(())
                    })
                    .unwrap();
                let told = std::fs::read(&out).unwrap();
                if form == PlyForm::Ascii {
                    // Texture coordinates equal positions, also on pieces; elements that no face refers to are kept.
                    let text = String::from_utf8(told).unwrap();
                    let body: Vec<&str> = text.split("end_header\n").nth(1).unwrap().lines().collect();
                    assert_eq!(*body.last().unwrap(), "77");
                    for (line, corners) in body[size.0..].iter().zip(&faces) {
                        let words: Vec<f64> = line.split(' ').map(|word| word.parse().unwrap()).collect();
                        for (k, &v) in corners.iter().enumerate() {
                            let [x, y, _] = again.positions.get(v);
                            assert!((words[6 + 2 * k] - x).abs() + (words[7 + 2 * k] - y).abs() < 1e-5, "{line}");
                        }
                        assert_eq!(words[words.len() - 1], words[0], "the quality of the face it came from");
                    }
                }
            }
        }
    }

    #[test]
    fn types_without_room_for_new_vertices_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let run = Run::new(&());
        // Stripes create more new vertices.
        let labels: Vec<u32> = (0..128).map(|f| (f / 2 % 8 + f / 16 * 2) / 5).collect();
        let labelling = Labelling { labels: &labels, colours: &[], quality: None, names: &[], fine: None };
        let path = dir.path().join("a.ply");
        for (index, coordinate, part) in [
            (Scalar::I8, Scalar::F32, "its faces index vertices by char, which cannot hold"),
            (Scalar::I32, Scalar::I16, "integer coordinates"),
            (Scalar::I32, Scalar::U16, "integer coordinates"),
        ] {
            sheet(&path, Encoding::Little, index, coordinate);
            if coordinate == Scalar::U16 {
                // Regression: integer coordinates were accepted if they were named X, Y and Z.
                let mut bytes = std::fs::read(&path).unwrap();
                for k in 0..3 {
                    let line = [&b"property ushort "[..], &b"xyz"[k..=k], b"\n"].concat();
                    let at = bytes.windows(line.len()).position(|window| window == line).unwrap() + line.len() - 2;
                    bytes[at].make_ascii_uppercase();
                }
                std::fs::write(&path, bytes).unwrap();
            }
            let mesh = open(&path, dir.path(), &run).unwrap();
            let write =
                |options: PlyOptions| write_labelled(&mesh, &dir.path().join("b.ply"), &labelling, options, &run);
            let split = PlyOptions { split_faces: true, ..PlyOptions::default() };
            let message = write(split).unwrap_err().to_string();
            assert!(message.contains(part) && !message.contains('\n'), "{message}");
            let both = write(PlyOptions { split_vertices: true, ..split }).unwrap_err().to_string();
            assert!(both.contains("choose one of them"), "{both}");
        }
    }
}
