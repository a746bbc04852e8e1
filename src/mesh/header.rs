//! The header of a PLY file.
//!
//! Real headers come with CRLF or lone CR, tabs, indentation, comments of 200 kB, `PLY` in capitals
//! and odd names, so the lines are found and normalised here and then given to `ply-rs-bw`, which
//! knows the grammar. Remarks (`comment`, `obj_info`) keep their place for the output. Cost: one
//! pass over the header, which may have [`LIMIT`] bytes, and a copy of it.

use super::model::{Element, Encoding, Kind, Property, Scalar};
use crate::base::{Error, Result};
use ply_rs_bw::parser::Parser;
use ply_rs_bw::ply::{self, DefaultElement};
use std::fmt::Write as _;
use std::path::Path;

/// Bytes that a header may have at most; anything longer is not a header.
pub const LIMIT: usize = 64 << 20;

/// A line of the header, for writing it again.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Line {
    /// A `comment` or `obj_info` line as it stands, without its line break.
    Remark(Vec<u8>),
    /// The start of the element of this number.
    Element(usize),
    /// A property: element number, property number.
    Property(usize, usize),
}

/// A parsed header.
#[derive(Clone, Debug)]
pub struct Header {
    /// How the payload is written.
    pub encoding: Encoding,
    /// The elements in file order.
    pub elements: Vec<Element>,
    /// All lines between `format` and `end_header`, in order.
    pub lines: Vec<Line>,
    /// Byte of the file where the payload begins.
    pub payload: usize,
}

/// Splits off the next line: its content, trimmed, and the bytes it takes with its line break.
fn next_line(bytes: &[u8], lone_cr: bool) -> Option<(&[u8], usize)> {
    let end = bytes.iter().position(|&byte| byte == if lone_cr { b'\r' } else { b'\n' })?;
    Some((bytes[..end].trim_ascii(), end + 1))
}

/// The start of a line as it can be shown in a message of one line.
pub(super) fn shown(line: &[u8]) -> String {
    let cut = &line[..line.len().min(40)];
    let dots = if line.len() > cut.len() { "…" } else { "" };
    format!("\"{}{dots}\"", String::from_utf8_lossy(cut).escape_debug())
}

/// Whether the file breaks its lines with a lone CR, as old Macs did.
fn breaks_with_cr(bytes: &[u8]) -> bool {
    let first = bytes.iter().position(|&byte| byte == b'\r' || byte == b'\n');
    first.is_some_and(|at| bytes[at] == b'\r' && bytes.get(at + 1) != Some(&b'\n'))
}

/// Parses the header at the start of `bytes`.
///
/// # Errors
/// [`Error::Malformed`] naming `path` and the header's line: no PLY, no end, a line that is no
/// statement, no format, a list counted by a floating-point number.
pub fn parse(path: &Path, bytes: &[u8]) -> Result<Header> {
    let bytes = &bytes[..bytes.len().min(LIMIT)];
    let not_ply = |first: &[u8]| {
        Error::malformed(
            path,
            "header line 1",
            format!("is {}, not \"ply\"", shown(first)),
            "PLY, OBJ, OFF and STL are read; convert the file to one of them",
        )
    };
    let bom = if bytes.starts_with(b"\xef\xbb\xbf") { 3 } else { 0 };
    let mut at = bom;
    while bytes.get(at).is_some_and(u8::is_ascii_whitespace) {
        at += 1;
    }
    let lone_cr = breaks_with_cr(&bytes[at..]);
    let Some((magic, taken)) = next_line(&bytes[at..], lone_cr) else {
        return Err(not_ply(&bytes[at..]));
    };
    if !magic.eq_ignore_ascii_case(b"ply") {
        return Err(not_ply(magic));
    }
    at += taken;

    let mut found = Statements::default();
    let mut number = 1;
    loop {
        number += 1;
        let Some((line, taken)) = next_line(&bytes[at..], lone_cr) else {
            let problem = "the header has no end_header line";
            return Err(Error::malformed(path, format!("header line {number}"), problem, CUT_SHORT));
        };
        at += taken;
        if line == b"end_header" {
            break;
        }
        found.add(line, number).map_err(|problem| {
            Error::malformed(
                path,
                format!("header line {number}"),
                problem,
                "correct the header or export the mesh again",
            )
        })?;
    }
    found.finish(path, at)
}

/// The remedy for files that end too early.
pub(super) const CUT_SHORT: &str = "the file is cut short or damaged; get it again";

/// The statements of a header, with the names replaced by plain ones (`e0`, `p1`, …): the grammar
/// knows only names of letters, digits, `_` and `-`, and merges properties of the same name.
#[derive(Default)]
struct Statements {
    plain: String,
    /// Number in the file of each line of `plain`, from its second line on.
    numbers: Vec<usize>,
    names: Vec<(String, Vec<String>)>,
    lines: Vec<Line>,
}

impl Statements {
    /// Takes one trimmed line; says what is wrong with it.
    fn add(&mut self, line: &[u8], number: usize) -> std::result::Result<(), String> {
        let keyword = line.split(u8::is_ascii_whitespace).next().unwrap_or_default();
        match keyword {
            b"" => return Ok(()),
            b"comment" | b"obj_info" => {
                self.lines.push(Line::Remark(line.to_vec()));
                return Ok(());
            }
            _ => {}
        }
        let text = std::str::from_utf8(line).map_err(|_| format!("{} is not text", shown(line)))?;
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        // Writing into a String cannot fail.
        let _ = match words[..] {
            ["format", ..] => writeln!(self.plain, "{}", words.join(" ")),
            ["element", name, count] => {
                self.lines.push(Line::Element(self.names.len()));
                let wrote = writeln!(self.plain, "element e{} {count}", self.names.len());
                self.names.push((name.to_owned(), Vec::new()));
                wrote
            }
            ["property", ref types @ .., name] if !types.is_empty() => {
                let element = self.names.len();
                let Some((_, properties)) = self.names.last_mut() else {
                    return Err("a property stands before the first element".into());
                };
                self.lines.push(Line::Property(element - 1, properties.len()));
                let wrote = writeln!(self.plain, "property {} p{}", types.join(" "), properties.len());
                properties.push(name.to_owned());
                wrote
            }
            _ => return Err(format!("{} is no statement of a PLY header", shown(line))),
        };
        self.numbers.push(number);
        Ok(())
    }

    /// Has the library parse the statements, and puts the names back.
    fn finish(self, path: &Path, payload: usize) -> Result<Header> {
        let plain = format!("ply\n{}end_header\n", self.plain);
        let parsed = Parser::<DefaultElement>::new().read_ply_header(&mut plain.as_bytes()).map_err(|error| {
            let line = error.line().and_then(|line| line.checked_sub(2));
            let place = match line.and_then(|line| self.numbers.get(line)) {
                Some(number) => format!("header line {number}"),
                None => "header".to_owned(),
            };
            let statement = line.and_then(|line| plain.lines().nth(line + 1));
            let problem = match statement {
                Some(text) => format!("{} is not valid PLY", shown(text.as_bytes())),
                None => shown(error.to_string().as_bytes()).trim_matches('"').to_owned(),
            };
            Error::malformed(path, place, problem, "correct the header or export the mesh again")
        })?;
        let mut elements = Vec::with_capacity(self.names.len());
        for ((name, names), parsed) in self.names.into_iter().zip(parsed.elements.values()) {
            let mut properties = Vec::with_capacity(names.len());
            for (name, parsed) in names.into_iter().zip(parsed.properties.values()) {
                let kind = match &parsed.data_type {
                    ply::PropertyType::Scalar(scalar) => Kind::One(scalar_of(scalar)),
                    ply::PropertyType::List(count, item) => {
                        Kind::List { count: scalar_of(count), item: scalar_of(item) }
                    }
                };
                if matches!(kind, Kind::List { count, .. } if count.is_real()) {
                    return Err(Error::malformed(
                        path,
                        format!("header, property {}", shown(name.as_bytes())),
                        "a list is counted by a floating-point number",
                        "give the count an integer type",
                    ));
                }
                properties.push(Property { name, kind });
            }
            elements.push(Element { name, count: parsed.count, properties });
        }
        let encoding = match parsed.encoding {
            ply::Encoding::Ascii => Encoding::Ascii,
            ply::Encoding::BinaryLittleEndian => Encoding::Little,
            ply::Encoding::BinaryBigEndian => Encoding::Big,
        };
        Ok(Header { encoding, elements, lines: self.lines, payload })
    }
}

fn scalar_of(scalar: &ply::ScalarType) -> Scalar {
    match scalar {
        ply::ScalarType::Char => Scalar::I8,
        ply::ScalarType::UChar => Scalar::U8,
        ply::ScalarType::Short => Scalar::I16,
        ply::ScalarType::UShort => Scalar::U16,
        ply::ScalarType::Int => Scalar::I32,
        ply::ScalarType::UInt => Scalar::U32,
        ply::ScalarType::Float => Scalar::F32,
        ply::ScalarType::Double => Scalar::F64,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Header> {
        parse(Path::new("x.ply"), text.as_bytes())
    }

    #[test]
    fn odd_line_breaks_spaces_and_remarks_are_understood() {
        let text = "PLY \n\tformat  ascii\t1.0\ncomment  a  b\n element vertex\t3 \nproperty   float  x\n\nobj_info o\nproperty list uchar int my.list\nend_header\n";
        for text in [text.to_owned(), text.replace('\n', "\r\n"), text.replace('\n', "\r")] {
            let header = read(&text).unwrap();
            assert_eq!(header.payload, text.len());
            assert_eq!(header.elements.len(), 1);
            assert_eq!((header.elements[0].name.as_str(), header.elements[0].count), ("vertex", 3));
            assert_eq!(header.elements[0].properties[1].kind, Kind::List { count: Scalar::U8, item: Scalar::I32 });
            assert_eq!(header.elements[0].properties[1].name, "my.list");
            assert_eq!(header.lines[0], Line::Remark(b"comment  a  b".to_vec()));
            assert_eq!(header.lines[3], Line::Remark(b"obj_info o".to_vec()));
        }
    }

    #[test]
    fn what_is_wrong_is_said_in_one_line_with_its_place() {
        for (text, part) in [
            ("plx\n", "header line 1: is \"plx\""),
            ("", "header line 1"),
            ("ply\nformat ascii 1.0\n", "header line 3: the header has no end_header"),
            (
                "ply\nformat ascii 1.0\nelement a 1\nproperty flot x\nend_header\n",
                "header line 4: \"property flot p0\"",
            ),
            ("ply\ncomment\nfoo 1\nend_header\n", "header line 3: \"foo 1\" is no statement"),
            ("ply\nformat ascii 1.0\nproperty int x\nend_header\n", "header line 3: a property stands"),
            ("ply\nend_header\n", "header: No format"),
            ("ply\nformat ascii 1.0\nelement a 99999999999999999999\nend_header\n", "header line 3"),
            ("ply\nformat ascii 1.0\nelement a 1\nproperty list float int x\nend_header\n", "floating-point"),
        ] {
            let message = read(text).unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
            assert!(!message.contains('\n'), "{message}");
        }
    }
}
