//! Measures how long each stage of a run takes.

use std::time::Instant;

use anyhow::{Context, Result};

/// The names of the stages and their durations in seconds, in order.
#[derive(Default)]
pub struct Stages(Vec<(&'static str, f64)>);

impl Stages {
    /// Runs a stage and measures it. An error names the stage.
    pub fn time<T>(&mut self, name: &'static str, run: impl FnOnce() -> Result<T>) -> Result<T> {
        eprintln!("\n== {name}");
        let begun = Instant::now();
        let result = run();
        self.0.push((name, begun.elapsed().as_secs_f64()));
        result.with_context(|| format!("on the clean root, stage `{name}`"))
    }

    /// Returns the sum of these stages in seconds, or `None` if one has not run.
    pub fn sum(&self, names: &[&str]) -> Option<f64> {
        let of = |name: &&str| self.0.iter().find(|(stage, _)| stage == name).map(|(_, seconds)| seconds);
        names.iter().map(of).sum()
    }

    pub fn print(&self) {
        println!("\n{:<24} {:>8}", "stage", "seconds");
        for (name, seconds) in &self.0 {
            println!("{name:<24} {seconds:>8.1}");
        }
        println!("{:<24} {:>8.1}", "total", self.0.iter().map(|(_, seconds)| seconds).sum::<f64>());
    }
}

#[cfg(test)]
#[path = "../../tests/unit/fresh/stages.rs"]
mod tests;
