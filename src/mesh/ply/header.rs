//! The header of a PLY file: its data, its parser and its writer.
//!
//! Real headers come with CRLF or lone CR, tabs, indentation, comments of 200 kB, `PLY` in capitals and odd names. So
//! the lines are found and normalised here and then passed to `ply-rs-bw`, which knows the grammar. Comments
//! (`comment`, `obj_info`) keep their place in the output. Cost: one pass over the header, which may have up to
//! [`LIMIT`] bytes, and a copy of it.

use super::element::{Element, Encoding, Kind, Property, Scalar};
use crate::base::printable::counted;
use crate::base::{Error, Result};
use ply_rs_bw::parser::Parser;
use ply_rs_bw::ply::{self, DefaultElement};
use std::fmt::Write as _;
use std::path::Path;

/// Bytes that a header may have at most; anything longer is not a header.
pub const LIMIT: usize = 16 << 20;
/// Lines that it may have at most.
const LINES: usize = 1 << 18;
/// Elements and properties that it may have at most; each is processed for every record.
const STATEMENTS: usize = 1 << 16;

/// A line of the header, for writing it again.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Line {
    /// A `comment` or `obj_info` line, verbatim, without its line break.
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

impl Header {
    /// The remarks, without their line breaks, in the order of the file.
    pub fn remarks(&self) -> impl Iterator<Item = &[u8]> {
        self.lines.iter().filter_map(|line| if let Line::Remark(text) = line { Some(&text[..]) } else { None })
    }

    /// Rejects counts that the file `path` of `len` bytes cannot hold, before anything relies on them.
    ///
    /// # Errors
    /// [`Error::Malformed`].
    pub(in crate::mesh) fn check_counts(&self, path: &Path, len: usize) -> Result<()> {
        let mut left = len.saturating_sub(self.payload) as u128;
        for element in &self.elements {
            let least = element.least_bytes(self.encoding);
            if least > left {
                let (name, count) = (element.name.escape_debug(), element.count);
                let records = format!("{} {}", counted(count, "record"), if count == 1 { "needs" } else { "need" });
                return Err(Error::malformed(
                    path,
                    format!("header, element {name}"),
                    format!("{records} at least {least} bytes, but only {left} are left in the file"),
                    CUT_SHORT,
                ));
            }
            left -= least;
        }
        Ok(())
    }
}

/// Splits off the next line: its content, trimmed, and the bytes it takes with its line break.
fn next_line(bytes: &[u8], lone_cr: bool) -> Option<(&[u8], usize)> {
    let end = bytes.iter().position(|&byte| byte == if lone_cr { b'\r' } else { b'\n' })?;
    Some((bytes[..end].trim_ascii(), end + 1))
}

/// The start of a line, made printable for a message of one line.
pub(in crate::mesh) fn shown(line: &[u8]) -> String {
    let cut = &line[..line.len().min(60)];
    let dots = if line.len() > cut.len() { "…" } else { "" };
    format!("\"{}{dots}\"", String::from_utf8_lossy(cut).escape_debug())
}

/// Whether the lines end in a lone CR, as on old Macs.
fn breaks_with_cr(bytes: &[u8]) -> bool {
    let first = bytes.iter().position(|&byte| byte == b'\r' || byte == b'\n');
    first.is_some_and(|at| bytes[at] == b'\r' && bytes.get(at + 1) != Some(&b'\n'))
}

/// Parses the header at the start of `bytes`.
///
/// # Errors
/// [`Error::Malformed`] naming `path` and the header's line: not a PLY, no end, an invalid statement, no format, a list
/// whose count is a floating-point number.
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
            let within = if bytes.len() < LIMIT { String::new() } else { format!(" in its first {} MiB", LIMIT >> 20) };
            let problem = format!("the header has no end_header line{within}");
            return Err(Error::malformed(path, format!("header line {number}"), problem, CUT_SHORT));
        };
        at += taken;
        if number > LINES || found.originals.len() > STATEMENTS {
            let problem = format!("the header has more than {STATEMENTS} elements and properties, or {LINES} lines");
            let remedy = "leave out those that the mesh does not need";
            return Err(Error::malformed(path, format!("header line {number}"), problem, remedy));
        }
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
pub(in crate::mesh) const CUT_SHORT: &str = "the file is cut short or damaged; get it again";

/// The statements of a header, with the names replaced by plain ones (`e0`, `p1`, …): the parser accepts only names of
/// letters, digits, `_` and `-`, and merges properties of the same name.
#[derive(Default)]
struct Statements {
    plain: String,
    /// For each line of `plain` from the second on, its line number in the file and the start of the original text.
    originals: Vec<(usize, String)>,
    names: Vec<(String, Vec<String>)>,
    lines: Vec<Line>,
}

impl Statements {
    /// Adds one trimmed line; the error is what is wrong with it.
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
                    return Err("a property precedes the first element".into());
                };
                self.lines.push(Line::Property(element - 1, properties.len()));
                let wrote = writeln!(self.plain, "property {} p{}", types.join(" "), properties.len());
                properties.push(name.to_owned());
                wrote
            }
            _ => return Err(format!("{} is not a statement of a PLY header", shown(line))),
        };
        self.originals.push((number, shown(line)));
        Ok(())
    }

    /// Parses the statements with the library and restores the names.
    fn finish(self, path: &Path, payload: usize) -> Result<Header> {
        let plain = format!("ply\n{}end_header\n", self.plain);
        let parsed = Parser::<DefaultElement>::new().read_ply_header(&mut plain.as_bytes()).map_err(|error| {
            let line = error.line().and_then(|line| line.checked_sub(2));
            let (place, problem) = match line.and_then(|line| Some((self.originals.get(line)?, line))) {
                Some(((number, original), line)) => {
                    let statement = plain.lines().nth(line + 1).unwrap_or_default();
                    let wide = statement.split(' ').find(|word| ["int64", "uint64"].contains(word));
                    let problem = match wide {
                        Some(word) => format!("{word} is not a PLY type; the widest integers are int and uint"),
                        None => format!("{original} is not valid PLY"),
                    };
                    (format!("header line {number}"), problem)
                }
                None => ("header".to_owned(), shown(error.to_string().as_bytes()).trim_matches('"').to_owned()),
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

/// Writes a header. All headers of this program are written here.
///
/// ```
/// use nystrom_stream::mesh::ply::{Encoding, HeaderWriter, Scalar};
/// let mut header = HeaderWriter::new(Encoding::Little);
/// header.element("vertex", 8).positions(false);
/// header.element("face", 12).corners(Scalar::U8, Scalar::I32).property("label", Scalar::I32);
/// let text = String::from_utf8(header.finish()).unwrap();
/// assert!(text.starts_with("ply\nformat binary_little_endian 1.0\nelement vertex 8\nproperty float x\n"));
/// assert!(text.ends_with("property list uchar int vertex_indices\nproperty int label\nend_header\n"));
/// ```
#[derive(Clone, Debug)]
pub struct HeaderWriter {
    /// Bytes rather than a `String`: comments of an input need not be Unicode.
    text: Vec<u8>,
}

impl HeaderWriter {
    /// A header without elements, of a payload in `encoding`.
    pub fn new(encoding: Encoding) -> Self {
        Self { text: format!("ply\nformat {} 1.0\n", encoding.word()).into_bytes() }
    }

    /// Adds a complete `comment` or `obj_info` line, given without its line break.
    pub fn remark(&mut self, line: impl AsRef<[u8]>) -> &mut Self {
        self.text.extend_from_slice(line.as_ref());
        self.text.push(b'\n');
        self
    }

    /// Begins an element of `count` records; its properties follow.
    pub fn element(&mut self, name: &str, count: u64) -> &mut Self {
        self.remark(format!("element {name} {count}"))
    }

    /// Adds a property to the current element.
    pub fn property(&mut self, name: &str, kind: impl Into<Kind>) -> &mut Self {
        self.remark(format!("property {} {name}", kind.into().words()))
    }

    /// Adds `x`, `y` and `z`, of 64 bits if `double`, else of 32.
    pub fn positions(&mut self, double: bool) -> &mut Self {
        let scalar = Scalar::coordinate(double);
        self.property("x", scalar).property("y", scalar).property("z", scalar)
    }

    /// Adds the list of a face's corners, of `item`s after a `count`.
    pub fn corners(&mut self, count: Scalar, item: Scalar) -> &mut Self {
        self.property("vertex_indices", Kind::List { count, item })
    }

    /// The header's bytes, up to where the payload begins.
    pub fn finish(mut self) -> Vec<u8> {
        self.remark("end_header");
        self.text
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
        let text = "PLY \n\tformat  ascii\t1.0\ncomment  a  b\n element vertex\t3 \nproperty   float  x\n\n\
            obj_info o\nproperty list uchar int my.list\nend_header\n";
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
                "header line 4: \"property flot x\" is not valid PLY",
            ),
            ("ply\ncomment\nfoo 1\nend_header\n", "header line 3: \"foo 1\" is not a statement"),
            ("ply\nformat ascii 1.0\nproperty int x\nend_header\n", "header line 3: a property precedes"),
            (
                "ply\nformat ascii 1.0\nelement a 1\nproperty list uchar uint64 vertex_indices\nend_header\n",
                "header line 4: uint64 is not a PLY type",
            ),
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
