//! Prints lines for users on stdout and stderr. It escapes untrusted text, so that the text stays
//! on its line.

use std::fmt::Display;
use std::io::{ErrorKind, Result, Write};

use crate::escape::{Escaped, escape_json};
use crate::log;

/// Prints lines to stdout, each escaped except for leading tabs. Ignores a closed pipe.
pub fn print(lines: impl IntoIterator<Item = impl Display>) -> Result<()> {
    write(&lines.into_iter().map(|line| escape_line(&line.to_string())).collect::<String>())
}

fn escape_line(line: &str) -> String {
    let text = line.trim_start_matches('\t');
    let (indent, _) = line.split_at(line.len() - text.len());
    format!("{indent}{}\n", Escaped(text))
}

/// Prints JSON text and a line feed to stdout. Ignores a closed pipe.
pub fn print_json(json: &str) -> Result<()> {
    write(&format!("{}\n", escape_json(json)))
}

fn write(text: &str) -> Result<()> {
    let mut stdout = std::io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(error),
        _ => Ok(()),
    }
}

/// Joins an error's causes on one line, and omits a cause that is part of the text before it.
pub fn join_causes(causes: impl Iterator<Item = String>) -> String {
    causes.fold(String::new(), |text, cause| match text.as_str() {
        "" => cause,
        before if before.contains(&cause) => text,
        _ => format!("{text}: {cause}"),
    })
}

/// Prints one escaped line to stderr. Never panics: if stderr cannot be written, the line is lost.
pub fn note(text: impl Display) {
    if log::is_started() {
        log::write_plain(text);
        log::flush();
    } else {
        let _ = writeln!(std::io::stderr(), "{}", Escaped(text));
    }
}
