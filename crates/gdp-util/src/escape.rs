//! Escapes the control characters in untrusted text that a terminal or an editor would execute.
//!
//! Names, labels and reasons come from cards, certificates and peers. A raw ESC in one of them
//! moves the cursor or sets the title, and a line feed forges a line. A bidirectional control makes
//! `a` look like `b` (Unicode TR 36, TR 55).

use std::borrow::Cow;
use std::fmt::{self, Write};

/// Displays `T` on one line. Each character that [`is_control`] appears as `\u{1b}`, `\n`, `\r` or
/// `\t`.
#[derive(Clone, Copy, Debug)]
pub struct Escaped<T>(pub T);

impl<T: fmt::Display> fmt::Display for Escaped<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(EscapingWriter(f), "{}", self.0)
    }
}

/// Writes text to `W`, escaped as by [`Escaped`].
pub struct EscapingWriter<W>(pub W);

impl<W: fmt::Write> fmt::Write for EscapingWriter<W> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        let mut rest = text;
        while let Some((before, control, after)) = split_at_control(rest) {
            self.0.write_str(before)?;
            match control {
                '\n' | '\r' | '\t' => write!(self.0, "{}", control.escape_debug())?,
                _ => write!(self.0, "{}", control.escape_unicode())?,
            }
            rest = after;
        }
        self.0.write_str(rest)
    }
}

/// Returns JSON text of the same value, in which each character that [`is_control`] is written as
/// `\u001b`.
///
/// Serializers do not escape DEL, C1 and bidirectional controls. JSON has no such characters
/// outside strings, except line feeds between tokens, which stay.
pub fn escape_json(json: &str) -> Cow<'_, str> {
    if !json.contains(|c| is_control(c) && c != '\n') {
        return json.into();
    }
    let mut escaped = String::with_capacity(json.len() + 64);
    for c in json.chars() {
        match c {
            c if c == '\n' || !is_control(c) => escaped.push(c),
            // All these characters are in the basic multilingual plane, so four digits suffice.
            c => escaped.extend(format!("\\u{:04x}", c as u32).chars()),
        }
    }
    escaped.into()
}

/// Returns whether a character is a C0, DEL or C1 control, a line or paragraph separator, or a
/// bidirectional control.
pub fn is_control(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

fn split_at_control(text: &str) -> Option<(&str, char, &str)> {
    let (at, control) = text.char_indices().find(|(_, c)| is_control(*c))?;
    Some((&text[..at], control, &text[at + control.len_utf8()..]))
}

#[cfg(test)]
#[path = "../tests/unit/escape.rs"]
mod tests;
