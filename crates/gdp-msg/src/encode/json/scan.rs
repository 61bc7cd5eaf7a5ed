//! A scanner for JSON tokens (RFC 8259). It builds no values.

use crate::encode::{Fault, Result};

/// Maximum depth of a skipped value, which exceeds that of all types.
const MAX_SKIPPED: usize = 128;

/// A JSON text with the position of the scanner.
pub(super) struct Scan<'a> {
    text: &'a str,
    pub at: usize,
}

/// A string as written, without its quotes.
#[derive(Clone, Copy)]
pub(super) struct Quoted<'a> {
    pub raw: &'a str,
    pub escaped: bool,
}

impl<'a> Scan<'a> {
    pub fn new(text: &'a str) -> Self {
        Self { text, at: 0 }
    }

    /// Returns the next byte after white space, without consuming it.
    pub fn peek(&mut self) -> Option<u8> {
        let rest = &self.text.as_bytes()[self.at..];
        let space = rest.iter().take_while(|byte| matches!(byte, b' ' | b'\t' | b'\n' | b'\r')).count();
        self.at += space;
        rest.get(space).copied()
    }

    /// Consumes the next byte if it is `byte`.
    pub fn accept(&mut self, byte: u8) -> bool {
        let is = self.peek() == Some(byte);
        self.at += usize::from(is);
        is
    }

    pub fn expect(&mut self, byte: u8, else_: &'static str) -> Result<()> {
        match self.peek() {
            None => Err(Fault::Truncated),
            Some(_) if self.accept(byte) => Ok(()),
            Some(_) => Err(Fault::Syntax(else_)),
        }
    }

    /// Reads a string.
    pub fn quoted(&mut self, else_: &'static str) -> Result<Quoted<'a>> {
        self.expect(b'"', else_)?;
        let start = self.at;
        let mut escaped = false;
        let bytes = self.text.as_bytes();
        loop {
            let rest = &bytes[self.at..];
            let plain = rest.iter().position(|byte| matches!(byte, b'"' | b'\\' | 0..0x20)).ok_or(Fault::Truncated)?;
            self.at += plain;
            match rest[plain] {
                b'"' => break,
                b'\\' if rest.len() > plain + 1 => (escaped, self.at) = (true, self.at + 2),
                b'\\' => return Err(Fault::Truncated),
                _ => return Err(Fault::Syntax("a control character in a string: escape it")),
            }
            if self.at > bytes.len() || !self.text.is_char_boundary(self.at) {
                return Err(Fault::Syntax("an escape that JSON does not have"));
            }
        }
        let raw = &self.text[start..self.at];
        self.at += 1;
        Ok(Quoted { raw, escaped })
    }

    /// Reads a number, `true`, `false` or `null`: any value without quotes or brackets.
    pub fn bare(&mut self) -> Result<&'a str> {
        let first = self.peek().ok_or(Fault::Truncated)?;
        let rest = &self.text[self.at..];
        let is_part = |byte: &u8| byte.is_ascii_alphanumeric() || matches!(byte, b'+' | b'-' | b'.');
        let length = rest.bytes().take_while(is_part).count();
        if length == 0 {
            return Err(Fault::Syntax(match first {
                b'{' => "an object where the type has none",
                b'[' => "an array where the type has none",
                b'"' => "a string where the type has none",
                _ => "a value is missing",
            }));
        }
        self.at += length;
        Ok(&rest[..length])
    }

    /// Skips a value. It checks only brackets and strings; a later reader of the value checks the
    /// rest.
    pub fn skip(&mut self) -> Result<()> {
        let mut depth = 0_usize;
        loop {
            match self.peek().ok_or(Fault::Truncated)? {
                b'"' => {
                    self.quoted("a string is expected")?;
                }
                b'{' | b'[' if depth >= MAX_SKIPPED => return Err(Fault::Syntax("values nest too deeply")),
                b'{' | b'[' => (depth, self.at) = (depth + 1, self.at + 1),
                b'}' | b']' if depth > 0 => (depth, self.at) = (depth - 1, self.at + 1),
                b',' | b':' if depth > 0 => self.at += 1,
                _ => {
                    self.bare()?;
                }
            }
            if depth == 0 {
                return Ok(());
            }
        }
    }
}

impl Quoted<'_> {
    /// Appends the text of the string with its escapes resolved.
    pub fn unescape(&self, into: &mut String) -> Result<()> {
        const NO_ESCAPE: Fault = Fault::Syntax("an escape that JSON does not have");
        let mut rest = self.raw;
        while let Some((plain, behind)) = rest.split_once('\\') {
            into.push_str(plain);
            let mut chars = behind.chars();
            let c = match chars.next().ok_or(NO_ESCAPE)? {
                c @ ('"' | '\\' | '/') => c,
                'b' => '\u{8}',
                'f' => '\u{c}',
                'n' => '\n',
                'r' => '\r',
                't' => '\t',
                'u' => {
                    let (c, behind) = unicode(chars.as_str()).ok_or(Fault::Unicode)?;
                    chars = behind.chars();
                    c
                }
                _ => return Err(NO_ESCAPE),
            };
            into.push(c);
            rest = chars.as_str();
        }
        into.push_str(rest);
        Ok(())
    }
}

/// Returns the character of `XXXX`, or of `XXXX\uXXXX` for a surrogate pair, and the rest of the
/// text.
fn unicode(text: &str) -> Option<(char, &str)> {
    let unit = |text: &str| {
        let digits = text.get(..4)?.bytes().all(|byte| byte.is_ascii_hexdigit());
        digits.then(|| u16::from_str_radix(&text[..4], 16).ok())?
    };
    let (first, behind) = (unit(text)?, text.get(4..)?);
    if let Some(c) = char::from_u32(first.into()) {
        return Some((c, behind));
    }
    let second = behind.strip_prefix("\\u")?;
    let c = char::decode_utf16([first, unit(second)?]).next()?.ok()?;
    Some((c, second.get(4..)?))
}
