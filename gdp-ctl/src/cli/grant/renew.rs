//! `gdp-ctl grant renew`: replaces certificates that were issued here by ones with the same rights
//! and a later end.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use clap::Args;
use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, Delegation, ReadGrant, Reading, Validity, issue};
use gdp_util::date::relative;
use gdp_util::terminal::note;
use gdp_util::unix_time::unix_seconds;

use super::super::credential_file::{CredentialFile, IssuedOutput};
use super::super::issuance_log::IssuanceLog;
use super::super::output;
use super::issuer::Issuer;
use super::ledger::Grant;
use crate::cli::context::Context;
use crate::cli::issuing::{lifetime, parse_seconds};

#[derive(Debug, Args)]
pub struct Options {
    /// Certificates to renew. A name card stands for all grants in its ledger that are valid and
    /// whose files still exist.
    #[arg(value_name = "FILE|CARD", required = true)]
    what: Vec<PathBuf>,
    /// Private key file of the owner, or of the delegate that issued the grants.
    #[arg(long, value_name = "FILE")]
    key: PathBuf,
    /// Validity of the renewed grants, such as 90s, 15m, 2h or 7d. Default: as long as before.
    #[arg(long = "for", value_parser = parse_seconds, value_name = "TIME")]
    lifetime: Option<u32>,
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    for what in &options.what {
        if NameCard::load(what).is_ok() {
            for file in files_of(what)? {
                options.renew(what, &file, context)?;
            }
        } else {
            options.renew(&card_of(what)?, what, context)?;
        }
    }
    Ok(())
}

/// Returns the files of the valid grants in the ledger of a card.
fn files_of(card: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let issuance_log = IssuanceLog::open(card)?;
    let (grants, revocation) = (issuance_log.ledger::<Grant>()?, issuance_log.revocation()?);
    let (now, revocation) = (unix_seconds(), revocation.map(|(_, claims)| claims));
    // The newest grant of each file: an earlier one was renewed.
    let valid = grants.iter().filter(|grant| grant.state(revocation.as_ref(), now) == "valid");
    let newest: BTreeMap<&PathBuf, u64> = valid.map(|grant| (&grant.file, grant.serial)).collect();
    let mut files = Vec::new();
    for (file, serial) in newest {
        let found = CredentialFile::load(file).and_then(|certificate| certificate.serial(issuance_log.card()));
        match found {
            Ok(found) if found == serial => files.push(file.clone()),
            _ => {
                let file = file.display();
                note(format_args!(
                    "gdp-ctl: warning: {file} is not renewed: the grant with serial {serial} is not there"
                ));
            }
        }
    }
    if files.is_empty() {
        bail!(
            "{}: its ledger has no valid grant whose file exists; issue one with `gdp-ctl grant add`",
            card.display()
        );
    }
    Ok(files)
}

/// Finds the card of a certificate, beside it or in the working directory, whose ledger has the
/// certificate.
fn card_of(file: &Path) -> anyhow::Result<PathBuf> {
    let certificate = CredentialFile::load(file)?;
    let beside = file.parent().filter(|folder| !folder.as_os_str().is_empty());
    for folder in beside.into_iter().chain([Path::new(".")]) {
        let entries = std::fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
        for entry in entries {
            let path = entry?.path();
            let is_card = path.extension().is_some_and(|ending| ending == "card");
            let Some(card) = is_card.then(|| NameCard::load(&path).ok()).flatten() else { continue };
            let Ok(serial) = certificate.serial(&card) else { continue };
            if IssuanceLog::open(&path)?.ledger::<Grant>()?.iter().any(|grant| grant.serial == serial) {
                return Ok(path);
            }
        }
    }
    bail!(
        "{}: no name card beside it or in this folder has a ledger with it; run this in the folder of the card with \
         which it was issued",
        file.display()
    )
}

impl Options {
    fn renew(&self, card: &Path, file: &Path, context: &Context) -> anyhow::Result<()> {
        let issuance_log = IssuanceLog::open(card)?;
        let certificate = CredentialFile::load(file)?;
        let serial = certificate.serial(issuance_log.card()).with_context(|| file.display().to_string())?;
        let grants = issuance_log.ledger::<Grant>()?;
        let Some(grant) = grants.into_iter().find(|grant| grant.serial == serial) else {
            bail!("{}: the ledger of {} does not have serial {serial}", file.display(), card.display());
        };
        let revocation = issuance_log.revocation()?.map(|(_, claims)| claims);
        if grant.state(revocation.as_ref(), unix_seconds()) == "revoked" {
            bail!("{}: it is revoked; issue another with `gdp-ctl grant add`", file.display());
        }
        let before = u32::try_from(lifetime(grant.not_before, grant.not_after)).unwrap_or(u32::MAX);
        let delegation = certificate.delegation().map(|signed| (file, signed));
        let issuer = Issuer::open(&self.key, card, &issuance_log, delegation, self.lifetime.unwrap_or(before))?;
        let (text, output) = renewed(&issuer, certificate, file).with_context(|| file.display().to_string())?;
        // Record the grant first: a grant that is not in the ledger would not be revoked.
        let (serial, Validity { not_before, not_after }) = (issuer.serial, issuer.validity);
        let mut grants = issuer.grants;
        grants.push(Grant { serial, not_before, not_after, file: std::path::absolute(file)?, ..grant });
        issuance_log.keep_ledger(grants)?;
        output::replace(file, &text)?;
        context.output.print(&output, || [format!("{} until {}", file.display(), relative(not_after, unix_seconds()))])
    }
}

/// Returns the text of a certificate with the same rights, and its output.
fn renewed(issuer: &Issuer, certificate: CredentialFile, file: &Path) -> anyhow::Result<(String, IssuedOutput)> {
    let (serial, Validity { not_before, not_after }) = (issuer.serial, issuer.validity);
    match certificate {
        CredentialFile::Ad(issued) => {
            let claims = issued.cert.claims_unverified()?;
            issuer.issue(&AdCert { serial, not_before, not_after, ..claims }, file)
        }
        CredentialFile::Read(Reading { grant, member }) => {
            let claims = grant.cert.claims_unverified()?;
            let (text, output) = issuer.issue(&ReadGrant { serial, not_before, not_after, ..claims }, file)?;
            Ok((text + &member.map(|member| member.to_pem()).unwrap_or_default(), output))
        }
        CredentialFile::Delegation(signed) => {
            let claims = Delegation { serial, not_before, not_after, ..signed.claims_unverified()? };
            Ok((issue(&issuer.key, &claims)?.to_pem(), IssuedOutput::new(&claims, serial, file)))
        }
        _ => bail!("it is no grant"),
    }
}
