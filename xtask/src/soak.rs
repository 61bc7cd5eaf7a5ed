//! `cargo xtask soak --minutes 30`: runs proxies and a switch under churn and kills, and checks
//! that they use no more at the end. It is the test that CI runs for half a minute
//! (`tests/tests/networks/soak`), for longer and with the bars.

use std::fs;

use anyhow::{Context, Result};
use gdp_tests::programs::own;
use serde_json::Value;

use crate::{shell, workspace};

#[derive(clap::Args)]
pub struct Options {
    /// Duration in minutes
    #[arg(long, default_value_t = 30)]
    minutes: u64,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
}

pub fn run(options: Options) -> Result<()> {
    let report = workspace::target().join("soak.json");
    // A report of an earlier run would look like one of this run.
    if report.exists() {
        fs::remove_file(&report).with_context(|| format!("cannot remove {}", report.display()))?;
    }
    let mut command = own(std::env::current_exe().context("the path of xtask")?);
    command.args(["test", "--root", "soak"]).current_dir(workspace::root());
    command.env("GDP_SOAK_SECONDS", (60 * options.minutes).to_string()).env("GDP_SOAK_REPORT", &report);
    let result = shell::say_and_run(&mut command);
    if let Ok(text) = fs::read_to_string(&report) {
        let figures: Value = serde_json::from_str(&text).with_context(|| format!("{}", report.display()))?;
        if options.json { println!("{figures:#}") } else { print(&figures) }
    }
    result
}

/// Prints the figures that have a bar.
fn print(figures: &Value) {
    println!("seed {}, {} s, {} nodes found at the end", figures["seed"], figures["seconds"], figures["nodes"]);
    for kill in figures["kills"].as_array().into_iter().flatten() {
        let seconds = |key: &str| kill[key].as_f64().unwrap_or_default();
        let (missed, restart) = (seconds("missed_s"), seconds("restart_s"));
        println!("kill -9 of {}: {missed:.2} s missed, {restart:.2} s restart", kill["program"]);
    }
    for growth in figures["growth"].as_array().into_iter().flatten() {
        println!(
            "{}: descriptors {}, resident kB {} (first quarter, second half)",
            growth["program"], growth["descriptors"], growth["resident_kb"]
        );
    }
}
