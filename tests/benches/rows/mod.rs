//! The options of a benchmark that has rows.

use std::path::PathBuf;

use gdp_tests::measure::Wanted;

#[derive(clap::Args)]
pub struct Rows {
    /// Row to measure; repeat for several. Default: all rows
    #[arg(long)]
    only: Vec<String>,
    /// Print one JSON object on stdout instead of tables
    #[arg(long)]
    json: bool,
    /// Folder for the plots
    #[arg(long)]
    plots: Option<PathBuf>,
    /// Argument that cargo passes to every benchmark
    #[arg(long = "bench", hide = true)]
    _cargo: bool,
}

impl Rows {
    pub fn wanted(&self) -> Wanted<'_> {
        Wanted { only: &self.only, json: self.json, plots: self.plots.as_deref() }
    }
}
