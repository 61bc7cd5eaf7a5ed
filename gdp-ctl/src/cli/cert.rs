//! `gdp-ctl cert`: contents of a certificate file. `gdp-ctl grant` and `gdp-ctl domain` create
//! these files.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Subcommand;

use super::credential_file::{ClaimMap, CredentialFile};
use super::issuance_log::IssuanceLog;
use crate::cli::context::Context;
use gdp_util::date::relative;
use gdp_util::unix_time::unix_seconds;

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Show the contents of a certificate. With a card, also verify that the card's owner, or the
    /// domain, certifies it now.
    Show {
        /// Certificate file.
        file: PathBuf,
        /// Card of the name or of the domain. A revocation file next to the card is applied.
        #[arg(long)]
        card: Option<PathBuf>,
    },
}

pub fn run(command: Command, context: &Context) -> anyhow::Result<()> {
    let Command::Show { file, card } = command;
    show(&file, card.as_deref(), context)
}

/// Prints a certificate, for `cert show` and `domain show`.
pub fn show(file: &Path, card: Option<&Path>, context: &Context) -> anyhow::Result<()> {
    let paper = CredentialFile::load(file)?;
    let mut output = paper.describe().with_context(|| file.display().to_string())?;
    output.verified = match card.map(IssuanceLog::open).transpose()? {
        Some(issuance_log) => {
            let (_, revocation) = issuance_log.revocation()?.unzip();
            let verdict = paper.verify(issuance_log.card(), revocation.as_ref(), unix_seconds());
            verdict.with_context(|| file.display().to_string())?
        }
        None => false,
    };
    context.output.print(&output, || {
        let mut lines = vec![format!("kind        {}", output.kind)];
        lines.extend(describe(&output.claims));
        let others = [("delegation", &output.delegation), ("member", &output.member), ("invite", &output.invite)];
        for (part, claims) in others {
            let Some(claims) = claims else { continue };
            lines.push(format!("by the {part}:"));
            lines.extend(describe(claims));
        }
        let verdict = match (output.verified, card) {
            (true, _) => "the owner of the name, or the domain, stands behind it now",
            (false, Some(_)) => "not verified: neither an owner nor a domain signs this",
            (false, None) => "not verified: give --card",
        };
        lines.push(verdict.to_owned());
        lines
    })
}

fn describe(claims: &ClaimMap) -> impl Iterator<Item = String> {
    let now = unix_seconds();
    claims.iter().map(move |(key, claim)| {
        let is_time = ["not_before", "not_after", "member_until"].contains(&key.as_str());
        let claim = match (claim.as_u64().filter(|_| is_time), claim.as_str()) {
            (Some(time), _) => relative(time, now),
            (None, Some(text)) => text.to_owned(),
            (None, None) => claim.to_string(),
        };
        format!("{key:<10}  {claim}")
    })
}
