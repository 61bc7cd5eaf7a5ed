//! `gdp-ctl grant list`: the grants in the ledger, and whether they are still valid.

use std::path::PathBuf;

use clap::Args;
use gdp_wire::Name;
use schemars::JsonSchema;
use serde::Serialize;

use super::super::issuance_log::IssuanceLog;
use super::super::output;
use super::super::revocation::RevocationOutput;
use super::ledger::{Grant, Holder};
use crate::cli::context::Context;
use gdp_util::date::relative;
use gdp_util::unix_time::unix_seconds;

#[derive(Debug, Args)]
pub struct Options {
    /// Name card. Grants issued by delegates are in the delegates' own ledgers.
    card: PathBuf,
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let issuance_log = IssuanceLog::open(&options.card)?;
    let (grants, (_, revocation)) = (issuance_log.ledger::<Grant>()?, issuance_log.revocation()?.unzip());
    let now = unix_seconds();
    let state = |grant: &Grant| grant.state(revocation.as_ref(), now);
    let output = GrantsOutput {
        name: issuance_log.card().name(),
        grants: grants.iter().map(|grant| GrantOutput::new(grant, state(grant))).collect(),
        revocation: revocation.as_ref().map(RevocationOutput::new),
    };
    context.output.print(&output, || {
        let row = |grant: &Grant| {
            let holds = match state(grant) {
                "valid" => format!("until {}", relative(grant.not_after, now)),
                "expired" => format!("expired {}", relative(grant.not_after, now)),
                "not yet" => format!("from {}", relative(grant.not_before, now)),
                other => other.to_owned(),
            };
            [grant.serial.to_string(), right(grant).into(), holder(&grant.to), holds, grant.file.display().to_string()]
        };
        output::table(["serial", "may", "to", "valid", "file"], &grants.iter().map(row).collect::<Vec<_>>())
    })
}

/// Output of `gdp-ctl grant list`.
#[derive(Debug, Serialize, JsonSchema)]
pub struct GrantsOutput {
    name: Name,
    grants: Vec<GrantOutput>,
    /// The newest revocation of the name.
    revocation: Option<RevocationOutput>,
}

/// A certificate in the ledger.
#[derive(Debug, Serialize, JsonSchema)]
struct GrantOutput {
    /// As text, because JavaScript and jq round such numbers.
    serial: String,
    publish: bool,
    read: bool,
    to: Holder,
    not_before: u64,
    not_after: u64,
    file: PathBuf,
    /// `valid`, `not yet`, `expired` or `revoked`.
    state: &'static str,
}

impl GrantOutput {
    fn new(grant: &Grant, state: &'static str) -> Self {
        let Grant { serial, publish, read, to, not_before, not_after, file } = grant.clone();
        Self { serial: serial.to_string(), publish, read, to, not_before, not_after, file, state }
    }
}

fn right(grant: &Grant) -> &'static str {
    match (grant.publish, grant.read) {
        (true, true) => "publish, read",
        (true, false) => "publish",
        (false, _) => "read",
    }
}

fn holder(holder: &Holder) -> String {
    match holder {
        Holder::Entity(entity) => format!("{entity:#}"),
        Holder::Role { domain, role } => format!("role {role} of {domain:#}"),
        Holder::Delegate(key) => format!("delegate {}…", &key.to_string()[..8]),
    }
}
