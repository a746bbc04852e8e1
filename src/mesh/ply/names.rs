//! Names of parts in the header of a PLY, one comment each: `comment part 3: left arm`.
//!
//! Other programs ignore comments and most keep them. Cost: one line per name.

use super::document::Document;

/// The prefix of such comments.
const START: &str = "comment part ";

/// The comments for `names`, one per part, empty for none. Headers are ASCII, and some programs reject others: other
/// characters are escaped as in Rust (`K\u{f6}rper`), and so is the backslash.
pub(super) fn remarks(names: &[String]) -> Vec<Vec<u8>> {
    let escaped = |name: &str| -> String {
        let plain = |c: char| matches!(c, ' '..='~') && c != '\\';
        name.chars().map(|c| if plain(c) { c.to_string() } else { c.escape_default().to_string() }).collect()
    };
    let named = names.iter().enumerate().filter(|(_, name)| !name.is_empty());
    named.map(|(part, name)| format!("{START}{part}: {}", escaped(name)).into_bytes()).collect()
}

/// The part and its name, if `remark` is such a comment.
pub(super) fn part_name(remark: &[u8]) -> Option<(u32, String)> {
    let text = String::from_utf8_lossy(remark.strip_prefix(START.as_bytes())?);
    let (part, name) = text.split_once(": ")?;
    Some((part.parse().ok()?, unescaped(name)))
}

/// `text` with its escapes decoded; invalid escapes stay.
fn unescaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some((before, after)) = rest.split_once('\\') {
        out.push_str(before);
        let hexadecimal = || {
            let (digits, after) = after.strip_prefix("u{")?.split_once('}')?;
            Some((char::from_u32(u32::from_str_radix(digits, 16).ok()?)?, after))
        };
        let one = |letter: char, c: char| Some((c, after.strip_prefix(letter)?));
        let found = one('\\', '\\').or_else(|| one('n', '\n')).or_else(|| one('t', '\t')).or_else(|| one('r', '\r'));
        let (c, after) = found.or_else(hexadecimal).unwrap_or(('\\', after));
        out.push(c);
        rest = after;
    }
    out + rest
}

/// The names of parts in the header of `document`: empty for none, and at most `parts`.
pub fn names_of(document: &Document, parts: usize) -> Vec<String> {
    let mut names = Vec::new();
    for (part, name) in document.header.remarks().filter_map(part_name) {
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
        let names = ["left arm: upper", "", "Kopf ö", "a\\n\nb\t頭 \\u{41}"].map(String::from);
        let remarks = remarks(&names);
        // Regression: plyfile rejects headers that are not ASCII.
        assert!(remarks.iter().all(|remark| remark.iter().all(|byte| (b' '..=b'~').contains(byte))));
        let names_read: Vec<_> = remarks.iter().filter_map(|remark| part_name(remark)).collect();
        assert_eq!(names_read, [0, 2, 3].map(|part| (part, names[part as usize].clone())));
        assert_eq!(unescaped(r"C:\parts \u{d800} \"), r"C:\parts \u{d800} \");
        for other in
            ["comment part", "comment part x: y", "comment part 1 : y", "comment made by hand", "comment part 1:y"]
        {
            assert_eq!(part_name(other.as_bytes()), None, "{other}");
        }
        assert_eq!(super::remarks(&["a\nend_header".to_string()]), [b"comment part 0: a\\nend_header".to_vec()]);
    }
}
