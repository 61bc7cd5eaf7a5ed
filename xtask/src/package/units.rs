//! Checks the units of systemd: their syntax, and how much of the system each can reach.

use std::fs;

use anyhow::{Context, Result, ensure};
use gdp_tests::netns::execute;
use gdp_tests::programs::{Executable as _, Program};

use super::build::packaging;

/// The exposure that a unit may have, of 10: "OK" in the words of systemd-analyze is below 5.
const EXPOSURE: f64 = 3.0;

/// The capabilities of a switch, and of no other unit.
const SWITCH: &str = "CAP_BPF CAP_PERFMON CAP_NET_ADMIN CAP_NET_RAW";

/// Prints the exposure of each unit, and fails if one has too much.
pub fn check() -> Result<()> {
    let copies = tempfile::tempdir()?;
    let folder = packaging("systemd");
    let listed = fs::read_dir(&folder).with_context(|| format!("cannot read {}", folder.display()))?;
    let mut names: Vec<_> = listed.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    for name in &names {
        let text = fs::read_to_string(folder.join(name))?;
        let needed = if name == "gdp-switch.service" { SWITCH } else { "" };
        ensure!(setting(&text, "CapabilityBoundingSet") == Some(needed), "{name}: its capabilities are others");
        ensure!(setting(&text, "User") == Some("gdp"), "{name} runs as another user");
        // The programs need not be installed here.
        let program = |line: &str| match line.starts_with("ExecStart=") {
            true => "ExecStart=/bin/true".to_owned(),
            false => line.to_owned(),
        };
        let text: Vec<String> = text.lines().map(program).collect();
        fs::write(copies.path().join(name), text.join("\n") + "\n")?;
    }
    for name in &names {
        // A template is looked at as an instance.
        let of = copies.path().join(name.replace("@.", "@home-server."));
        if name.contains('@') {
            fs::copy(copies.path().join(name), &of)?;
        }
        let mut verify = Program::SystemdAnalyze.command();
        let said = verify.args(["verify", "--man=no", "--recursive-errors=no"]).arg(&of).output()?;
        let complaints = String::from_utf8_lossy(&said.stderr).into_owned();
        ensure!(said.status.success() && complaints.is_empty(), "{name}: {complaints}");
        let mut security = Program::SystemdAnalyze.command();
        security.args(["security", "--offline=true", "--no-pager", "--json=off"]).arg(&of);
        let exposure = exposure(&execute(&mut security)?).with_context(|| format!("{name}: no score"))?;
        println!("{name:<20} exposure {exposure:.1} of 10");
        ensure!(exposure <= EXPOSURE, "{name}: an exposure of {exposure}, and {EXPOSURE} is the most");
    }
    Ok(())
}

/// Returns the value of a setting.
pub fn setting<'a>(unit: &'a str, key: &str) -> Option<&'a str> {
    unit.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix('='))
}

/// Returns the score at the end of the report.
fn exposure(report: &str) -> Option<f64> {
    let line = report.lines().find(|line| line.contains("Overall exposure level"))?;
    line.split_once(": ")?.1.split_whitespace().next()?.parse().ok()
}

#[cfg(test)]
#[path = "../../tests/unit/package/units.rs"]
mod tests;
