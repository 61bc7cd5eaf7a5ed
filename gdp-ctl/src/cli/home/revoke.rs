//! `gdp-ctl revoke LABEL`: ends the membership of a member, or an invitation that was not used.

use anyhow::{Context as _, bail};
use clap::Args;
use gdp_core::cert::issue;
use gdp_util::terminal::note;
use gdp_util::unix_time::unix_seconds;

use super::{Home, HomeOptions, members};
use crate::cli::context::Context;
use crate::cli::domain::Issue;
use crate::cli::revocation::{next, publish};

#[derive(Debug, Args)]
pub struct Options {
    /// Label of the member, as `gdp-ctl robots` shows it.
    label: String,
    #[command(flatten)]
    home: HomeOptions,
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    revoke(&options.home.home()?, std::slice::from_ref(&options.label), context)
}

/// Revokes all that was issued to these labels, by one revocation. Publishes again what was revoked
/// before.
pub(super) fn revoke(home: &Home, labels: &[String], context: &Context) -> anyhow::Result<()> {
    let authority = home.authority()?;
    let mut chosen = Vec::new();
    for label in labels {
        let of: Vec<&Issue> =
            authority.ledger.issued.iter().filter(|issue| issue.label.as_ref() == Some(label)).collect();
        if of.is_empty() {
            bail!("nothing was issued to {label}; `gdp-ctl robots` lists the labels");
        }
        let holds = of.iter().filter(|issue| !issue.is_revoked(authority.ledger.revocation.as_ref()));
        chosen.extend(holds.map(|issue| (label, issue.serial)));
    }
    let again = format!("gdp-ctl revoke {}", labels.join(" "));
    if chosen.is_empty() {
        let known = authority.ledger.issuance_log.revocation()?;
        let (signed, claims) = known.context("nothing is revoked")?;
        note("gdp-ctl: revoked already; publishing it again");
        return publish(&authority.ledger.issuance_log, signed, &claims, true, &again, context);
    }
    let serials: Vec<u64> = chosen.iter().map(|(_, serial)| *serial).collect();
    // What the join service stores is for the text only.
    let joined = members::stored(home).map_or_else(|_| Vec::new(), |service| service.rows(unix_seconds()));
    let (name, known) = (authority.identity.name(), authority.ledger.revocation.as_ref());
    let claims = next(name, known, &authority.ledger.issued, &serials, None, unix_seconds())?;
    let signed = issue(authority.identity.key(), &claims)?;
    authority.ledger.issuance_log.keep_revocation(&signed)?;
    for (label, serial) in &chosen {
        home.record("revoke", label, &[*serial])?;
        match joined.iter().find(|row| row.enrollment.member == *serial) {
            Some(row) => note(format_args!("{label} ({:#}): its membership is revoked", row.entity)),
            None => note(format_args!("{label}: its membership or invitation is revoked")),
        }
    }
    publish(&authority.ledger.issuance_log, signed, &claims, true, &again, context)
}
