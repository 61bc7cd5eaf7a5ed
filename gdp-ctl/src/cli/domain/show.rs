//! `gdp-ctl domain show`: contents of a file or an invitation.

use std::path::{Path, PathBuf};

use clap::Args;
use gdp_core::card::NameCard;
use gdp_core::cert::{Claims, Invite};
use gdp_core::domain::Token;
use gdp_wire::Name;
use schemars::JsonSchema;
use serde::Serialize;

use super::super::credential_file::{ClaimMap, claim_map};
use super::super::issuance_log::IssuanceLog;
use super::super::revocation::RevocationOutput;
use super::super::{cert, output};
use super::join::read_token;
use super::ledger::{Issue, IssueOutput};
use crate::cli::context::Context;
use gdp_util::date::relative;
use gdp_util::unix_time::unix_seconds;

#[derive(Debug, Args)]
pub struct Options {
    /// Domain card, certificate file, invitation, or `-` for an invitation on stdin.
    #[arg(value_name = "FILE|TOKEN")]
    what: String,
    /// Card of the domain, for a certificate. A revocation file next to the card is applied.
    #[arg(long, value_name = "FILE")]
    card: Option<PathBuf>,
}

/// Output of `gdp-ctl domain show` for an invitation.
#[derive(Debug, Serialize, JsonSchema)]
pub struct InvitationOutput {
    kind: &'static str,
    claims: ClaimMap,
    /// As text, because JavaScript and jq round such numbers.
    serial: String,
    /// The address that the new member must dial.
    at: String,
    /// The switch at this address.
    switch: Option<Name>,
}

/// Output of `gdp-ctl domain show` for a domain.
#[derive(Debug, Serialize, JsonSchema)]
pub struct DomainOutput {
    name: Name,
    /// 66 hex digits.
    public_key: String,
    issued: Vec<IssueOutput>,
    /// The newest revocation of the domain.
    revocation: Option<RevocationOutput>,
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let path = Path::new(&options.what);
    if options.what == "-" || options.what.starts_with("gdp1") && !path.exists() {
        return token(&read_token(&options.what)?, context);
    }
    if options.card.is_none() && NameCard::load(path).is_ok() {
        return domain(path, context);
    }
    cert::show(path, options.card.as_deref(), context)
}

fn token(token: &Token, context: &Context) -> anyhow::Result<()> {
    let invite = token.invite()?;
    let output = InvitationOutput {
        kind: Invite::KIND,
        claims: claim_map(&invite),
        serial: invite.serial.to_string(),
        at: token.at().to_string(),
        switch: token.switch(),
    };
    let now = unix_seconds();
    context.output.print(&output, || {
        let switch = token.switch().map_or("any".to_owned(), |switch| switch.to_string());
        [
            "kind        Invite".to_owned(),
            format!("domain      {}", invite.domain),
            format!("role        {}", invite.role),
            format!("serial      {}", invite.serial),
            format!("use until   {}", relative(invite.not_after, now)),
            format!("member until {}", relative(invite.member_until, now)),
            format!("dial        {}", token.addresses().map(ToString::to_string).collect::<Vec<_>>().join(", then ")),
            format!("switch      {switch}"),
        ]
    })
}

fn domain(card: &Path, context: &Context) -> anyhow::Result<()> {
    let issuance_log = IssuanceLog::open(card)?;
    let (issued, (_, revocation), now) =
        (issuance_log.ledger::<Issue>()?, issuance_log.revocation()?.unzip(), unix_seconds());
    let state = |issue: &Issue| issue.state(revocation.as_ref(), now);
    let name = issuance_log.card().name();
    let output = DomainOutput {
        name,
        public_key: issuance_log.card().owner_key().to_string(),
        issued: issued.iter().map(|issue| issue.describe(state(issue))).collect(),
        revocation: revocation.as_ref().map(RevocationOutput::new),
    };
    context.output.print(&output, || {
        let row = |issue: &Issue| {
            let holder = issue.holder().map_or("who has the line".to_owned(), |holder| format!("{holder:#}"));
            let file = issue.file.as_ref().map_or(String::new(), |file| file.display().to_string());
            let label = issue.label.clone().unwrap_or_default();
            [label, issue.serial.to_string(), issue.kind().into(), holder, issue.right(), state(issue).into(), file]
        };
        let rows: Vec<_> = issued.iter().map(row).collect();
        let mut lines = vec![format!("domain {name}")];
        lines.extend(output::table(["label", "serial", "kind", "to", "as", "state", "file"], &rows));
        lines
    })
}
