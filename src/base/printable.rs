//! Names and words out of files as they may be shown: on one line, and without anything that a terminal obeys.
//!
//! A file's name, a property's name in a header or a line of a damaged file may hold escape sequences, line breaks or
//! marks that turn the direction of writing. In messages they appear as Rust writes them, `\u{1b}`, so that one message
//! stays one line and says what is there. Cost: one pass over the text, a copy only where something is replaced.

use std::borrow::Cow;

/// Whether `c` would do something to a line rather than be seen on it.
fn acts(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{feff}')
}

/// `text` on one line.
pub fn line(text: &str) -> Cow<'_, str> {
    replaced(text, acts)
}

/// `text` with its line breaks, and nothing else that acts.
pub fn lines(text: &str) -> Cow<'_, str> {
    replaced(text, |c| c != '\n' && acts(c))
}

fn replaced(text: &str, acts: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.contains(&acts) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        match acts(c) {
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
    fn what_a_terminal_obeys_is_spelt_out() {
        assert_eq!(line("a\x1b[31m\n\u{9b}2J\u{202e}b\tc"), "a\\u{1b}[31m\\n\\u{9b}2J\\u{202e}b\\tc");
        assert_eq!(lines("one\ntwo\r"), "one\ntwo\\r");
        assert!(matches!(line("Körper-№1 «頭».ply"), Cow::Borrowed(_)));
    }
}
