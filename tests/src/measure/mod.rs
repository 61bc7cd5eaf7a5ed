//! Parts of benchmarks: contenders measured in turn, figures, and their output.
//!
//! - [`rounds`]: measuring in turn; [`cpu`]: CPU assignment; [`figure`]: results
//! - [`table`] and [`plot`] (on [`svg`]) render figures; [`run`] runs rows and does both

pub mod cpu;
pub mod figure;
pub mod plot;
pub mod rounds;
mod svg;
mod table;

use std::path::Path;

use anyhow::{Context, Result, bail};

use figure::{Figure, Report};

/// A function from a benchmark's options to the figures of one row.
pub type Row<B> = fn(&B) -> Result<Vec<Figure>>;

/// The rows to measure and the form of the output.
pub struct Wanted<'a> {
    /// Names of rows; empty: all.
    pub only: &'a [String],
    /// One JSON object on stdout instead of tables.
    pub json: bool,
    /// A folder to draw plots into.
    pub plots: Option<&'a Path>,
}

/// Measures the selected rows one after the other.
pub fn run<B>(bench: &B, rows: &[(&str, Row<B>)], wanted: &Wanted) -> Result<()> {
    if let Some(unknown) = wanted.only.iter().find(|only| rows.iter().all(|(name, _)| name != only)) {
        bail!("no row `{unknown}`; there are {}", rows.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", "));
    }
    let mut figures = Vec::new();
    for (name, row) in rows {
        if wanted.only.is_empty() || wanted.only.iter().any(|only| only == name) {
            let row = row(bench).with_context(|| format!("row {name}"))?;
            if !wanted.json {
                row.iter().for_each(|figure| print!("{figure}"));
            }
            figures.extend(row);
        }
    }
    finish(figures, wanted)
}

/// Prints figures that were measured together, and draws them.
pub fn report(figures: Vec<Figure>, wanted: &Wanted) -> Result<()> {
    if !wanted.json {
        figures.iter().for_each(|figure| print!("{figure}"));
    }
    finish(figures, wanted)
}

/// Draws the figures, and prints them all as JSON.
fn finish(figures: Vec<Figure>, wanted: &Wanted) -> Result<()> {
    if let Some(folder) = wanted.plots {
        plot::draw(&figures, folder)?;
    }
    if wanted.json {
        println!("{}", serde_json::to_string_pretty(&Report::new(figures)?)?);
    }
    Ok(())
}
