//! The header of a `.npy` file: a Python dictionary with three keys, of which only the form that NumPy writes is
//! accepted.
//!
//! One pass over the text without recursion, so the time is linear in its length: a parser for all of Python's literals
//! takes exponential time on nested brackets, and `.npy` files may come from untrusted sources.

/// The content of a header.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Header {
    /// NumPy's type: the content of a string such as `<f4`, or a list of fields without spaces such as `[('a','<i8')]`.
    pub descr: String,
    /// Whether the first axis varies fastest.
    pub fortran: bool,
    /// Items along each axis; their product fits into 63 bits.
    pub shape: Vec<u64>,
    /// Bytes before the data.
    pub data: usize,
}

/// The header at the beginning of `bytes`, or what is wrong with it.
pub(crate) fn parse(bytes: &[u8]) -> Result<Header, String> {
    let begins = |magic: &[u8]| bytes.starts_with(magic);
    let short = || "the file ends within the header".to_string();
    let (start, len) = match bytes.get(6) {
        _ if !begins(b"\x93NUMPY") => return Err("it does not begin as a .npy file".into()),
        Some(1) => (10, bytes.get(8..10).map(|two| usize::from(u16::from_le_bytes([two[0], two[1]])))),
        Some(2 | 3) => {
            (12, bytes.get(8..12).map(|four| u32::from_le_bytes([four[0], four[1], four[2], four[3]]) as usize))
        }
        Some(version) => return Err(format!("version {version} of the format is unknown")),
        None => return Err(short()),
    };
    let data = start + len.ok_or_else(short)?;
    let text = bytes.get(start..data).ok_or_else(short)?;
    let text = std::str::from_utf8(text).map_err(|_| "it is not text")?;
    let mut rest = Scanner(text);
    let (mut descr, mut fortran, mut shape) = (None, None, None);
    rest.expect('{')?;
    while !rest.accept('}') {
        let key = rest.string()?;
        rest.expect(':')?;
        match key {
            "descr" => descr = Some(rest.descr()?),
            "fortran_order" => fortran = Some(rest.boolean()?),
            "shape" => shape = Some(rest.shape()?),
            _ => return Err("it has a key other than descr, fortran_order and shape".into()),
        }
        if !rest.accept(',') && !rest.0.trim_start().starts_with('}') {
            return Err("a comma is missing".into());
        }
    }
    let shape = shape.ok_or("it has no shape")?;
    let items = shape.iter().try_fold(1u64, |product, &dim: &u64| product.checked_mul(dim.max(1)));
    if items.is_none_or(|items| items >= 1 << 63) {
        return Err(TOO_LARGE.into());
    }
    let (descr, fortran) = (descr.ok_or("it has no descr")?, fortran.ok_or("it has no fortran_order")?);
    Ok(Header { descr, fortran, shape, data })
}

const TOO_LARGE: &str = "its shape is too large for memory or disk";

/// The rest of the text.
struct Scanner<'a>(&'a str);

impl<'a> Scanner<'a> {
    fn accept(&mut self, char: char) -> bool {
        let rest = self.0.trim_start().strip_prefix(char);
        self.0 = rest.unwrap_or(self.0);
        rest.is_some()
    }

    fn expect(&mut self, char: char) -> Result<(), String> {
        if self.accept(char) { Ok(()) } else { Err(format!("'{char}' is missing")) }
    }

    /// A string in quotes of either kind, without escapes.
    fn string(&mut self) -> Result<&'a str, String> {
        let text = self.0.trim_start();
        let quote = text.chars().next().filter(|char| matches!(char, '\'' | '"')).ok_or("a string is missing")?;
        let (string, rest) = text[1..].split_once(quote).ok_or("a string has no end")?;
        if string.contains('\\') {
            return Err("a string has escapes".into());
        }
        self.0 = rest;
        Ok(string)
    }

    /// A type: a string, or a list, whose text is taken up to its closing bracket.
    fn descr(&mut self) -> Result<String, String> {
        if !self.0.trim_start().starts_with('[') {
            return Ok(self.string()?.to_string());
        }
        let (mut text, mut depth) = (String::new(), 0usize);
        loop {
            self.0 = self.0.trim_start();
            let char = self.0.chars().next().ok_or("a list has no end")?;
            if matches!(char, '\'' | '"') {
                let name = self.string()?;
                text.extend(["'", name, "'"]);
                continue;
            }
            self.0 = &self.0[char.len_utf8()..];
            match char {
                '[' | '(' => depth += 1,
                ']' | ')' => depth -= 1,
                _ => {}
            }
            if char == ']' && text.ends_with(',') {
                text.pop();
            }
            text.push(char);
            if depth == 0 {
                return Ok(text);
            }
        }
    }

    fn boolean(&mut self) -> Result<bool, String> {
        let text = self.0.trim_start();
        let found = [("False", false), ("True", true)];
        let found = found.iter().find_map(|&(word, value)| Some((text.strip_prefix(word)?, value)));
        let (rest, value) = found.ok_or("fortran_order is neither True nor False")?;
        self.0 = rest;
        Ok(value)
    }

    fn shape(&mut self) -> Result<Vec<u64>, String> {
        self.expect('(')?;
        let mut shape = Vec::new();
        while !self.accept(')') {
            let text = self.0.trim_start();
            let digits = text.bytes().take_while(u8::is_ascii_digit).count();
            if digits == 0 {
                return Err("the shape is not a tuple of whole numbers".into());
            }
            shape.push(text[..digits].parse().map_err(|_| TOO_LARGE)?);
            self.0 = &text[digits..];
            if !self.accept(',') {
                self.expect(')')?;
                break;
            }
        }
        Ok(shape)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> Result<Header, String> {
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((text.len() as u16).to_le_bytes());
        bytes.extend(text.bytes());
        parse(&bytes)
    }

    #[test]
    fn numpys_forms_are_read() {
        let text = "{'descr': '<f4', 'fortran_order': False, 'shape': (3, 4), }   \n";
        let plain = Header { descr: "<f4".into(), fortran: false, shape: vec![3, 4], data: 10 + text.len() };
        assert_eq!(of(text).unwrap(), plain);
        assert!(of(r#"{"shape":(),"descr":"|u1","fortran_order":True}"#).unwrap().shape.is_empty());
        assert!(of("{'descr': '|u1', 'fortran_order': True, 'shape': (7,), }").unwrap().fortran);
        let fields =
            of("{'descr': [('a', '<i4', (3,)), (\"b\", '<f4'),], 'fortran_order': False, 'shape': (7,)}").unwrap();
        assert_eq!(fields.descr, "[('a','<i4',(3,)),('b','<f4')]");
        let text = b"{'descr': '<f4', 'fortran_order': False, 'shape': (3, 4), }";
        let second = [&b"\x93NUMPY\x02\x00"[..], &(text.len() as u32).to_le_bytes(), text].concat();
        assert_eq!(parse(&second).unwrap().data, 12 + text.len());
    }

    #[test]
    fn others_are_refused() {
        let not = |text: &str, what: &str| assert!(of(text).unwrap_err().contains(what), "{text}: {:?}", of(text));
        not("", "'{' is missing");
        not("{'descr': '<f4'", "comma");
        not("{'descr': '<f4', ", "string is missing");
        not("{'descr': '<f4', 'fortran_order': False, 'shape': 5}", "'(' is missing");
        not("{'descr': '<f4', 'fortran_order': False, 'shape': (-5,)}", "whole numbers");
        not("{'descr': '<f4', 'fortran_order': False, 'shape': (5 6)}", "')' is missing");
        not("{'descr': '<f4', 'fortran_order': False, 'shape': (99999999999999999999,)}", "memory or disk");
        not("{'descr': '<f4', 'fortran_order': False, 'shape': (4294967296, 2147483648)}", "memory or disk");
        not("{'descr': '<f4', 'fortran_order': False, 'shape': (0, 4294967296, 4294967296)}", "memory or disk");
        not("{'descr': '<f4', 'fortran_order': 0, 'shape': (5,)}", "True nor False");
        not("{'descr': [('a', '<f4', 'fortran_order': 0, 'shape': (5,)}", "no end");
        not("{'descr': '<f4', 'fortran_order': False}", "no shape");
        not("{'fortran_order': False, 'shape': (5,)}", "no descr");
        not("{'descr': '<f4', 'shape': (5,)}", "no fortran_order");
        not("{'descr': '<f4', 'other': (5,)}", "a key other");
        not(r"{'descr': '<\x66', 'shape': (5,)}", "escapes");
        assert!(parse(b"NUMPY").unwrap_err().contains("begin"));
        assert!(parse(b"\x93NUMPY").unwrap_err().contains("ends"));
        assert!(parse(b"\x93NUMPY\x01\x00\xff\x00{").unwrap_err().contains("ends"));
        assert!(parse(b"\x93NUMPY\x02\x00\xff\xff\xff\xff{").unwrap_err().contains("ends"));
        assert!(parse(b"\x93NUMPY\x04\x00\x01\x00{").unwrap_err().contains("version 4"));
    }

    #[test]
    fn nested_brackets_take_no_longer_than_their_bytes() {
        // A parser of all Python literals took practically for ever on twenty of them.
        for bracket in ["[", "{", "(", "[(", "[{"] {
            let nested = bracket.repeat(20_000);
            assert!(of(&format!("{{'descr': {nested}")).is_err());
            assert!(of(&format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {nested}")).is_err());
        }
    }
}
