//! Two proxies and a switch under churn: nodes come and go, and programs are killed, in an order of
//! a fixed seed. At the end every route carries, and the programs use what they used at the start.
//!
//! ```text
//!   nodes, robot r0 ── l0 s1 r0 ── l0 cloud, nodes
//! ```
//!
//! `cargo xtask soak` runs it for longer, and then it checks the bars as well.

mod site;
mod usage;

use std::fs;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use serde_json::json;

use site::{NODES, Program, Site};
use usage::Usage;

/// Seconds of the run; `GDP_SOAK_SECONDS` overrides this, and adds the bars.
const SECONDS: u64 = 30;

/// The file that receives the figures, if this variable names one.
const REPORT: &str = "GDP_SOAK_REPORT";

const SEED: u64 = 2026;

/// What a kill of a proxy may cost besides its restart.
const MISSED: Duration = Duration::from_millis(500);

/// Lines that a program may log in a minute. Three times a second a node leaves or returns, and a
/// proxy logs up to ten lines for each.
const LINES_A_MINUTE: f64 = 4000.0;

/// Longest time until everything is discovered, on two cores.
const SETTLED: Duration = Duration::from_secs(60);

#[test]
fn nodes_and_programs_come_and_go_and_every_route_still_carries() -> Result<()> {
    let wanted = std::env::var("GDP_SOAK_SECONDS").ok().and_then(|text| text.parse().ok());
    let seconds = wanted.unwrap_or(SECONDS);
    println!("seed {SEED}, {seconds} s");
    let mut site = Site::start(SEED)?;
    site.wait_for_all(NODES / 2, false)?;

    // Bounded: a round takes at least its pause.
    let pause = Duration::from_secs(if wanted.is_some() { 15 } else { 5 });
    let (begin, mut random) = (Instant::now(), Random(SEED));
    let (mut usages, mut kills) = (Vec::new(), Vec::new());
    let mut turn = Vec::new();
    while begin.elapsed() < Duration::from_secs(seconds) {
        if turn.is_empty() {
            turn = random.shuffled(Program::ALL.to_vec());
        }
        let program = turn.pop().context("a program")?;
        let kill = site.kill(program)?;
        println!("{:4} s: {kill:?}", begin.elapsed().as_secs());
        kills.push(kill);
        std::thread::sleep(pause);
        usages.push(site.usage()?);
    }

    site.wait_for_all(NODES, true)?;
    site.check_alive()?;
    let minutes = begin.elapsed().as_secs_f64() / 60.0;
    let lines = site.log_lines();
    for (program, lines) in &lines {
        println!("{program}: {:.0} lines of log a minute", *lines as f64 / minutes);
        ensure!(*lines as f64 / minutes < LINES_A_MINUTE, "{program} logs {lines} lines in {minutes:.1} minutes");
    }
    let growth = Usage::growth(&usages);
    println!("second half compared with the first quarter: {growth:?}");
    if let Ok(path) = std::env::var(REPORT) {
        let kills: Vec<_> = kills.iter().map(site::Kill::json).collect();
        let growth: Vec<_> = growth.iter().map(usage::Growth::json).collect();
        let report = json!({
            "seed": SEED, "seconds": seconds, "kills": kills, "growth": growth, "nodes": NODES,
            "log_lines": lines.iter().map(|(program, lines)| json!({"program": program, "lines": lines})).collect::<Vec<_>>(),
        });
        fs::write(&path, report.to_string()).with_context(|| format!("cannot write {path}"))?;
    }
    if wanted.is_some() {
        for kill in kills.iter().filter(|kill| kill.program.is_proxy()) {
            ensure!(kill.missed <= kill.restart + MISSED, "{kill:?}");
        }
        for growth in growth {
            ensure!(growth.is_flat(), "{growth:?}");
        }
    }
    Ok(())
}

/// Xorshift (Marsaglia 2003), so that a run can be repeated.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    fn shuffled<T>(&mut self, mut items: Vec<T>) -> Vec<T> {
        for i in (1..items.len()).rev() {
            items.swap(i, (self.next() % (i as u64 + 1)) as usize);
        }
        items
    }
}
