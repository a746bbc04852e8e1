//! Edits as plain data.
//!
//! The JSON form is derived; [`super::read`] reads it edit by edit, so that errors name the edit. Cost: none.

use crate::base::printable::Significant;
use serde::de::{Deserializer, Error};
use serde::{Deserialize, Serialize};
use serde_json::Number;
use std::path::PathBuf;

/// A place on the surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Place {
    /// A face of the file, from 0.
    Face(#[serde(deserialize_with = "whole")] u64),
    /// A point in units of the file; it denotes the face nearest to it.
    Point([f64; 3]),
}

/// An sRGB colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Colour(pub [u8; 3]);

/// One correction. A part is identified by any place on it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "edit", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Edit {
    /// Joins the parts at these places into one.
    Merge {
        /// Two places or more.
        at: Vec<Place>,
    },
    /// Divides the part at this place along the hierarchy.
    Split {
        /// A place on it.
        at: Place,
        /// Number of pieces, 2 by default.
        #[serde(default = "two", deserialize_with = "whole")]
        into: usize,
    },
    /// Cuts the part that contains both places between them.
    Cut {
        /// One place on either side of the cut.
        between: [Place; 2],
    },
    /// Hint: these places belong to the same part.
    Together {
        /// Two places or more.
        at: Vec<Place>,
    },
    /// Hint: no two of these places belong to the same part.
    Apart {
        /// Two places or more.
        at: Vec<Place>,
    },
    /// Names the part at this place.
    Name {
        /// A place on it.
        at: Place,
        /// Its name: one line of text. Empty: no name.
        name: String,
    },
    /// Colours the part at this place.
    Colour {
        /// A place on it.
        at: Place,
        /// The colour, as `"#e69f00"`.
        colour: Colour,
    },
    /// Drops the part at this place: all dropped parts together get the last label.
    Drop {
        /// A place on it.
        at: Place,
    },
    /// Protects the part at this place from hints and later edits.
    Protect {
        /// A place on it.
        at: Place,
    },
}

fn two() -> usize {
    2
}

/// A whole number, which some languages write as 3.0.
pub(super) fn whole<'de, D: Deserializer<'de>, T: TryFrom<u64>>(from: D) -> Result<T, D::Error> {
    let number = Number::deserialize(from)?;
    let real = number.as_f64().filter(|x| x.fract() == 0. && (0. ..=f64::from(u32::MAX)).contains(x));
    let whole = number.as_u64().or(real.map(|x| x as u64)).and_then(|number| number.try_into().ok());
    whole.ok_or_else(|| D::Error::custom(format!("{number} is not a whole number, 0 or more")))
}

/// The edits of one mesh.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Edits {
    /// The file that they were read from, for messages; empty if there is none.
    #[serde(skip)]
    pub path: PathBuf,
    /// Number of parts before the edits; if not given, the number found.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub parts: Option<usize>,
    /// Detail before the edits, −1 to 1, unless it is 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub detail: Option<f64>,
    /// Least and greatest corner of the mesh on which the places lie. On a mesh in other units, places are scaled
    /// accordingly.
    #[serde(rename = "box", skip_serializing_if = "Option::is_none")]
    pub bounds: Option<[[f64; 3]; 2]>,
    /// The edits. Hints are applied first wherever they stand; the others follow in this order.
    pub edits: Vec<Edit>,
}

impl Edit {
    /// Its kind, as written in the file.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Merge { .. } => "merge",
            Self::Split { .. } => "split",
            Self::Cut { .. } => "cut",
            Self::Together { .. } => "together",
            Self::Apart { .. } => "apart",
            Self::Name { .. } => "name",
            Self::Colour { .. } => "colour",
            Self::Drop { .. } => "drop",
            Self::Protect { .. } => "protect",
        }
    }

    /// All its places, in order.
    pub fn places(&self) -> &[Place] {
        match self {
            Self::Merge { at } | Self::Together { at } | Self::Apart { at } => at,
            Self::Cut { between } => between,
            Self::Split { at, .. } | Self::Name { at, .. } | Self::Colour { at, .. } => std::slice::from_ref(at),
            Self::Drop { at } | Self::Protect { at } => std::slice::from_ref(at),
        }
    }

    /// The same, to change them.
    pub(super) fn places_mut(&mut self) -> &mut [Place] {
        match self {
            Self::Merge { at } | Self::Together { at } | Self::Apart { at } => at,
            Self::Cut { between } => between,
            Self::Split { at, .. } | Self::Name { at, .. } | Self::Colour { at, .. } => std::slice::from_mut(at),
            Self::Drop { at } | Self::Protect { at } => std::slice::from_mut(at),
        }
    }

    /// Whether it leaves the extent of all parts as it is: names, colours, drops or protects one.
    pub fn is_mark(&self) -> bool {
        matches!(self, Self::Name { .. } | Self::Colour { .. } | Self::Drop { .. } | Self::Protect { .. })
    }

    /// Whether it is a hint, which enters the decision on parts.
    pub fn is_hint(&self) -> bool {
        matches!(self, Self::Together { .. } | Self::Apart { .. })
    }
}

impl Edits {
    /// Whether some of them protect parts: those of the cut that the edits state.
    pub fn protects(&self) -> bool {
        self.edits.iter().any(|edit| matches!(edit, Edit::Protect { .. }))
    }
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Self::Face(face) => write!(f, "face {face}"),
            Self::Point(point) => {
                let [x, y, z] = point.map(Significant);
                write!(f, "[{x}, {y}, {z}]")
            }
        }
    }
}

impl TryFrom<String> for Colour {
    type Error = String;
    fn try_from(text: String) -> Result<Self, String> {
        let digits =
            text.strip_prefix('#').filter(|digits| digits.len() == 6 && digits.bytes().all(|c| c.is_ascii_hexdigit()));
        let byte = |k: usize| u8::from_str_radix(digits?.get(2 * k..2 * k + 2)?, 16).ok();
        match (byte(0), byte(1), byte(2)) {
            (Some(r), Some(g), Some(b)) => Ok(Self([r, g, b])),
            _ => Err(format!("{text:?} is not a colour; write it as \"#e69f00\"")),
        }
    }
}

impl From<Colour> for String {
    fn from(Colour([r, g, b]): Colour) -> String {
        format!("#{r:02x}{g:02x}{b:02x}")
    }
}
