//! The figure: rates, and what XDP gains over the others.

use std::fmt;

use serde::Serialize;

use crate::fib::FibFigures;
use crate::path::Kind;
use crate::traffic::Rate;

#[derive(Serialize)]
pub struct Report {
    /// Version of this schema.
    v: u32,
    rows: Vec<Row>,
    ratios: Vec<Ratio>,
    fib: FibFigures,
}

/// All measurements of one path at one size.
#[derive(Serialize)]
pub struct Row {
    kind: Kind,
    hops: usize,
    /// Bytes behind the GDP header.
    payload: usize,
    /// Bytes on the cable, Ethernet header included.
    frame: usize,
    /// Frames per second: the median of the rounds.
    pps: f64,
    min_pps: f64,
    max_pps: f64,
    lost_percent: f64,
    #[serde(skip)]
    rounds: Vec<Rate>,
}

/// How many times the frames per second of `over` XDP forwards: the median of the rounds' ratios.
#[derive(Serialize)]
struct Ratio {
    over: Kind,
    hops: usize,
    payload: usize,
    times: f64,
}

impl Row {
    pub fn new(kind: Kind, hops: usize, payload: usize) -> Self {
        let frame = 14 + gdp_wire::Header::LEN + payload;
        let (pps, min_pps, max_pps, lost_percent) = (0.0, 0.0, 0.0, 0.0);
        Self { kind, hops, payload, frame, pps, min_pps, max_pps, lost_percent, rounds: Vec::new() }
    }

    pub fn add(&mut self, rate: Rate) {
        self.rounds.push(rate);
    }

    fn summarise(&mut self) {
        let rates = sorted(self.rounds.iter().map(|rate| rate.pps));
        (self.pps, self.min_pps, self.max_pps) = (median(&rates), rates[0], rates[rates.len() - 1]);
        let (sent, lost) = self.rounds.iter().fold((0, 0), |(sent, lost), rate| (sent + rate.sent, lost + rate.lost));
        self.lost_percent = 100.0 * lost as f64 / sent as f64;
    }
}

impl Report {
    /// Every row must have at least one round.
    pub fn new(mut rows: Vec<Row>, fib: FibFigures) -> Self {
        rows.iter_mut().for_each(Row::summarise);
        let mut ratios = Vec::new();
        for xdp in rows.iter().filter(|row| row.kind == Kind::Xdp) {
            let same = |row: &&Row| (row.hops, row.payload) == (xdp.hops, xdp.payload) && row.kind != Kind::Xdp;
            for other in rows.iter().filter(same) {
                let rounds = xdp.rounds.iter().zip(&other.rounds).map(|(ours, theirs)| ours.pps / theirs.pps);
                let times = median(&sorted(rounds));
                ratios.push(Ratio { over: other.kind, hops: xdp.hops, payload: xdp.payload, times });
            }
        }
        Self { v: 2, rows, ratios, fib }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{:<11}{:>5}{:>8}{:>11}{:>22}{:>8}", "plane", "hops", "bytes", "Mpps", "min … max", "lost")?;
        for row in &self.rows {
            let [pps, min, max] = [row.pps, row.min_pps, row.max_pps].map(|pps| pps / 1e6);
            let (kind, range) = (row.kind.as_str(), format!("{min:.3} … {max:.3}"));
            writeln!(f, "{kind:<11}{:>5}{:>8}{pps:>11.3}{range:>22}{:>7.2}%", row.hops, row.frame, row.lost_percent)?;
        }
        for ratio in &self.ratios {
            let (over, hops) = (ratio.over.as_str(), ratio.hops);
            writeln!(f, "XDP over {over}, {hops} hops, {} B of payload: {:.1} ×", ratio.payload, ratio.times)?;
        }
        write!(f, "{}", self.fib)
    }
}

impl Kind {
    fn as_str(self) -> &'static str {
        match self {
            Self::Xdp => "XDP",
            Self::Ip => "kernel IP",
            Self::Userspace => "userspace",
        }
    }
}

fn sorted(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values
}

/// Of sorted values, at least one.
fn median(sorted: &[f64]) -> f64 {
    let middle = sorted.len() / 2;
    if sorted.len() % 2 == 1 { sorted[middle] } else { (sorted[middle - 1] + sorted[middle]) / 2.0 }
}
