//! What a program uses: open descriptors and resident memory.

use std::fs;

use anyhow::{Context, Result};
use gdp_tests::process::Process;
use serde_json::{Value, json};

/// A sample of one program.
#[derive(Clone, Copy, Debug)]
pub struct Usage {
    pub program: &'static str,
    descriptors: usize,
    resident_kb: usize,
}

/// The largest samples of a program in the first quarter and in the second half.
#[derive(Clone, Copy, Debug)]
pub struct Growth {
    program: &'static str,
    descriptors: (usize, usize),
    resident_kb: (usize, usize),
}

impl Usage {
    pub fn of(program: &'static str, process: &Process) -> Result<Self> {
        let folder = format!("/proc/{}", process.pid());
        let statm = fs::read_to_string(format!("{folder}/statm")).context("statm")?;
        // The second field is in pages of 4 kB (proc_pid_statm(5)).
        let pages: usize = statm.split(' ').nth(1).context("pages")?.parse()?;
        let descriptors = fs::read_dir(format!("{folder}/fd")).context("its descriptors")?.count();
        Ok(Self { program, descriptors, resident_kb: pages * 4 })
    }

    pub fn growth(rounds: &[Vec<Self>]) -> Vec<Growth> {
        let (first, second) = (&rounds[..(rounds.len() / 4).max(1).min(rounds.len())], &rounds[rounds.len() / 2..]);
        let programs = rounds.first().map(|round| round.iter().map(|usage| usage.program)).into_iter().flatten();
        let most = |rounds: &[Vec<Self>], program, of: fn(&Self) -> usize| {
            rounds.iter().flatten().filter(|usage| usage.program == program).map(of).max().unwrap_or(0)
        };
        let of = |program, value| (most(first, program, value), most(second, program, value));
        programs
            .map(|program| Growth {
                program,
                descriptors: of(program, |usage| usage.descriptors),
                resident_kb: of(program, |usage| usage.resident_kb),
            })
            .collect()
    }
}

impl Growth {
    /// Returns whether descriptors grew by 5 % at most and memory by 10 %.
    pub fn is_flat(&self) -> bool {
        self.descriptors.1 * 100 <= self.descriptors.0 * 105 && self.resident_kb.1 * 10 <= self.resident_kb.0 * 11
    }

    pub fn json(&self) -> Value {
        json!({"program": self.program, "descriptors": self.descriptors, "resident_kb": self.resident_kb})
    }
}
