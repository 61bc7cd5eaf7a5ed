//! The rows of Table I, and how they are printed.

use serde::Serialize;

use super::links::LinkKind;
use super::site::Setup;
use super::stages::Stages;
use super::trial::{Times, Trial};
use super::workload::Workload;

/// One line of the table.
#[derive(Serialize)]
pub struct TableRow {
    pub workload: &'static str,
    #[serde(skip)]
    pub of: Workload,
    pub setup: Setup,
    pub links: LinkKind,
    pub round: u32,
    #[serde(flatten)]
    pub trial: Trial,
}

/// Prints all rows as a table of Markdown.
pub fn print_table(rows: &[TableRow]) {
    println!(
        "| workload | links | setup | answered | to the edge | compute | to the robot | total | robot's CPU | \
         wake-ups/s | uplink | result |"
    );
    println!("|{}", " --- |".repeat(12));
    for TableRow { of, setup, links, trial, .. } in rows {
        let times = |Times { p50, p99 }| format!("{p50:.1} ({p99:.1})");
        println!(
            "| {} | {} | {} | {}/{} | {} | {} | {} | {} | {:.1} ms | {:.0} | {:.2} MB | {} |",
            of.describe(),
            links.name(),
            setup.describe(),
            trial.requests - trial.lost,
            trial.requests,
            times(trial.to_edge_ms),
            times(trial.compute_ms),
            times(trial.to_robot_ms),
            times(trial.total_ms),
            trial.robot_cpu_ms,
            trial.robot_wakeups,
            trial.uplink_bytes / 1e6,
            if trial.is_comparable { of.result(&trial.result) } else { "not comparable".to_owned() },
        );
    }
    println!("Times in milliseconds, median and (p99). CPU and uplink per request.\n");
    println!("| workload | setup | topic | robot's DDS | seal, sign, send | proxy to proxy | write into DDS |");
    println!("|{}", " --- |".repeat(7));
    for TableRow { of, setup, links, trial, .. } in rows {
        for Stages { topic, dds_ms, send_ms, fabric_ms, write_ms } in &trial.stages {
            let stages = [dds_ms, send_ms, fabric_ms, write_ms];
            let shown = stages.map(|time| time.map_or_else(|| "-".to_owned(), |time| format!("{time:.1}")));
            let (setup, links) = (setup.describe(), links.name());
            println!("| {} | {setup}, {links} links | {topic} | {} |", of.describe(), shown.join(" | "));
        }
    }
    println!("Medians in milliseconds, by the proxies' statistics. The third contains the second.\n");
}
