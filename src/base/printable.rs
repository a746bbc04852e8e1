//! Numbers for people, and text from files made safe to display: on one line, and without control characters that a
//! terminal would act on.
//!
//! A file name, a property name in a header or a line of a damaged file may contain escape sequences, line breaks or
//! marks that reverse the writing direction. Messages show them in Rust's notation, `\u{1b}`, so that a message stays
//! on one line and still shows what the file contains. Cost: one pass over the text; a copy only where something is
//! replaced.

use std::borrow::Cow;
use std::fmt::{Display, Formatter, LowerExp};

/// Whether `c` is a control or direction character rather than a visible one.
fn is_control(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{feff}')
}

/// Formats 1234567 as 1.23 M.
pub fn human(x: f64) -> String {
    match x {
        x if x >= 1e9 => format!("{:.2} G", x / 1e9),
        x if x >= 1e6 => format!("{:.2} M", x / 1e6),
        x if x >= 1e4 => format!("{:.1} k", x / 1e3),
        x => format!("{x:.0}"),
    }
}

/// Formats 1 part, 2 parts, 3 vertices.
pub fn counted(count: usize, word: &str) -> String {
    format!("{count} {}", noun(count, word))
}

/// `word` for `count` of them.
pub fn noun(count: usize, word: &str) -> Cow<'_, str> {
    if count == 1 {
        return word.into();
    }
    match word.strip_suffix("ex") {
        Some(stem) => format!("{stem}ices").into(),
        None => format!("{word}{}", if word.ends_with("sh") { "es" } else { "s" }).into(),
    }
}

/// A real number for people: with as many significant digits as the precision, or without one as many as identify it;
/// without an exponent unless it is very large or very small, since the standard library writes out hundreds of zeros.
///
/// ```
/// use nystrom_stream::base::printable::Significant;
/// assert_eq!(format!("{} {}", Significant(0.25), Significant(1e300)), "0.25 1e300");
/// assert_eq!(format!("{:.3} {:.3}", Significant(12.3456), Significant(-1.23456e-9)), "12.3 -1.23e-9");
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Significant<T>(pub T);

impl<T: Copy + Display + LowerExp + Into<f64>> Display for Significant<T> {
    fn fmt(&self, f: &mut Formatter) -> std::fmt::Result {
        let size = self.0.into().abs();
        let power = if size == 0. { 0 } else { size.log10().floor() as i32 };
        match (f.precision().map(|digits| digits as i32), (-5..15).contains(&power)) {
            (None, true) => write!(f, "{}", self.0),
            (None, false) => write!(f, "{:e}", self.0),
            (Some(digits), true) => write!(f, "{:.*}", (digits - 1 - power).max(0) as usize, self.0),
            (Some(digits), false) => write!(f, "{:.*e}", (digits - 1).max(0) as usize, self.0),
        }
    }
}

/// `text` on one line.
pub fn line(text: &str) -> Cow<'_, str> {
    replaced(text, is_control)
}

/// `text` with its line breaks kept and everything else escaped.
pub fn lines(text: &str) -> Cow<'_, str> {
    replaced(text, |c| c != '\n' && is_control(c))
}

fn replaced(text: &str, is_control: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.contains(&is_control) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        match is_control(c) {
            true => out.extend(c.escape_default()),
            false => out.push(c),
        }
    }
    Cow::Owned(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_is_singular() {
        let told = |count: usize| ["cell", "mesh", "vertex"].map(|word| counted(count, word)).join(", ");
        assert_eq!(told(0), "0 cells, 0 meshes, 0 vertices");
        assert_eq!(told(1), "1 cell, 1 mesh, 1 vertex");
    }

    #[test]
    fn what_a_terminal_obeys_is_spelt_out() {
        assert_eq!(line("a\x1b[31m\n\u{9b}2J\u{202e}b\tc"), "a\\u{1b}[31m\\n\\u{9b}2J\\u{202e}b\\tc");
        assert_eq!(lines("one\ntwo\r"), "one\ntwo\\r");
        assert!(matches!(line("Körper-№1 «頭».ply"), Cow::Borrowed(_)));
    }
}
