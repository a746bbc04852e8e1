//! Names of parts in the header of a PLY, a remark each: `comment part 3: left arm`.
//!
//! Other programs ignore remarks and most keep them. Cost: a line per name.

use super::document::Document;
use crate::base::printable::line;

/// What such remarks begin with.
const START: &str = "comment part ";

/// The remarks that tell `names`, one per part, empty for none.
pub(super) fn remarks(names: &[String]) -> Vec<Vec<u8>> {
    let named = names.iter().enumerate().filter(|(_, name)| !name.is_empty());
    named.map(|(part, name)| format!("{START}{part}: {}", line(name)).into_bytes()).collect()
}

/// The part and its name, where `remark` tells one.
pub(super) fn told(remark: &[u8]) -> Option<(u32, String)> {
    let text = String::from_utf8_lossy(remark.strip_prefix(START.as_bytes())?);
    let (part, name) = text.split_once(": ")?;
    Some((part.parse().ok()?, name.to_string()))
}

/// The names that the header of `document` tells, by part: empty for none, and no more than `parts`.
pub fn names_of(document: &Document, parts: usize) -> Vec<String> {
    let mut names = Vec::new();
    for (part, name) in document.header.remarks().filter_map(told) {
        let part = part as usize;
        if part < parts {
            names.resize(names.len().max(part + 1), String::new());
            names[part] = name;
        }
    }
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_told_is_read_again() {
        let names = ["left arm: upper".to_string(), String::new(), "Kopf ö".into()];
        let remarks = remarks(&names);
        let told: Vec<_> = remarks.iter().filter_map(|remark| told(remark)).collect();
        assert_eq!(told, [(0, names[0].clone()), (2, names[2].clone())]);
        for other in
            ["comment part", "comment part x: y", "comment part 1 : y", "comment made by hand", "comment part 1:y"]
        {
            assert_eq!(super::told(other.as_bytes()), None, "{other}");
        }
        assert_eq!(super::remarks(&["a\nend_header".to_string()]), [b"comment part 0: a\\nend_header".to_vec()]);
    }
}
