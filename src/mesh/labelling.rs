//! What is added to each face of the output, and the header that announces it.

use super::document::Document;
use super::header::Line;
use super::model::{Encoding, Kind, Scalar};
use super::output::Gather;
use std::io::Write as _;

/// Labels, colours and qualities of all faces, in file order.
#[derive(Clone, Copy, Debug)]
pub struct Labelling<'a> {
    /// A label a face.
    pub labels: &'a [u32],
    /// A colour (sRGB) a label.
    pub colours: &'a [[u8; 3]],
    /// A quality a face, if there is one.
    pub quality: Option<&'a [f32]>,
}

/// The remark that says where labels come from.
const REMARK: &[u8] = b"comment labelled by nystrom-stream";
/// The colour of labels beyond the last colour.
const GREY: [u8; 3] = [128; 3];

impl Labelling<'_> {
    /// Names and types of the properties added.
    pub(super) fn added(&self) -> &'static [(&'static str, Scalar)] {
        let all: &[_; 5] = &[
            ("label", Scalar::I32),
            ("red", Scalar::U8),
            ("green", Scalar::U8),
            ("blue", Scalar::U8),
            ("quality", Scalar::F32),
        ];
        if self.quality.is_some() { all } else { &all[..4] }
    }

    /// Bytes that a binary face grows by.
    pub(super) fn size(&self) -> usize {
        if self.quality.is_some() { 11 } else { 7 }
    }

    /// The added numbers of `face` as a binary file holds them; the first [`Labelling::size`]
    /// bytes count.
    #[inline]
    pub(super) fn packed(&self, face: usize, big: bool) -> [u8; 11] {
        let label = self.labels[face];
        let colour = self.colours.get(label as usize).copied().unwrap_or(GREY);
        let quality = self.quality.map_or(0.0, |quality| quality[face]);
        let (label, quality) = if big {
            (label.to_be_bytes(), quality.to_be_bytes())
        } else {
            (label.to_le_bytes(), quality.to_le_bytes())
        };
        let mut packed = [0; 11];
        packed[..4].copy_from_slice(&label);
        packed[4..7].copy_from_slice(&colour);
        packed[7..].copy_from_slice(&quality);
        packed
    }

    /// Appends the added numbers of `face`, each after a blank where they are text.
    pub(super) fn append(&self, face: usize, target: Encoding, out: &mut Gather) {
        if target != Encoding::Ascii {
            let packed = self.packed(face, target == Encoding::Big);
            out.buffer.extend_from_slice(&packed[..self.size()]);
            return;
        }
        let label = self.labels[face];
        let colour = self.colours.get(label as usize).copied().unwrap_or(GREY);
        out.decimal(label as i32);
        for part in colour {
            out.buffer.push(b' ');
            out.decimal(part);
        }
        if let Some(quality) = self.quality {
            // Writing into a Vec cannot fail.
            let _ = write!(out.buffer, " {:?}", quality[face]);
        }
    }
}

/// Which properties of the face element stay: all but those that are written anew.
pub(super) fn kept(document: &Document, labelling: &Labelling) -> Vec<bool> {
    let properties = document.header.elements[document.face].properties.iter().enumerate();
    properties
        .map(|(number, property)| {
            number == document.list
                || !document.strips && labelling.added().iter().all(|(name, _)| *name != property.name)
        })
        .collect()
}

/// The vertex property that CloudCompare shows as a scalar field called `label`.
pub(super) const VERTEX_LABEL: &str = "scalar_label";

/// The header of the labelled file, with `faces` faces, and with labels of vertices where `vertex_labels`.
pub(super) fn header(
    document: &Document,
    labelling: &Labelling,
    target: Encoding,
    faces: usize,
    vertex_labels: bool,
) -> Vec<u8> {
    let header = &document.header;
    let vertex = document.vertex().filter(|_| vertex_labels);
    let kept = kept(document, labelling);
    let mut out = format!("ply\nformat {} 1.0\n", target.word()).into_bytes();
    let close = |out: &mut Vec<u8>, element: Option<usize>| {
        if element == Some(document.face) {
            for (name, scalar) in labelling.added() {
                out.extend_from_slice(format!("property {} {name}\n", scalar.word()).as_bytes());
            }
        } else if element.is_some() && element == vertex {
            out.extend_from_slice(format!("property float {VERTEX_LABEL}\n").as_bytes());
        }
    };
    let mut open = None;
    for line in &header.lines {
        match line {
            Line::Remark(text) if text == REMARK => {}
            Line::Remark(text) => {
                out.extend_from_slice(text);
                out.push(b'\n');
            }
            Line::Element(number) => {
                if open.is_none() {
                    out.extend_from_slice(REMARK);
                    out.push(b'\n');
                }
                close(&mut out, open);
                open = Some(*number);
                let element = &header.elements[*number];
                let is_face = *number == document.face;
                let name = if is_face && document.strips { "face" } else { &element.name };
                let count = if is_face { faces } else { element.count };
                out.extend_from_slice(format!("element {name} {count}\n").as_bytes());
            }
            Line::Property(element, number) if *element != document.face || kept[*number] => {
                let property = &header.elements[*element].properties[*number];
                let name = &property.name;
                if vertex == Some(*element) && name == VERTEX_LABEL {
                    continue;
                }
                let text = match property.kind {
                    _ if document.strips && *element == document.face => {
                        "property list uchar int vertex_indices\n".to_owned()
                    }
                    Kind::One(scalar) => format!("property {} {name}\n", scalar.word()),
                    Kind::List { count, item } => format!("property list {} {} {name}\n", count.word(), item.word()),
                };
                out.extend_from_slice(text.as_bytes());
            }
            Line::Property(..) => {}
        }
    }
    close(&mut out, open);
    out.extend_from_slice(b"end_header\n");
    out
}
