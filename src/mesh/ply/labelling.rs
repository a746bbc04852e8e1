//! Labels, colours and qualities of faces as a PLY holds them, and the options of a labelled file.
//!
//! A binary face grows by 7 bytes, or 11 with a quality; nothing is stored besides the caller's arrays.

use super::document::{Document, Remarks};
use super::element::{Encoding, Scalar};
use super::names;
use super::values::Encoder;
use crate::base::{Error, Result};
use crate::mesh::geometry::{Mesh, one_per_face};
use crate::mesh::split_faces::{FaceSplit, FineLabels};
use crate::store::Run;

/// The encoding of a labelled file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PlyForm {
    /// The input's; kept text stays verbatim.
    #[default]
    Same,
    /// Little-endian.
    Binary,
    /// Text; floating-point numbers in the shortest form that reads back exactly.
    Ascii,
}

/// Options of a labelled file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct PlyOptions {
    /// Its encoding.
    pub form: PlyForm,
    /// Whether each vertex gets the label of most faces around it, as `float scalar_label` (-1 without faces), and its
    /// colour, replacing existing properties: for programs that do not read face properties.
    pub vertex_labels: bool,
    /// Whether parts share no vertex, and vertices have labels and colours; properties of the input are then dropped.
    pub split_vertices: bool,
    /// Whether faces are split where smooth boundaries cross them ([`crate::mesh::split_faces`]), instead of boundaries
    /// along edges. Cannot be combined with the others.
    pub split_faces: bool,
}

impl From<PlyForm> for PlyOptions {
    fn from(form: PlyForm) -> Self {
        Self { form, ..Self::default() }
    }
}

impl PlyForm {
    /// The encoding of an output whose input has the encoding `input`.
    pub(super) fn encoding(self, input: Encoding) -> Encoding {
        match self {
            Self::Same => input,
            Self::Binary => Encoding::Little,
            Self::Ascii => Encoding::Ascii,
        }
    }
}

/// The label of a face that has none.
pub const UNLABELLED: u32 = u32::MAX;

/// Labels, colours and qualities of all faces, in file order.
#[derive(Clone, Copy, Debug)]
pub struct Labelling<'a> {
    /// One label per face.
    pub labels: &'a [u32],
    /// One colour (sRGB) per label; grey for labels beyond the last, except as in [`colour_of`].
    pub colours: &'a [[u8; 3]],
    /// One quality per face, optional.
    pub quality: Option<&'a [f32]>,
    /// One name per label, empty for none; may be shorter than the labels, or empty as a whole.
    pub names: &'a [String],
    /// Labels on the mesh's refinement, if its parts were decided there: where boundaries lie if faces are split.
    pub fine: Option<&'a FineLabels>,
}

/// The comment that names the program.
const REMARK: &[u8] = b"comment labelled by nystrom-stream";
/// The colour of what has none of its own: labels beyond the colours, faces without a match, parts that were dropped.
pub const GREY: [u8; 3] = [128; 3];
/// Greater labels take as many colours in turn: there need not be one for each number up to a label in the billions.
pub const REPEATED: usize = 1 << 16;

/// The colour of `label` among `colours`, one per label. If there are [`REPEATED`], greater labels take them in turn;
/// otherwise they are grey, as are faces without a label.
#[inline]
pub fn colour_of(colours: &[[u8; 3]], label: u32) -> [u8; 3] {
    let place = label as usize;
    let place = if colours.len() == REPEATED && label != UNLABELLED { place % REPEATED } else { place };
    colours.get(place).copied().unwrap_or(GREY)
}

impl<'a> Labelling<'a> {
    /// Labels alone, one per face: without qualities and names, and grey where a format has colours.
    pub fn of(labels: &'a [u32]) -> Self {
        Self { labels, colours: &[], quality: None, names: &[], fine: None }
    }
}

impl Labelling<'_> {
    /// The split faces of `mesh`.
    ///
    /// # Errors
    /// As [`FaceSplit::of`].
    pub(super) fn split(&self, mesh: &Mesh, run: &Run) -> Result<FaceSplit> {
        match self.fine {
            Some(fine) => FaceSplit::of_refined(mesh, self.labels, fine, run),
            None => FaceSplit::of(mesh, self.labels, run),
        }
    }

    /// The name of `label`, if it has one.
    pub fn name(&self, label: usize) -> Option<&str> {
        self.names.get(label).map(String::as_str).filter(|name| !name.is_empty())
    }

    /// Rejects labels and qualities unless there is one for each of `faces` faces.
    pub(crate) fn fit(&self, faces: usize) -> Result<()> {
        one_per_face("labels", self.labels.len(), faces)?;
        one_per_face("quality", self.quality.map_or(faces, <[f32]>::len), faces)
    }

    /// Rejects labels that a PLY cannot hold: those of faces are an `int`, which every reader knows; those of vertices
    /// are a `float`, which CloudCompare displays and which is exact up to 2²⁴.
    pub(super) fn fit_ply(&self, of_vertices: bool) -> Result<()> {
        let most = if of_vertices { 1 << 24 } else { i32::MAX as u32 };
        let label = self.labels.iter().fold(0, |top, &label| top.max(label));
        if label > most {
            let problem = format!("{label} exceeds {most}, the largest label that such a file can hold");
            return Err(Error::parameter("labels", problem, "number the parts from 0, or write a .npy or .seg"));
        }
        Ok(())
    }

    /// The colour of `face`: its label's, or grey.
    pub(crate) fn colour(&self, face: usize) -> [u8; 3] {
        self.colour_of(Some(self.labels[face]))
    }

    /// The colour of `label`; grey without one.
    pub(super) fn colour_of(&self, label: Option<u32>) -> [u8; 3] {
        colour_of(self.colours, label.unwrap_or(UNLABELLED))
    }

    /// Appends the numbers of [`VERTEX_PROPERTIES`] of a vertex with `label`.
    pub(super) fn append_vertex(&self, label: Option<u32>, encoder: Encoder, out: &mut Vec<u8>) {
        encoder.real(Scalar::F32, label.map_or(-1., f64::from), out);
        for part in self.colour_of(label) {
            encoder.integer(Scalar::U8, part.into(), out);
        }
    }

    /// Names and types of the properties that a face gets.
    pub(crate) fn properties(&self) -> &'static [(&'static str, Scalar)] {
        let all: &[_; 5] = &[
            ("label", Scalar::I32),
            ("red", Scalar::U8),
            ("green", Scalar::U8),
            ("blue", Scalar::U8),
            ("quality", Scalar::F32),
        ];
        if self.quality.is_some() { all } else { &all[..4] }
    }

    /// Bytes added to a binary face.
    pub(super) fn size(&self) -> usize {
        if self.quality.is_some() { 11 } else { 7 }
    }

    /// The added numbers of `face` in binary; only the first [`Labelling::size`] bytes are used.
    #[inline]
    pub(super) fn packed(&self, face: usize, big: bool) -> [u8; 11] {
        let (label, colour) = (self.labels[face], self.colour(face));
        let quality = self.quality.map_or(0.0, |quality| quality[face]);
        let (label, quality) = if big {
            (label.to_be_bytes(), quality.to_be_bytes())
        } else {
            (label.to_le_bytes(), quality.to_le_bytes())
        };
        let ([a, b, c, d], [red, green, blue], [e, f, g, h]) = (label, colour, quality);
        [a, b, c, d, red, green, blue, e, f, g, h]
    }

    /// Appends the numbers of [`Labelling::properties`] of `face`.
    pub(crate) fn append(&self, face: usize, encoder: Encoder, out: &mut Vec<u8>) {
        self.append_piece(face, self.labels[face], encoder, out);
    }

    /// The same for a piece of `face` that has `label`.
    pub(super) fn append_piece(&self, face: usize, label: u32, encoder: Encoder, out: &mut Vec<u8>) {
        self.append_values(label, |quality| quality[face], encoder, out);
    }

    /// Appends the numbers of [`Labelling::properties`] for a face that the mesh does not have, with `label` and no
    /// quality.
    pub(crate) fn append_added(&self, label: u32, encoder: Encoder, out: &mut Vec<u8>) {
        self.append_values(label, |_| 0., encoder, out);
    }

    fn append_values(&self, label: u32, of_face: impl Fn(&[f32]) -> f32, encoder: Encoder, out: &mut Vec<u8>) {
        encoder.integer(Scalar::I32, i64::from(label as i32), out);
        for part in self.colour_of(Some(label)) {
            encoder.integer(Scalar::U8, part.into(), out);
        }
        if let Some(quality) = self.quality {
            encoder.real(Scalar::F32, of_face(quality).into(), out);
        }
    }

    /// The header of the labelled file; `split` has the split faces.
    pub(super) fn header(
        &self,
        document: &Document,
        mesh: &Mesh,
        options: PlyOptions,
        split: Option<&FaceSplit>,
    ) -> Vec<u8> {
        let votes = |element: usize| options.vertex_labels && element == document.vertex;
        let faces = kept_properties(document, self);
        let stays = |element: usize, property: usize| match element {
            _ if element == document.face => faces[property],
            _ => !votes(element) || !of_vertices(&document.header.elements[element].properties[property].name),
        };
        let added = |element: usize| match element {
            _ if element == document.face => self.properties().to_vec(),
            _ if votes(element) => VERTEX_PROPERTIES.to_vec(),
            _ => Vec::new(),
        };
        let target = options.form.encoding(document.header.encoding);
        let mut remarks = vec![REMARK.to_vec()];
        remarks.extend(names::remarks(self.names));
        let stale = |remark: &[u8]| remark == REMARK || names::part_name(remark).is_some();
        let faces = mesh.faces.len();
        let count = |element: usize| match split {
            Some(split) if element == document.vertex => split.vertex_count(),
            Some(split) if element == document.face => split.face_count(faces),
            _ => document.count(element, faces),
        };
        document.header_of_copy(target, count, Remarks { added: &remarks, stale: &stale }, stays, added)
    }
}

/// Which properties of the face element are kept: all but those that are replaced.
pub(super) fn kept_properties(document: &Document, labelling: &Labelling) -> Vec<bool> {
    let properties = document.header.elements[document.face].properties.iter().enumerate();
    properties
        .map(|(number, property)| {
            number == document.list
                || !document.strips && labelling.properties().iter().all(|(name, _)| *name != property.name)
        })
        .collect()
}

/// The properties that a vertex gets: CloudCompare displays the first as a scalar field called `label`.
pub(super) const VERTEX_PROPERTIES: [(&str, Scalar); 4] =
    [("scalar_label", Scalar::F32), ("red", Scalar::U8), ("green", Scalar::U8), ("blue", Scalar::U8)];

/// Whether `name` is one of [`VERTEX_PROPERTIES`].
pub(super) fn of_vertices(name: &str) -> bool {
    VERTEX_PROPERTIES.iter().any(|(own, _)| *own == name)
}
