//! `cargo xtask pairings [--write]`: tries each ROS software with rclpy through two proxies, and
//! prints the table of `docs/ros.md`.
//!
//! The cases are those of `gdp-proxy/tests/pairings`, which CI runs in part.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result};
use serde_json::Value;

use crate::setup::{self, Purpose};
use crate::workspace::FEATURES;
use crate::workspace::{self, Profile};
use crate::{peers, shell};

#[derive(clap::Args)]
pub struct Options {
    /// Write the table into docs/ros.md, between its markers
    #[arg(long)]
    write: bool,
    /// Read the cells from this report of an earlier run, and try nothing
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
}

/// The rows: label in the report, name in the table, and the source of the version.
const ROWS: [(&str, &str, Version); 6] = [
    ("jazzy", "Jazzy: rclpy on Fast DDS", Version::Wheel("venv-jazzy", "ros_fastrtps-")),
    ("kilted", "Kilted: rclpy on Fast DDS", Version::Wheel("venv", "ros_fastdds-")),
    ("cyclone", "Cyclone DDS", Version::Wheel("venv", "cyclonedds-")),
    ("dust_dds", "dust_dds", Version::Wheel("venv", "dust_dds-")),
    ("rospy", "rospy", Version::Package("python3-rospy")),
    ("roscpp", "roscpp", Version::Package("libroscpp4d")),
];

enum Version {
    /// An installed wheel: the environment, and the start of its folder's name.
    Wheel(&'static str, &'static str),
    /// A package of Debian.
    Package(&'static str),
}

const BEGIN: &str = "<!-- cargo xtask pairings --write -->";
const END: &str = "<!-- end -->";

pub fn run(options: Options) -> Result<()> {
    let report = match options.report {
        Some(report) => report,
        None => try_all()?,
    };
    let text = fs::read_to_string(&report).with_context(|| format!("cannot read {}", report.display()))?;
    let table = table(&serde_json::from_str(&text)?)?;
    print!("{table}");
    if options.write { write(&table) } else { Ok(()) }
}

/// Runs the test that tries every cell, and returns its report.
fn try_all() -> Result<PathBuf> {
    setup::ensure(Purpose::Unit)?;
    peers::build()?;
    let report = workspace::target().join("pairings.json");
    // A report of an earlier run would be taken for this one's. It may not exist.
    _ = fs::remove_file(&report);
    let mut command = shell::cargo();
    command.args(["test", "--profile", Profile::Checked.name(), "--features", FEATURES]);
    command.args(["--test", "pairings", "--", "--nocapture"]).env("GDP_PAIRINGS_REPORT", &report);
    shell::say_and_run(&mut command)?;
    Ok(report)
}

/// Returns the table with its date, and below it a line for each cell that is not `yes`.
fn table(report: &Value) -> Result<String> {
    let columns: Vec<&str> =
        report["columns"].as_array().context("columns")?.iter().filter_map(Value::as_str).collect();
    let mut table = format!("Tried on {} through two proxies and a switch.\n\n| software |", today());
    table.extend(columns.iter().map(|column| format!(" {column} |")));
    table += &format!("\n|{}\n", " --- |".repeat(1 + columns.len()));
    let mut reasons = String::new();
    for (label, name, version) in &ROWS {
        table += &format!("| {name}{} |", version.find()?);
        let mut absent: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
        for column in &columns {
            let cell = report["rows"][*label][*column].as_str();
            let cell = cell.with_context(|| format!("the report has nothing on {label}, {column}"))?;
            table += &format!(" {} |", cell.split([' ', ':']).next().unwrap_or_default());
            if let Some(reason) = cell.strip_prefix("no: ") {
                reasons += &format!("- {name}, {column}: {reason}.\n");
            }
            if let Some(reason) = cell.strip_prefix("– (") {
                absent.entry(reason.trim_end_matches(')')).or_default().push(column);
            }
        }
        for (reason, columns) in absent {
            reasons += &format!("- {name} {reason}: {}.\n", columns.join(", "));
        }
        table.push('\n');
    }
    Ok(format!("{table}\n{reasons}"))
}

impl Version {
    fn find(&self) -> Result<String> {
        match self {
            Self::Wheel(environment, start) => {
                let folder = workspace::target().join(environment).join("lib/python3.11/site-packages");
                let entries = fs::read_dir(&folder).with_context(|| format!("cannot read {}", folder.display()))?;
                let names = entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned());
                let found = names
                    .into_iter()
                    .find_map(|name| Some(name.strip_prefix(start)?.strip_suffix(".dist-info")?.to_owned()));
                Ok(format!(" {}", found.with_context(|| format!("{start} is not in {}", folder.display()))?))
            }
            Self::Package(package) => {
                let status = fs::read_to_string("/var/lib/dpkg/status").context("the packages of Debian")?;
                let entry = status.split("\n\n").find(|entry| entry.starts_with(&format!("Package: {package}\n")));
                let version = entry.and_then(|entry| entry.lines().find_map(|line| line.strip_prefix("Version: ")));
                Ok(format!(" {}", version.with_context(|| format!("{package} is not installed"))?))
            }
        }
    }
}

fn write(table: &str) -> Result<()> {
    let path = workspace::root().join("docs/ros.md");
    let text = fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
    let replaced = replace(&text, table).with_context(|| format!("{} has no `{BEGIN}`", path.display()))?;
    fs::write(&path, replaced).with_context(|| format!("cannot write {}", path.display()))
}

fn replace(text: &str, table: &str) -> Option<String> {
    let (before, rest) = text.split_once(BEGIN)?;
    let (_, after) = rest.split_once(END)?;
    Some(format!("{before}{BEGIN}\n\n{table}\n{END}{after}"))
}

/// Returns today's date in UTC, as `YYYY-MM-DD`.
fn today() -> String {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_secs());
    let mut days = seconds / 86_400;
    let is_leap = |year: u64| year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400));
    let mut year = 1970;
    while days >= 365 + u64::from(is_leap(year)) {
        days -= 365 + u64::from(is_leap(year));
        year += 1;
    }
    let february = 28 + u64::from(is_leap(year));
    let mut month = 1;
    for length in [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31] {
        if days < length {
            break;
        }
        days -= length;
        month += 1;
    }
    format!("{year}-{month:02}-{:02}", days + 1)
}
