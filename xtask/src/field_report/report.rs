//! The table to send in, and the rows behind it.

use std::fmt;
use std::fs::File;
use std::io::Write as _;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result};
use gdp_tests::peers::percentile;
use serde_json::json;

use super::nic::MachineFacts;

/// The replies to requests of one size over one path in one round.
pub struct RoundTrips {
    pub bytes: usize,
    pub path: &'static str,
    pub round: usize,
    /// Requests without a reply.
    pub lost: usize,
    /// Replies with other bytes than their requests.
    pub damaged: usize,
    /// In ascending order.
    pub times: Vec<Duration>,
}

/// All rows, and the machines that they are of.
pub struct FieldReport {
    pub rows: Vec<RoundTrips>,
    pub robot: MachineFacts,
    pub edge: MachineFacts,
    pub data_plane: String,
}

impl FieldReport {
    /// Writes one JSON object a row, and first one with both machines.
    pub fn write(&self, path: &Path) -> Result<()> {
        let machines = json!({"robot": self.robot, "edge": self.edge, "data_plane": self.data_plane});
        let rows = self.rows.iter().map(|RoundTrips { bytes, path, round, lost, damaged, times }| {
            let ms: Vec<f64> = times.iter().copied().map(milliseconds).collect();
            json!({"bytes": bytes, "path": path, "round": round, "lost": lost, "damaged": damaged, "ms": ms})
        });
        let write = || {
            let mut file = File::create(path)?;
            [machines].into_iter().chain(rows).try_for_each(|row| writeln!(file, "{row}"))
        };
        write().with_context(|| format!("cannot write {}", path.display()))?;
        eprintln!("all rows: {}", path.display());
        Ok(())
    }

    /// Returns the replies of a size over a path in all rounds together.
    fn merged(&self, bytes: usize, path: &'static str) -> RoundTrips {
        let mut all = RoundTrips { bytes, path, round: 0, lost: 0, damaged: 0, times: Vec::new() };
        for row in self.rows.iter().filter(|row| (row.bytes, row.path) == (bytes, path)) {
            all.lost += row.lost;
            all.damaged += row.damaged;
            all.times.extend(&row.times);
        }
        all.times.sort();
        all
    }

    /// Returns whether every row has replies, and none was damaged.
    pub fn is_whole(&self) -> bool {
        !self.rows.is_empty() && self.rows.iter().all(|row| !row.times.is_empty() && row.damaged == 0)
    }
}

impl RoundTrips {
    /// Returns a percentile in milliseconds, if there was a reply.
    fn at(&self, percent: f64) -> Option<f64> {
        (!self.times.is_empty()).then(|| milliseconds(percentile(&self.times, percent)))
    }
}

impl fmt::Display for FieldReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "| size | DDS median, p99 | GDP median, p99 | GDP/DDS | lost: DDS, GDP |")?;
        writeln!(f, "|{}", " --- |".repeat(5))?;
        let mut sizes: Vec<usize> = self.rows.iter().map(|row| row.bytes).collect();
        sizes.sort_unstable();
        sizes.dedup();
        let mut damaged = 0;
        for bytes in sizes {
            let [dds, gdp] = ["dds", "gdp"].map(|path| self.merged(bytes, path));
            let times = |of: &RoundTrips| match (of.at(50.0), of.at(99.0)) {
                (Some(median), Some(p99)) => format!("{median:.2}, {p99:.2}"),
                _ => "no reply".to_owned(),
            };
            let ratio = gdp.at(50.0).zip(dds.at(50.0)).map_or_else(|| "-".to_owned(), |(a, b)| format!("{:.2}", a / b));
            let lost = |of: &RoundTrips| format!("{} of {}", of.lost, of.lost + of.times.len());
            let (of_dds, of_gdp) = (times(&dds), times(&gdp));
            writeln!(f, "| {} | {of_dds} | {of_gdp} | {ratio} | {}, {} |", size(bytes), lost(&dds), lost(&gdp))?;
            damaged += dds.damaged + gdp.damaged;
        }
        writeln!(f, "\nRound trips in milliseconds, by the robot's clock.\n")?;
        writeln!(f, "- robot: {}", self.robot)?;
        writeln!(f, "- edge: {}, data plane {}", self.edge, self.data_plane)?;
        if damaged > 0 {
            writeln!(f, "- DAMAGED: {damaged} replies had other bytes than their requests")?;
        }
        let mut drivers: Vec<&str> =
            [&self.robot, &self.edge].into_iter().filter_map(MachineFacts::virtual_driver).collect();
        drivers.dedup();
        drivers.iter().try_for_each(|driver| writeln!(f, "- {}", mark(driver)))
    }
}

/// The mark of figures that are not of hardware.
pub fn mark(driver: &str) -> String {
    format!("{driver}: these are not figures of a NIC")
}

fn size(bytes: usize) -> String {
    match bytes {
        1_000_000.. => format!("{} MB", bytes / 1_000_000),
        1_000.. => format!("{} kB", bytes / 1_000),
        _ => format!("{bytes} B"),
    }
}

fn milliseconds(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}

#[cfg(test)]
#[path = "../../tests/unit/field_report/report.rs"]
mod tests;
