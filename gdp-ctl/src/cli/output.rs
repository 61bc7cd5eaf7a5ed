//! What commands print: JSON for programs, lines for people. A reader that stopped reading is no error.

use std::fs::OpenOptions;
use std::io::{ErrorKind, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use anyhow::Context;
use serde_json::Value;

pub struct Output {
    pub json: bool,
}

impl Output {
    /// Prints `value`, an object, with `"v": 1`; or, without `-j`, what `text` makes.
    pub fn print(&self, mut value: Value, text: impl FnOnce() -> String) -> anyhow::Result<()> {
        let text = if self.json {
            value["v"] = 1.into();
            value.to_string()
        } else {
            text()
        };
        let mut stdout = std::io::stdout().lock();
        match stdout.write_all(text.trim_end().as_bytes()).and_then(|()| stdout.write_all(b"\n")) {
            Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(error).context("cannot write to stdout"),
            _ => Ok(()),
        }
    }
}

/// Writes a new file that others may read; an existing one is never overwritten.
pub fn write_new(path: &Path, text: &str) -> anyhow::Result<()> {
    let mut file = OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(0o644)
        .open(path)
        .with_context(|| format!("cannot create {} (it is never overwritten)", path.display()))?;
    file.write_all(text.as_bytes()).with_context(|| format!("cannot write {}", path.display()))
}

/// Columns of equal width, left-aligned, under a heading.
pub fn table<const N: usize>(heading: [&str; N], rows: &[[String; N]]) -> String {
    let mut widths = heading.map(|h| h.chars().count());
    for row in rows {
        for (width, cell) in widths.iter_mut().zip(row) {
            *width = (*width).max(cell.chars().count());
        }
    }
    let line = |cells: [&str; N]| {
        let padded = cells.iter().zip(widths).map(|(cell, width)| format!("{cell:width$}"));
        padded.collect::<Vec<_>>().join("  ").trim_end().to_owned()
    };
    let lines = std::iter::once(line(heading)).chain(rows.iter().map(|row| line(row.each_ref().map(String::as_str))));
    lines.collect::<Vec<_>>().join("\n")
}

/// A name in a JSON value, in its short form.
pub fn short(value: &Value) -> String {
    match value.as_str() {
        Some(text) => text.parse::<gdp_wire::Name>().map_or_else(|_| text.to_owned(), |name| format!("{name:#}")),
        None => String::new(),
    }
}
