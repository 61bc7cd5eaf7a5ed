//! Lines for people, on stdout and stderr. Whatever a stranger wrote stays on the line and is shown
//! as text.

use std::fmt::Display;
use std::io::{ErrorKind, Result, Write};

use crate::escape::{Escaped, escape_json};
use crate::log;

/// Prints lines, each escaped as a whole but for tabs that indent it. A reader that stopped reading
/// is no error.
pub fn print(lines: impl IntoIterator<Item = impl Display>) -> Result<()> {
    write(&lines.into_iter().map(|line| escape_line(&line.to_string())).collect::<String>())
}

fn escape_line(line: &str) -> String {
    let text = line.trim_start_matches('\t');
    let (indent, _) = line.split_at(line.len() - text.len());
    format!("{indent}{}\n", Escaped(text))
}

/// Prints JSON text and a line feed. A reader that stopped reading is no error.
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

/// Tells the user something on stderr, on one line. Never panics: where stderr cannot be written it
/// is lost.
pub fn note(text: impl Display) {
    if log::is_started() {
        log::write_plain(text);
        log::flush();
    } else {
        let _ = writeln!(std::io::stderr(), "{}", Escaped(text));
    }
}
