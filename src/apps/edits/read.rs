//! Reading and writing files of edits: every error names the wrong edit and the remedy.

use super::data::{Edit, Edits, Place, whole};
use crate::base::{Error, Result};
use crate::store::json;
use serde::Deserialize;
use serde::de::IgnoredAny;
use serde_json::Value;
use serde_json::value::RawValue;
use std::path::Path;

/// The `format` field of the files.
pub const FORMAT: &str = "nystrom-stream edits";
/// Version of the format.
pub const VERSION: u64 = 1;
/// Maximum number of places per edit: more than there are cells.
const PLACES: usize = 4096;
/// Maximum number of bytes of a name.
const NAME: usize = 200;

/// The file without its edits, which are read one by one.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, expecting = "an object with format, version and edits")]
struct Head {
    format: String,
    #[serde(deserialize_with = "whole")]
    version: u64,
    #[serde(default)]
    parts: Option<Count>,
    #[serde(default)]
    detail: Option<f64>,
    #[serde(default, rename = "box")]
    bounds: Option<[[f64; 3]; 2]>,
    /// For people only.
    #[serde(default, rename = "mesh")]
    _mesh: IgnoredAny,
    // As text: a table of fields would keep the last of two of a name.
    edits: Vec<Box<RawValue>>,
}

#[derive(Deserialize)]
struct Count(#[serde(deserialize_with = "whole")] usize);

impl Edits {
    /// Reads the file `path`.
    ///
    /// # Errors
    /// [`Error::Io`]; as [`Edits::of_text`].
    pub fn read(path: &Path) -> Result<Self> {
        let text = json::read_small(path)?;
        Self::of_text(&text, path)
    }

    /// Parses the edits in `text`, the content of `path`.
    ///
    /// ```
    /// use nystrom_stream::apps::edits::Edits;
    /// let text = r#"{"format": "nystrom-stream edits", "version": 1, "edits": [{"edit": "split", "at": 17}]}"#;
    /// let edits = Edits::of_text(text.as_bytes(), "edits.json".as_ref())?;
    /// assert_eq!(edits.edits[0].kind(), "split");
    /// let wrong = text.replace("17", "[1, 2]");
    /// let error = Edits::of_text(wrong.as_bytes(), "edits.json".as_ref()).unwrap_err();
    /// assert!(error.to_string().starts_with("edits.json: edit 1 (split): "));
    /// # Ok::<(), nystrom_stream::base::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Malformed`] naming the edit; [`Error::Unusable`] for what concerns no single edit.
    pub fn of_text(text: &[u8], path: &Path) -> Result<Self> {
        let form = "see docs/edits.md for the format";
        // Some editors begin each file with a byte order mark.
        let text = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(text);
        if text.trim_ascii().is_empty() {
            return Err(Error::unusable(path, "is empty", form));
        }
        // Derived code takes a list for the fields of the head, one after the other, and its message confuses.
        if text.trim_ascii_start().starts_with(b"[") {
            let remedy = format!(r#"write {{"format": "{FORMAT}", "version": {VERSION}, "edits": […]}} around it"#);
            return Err(Error::unusable(path, "is a bare list", remedy));
        }
        let head: Head = serde_json::from_slice(text)
            .map_err(|error| Error::unusable(path, format!("is not a list of edits: {error}"), form))?;
        if head.format != FORMAT || head.version != VERSION {
            let problem = format!("format {:?}, version {}, is not supported", head.format, head.version);
            let remedy = format!("give a file whose format is {FORMAT:?} and whose version is {VERSION}");
            return Err(Error::unusable(path, problem, remedy));
        }
        let mut edits = Self {
            path: path.into(),
            parts: head.parts.map(|Count(parts)| parts),
            detail: head.detail,
            bounds: head.bounds,
            edits: Vec::with_capacity(head.edits.len()),
        };
        for (number, value) in head.edits.iter().enumerate() {
            let value = value.get();
            let fields: Value = serde_json::from_str(value).unwrap_or_default();
            let kind = fields["edit"].as_str().map(|kind| format!(" ({kind})")).unwrap_or_default();
            let wrong = |problem: &str| Error::malformed(path, format!("edit {}{kind}", number + 1), problem, form);
            // Derived code takes a list for the fields here too.
            if !value.starts_with('{') {
                return Err(wrong(r#"is not an object, such as {"edit": "drop", "at": 17}"#));
            }
            let edit = serde_json::from_str(value).map_err(|error| {
                let text = error.to_string();
                // The line is one of this edit, not of the file.
                let text = text.rsplit_once(" at line ").map_or(&text[..], |(text, _)| text);
                let places = text.contains("untagged enum Place");
                let text = text.replace("expected a sequence", "expected a list");
                wrong(if places { "a place is neither [x, y, z] nor the number of a face" } else { &text })
            })?;
            edits.edits.push(edit);
        }
        edits.check()?;
        Ok(edits)
    }

    /// Rejects edits that are invalid for any mesh.
    ///
    /// # Errors
    /// As [`Edits::of_text`].
    pub fn check(&self) -> Result<()> {
        let wrong = |problem: &str, remedy: &str| Err(Error::unusable(self.name(), problem, remedy));
        if self.parts.is_some() && self.detail.is_some() {
            return wrong("has both parts and detail", "keep one of them");
        }
        if self.parts == Some(0) {
            return wrong("starts from 0 parts", "give at least 1");
        }
        if self.detail.is_some_and(|detail| !(-1. ..=1.).contains(&detail)) {
            return wrong("its detail is not between -1 and 1", "correct it");
        }
        if self.bounds.is_some_and(|[low, high]| !(0..3).all(|k| low[k] <= high[k] && (high[k] - low[k]).is_finite())) {
            return wrong("its box is not a minimum and a maximum corner", "correct it or leave it out");
        }
        for (number, edit) in self.edits.iter().enumerate() {
            let wrong = |problem: &str, remedy: &str| Err(self.wrong(number, problem, remedy));
            let finite = |place: &Place| !matches!(place, Place::Point(p) if !p.iter().all(|x| x.is_finite()));
            if !edit.places().iter().all(finite) {
                return wrong("a coordinate is not a number", "give three finite numbers");
            }
            match edit {
                Edit::Merge { at } | Edit::Together { at } | Edit::Apart { at } if at.len() < 2 => {
                    return wrong("has fewer than two places", "give two or more");
                }
                Edit::Merge { at } | Edit::Together { at } | Edit::Apart { at } if at.len() > PLACES => {
                    return wrong("has more than 4096 places", "give one or two on each part");
                }
                Edit::Split { into: 0 | 1, .. } => return wrong("into fewer than 2 pieces", "give 2 or more"),
                Edit::Name { name, .. } if name.chars().any(char::is_control) || name.len() > NAME => {
                    return wrong("the name has a control character or is too long", "give one short line of text");
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// The error for edit `number`, counted from 0.
    pub fn wrong(&self, number: usize, problem: impl Into<String>, remedy: impl Into<String>) -> Error {
        let kind = self.edits.get(number).map_or("", Edit::kind);
        Error::malformed(self.name(), format!("edit {} ({kind})", number + 1), problem, remedy)
    }

    /// The file that they were read from; a stand-in for those that a program made.
    fn name(&self) -> &Path {
        if self.path.as_os_str().is_empty() { Path::new("<edits>") } else { &self.path }
    }

    /// The file's text.
    ///
    /// # Errors
    /// [`Error::Internal`] for values that JSON cannot represent.
    pub fn text(&self) -> Result<String> {
        let mut value = json::value("the edits", self)?;
        if let Some(map) = value.as_object_mut() {
            map.insert("format".into(), FORMAT.into());
            map.insert("version".into(), VERSION.into());
        }
        Ok(format!("{value:#}\n"))
    }

    /// Writes the file `path`, by rename.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn write(&self, path: &Path) -> Result<()> {
        json::publish(path, self.text()?.as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::super::data::Colour;
    use super::*;

    fn error(edits: &str) -> String {
        let text = format!(r#"{{"format": "nystrom-stream edits", "version": 1, "edits": [{edits}]}}"#);
        Edits::of_text(text.as_bytes(), Path::new("e.json")).unwrap_err().to_string()
    }

    #[test]
    fn what_is_written_is_read_again() {
        let at = Place::Point([1., -2.5, 3e-9]);
        let edits = Edits {
            path: "e.json".into(),
            parts: Some(9),
            bounds: Some([[0.; 3], [1.; 3]]),
            edits: vec![
                Edit::Merge { at: vec![at, Place::Face(7)] },
                Edit::Split { at, into: 3 },
                Edit::Cut { between: [at, Place::Face(0)] },
                Edit::Together { at: vec![at, at] },
                Edit::Apart { at: vec![at, at, at] },
                Edit::Name { at, name: "left \"arm\"".into() },
                Edit::Colour { at, colour: Colour([1, 171, 255]) },
                Edit::Drop { at },
                Edit::Protect { at },
            ],
            ..Edits::default()
        };
        assert_eq!(Edits::of_text(edits.text().unwrap().as_bytes(), Path::new("e.json")).unwrap(), edits);
    }

    #[test]
    fn errors_name_the_edit_and_the_remedy() {
        for (edits, part) in [
            (
                r#"{"edit": "split", "at": 1}, {"edit": "merge", "at": [[1, 2, 3]]}"#,
                "edit 2 (merge): has fewer than two",
            ),
            (r#"{"edit": "split", "at": [1, 2]}"#, "edit 1 (split): a place is neither [x, y, z] nor"),
            (r#"{"edit": "split", "at": 1, "into": 1}"#, "edit 1 (split): into fewer than 2"),
            (r#"{"edit": "split", "at": 1, "in": 1}"#, "edit 1 (split): unknown field `in`"),
            (r#"{"edit": "paint", "at": 1}"#, "edit 1 (paint): unknown variant `paint`"),
            (r##"{"edit": "colour", "at": 1, "colour": "#12345"}"##, "is not a colour; write it as"),
            (r#"{"edit": "name", "at": 1, "name": "a\nb"}"#, "edit 1 (name): the name has a control character"),
            (r#"{"edit": "cut", "between": [1, 2, 3]}"#, "edit 1 (cut): "),
            ("17", "edit 1: is not an object, such as {"),
            // Regression: a list was taken for the fields.
            (r#"["drop", 5]"#, "edit 1: is not an object, such as {"),
            // Regression: the last of two fields of a name was taken in silence.
            (r#"{"edit": "drop", "at": 1, "at": 2}"#, "edit 1 (drop): duplicate field `at`"),
            (r#"{"edit": "drop", "at": 1, "edit": "protect"}"#, "duplicate field `edit`"),
            (r#"{"edit": "drop", "at": [1e999, 0, 0]}"#, "edit 1: number out of range; "),
            (r#"{"edit": "drop", "at": 1.5}"#, "edit 1 (drop): a place is neither"),
            (r#"{"edit": "split", "at": 1, "into": 2.5}"#, "(split): 2.5 is not a whole number, 0 or more; "),
            (r#"{"edit": "split", "at": 1, "into": -1}"#, "(split): -1 is not a whole number, 0 or more; "),
            (r#"{"edit": "split", "at": 1, "into": "3"}"#, "invalid type: string \"3\", expected a JSON number; "),
            // Regression: signs were taken for digits.
            (r##"{"edit": "colour", "at": 1, "colour": "#+1+2+3"}"##, "is not a colour; write it as"),
        ] {
            let error = error(edits);
            assert!(error.starts_with("e.json: ") && error.contains(part) && error.contains("; "), "{error}");
        }
    }

    /// Regression: what some editors and languages write was refused: a byte order mark, and 3.0 for 3.
    #[test]
    fn other_programs_write_whole_numbers_and_marks_their_own_way() {
        let text = |three: &str, face: &str| {
            let edits = format!(r#"[{{"into": {three}, "at": {face}, "edit": "split"}}]"#);
            format!(r#"{{"edits": {edits}, "parts": {three}, "version": 1, "format": "nystrom-stream edits"}}"#)
        };
        let read = |text: &str| Edits::of_text(text.as_bytes(), Path::new("e.json")).unwrap();
        let expected = read(&text("3", "170"));
        for (three, face) in [("3.0", "170.0"), ("3e0", "1.7e2")] {
            assert_eq!(read(&text(three, face).replace(": 1,", ": 1.0,")), expected);
        }
        assert_eq!(read(&format!("\u{feff}{}", text("3", "170").replace(", ", ",\r\n"))), expected);
        let error = Edits::of_text("\u{feff}[]".as_bytes(), Path::new("e.json")).unwrap_err().to_string();
        assert!(error.contains("is a bare list"), "{error}");
    }

    /// Regression: without a file the message began with "edits: edits: ".
    #[test]
    fn errors_about_all_edits_name_them_once() {
        let head = |more: &str| format!(r#"{{"format": "nystrom-stream edits", "version": 1, {more}, "edits": []}}"#);
        for (text, told) in [
            (String::new(), "is empty; see docs/edits.md"),
            ("{".into(), "is not a list of edits: EOF"),
            // Regression: "is not a list of edits: invalid type: map, expected a string" was said of a list of edits.
            (r#" [{"edit": "split", "at": 0}]"#.into(), "is a bare list; write {\"format\": \"nystrom-stream edits\""),
            ("[]".into(), "is a bare list"),
            // Regression: the message said "expected struct Head".
            ("3".into(), "is not a list of edits: invalid type: integer `3`, expected an object with format, version"),
            (head(r#""parts": -1"#), "is not a list of edits: -1 is not a whole number, 0 or more at line 1"),
            ("{}".into(), "is not a list of edits: missing field `format`"),
            (
                r#"{"format": "x", "version": 1, "edits": []}"#.into(),
                r#"format "x", version 1, is not supported; give"#,
            ),
            (head(r#""parts": 2, "detail": 0.5"#), "has both parts and detail; keep one"),
            (head(r#""parts": 0"#), "starts from 0 parts; give at least 1"),
            (head(r#""detail": 2"#), "its detail is not between"),
            (head(r#""box": [[1, 1, 1], [0, 0, 0]]"#), "its box is not a minimum"),
        ] {
            let error = Edits::of_text(text.as_bytes(), Path::new("edits")).unwrap_err().to_string();
            assert!(error.starts_with(&format!("edits: {told}")) && error.contains("; "), "{error}");
        }
    }
}
