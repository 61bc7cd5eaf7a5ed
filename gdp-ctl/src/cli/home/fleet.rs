//! `gdp-ctl apply`: makes the members of the domain those of a file. It shows the difference first.
//!
//! Whoever is new in the file is invited, and whoever is not in it is revoked. Members whose topics
//! differ are enrolled anew, without joining again.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, anyhow, bail};
use clap::Args;
use gdp_core::cert::{Enrollment, TopicsOf, issue};
use gdp_util::terminal::note;
use gdp_util::unix_time::unix_seconds;
use gdp_util::{text_file, yaml};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::invite::{Terms, check_free, check_pattern, imported, topics_of};
use super::renewals::RENEWABLE;
use super::{HOUR, Home, HomeOptions, files};
use crate::cli::context::Context;
use crate::cli::issuing::parse_seconds;
use gdp_directory::SERVER;

/// Maximum size of a file, in bytes.
const MAX_FILE: u64 = 1 << 20;

#[derive(Debug, Args)]
pub struct Options {
    /// File of the fleet (YAML).
    #[arg(short, long, value_name = "FILE")]
    file: PathBuf,
    /// Make the difference. Without this, it is only shown.
    #[arg(long)]
    yes: bool,
    #[command(flatten)]
    home: HomeOptions,
}

/// The file.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Fleet {
    /// The version of the format, 1.
    version: u64,
    /// The members by their labels.
    members: BTreeMap<String, MemberTerms>,
}

/// A member in the file. The keys are those of `gdp-ctl invite`.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct MemberTerms {
    /// Patterns of topics that others may read, such as `/camera/**`.
    #[serde(default)]
    expose: Vec<String>,
    /// Patterns of topics to get from the server.
    #[serde(default)]
    import: Vec<String>,
    /// Topics of others to read, such as `robot7:/camera/**`.
    #[serde(default)]
    read: Vec<String>,
    /// How long the membership lasts, such as `7d`. By default 365 days.
    #[serde(default, rename = "for")]
    duration: Option<String>,
    /// The role of the membership, for grants that name one.
    #[serde(default)]
    role: Option<String>,
}

/// Output of `gdp-ctl apply`: one object for each difference.
#[derive(Debug, Serialize, JsonSchema)]
pub struct ApplyOutput {
    label: String,
    /// `invite`, `enroll` or `revoke`.
    change: &'static str,
    /// Whether it is made.
    done: bool,
    /// The line of an invitation, which is a secret. Only if it is made.
    line: Option<String>,
}

enum Difference {
    Invite(Terms),
    Enroll(Enrollment),
    Revoke,
}

impl Difference {
    fn as_str(&self) -> &'static str {
        match self {
            Self::Invite(_) => "invite",
            Self::Enroll(_) => "enroll",
            Self::Revoke => "revoke",
        }
    }
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let home = options.home.home()?;
    let fleet = load(&options.file)?;
    let changes = changes(&home, fleet)?;
    if changes.is_empty() {
        note("gdp-ctl: no difference");
    }
    let gone = changes.iter().filter(|(_, change)| matches!(change, Difference::Revoke));
    let gone: Vec<String> = gone.map(|(label, _)| label.clone()).collect();
    // First, because another change may fail.
    if options.yes && !gone.is_empty() {
        super::revoke::revoke(&home, &gone, context)?;
    }
    for (label, change) in changes {
        let kind = change.as_str();
        let line = match change {
            Difference::Invite(terms) if options.yes => {
                let address = home.address()?;
                let (token, _) = home.invite(terms, address.target()?, address.switch)?;
                let token = token.also(address.tls_targets()?);
                Some(token.to_line().to_string())
            }
            Difference::Enroll(enrollment) if options.yes => {
                home.reenroll(enrollment)?;
                None
            }
            _ => None,
        };
        let output = ApplyOutput { label, change: kind, done: options.yes, line };
        context.output.print(&output, || {
            let line = output.line.as_ref().map_or(String::new(), |line| format!(" {line}"));
            [format!("{kind} {}{line}", output.label)]
        })?;
    }
    if !options.yes {
        note("gdp-ctl: nothing is done; add --yes to make this so");
    }
    Ok(())
}

fn load(path: &Path) -> anyhow::Result<Fleet> {
    let text = text_file::read(path, MAX_FILE).with_context(|| format!("{}: cannot be read", path.display()))?;
    let Some(text) = text else { bail!("{}: longer than {MAX_FILE} bytes, so not a fleet", path.display()) };
    let fleet: Fleet = yaml::parse(&text).map_err(|error| anyhow!("{}: {error}", path.display()))?;
    match fleet.version {
        1 => Ok(fleet),
        other => bail!("{}: version {other} is not known to this release; write version: 1", path.display()),
    }
}

/// Returns the differences between the domain and the file, in the order of labels.
fn changes(home: &Home, fleet: Fleet) -> anyhow::Result<Vec<(String, Difference)>> {
    let known: BTreeMap<String, Enrollment> = home.enrolled()?;
    let mut changes = Vec::new();
    let gone = known.keys().filter(|label| *label != SERVER && !fleet.members.contains_key(*label));
    changes.extend(gone.map(|label| (label.clone(), Difference::Revoke)));
    for (label, wanted) in fleet.members {
        let (terms, enrollment) = (terms(&label, wanted).with_context(|| label.clone())?, known.get(&label));
        let same = |enrollment: &Enrollment| {
            (&enrollment.expose, &enrollment.import, &enrollment.read) == (&terms.expose, &terms.import, &terms.read)
        };
        match enrollment {
            None => changes.push((label, Difference::Invite(terms))),
            Some(enrollment) if same(enrollment) => {}
            Some(enrollment) => {
                let Terms { expose, import, read, .. } = terms;
                let enrollment = Enrollment { expose, import, read, ..enrollment.clone() };
                changes.push((label, Difference::Enroll(enrollment)));
            }
        }
    }
    changes.sort_by(|(a, _), (b, _)| a.cmp(b));
    Ok(changes)
}

fn terms(label: &str, wanted: MemberTerms) -> anyhow::Result<Terms> {
    let MemberTerms { expose, import, read, duration, role } = wanted;
    check_free(label)?;
    expose.iter().try_for_each(|pattern| check_pattern(pattern))?;
    let duration = duration.map_or(Ok(RENEWABLE), |text| parse_seconds(&text).map(u64::from));
    Ok(Terms {
        label: label.into(),
        role: role.unwrap_or_else(|| "robot".into()),
        expose,
        import: imported(label, &import)?,
        read: read.iter().map(|text| topics_of(text)).collect::<anyhow::Result<Vec<TopicsOf>>>()?,
        duration: duration.map_err(anyhow::Error::msg)?,
        within: 24 * HOUR,
    })
}

impl Home {
    /// Signs other topics for a member. The join service lists them at once.
    fn reenroll(&self, enrollment: Enrollment) -> anyhow::Result<()> {
        let authority = self.authority()?;
        let (key, successor) = (authority.identity.key().verify_key(), self.card()?.successor());
        let rows = super::members::stored(self)?.rows(unix_seconds());
        let signer = rows.iter().find(|row| row.enrollment.member == enrollment.member).and_then(|row| row.signer);
        if signer.is_some() && signer == successor && signer != Some(key) {
            bail!("{}: the successor of the domain's key admitted it; name the successor's by --key", enrollment.label);
        }
        let enrollment = Enrollment { serial: authority.serial, ..enrollment };
        self.record("enroll", &enrollment.label, &[enrollment.member])?;
        let signed = issue(authority.identity.key(), &enrollment)?;
        self.keep_signed(files::ENROLLMENTS, [(enrollment.label, signed.to_pem())])
    }
}

#[cfg(test)]
#[path = "../../../tests/unit/cli/fleet.rs"]
mod tests;
