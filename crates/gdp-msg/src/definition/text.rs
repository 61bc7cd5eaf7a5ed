//! Parses texts with several definitions, as in ROS 1 connection headers, bags and MCAP's
//! `ros2msg`. The type itself comes first. Each type that it uses follows a line of `=` and `MSG:
//! package/Type`.

use super::{Definition, DefinitionError, MAX_TEXT, Problem, parse};
use crate::dialect::Dialect;
use crate::name::{TypeName, excerpt};

/// Maximum number of definitions in one text.
const MAX_DEFINITIONS: usize = 1024;

/// Returns all definitions of a text, that of `name` first.
///
/// # Errors
/// If a definition is invalid. The error names the type and the line, counted over the whole text.
pub fn split(dialect: Dialect, name: &TypeName, text: &str) -> Result<Vec<Definition>, DefinitionError> {
    let refused = |line, problem| DefinitionError::new(name, line, problem);
    if text.len() > MAX_TEXT {
        return Err(refused(0, Problem::TooLong));
    }
    let mut definitions = Vec::new();
    let mut current = (name.clone(), 1, 0);
    let mut lines = Lines { text, at: 0, number: 0 };
    while let Some((start, number, line)) = lines.next() {
        if !is_separator(line) {
            continue;
        }
        let (of, first, from) = current;
        definitions.push(parse(dialect, &of, &text[from..start], first)?);
        if definitions.len() >= MAX_DEFINITIONS {
            return Err(refused(number, Problem::TooMany));
        }
        let Some((_, number, header)) = lines.next() else {
            return Err(refused(number, Problem::Header(String::new())));
        };
        if header.starts_with("IDL:") {
            return Err(refused(number, Problem::Idl));
        }
        let Some(header) = header.strip_prefix("MSG:") else {
            return Err(refused(number, Problem::Header(excerpt(header))));
        };
        let of = TypeName::parse(header.trim()).map_err(|error| refused(number, error.into()))?;
        current = (of, number + 1, lines.at);
    }
    let (of, first, from) = current;
    definitions.push(parse(dialect, &of, &text[from..], first)?);
    Ok(definitions)
}

fn is_separator(line: &str) -> bool {
    let line = line.trim_end();
    line.len() >= 3 && line.bytes().all(|byte| byte == b'=')
}

/// Iterates over lines, each with its byte offset and its number from 1.
struct Lines<'a> {
    text: &'a str,
    at: usize,
    number: usize,
}

impl<'a> Iterator for Lines<'a> {
    type Item = (usize, usize, &'a str);

    fn next(&mut self) -> Option<Self::Item> {
        let rest = self.text.get(self.at..).filter(|rest| !rest.is_empty())?;
        let start = self.at;
        let line = rest.split('\n').next().unwrap_or_default();
        self.at = (start + line.len() + 1).min(self.text.len());
        self.number += 1;
        Some((start, self.number, line))
    }
}
