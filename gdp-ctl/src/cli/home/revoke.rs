//! `gdp-ctl revoke LABEL`: ends the membership of a member, or an invitation that was not used.

use anyhow::bail;
use clap::Args;
use gdp_core::cert::issue;
use gdp_util::terminal::note;
use gdp_util::unix_time::unix_seconds;

use super::{Home, HomeOptions, join_service};
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

/// Revokes all that was issued to these labels, by one revocation.
pub(super) fn revoke(home: &Home, labels: &[String], context: &Context) -> anyhow::Result<()> {
    let authority = home.authority()?;
    let joined = join_service::stored(home)?.rows(unix_seconds());
    let mut chosen = Vec::new();
    for label in labels {
        let of: Vec<&Issue> = authority.issued.iter().filter(|issue| issue.label.as_ref() == Some(label)).collect();
        let holds = of.iter().filter(|issue| !issue.is_revoked(authority.revocation.as_ref()));
        let serials: Vec<u64> = holds.map(|issue| issue.serial).collect();
        match (of.is_empty(), serials.is_empty()) {
            (true, _) => bail!("nothing was issued to {label}; `gdp-ctl robots` lists the labels"),
            (_, true) => bail!("{label} is revoked already"),
            _ => {}
        }
        home.record("revoke", label, &serials)?;
        match joined.iter().find(|row| serials.contains(&row.enrollment.member)) {
            Some(row) => note(format_args!(
                "{label} ({:#}): its membership is revoked; switches refuse it, and the directory no longer lists it",
                row.entity
            )),
            None => note(format_args!("{label} has not joined; its invitation is revoked")),
        }
        chosen.extend(serials);
    }
    let (name, known) = (authority.identity.name(), authority.revocation.as_ref());
    let claims = next(name, known, &authority.issued, &chosen, None, unix_seconds())?;
    let signed = issue(authority.identity.key(), &claims)?;
    authority.issuance_log.keep_revocation(&signed)?;
    let again = format!("gdp-ctl domain revoke --key {}", home.path("domain.pem").display());
    publish(&authority.issuance_log, signed, &claims, true, &again, context)
}
