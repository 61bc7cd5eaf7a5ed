//! What commands print: JSON for programs, lines for people. Either way no text of a stranger
//! reaches a terminal unescaped.

use std::fs::OpenOptions;
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use anyhow::Context;
use gdp_util::escape::Escaped;
use gdp_util::terminal;
use serde_json::Value;

pub struct Output {
    pub json: bool,
}

impl Output {
    /// Prints `value`, an object, with `"v": 1`; or, without `-j`, the `lines`. Each is escaped as
    /// a whole, so that a line feed in a text does not make another line.
    pub fn print<L>(&self, mut value: Value, lines: impl FnOnce() -> L) -> anyhow::Result<()>
    where
        L: IntoIterator<Item = String>,
    {
        let printed = if self.json {
            value["v"] = 1.into();
            terminal::print_json(&value.to_string())
        } else {
            terminal::print(lines())
        };
        printed.context("cannot write to stdout")
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

/// Lines of columns of equal width, left-aligned, under a heading. Cells are escaped before they
/// are measured.
pub fn table<const N: usize>(heading: [&str; N], rows: &[[String; N]]) -> Vec<String> {
    let escaped = |row: &[String; N]| row.each_ref().map(|cell| Escaped(cell).to_string());
    let rows: Vec<[String; N]> = std::iter::once(heading.map(str::to_owned)).chain(rows.iter().map(escaped)).collect();
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or_default();
    let widths: [usize; N] = std::array::from_fn(width);
    let line = |row: &[String; N]| {
        let padded = row.iter().zip(widths).map(|(cell, width)| format!("{cell:width$}"));
        padded.collect::<Vec<_>>().join("  ").trim_end().to_owned()
    };
    rows.iter().map(line).collect()
}

/// Lines of a text that was made here, such as YAML, and in which nobody else's line feeds are
/// left.
pub fn lines_of(text: &str) -> Vec<String> {
    text.trim_end().lines().map(str::to_owned).collect()
}

/// A name in a JSON value, in its short form.
pub fn short(value: &Value) -> String {
    match value.as_str() {
        Some(text) => text.parse::<gdp_wire::Name>().map_or_else(|_| text.to_owned(), |name| format!("{name:#}")),
        None => String::new(),
    }
}
