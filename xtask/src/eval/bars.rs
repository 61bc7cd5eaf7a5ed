//! The bars of Table I: what GDP may add to plain DDS, and what must not differ.

use std::fmt;

use anyhow::{Context as _, Result, ensure};

use super::links::LinkKind;
use super::site::Setup;
use super::table_row::TableRow;
use super::trial::{Times, Trial};
use super::workload::Workload;

/// A bar, and whether it was met.
pub struct Bar {
    what: String,
    is_met: bool,
}

impl fmt::Display for Bar {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", if self.is_met { "met" } else { "MISSED" }, self.what)
    }
}

/// The part of a total that may differ from plain DDS.
const TOTAL_SHARE: f64 = 0.05;

/// Returns all bars of these rows.
pub fn of_table(rows: &[TableRow]) -> Vec<Bar> {
    let mut bars = Vec::new();
    for row in rows.iter().filter(|row| matches!(row.setup, Setup::Gdp | Setup::Domains)) {
        let same = |setup| measured_with(rows, row, setup);
        let name = format!("{}, {} links, {}", row.of.describe(), row.links.name(), row.setup.describe());
        let mut bar = |is_met, what: String| bars.push(Bar { what: format!("{name}: {what}"), is_met });
        let Trial { lost, damaged, .. } = row.trial;
        bar(lost == 0 && damaged == 0, format!("{lost} requests lost, {damaged} damaged"));
        if let Some(zenoh) = same(Setup::Zenoh) {
            for (direction, ours, theirs) in directions(&row.trial, &zenoh.trial) {
                bar(ours <= theirs, format!("{direction} {ours:.2} ms, zenoh with TLS {theirs:.2} ms"));
            }
        }
        let Some(routers) = same(Setup::Routers) else { continue };
        if row.links == LinkKind::Plain {
            let most = row.of.paper_adds() / 10.0;
            for (direction, ours, theirs) in directions(&row.trial, &routers.trial) {
                let added = ours - theirs;
                bar(added <= most, format!("{direction} {added:.2} ms more than over routers, at most {most:.1} ms"));
            }
        }
        bar(is_close(rows, row), "total within 5 % of plain DDS, or of its slowest run".to_owned());
        if let (Some(reply), Some(local)) = (digest(row), same(Setup::RobotOnly)) {
            bar(Some(reply) == digest(local), format!("results equal those of {}", local.setup.describe()));
        }
    }
    bars
}

/// Fails if GDP lost or changed a request, or if an answer differs from that over routers.
pub fn check(rows: &[TableRow]) -> Result<()> {
    for row in rows.iter().filter(|row| matches!(row.setup, Setup::Gdp | Setup::Domains)) {
        let name = || format!("{}, {}", row.of.describe(), row.setup.describe());
        row.trial.check(row.of).with_context(name)?;
        // A reply that is lost is missing in the digest.
        let plain = measured_with(rows, row, Setup::Routers).filter(|plain| plain.trial.lost == 0);
        if let (Some(reply), Some(plain)) = (digest(row), plain) {
            ensure!(Some(reply) == digest(plain), "{}: the results differ from those over routers", name());
        }
    }
    Ok(())
}

/// Returns the row of another setup for the same workload, links and round.
fn measured_with<'a>(rows: &'a [TableRow], row: &TableRow, setup: Setup) -> Option<&'a TableRow> {
    let key = |of: &TableRow| (of.of, of.links, of.round);
    rows.iter().find(|other| other.setup == setup && key(other) == key(row))
}

/// Returns the medians of both directions, ours and theirs.
fn directions(ours: &Trial, theirs: &Trial) -> [(&'static str, f64, f64); 2] {
    [
        ("to the edge", ours.to_edge_ms.p50, theirs.to_edge_ms.p50),
        ("to the robot", ours.to_robot_ms.p50, theirs.to_robot_ms.p50),
    ]
}

/// Returns whether the median total is within 5 % of a run of plain DDS, or not above its slowest.
fn is_close(rows: &[TableRow], row: &TableRow) -> bool {
    let plain = rows.iter().filter(|other| (other.setup, other.of, other.links) == (Setup::Routers, row.of, row.links));
    let slowest = plain.map(|other| other.trial.total_ms).map(|Times { p50, .. }| p50).fold(0.0, f64::max);
    row.trial.total_ms.p50 <= slowest * (1.0 + TOTAL_SHARE)
}

/// Returns the digest of all replies. SLAM has none: its threads race, also at home.
fn digest(row: &TableRow) -> Option<&str> {
    (row.of != Workload::Slam).then(|| row.trial.result["digest"].as_str()).flatten()
}
