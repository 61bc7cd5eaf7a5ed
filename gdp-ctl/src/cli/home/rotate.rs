//! `gdp-ctl admin rotate`: the successor of the domain's key signs again what the domain signed for
//! its members, who take it from the directory. With `--retire`, nothing that the first key signed
//! holds any longer. Each step may be repeated after an interruption.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use clap::Args;
use gdp_core::cert::{Enrollment, MemberCert, Membership, Revocation, issue};
use gdp_core::identity::{Identity, SigningKey, VerifyKey};
use gdp_directory::service::MemberRow;
use gdp_util::terminal::note;
use gdp_util::unix_time::unix_seconds;
use schemars::JsonSchema;
use serde::Serialize;

use super::renewals::{OWN, delegate_renewal};
use super::{Home, HomeOptions, files, members};
use crate::cli::context::Context;
use crate::cli::domain::{Issue, To};
use crate::cli::issuing::validity;
use crate::cli::revocation::{next, send};

const NOT_SIGNED: &str = "gdp-ctl: not signed again: lines of `gdp-ctl invite` that were not used, peerings, and the \
                          memberships of further switches (`gdp-ctl domain admit`). They end with --retire";

#[derive(Debug, Args)]
pub struct Options {
    /// End everything that the first key signed. Members that did not connect since the rotation
    /// have to be invited again.
    #[arg(long)]
    retire: bool,
    #[command(flatten)]
    home: HomeOptions,
}

/// Output of `gdp-ctl admin rotate`.
#[derive(Debug, Serialize, JsonSchema)]
pub struct RotationOutput {
    /// Public key of the successor.
    key: String,
    /// Labels of the members whose certificates were signed again now.
    members: Vec<String>,
    /// Whether the first key is retired, and the RIB knows it.
    retired: bool,
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let folder = options.home.home()?.folder;
    let successor = Some(options.home.key.clone().unwrap_or_else(|| default_key(&folder)));
    // All that follows is signed by the successor.
    let home = Home { folder, key: successor };
    let key = home.successor()?;
    let lifetime = home.address()?.lifetime;
    for own in OWN {
        let membership = home.membership(own)?;
        if membership.signer_unverified()? != key {
            home.admit(membership.cert.claims_unverified()?.entity, own, lifetime)?;
        }
    }
    let rows = members::stored(&home)?.rows(unix_seconds());
    let members = home.readmit(rows.into_iter().filter(|row| row.signer != Some(key)).collect(), lifetime)?;
    home.record("rotate", "", &[])?;
    home.replace_key()?;
    note(NOT_SIGNED);
    if options.retire {
        home.retire(context)?;
    } else {
        note("gdp-ctl: when all members were connected, end what the first key signed: gdp-ctl admin rotate --retire");
    }
    let output = RotationOutput { key: key.to_string(), members, retired: options.retire };
    let count = output.members.len();
    context.output.print(&output, || match options.retire {
        true => [format!("The key {} signs for the domain, and no other.", output.key)],
        false => [format!("The key {} signs for the domain; {count} members have new certificates.", output.key)],
    })
}

/// Returns the file of the successor's key, which may have become the domain's.
fn default_key(folder: &Path) -> PathBuf {
    let file = folder.join("successor.pem");
    if file.exists() { file } else { folder.join("domain.pem") }
}

impl Home {
    /// Checks that this home signs by the key of the successor, and returns it.
    fn successor(&self) -> anyhow::Result<VerifyKey> {
        self.check_exists()?;
        let (file, card) = (self.key.as_ref().context("a key")?, self.card()?);
        let key = SigningKey::load(file)?.verify_key();
        if Some(key) != card.successor() {
            let (file, domain) = (file.display(), card.name());
            bail!("{file} is not the successor that the card of domain {domain:#} names; choose its file by --key");
        }
        Ok(key)
    }

    /// Signs membership, enrollment and renewal of these members. Returns their labels.
    fn readmit(&self, rows: Vec<MemberRow>, lifetime: u64) -> anyhow::Result<Vec<String>> {
        let mut authority = self.authority()?;
        let (domain, first) = (authority.identity.name(), authority.serial);
        let (mut memberships, mut enrolled, mut renewed) = (Vec::new(), Vec::new(), Vec::new());
        let (not_before, until) = validity(lifetime);
        for (MemberRow { entity, enrollment, role, .. }, serial) in rows.into_iter().zip(first..) {
            let (ends, label) = (enrollment.not_after, enrollment.label.clone());
            let not_after = until.min(ends);
            let claims = MemberCert { domain, entity, role: role.clone(), serial, not_before, not_after };
            let membership = Membership::issue(&authority.identity, &claims)?;
            let renewal = delegate_renewal(&authority, enrollment.join_service, serial, lifetime, ends)?;
            let enrollment = issue(authority.identity.key(), &Enrollment { member: serial, serial, ..enrollment })?;
            let to = To::Member { entity, role };
            let issued = Issue { serial, to, label: Some(label.clone()), not_before, not_after, ends, file: None };
            authority.ledger.issued.push(issued);
            renewed.push((label.clone(), renewal.to_pem()));
            enrolled.push((label.clone(), enrollment.to_pem()));
            memberships.push((label, membership.to_pem()));
        }
        // The ledger first: what is not in it is not revoked. The memberships last, because the
        // join service takes a membership with its enrollment.
        authority.ledger.issuance_log.keep_ledger(authority.ledger.issued.clone())?;
        let labels = memberships.iter().map(|(label, _)| label.clone()).collect();
        self.keep_signed(files::RENEWALS, renewed)?;
        self.keep_signed(files::ENROLLMENTS, enrolled)?;
        self.keep_signed(files::MEMBERSHIPS, memberships)?;
        Ok(labels)
    }

    /// Replaces the first key of the domain by the successor, if it is in the folder.
    fn replace_key(&self) -> anyhow::Result<()> {
        let (path, new) = (self.path("domain.pem"), self.path("domain.new"));
        if !path.exists() {
            return Ok(());
        }
        let key = SigningKey::load(self.key.as_ref().context("a key")?)?;
        let identity = Identity::of_domain(key, &self.card()?).context("the successor")?;
        match std::fs::remove_file(&new) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(error).context("domain.new"),
            _ => {}
        }
        identity.save_new(&new)?;
        std::fs::rename(&new, &path).with_context(|| format!("cannot replace {}", path.display()))
    }

    /// Publishes a revocation that ends what the first key signed.
    fn retire(&self, context: &Context) -> anyhow::Result<()> {
        let authority = self.authority()?;
        let (name, ledger) = (authority.identity.name(), &authority.ledger);
        let claims = next(name, ledger.revocation.as_ref(), &ledger.issued, &[], None, unix_seconds())?;
        let claims = Revocation { signer: Some(authority.identity.key().verify_key()), ..claims };
        let signed = issue(authority.identity.key(), &claims)?;
        ledger.issuance_log.keep_revocation(&signed)?;
        self.record("retire", "", &[])?;
        let again = "the revocation is stored and not published; `gdp-ctl up` or another `admin rotate --retire` does";
        send(ledger.issuance_log.card(), signed, context).context(again)
    }
}
