//! Debian's changelog of the packages, from `CHANGELOG.md`.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result, ensure};

use crate::workspace;

const COLUMNS: usize = 79;

/// Who makes the packages.
pub const MAINTAINER: &str = "The GDP developers <gdp@packages.invalid>";

/// Writes the changelog. Its newest version is `version`, even if `CHANGELOG.md` does not have it:
/// a package of a version between two releases.
pub fn write(version: &str, to: &Path) -> Result<()> {
    let source = workspace::root().join("CHANGELOG.md");
    let text = fs::read_to_string(&source).with_context(|| format!("cannot read {}", source.display()))?;
    fs::write(to, debian(&text, version)?).with_context(|| format!("cannot write {}", to.display()))
}

/// Converts a changelog of keepachangelog.com.
fn debian(text: &str, version: &str) -> Result<String> {
    let mut entries = entries(text)?;
    let (newest, date, _) = entries.first().context("CHANGELOG.md has no version")?;
    if newest != version {
        let changes = vec![format!("Made from the source after {newest}.")];
        entries.insert(0, (version.to_owned(), date.clone(), changes));
    }
    let mut out = String::new();
    let count = entries.len();
    for (at, (version, date, changes)) in entries.into_iter().enumerate() {
        // A later entry of one day needs a later time.
        let second = count - at - 1;
        writeln!(out, "gdp ({version}-1) unstable; urgency=medium\n")?;
        changes.iter().for_each(|change| out.push_str(&wrapped(change)));
        writeln!(out, "\n -- {MAINTAINER}  {} 00:00:{second:02} +0000\n", rfc_2822(&date)?)?;
    }
    Ok(out)
}

/// Returns a change as Debian's lines of at most 80 columns.
fn wrapped(change: &str) -> String {
    let (mut out, mut line) = (String::new(), "  *".to_owned());
    for word in change.split_whitespace() {
        if line.len() + 1 + word.len() > COLUMNS {
            out.push_str(&line);
            out.push('\n');
            line = "   ".to_owned();
        }
        line.push(' ');
        line.push_str(word);
    }
    out + &line + "\n"
}

/// Returns version, date and changes of each release, the newest first.
fn entries(text: &str) -> Result<Vec<(String, String, Vec<String>)>> {
    let mut entries: Vec<(String, String, Vec<String>)> = Vec::new();
    for line in text.lines() {
        if let Some(head) = line.strip_prefix("## [") {
            let (version, date) = head.split_once("] - ").with_context(|| format!("no date: {line}"))?;
            entries.push((version.to_owned(), date.trim().to_owned(), Vec::new()));
        } else if let (Some((_, _, changes)), Some(change)) = (entries.last_mut(), line.strip_prefix("- ")) {
            changes.push(change.to_owned());
        } else if let (Some((_, _, changes)), Some(more)) = (entries.last_mut(), line.strip_prefix("  "))
            && let Some(change) = changes.last_mut()
        {
            change.push(' ');
            change.push_str(more.trim());
        }
    }
    Ok(entries)
}

/// Returns a date such as 2026-11-26 as `Thu, 26 Nov 2026`.
fn rfc_2822(date: &str) -> Result<String> {
    const DAYS: [&str; 7] = ["Sun", "Mon", "Tue", "Wed", "Thu", "Fri", "Sat"];
    const MONTHS: [&str; 12] = ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"];
    let numbers: Vec<usize> = date.split('-').map(str::parse).collect::<Result<_, _>>().context(date.to_owned())?;
    let [year, month, day] = numbers[..] else { anyhow::bail!("{date} is no date") };
    ensure!((1..=12).contains(&month) && (1..=31).contains(&day), "{date} is no date");
    // Sakamoto's method.
    let offset = [0, 3, 2, 5, 0, 3, 5, 1, 4, 6, 2, 4][month - 1];
    let year_of = if month < 3 { year - 1 } else { year };
    let weekday = (year_of + year_of / 4 - year_of / 100 + year_of / 400 + offset + day) % 7;
    Ok(format!("{}, {day:02} {} {year}", DAYS[weekday], MONTHS[month - 1]))
}

#[cfg(test)]
#[path = "../../tests/unit/package/changelog.rs"]
mod tests;
