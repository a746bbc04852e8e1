//! Names of parts from a table: one line per part, with its number and its name separated by a tab.
//!
//! Spreadsheets can write such files. A first line that does not start with a number is a header and is skipped. The
//! file is read as a whole.

use crate::base::{Error, Result};
use crate::store::json;
use std::path::Path;

/// The greatest part number that can be named.
const MOST: usize = 1 << 16;

/// Reads the table `path`: one name per part, empty for none.
///
/// # Errors
/// [`Error::Io`]; [`Error::Malformed`] naming the line.
pub fn read_names(path: &Path) -> Result<Vec<String>> {
    let text = json::read_small(path)?;
    let text = String::from_utf8(text).map_err(|error| {
        let before = &error.as_bytes()[..error.utf8_error().valid_up_to()];
        let line = before.iter().filter(|&&byte| byte == b'\n').count() + 1;
        Error::malformed(path, format!("line {line}"), "is not UTF-8", "save the table with this encoding")
    })?;
    of_text(&text, path)
}

fn of_text(text: &str, path: &Path) -> Result<Vec<String>> {
    let mut names: Vec<String> = Vec::new();
    for (number, line) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        let wrong = |problem: &str| {
            let remedy = "write the number of a part, a tab, and its name";
            Err(Error::malformed(path, format!("line {}", number + 1), problem, remedy))
        };
        let Some((part, name)) = line.split_once('\t') else {
            if line.trim().is_empty() {
                continue;
            }
            return wrong("has no tab");
        };
        let Ok(part) = part.trim().parse::<usize>() else {
            if number == 0 {
                continue;
            }
            return wrong("does not begin with the number of a part");
        };
        let name = name.split('\t').next().unwrap_or_default().trim();
        if part >= MOST || name.chars().any(char::is_control) {
            return wrong("has too large a number or a control character");
        }
        if names.len() <= part {
            names.resize(part + 1, String::new());
        }
        if !names[part].is_empty() {
            return wrong("names the same part again");
        }
        names[part] = name.to_string();
    }
    Ok(names)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_are_read_and_wrong_lines_are_named() {
        let of = |text: &str| of_text(text, Path::new("n.tsv"));
        assert_eq!(of("part\tname\n2\tleft arm\r\n0\thead\tx\n\n").unwrap(), ["head", "", "left arm"]);
        assert_eq!(of("").unwrap(), Vec::<String>::new());
        for (text, told) in [
            ("0\ta\nhead", "line 2: has no tab"),
            ("0\ta\nb\tc", "line 2: does not begin"),
            ("0\ta\n0\tb", "line 2: names the same part again"),
            ("99999999\ta", "line 1: has too large"),
        ] {
            let error = of(text).unwrap_err().to_string();
            assert!(error.starts_with("n.tsv: ") && error.contains(told), "{error}");
        }
    }

    /// Regression: letters of another encoding became question marks in all outputs.
    #[test]
    fn tables_of_another_encoding_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("n.tsv");
        std::fs::write(&path, b"0\thead\n1\tK\xf6rper\n").unwrap();
        let error = read_names(&path).unwrap_err().to_string();
        assert!(error.ends_with("n.tsv: line 2: is not UTF-8; save the table with this encoding"), "{error}");
        std::fs::write(&path, "\u{feff}0\tKörper\n").unwrap();
        assert_eq!(read_names(&path).unwrap(), ["Körper"]);
    }
}
