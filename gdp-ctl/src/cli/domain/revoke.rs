//! `gdp-ctl domain revoke`: signs the domain's next revocation, with a higher number than the last.

use std::fmt::Display;
use std::path::Path;

use anyhow::{Context as _, bail};
use clap::Args;
use gdp_core::cert::issue;
use gdp_core::domain::Token;
use gdp_core::name::NamePrefix;
use gdp_wire::Name;

use super::super::credential_file::CredentialFile;
use super::super::revocation::{next, publish};
use super::issue::KeyOptions;
use crate::cli::context::Context;
use crate::cli::domain::authority::Authority;
use crate::cli::entity::{find, parse_entity_prefix};
use gdp_util::unix_time::unix_seconds;

#[derive(Debug, Args)]
pub struct Options {
    #[command(flatten)]
    key: KeyOptions,
    /// Certificates to revoke: serials as listed by `gdp-ctl domain show`, files, or `-` for an
    /// invitation on stdin. Without a selection, the command publishes the newest revocation again.
    #[arg(value_name = "SERIAL|FILE")]
    what: Vec<String>,
    /// All memberships of this entity in the domain's ledger: its name, the first digits of it, or
    /// its key file.
    #[arg(long, value_name = "NAME|PREFIX|FILE", value_parser = parse_entity_prefix)]
    entity: Vec<NamePrefix>,
    /// All rights granted to this other domain.
    #[arg(long, value_name = "NAME")]
    domain: Vec<Name>,
    /// All certificates and invitations issued until now.
    #[arg(long)]
    all: bool,
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let authority = options.key.open()?;
    let anew = options.all || !options.what.is_empty() || !options.entity.is_empty() || !options.domain.is_empty();
    let (signed, claims) = if anew {
        let floor = options.all.then_some(authority.serial);
        let chosen = options.chosen(&authority)?;
        let (name, known) = (authority.identity.name(), authority.ledger.revocation.as_ref());
        let claims = next(name, known, &authority.ledger.issued, &chosen, floor, unix_seconds())?;
        let signed = issue(authority.identity.key(), &claims)?;
        authority.ledger.issuance_log.keep_revocation(&signed)?;
        (signed, claims)
    } else {
        let known = authority.ledger.issuance_log.revocation()?;
        known.with_context(|| format!("nothing of {} is revoked yet; say what to revoke", authority.identity.name()))?
    };
    let again = format!("gdp-ctl domain revoke --key {}", options.key.key.display());
    publish(&authority.ledger.issuance_log, signed, &claims, anew, &again, context)
}

impl Options {
    fn chosen(&self, authority: &Authority) -> anyhow::Result<Vec<u64>> {
        let mut chosen = Vec::new();
        for text in &self.what {
            chosen.push(match text.parse() {
                Ok(serial) => serial,
                Err(_) if text == "-" => serial_of(&super::join::read_token("-")?, authority)?,
                Err(_) => {
                    let paper = CredentialFile::load(Path::new(text))?;
                    paper.domain_serial(authority.identity.name()).with_context(|| text.clone())?
                }
            });
        }
        for prefix in &self.entity {
            let members = authority.ledger.issued.iter().filter_map(|issue| Some((issue.member()?, issue.serial)));
            let entity = find(prefix, members.clone().map(|(member, _)| member))?;
            let entity = entity.with_context(|| nothing_for(prefix))?;
            chosen.extend(members.filter(|(member, _)| *member == entity).map(|(_, serial)| serial));
        }
        for domain in &self.domain {
            let before = chosen.len();
            let peers = authority.ledger.issued.iter().filter(|issue| issue.peer() == Some(*domain));
            chosen.extend(peers.map(|issue| issue.serial));
            if chosen.len() == before {
                bail!(nothing_for(domain));
            }
        }
        Ok(chosen)
    }
}

fn nothing_for(whom: &dyn Display) -> String {
    format!(
        "nothing was issued to {whom} from here; name its files, or the serials of `gdp-ctl domain show`, such as that \
         of its invitation"
    )
}

fn serial_of(token: &Token, authority: &Authority) -> anyhow::Result<u64> {
    let invite = token.invite()?;
    if invite.domain != authority.identity.name() {
        bail!("the invitation is of domain {}", invite.domain);
    }
    Ok(invite.serial)
}
