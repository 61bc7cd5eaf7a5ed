//! `gdp-ctl grant revoke`: signs the owner's next revocation, with a higher number than the last.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use clap::Args;
use gdp_core::card::NameCard;
use gdp_core::cert::{Revocation, Signed, issue};
use gdp_core::identity::{SigningKey, VerifyKey};
use gdp_core::name::NamePrefix;

use super::super::credential_file::CredentialFile;
use super::super::issuance_log::IssuanceLog;
use super::super::revocation::{next, next_serial, publish};
use super::ledger::{Grant, Holder};
use crate::cli::context::Context;
use crate::cli::entity::{find, parse_entity_prefix, parse_public_key};
use gdp_util::unix_time::unix_seconds;

#[derive(Debug, Args)]
pub struct Options {
    /// Name card. The newest revocation is next to it, in CARD.revocation.
    card: PathBuf,
    /// Grants to revoke: serials as listed by `gdp-ctl grant list`, or certificate files. Without a
    /// selection, the command publishes the newest revocation again.
    #[arg(value_name = "SERIAL|FILE")]
    serials: Vec<String>,
    /// All grants to this entity in the ledger, for example to a stolen robot: its name, the first
    /// digits of it, or its key file.
    #[arg(long, value_name = "NAME|PREFIX|FILE", value_parser = parse_entity_prefix)]
    entity: Vec<NamePrefix>,
    /// This delegate, and all grants that it issued.
    #[arg(long, value_name = "KEY", value_parser = parse_public_key)]
    delegate: Vec<VerifyKey>,
    /// All grants issued until now, by the owner or by delegates.
    #[arg(long)]
    all: bool,
    /// Private key file of the owner. A delegate cannot revoke.
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let issuance_log = IssuanceLog::open(&options.card)?;
    let known = issuance_log.revocation()?;
    let anew = options
        .revokes()
        .then(|| options.revoke(&issuance_log, known.as_ref().map(|(_, claims)| claims)))
        .transpose()?;
    let (signed, claims) = match (anew, known) {
        (Some(anew), _) => {
            issuance_log.keep_revocation(&anew.0)?;
            anew
        }
        (None, Some(known)) => known,
        (None, None) => bail!("nothing of {} is revoked yet; say what to revoke", issuance_log.card().name()),
    };
    publish(
        &issuance_log,
        signed,
        &claims,
        options.revokes(),
        &format!("gdp-ctl grant revoke {}", options.card.display()),
        context,
    )
}

impl Options {
    fn revokes(&self) -> bool {
        self.all || !self.serials.is_empty() || !self.entity.is_empty() || !self.delegate.is_empty()
    }

    fn revoke(
        &self,
        issuance_log: &IssuanceLog,
        known: Option<&Revocation>,
    ) -> anyhow::Result<(Signed<Revocation>, Revocation)> {
        let card = issuance_log.card();
        let path = self.key.as_deref().context("only the owner revokes: add --key OWNER.pem")?;
        let key = SigningKey::load(path)?;
        if key.verify_key() != *card.owner_key() {
            bail!("{} is not the owner of {}, and only the owner revokes", path.display(), card.name());
        }
        let grants = issuance_log.ledger::<Grant>()?;
        let floor = if self.all { Some(next_serial(&grants, known)?) } else { None };
        let claims = next(card.name(), known, &grants, &self.chosen(card, &grants)?, floor, unix_seconds())?;
        Ok((issue(&key, &claims)?, claims))
    }

    /// Returns the serials to revoke.
    fn chosen(&self, card: &NameCard, grants: &[Grant]) -> anyhow::Result<Vec<u64>> {
        let mut chosen = Vec::new();
        for text in &self.serials {
            chosen.push(match text.parse() {
                Ok(serial) => serial,
                Err(_) => CredentialFile::load(Path::new(text))?.serial(card).with_context(|| text.clone())?,
            });
        }
        let known = || grants.iter().filter_map(|grant| grant.to.entity());
        let mut holders: Vec<Holder> = self.delegate.iter().copied().map(Holder::Delegate).collect();
        for prefix in &self.entity {
            let entity = find(prefix, known())?.with_context(|| nothing_for(prefix))?;
            holders.push(Holder::Entity(entity));
        }
        for holder in holders {
            let before = chosen.len();
            chosen.extend(grants.iter().filter(|grant| grant.to == holder).map(|grant| grant.serial));
            if chosen.len() == before {
                bail!(nothing_for(&holder));
            }
        }
        Ok(chosen)
    }
}

fn nothing_for(whom: &dyn Display) -> String {
    format!("nothing was granted to {whom} from here; name certificate files or the serials of `gdp-ctl grant list`")
}
