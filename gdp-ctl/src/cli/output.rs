//! Output of commands: JSON for programs, lines for users. In both forms, control characters in
//! foreign text are escaped before they reach a terminal.

use std::fs::OpenOptions;
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use anyhow::Context;
use gdp_proto::admin::error::{ErrorCode, ErrorReply};
use gdp_proto::admin::{self, Versioned};
use gdp_util::escape::Escaped;
use gdp_util::terminal;
use gdp_wire::Name;
use schemars::JsonSchema;
use serde::Serialize;

use crate::client::ClientError;

/// A failure that the printed output already shows, so that `-j` prints no further object.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct AlreadyPrinted(pub String);

/// Output of `-j` for a command that fails.
#[derive(Debug, Serialize, JsonSchema)]
pub struct FailureOutput {
    pub error: ErrorReply,
}

#[derive(Clone)]
pub struct Output {
    pub json: bool,
}

impl Output {
    /// Prints the object `value` with its format version, or without `-j` the `lines`. Each line is
    /// escaped as a whole, so that a line feed in a text does not start another line.
    pub fn print<T, L>(&self, value: &T, lines: impl FnOnce() -> L) -> anyhow::Result<()>
    where
        T: Serialize + JsonSchema,
        L: IntoIterator<Item = String>,
    {
        let printed = if self.json {
            terminal::print_json(&serde_json::to_string(&Versioned { v: admin::VERSION, value })?)
        } else {
            terminal::print(lines())
        };
        printed.context("cannot write to stdout")
    }

    /// Prints the reason for a failure with `-j`, unless the output already shows it.
    pub fn print_failure(&self, error: &anyhow::Error) -> anyhow::Result<()> {
        if !self.json || error.is::<AlreadyPrinted>() {
            return Ok(());
        }
        let code = error.downcast_ref().map_or(ErrorCode::Failed, ClientError::code);
        let causes: Vec<_> = error.chain().map(|cause| ErrorReply::new(code, &cause.to_string())).collect();
        let remedies: Vec<_> = causes.iter().filter_map(|cause| cause.remedy.clone()).collect();
        let remedy = Some(remedies.join("; ")).filter(|remedy| !remedy.is_empty());
        let reason = terminal::join_causes(causes.into_iter().map(|cause| cause.reason));
        self.print(&FailureOutput { error: ErrorReply { code, reason, remedy } }, || None)
    }

    /// Prints a line for users; does nothing with `-j`.
    pub fn tell(&self, line: impl FnOnce() -> String) -> anyhow::Result<()> {
        if self.json { Ok(()) } else { terminal::print([line()]).context("cannot write to stdout") }
    }
}

/// Writes a new file that other users may read. Never overwrites an existing file.
pub fn write_new(path: &Path, text: &str) -> anyhow::Result<()> {
    let mut file = OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(0o644)
        .open(path)
        .with_context(|| format!("cannot create {} (it is never overwritten)", path.display()))?;
    let written = file.write_all(text.as_bytes()).and_then(|()| gdp_util::ownership::give_file(&file, path));
    written.with_context(|| format!("cannot write {}", path.display()))
}

/// Replaces a file atomically, and keeps its permissions. A link stays, and its target is replaced.
pub fn replace(path: &Path, text: &str) -> anyhow::Result<()> {
    if gdp_util::ownership::is_foreign_link(path) {
        anyhow::bail!("{} is a symbolic link of another user, and root does not follow it", path.display());
    }
    let target = path.canonicalize().with_context(|| format!("cannot find {}", path.display()))?;
    let mut new_name = target.file_name().unwrap_or_default().to_owned();
    new_name.push(format!(".{}.tmp", std::process::id()));
    let new = target.with_file_name(new_name);
    let replaced = (|| {
        let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&new)?;
        file.set_permissions(target.metadata()?.permissions())?;
        file.write_all(text.as_bytes())?;
        file.sync_all()?;
        gdp_util::ownership::give_file(&file, &new)?;
        std::fs::rename(&new, &target)
    })();
    if replaced.is_err() {
        // The file may not exist.
        let _ = std::fs::remove_file(&new);
    }
    replaced.with_context(|| format!("cannot replace {}", path.display()))
}

/// Formats left-aligned columns under a heading. Cells are escaped before their width is measured.
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

/// Splits a text of this program, such as YAML, into lines. The text must not contain unescaped
/// line feeds of others.
pub fn lines_of(text: &str) -> Vec<String> {
    text.trim_end().lines().map(str::to_owned).collect()
}

/// Joins names in their short form.
pub fn short<'a>(names: impl IntoIterator<Item = &'a Name>) -> String {
    names.into_iter().map(|name| format!("{name:#}")).collect::<Vec<_>>().join(" ")
}

/// Returns the value as text, or a dash if there is none.
pub fn or_dash<T: ToString>(value: Option<T>) -> String {
    value.map_or_else(|| "–".to_owned(), |value| value.to_string())
}
