//! Measured rows as JSON lines, in `target/eval`.

use std::fs::File;
use std::io::Write as _;
use std::path::PathBuf;

use anyhow::{Context, Result};
use serde::Serialize;
use serde_json::Value;

use crate::workspace;

pub struct RawRows {
    path: PathBuf,
    file: File,
}

impl RawRows {
    /// Creates `NAME.jsonl`, or empties it.
    pub fn create(name: &str) -> Result<Self> {
        let folder = workspace::target().join("eval");
        std::fs::create_dir_all(&folder).with_context(|| format!("cannot create {}", folder.display()))?;
        let path = folder.join(format!("{name}.jsonl"));
        let file = File::create(&path).with_context(|| format!("cannot create {}", path.display()))?;
        Ok(Self { path, file })
    }

    pub fn write(&mut self, row: &impl Serialize) -> Result<()> {
        let line = serde_json::to_string(row)?;
        writeln!(self.file, "{line}").with_context(|| format!("cannot write {}", self.path.display()))
    }

    /// Says where the rows are.
    pub fn finish(self) {
        eprintln!("all rows: {}", self.path.display());
    }
}

/// Writes these rows and their summary to `NAME.jsonl`, and with `json` also to stdout.
pub fn write_all(name: &str, rows: &[impl Serialize], summary: &Value, json: bool) -> Result<()> {
    let mut raw = RawRows::create(name)?;
    rows.iter().try_for_each(|row| raw.write(row))?;
    raw.write(summary)?;
    raw.finish();
    if json {
        rows.iter().try_for_each(|row| serde_json::to_string(row).map(|line| println!("{line}")))?;
        println!("{summary}");
    }
    Ok(())
}
