//! `gdp-ctl admin rotate`: replaces the key of the domain by its successor. Everything that the
//! domain signed for its members is signed again, and members take it from the directory. With
//! `--retire`, nothing that the first key signed holds any longer.

use anyhow::{Context as _, bail};
use clap::Args;
use gdp_core::cert::{Enrollment, MemberCert, Membership, Revocation, issue};
use gdp_core::identity::{Identity, SigningKey};
use gdp_directory::service::MemberRow;
use gdp_util::terminal::note;
use gdp_util::unix_time::unix_seconds;
use schemars::JsonSchema;
use serde::Serialize;
use std::path::PathBuf;

use super::renewals::OWN;
use super::{Home, HomeOptions, enrollments, members, renewals};
use crate::cli::context::Context;
use crate::cli::domain::{Issue, To};
use crate::cli::issuing::validity;
use crate::cli::revocation::{next, publish};

/// Name of the file with the membership of each label.
pub const FILE: &str = "memberships";

#[derive(Debug, Args)]
pub struct Options {
    /// Key file of the successor. Default: successor.pem in the folder.
    #[arg(long, value_name = "FILE")]
    successor: Option<PathBuf>,
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
    /// Public key that signs for the domain now.
    key: String,
    /// Labels of the members whose certificates were signed again.
    members: Vec<String>,
    retired: bool,
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let home = options.home.home()?;
    let card = home.card()?;
    let path = home.path("domain.pem");
    let successor = options.successor.clone().unwrap_or_else(|| home.path("successor.pem"));
    let current = if path.exists() { Some(SigningKey::load(&path)?) } else { None };
    let has_succeeded = current.as_ref().is_some_and(|key| Some(key.verify_key()) == card.successor());
    if !has_succeeded {
        let key = SigningKey::load(&successor)?;
        if Some(key.verify_key()) != card.successor() {
            let (file, domain) = (successor.display(), card.name());
            bail!(
                "{file} is not the successor that the card of domain {domain:#} names; choose the file by --successor"
            );
        }
        let identity = Identity::of_domain(key, &card).context("the successor")?;
        install(&identity, &path)?;
    }
    let rows = members::stored(&home)?.rows(unix_seconds());
    let mut labels = Vec::new();
    if !(has_succeeded && options.retire) {
        let lifetime = home.address()?.lifetime;
        for own in OWN {
            let entity = home.membership(own)?.cert.claims_unverified()?.entity;
            home.admit(entity, own, lifetime)?;
        }
        for row in rows {
            labels.push(row.enrollment.label.clone());
            readmit(&home, row, lifetime)?;
        }
        home.record("rotate", "", &[])?;
    }
    let key = SigningKey::load(&path)?.verify_key().to_string();
    let output = RotationOutput { key, members: labels, retired: options.retire };
    let count = output.members.len();
    context.output.print(&output, || match options.retire {
        true => [format!("The key {} signs for the domain, and no other.", output.key)],
        false => [format!("The key {} signs for the domain; {count} members have new certificates.", output.key)],
    })?;
    if options.retire {
        return retire(&home, context);
    }
    note("gdp-ctl: when all members were connected, end what the first key signed: gdp-ctl admin rotate --retire");
    Ok(())
}

/// Replaces the domain's key.
fn install(successor: &Identity, path: &std::path::Path) -> anyhow::Result<()> {
    let new = path.with_extension("new");
    let _ = std::fs::remove_file(&new);
    successor.save_new(&new)?;
    std::fs::rename(&new, path).with_context(|| format!("cannot replace {}", path.display()))
}

/// Signs membership, enrollment and renewal of a member by the domain's key.
fn readmit(home: &Home, row: MemberRow, lifetime: u64) -> anyhow::Result<()> {
    let authority = home.authority()?;
    let MemberRow { entity, enrollment, role, .. } = row;
    let (serial, ends, label) = (authority.serial, enrollment.not_after, enrollment.label.clone());
    let (not_before, not_after) = validity(lifetime);
    let not_after = not_after.min(ends);
    let key = authority.identity.key();
    let domain = authority.identity.name();
    let claims = MemberCert { domain, entity, role: role.clone(), serial, not_before, not_after };
    let membership = Membership::issue(&authority.identity, &claims)?;
    let enrollment = issue(key, &Enrollment { member: serial, serial, ..enrollment })?;
    let renewal = home.delegate_renewal(&authority, serial, lifetime, ends)?;
    authority.remember(Issue {
        serial,
        to: To::Member { entity, role },
        label: Some(label.clone()),
        not_before,
        not_after,
        ends,
        file: None,
    })?;
    home.keep_signed(renewals::FILE, [(label.clone(), renewal.to_pem())])?;
    home.keep_signed(enrollments::FILE, [(label.clone(), enrollment.to_pem())])?;
    // The last one, because the join service takes a membership with its enrollment.
    home.keep_signed(FILE, [(label, membership.to_pem())])
}

/// Publishes a revocation by the successor that ends what the first key signed.
fn retire(home: &Home, context: &Context) -> anyhow::Result<()> {
    let authority = home.authority()?;
    let (name, known) = (authority.identity.name(), authority.ledger.revocation.as_ref());
    let claims = next(name, known, &authority.ledger.issued, &[], None, unix_seconds())?;
    let claims = Revocation { signer: Some(authority.identity.key().verify_key()), ..claims };
    let signed = issue(authority.identity.key(), &claims)?;
    authority.ledger.issuance_log.keep_revocation(&signed)?;
    home.record("retire", "", &[])?;
    publish(&authority.ledger.issuance_log, signed, &claims, true, "gdp-ctl admin rotate --retire", context)
}
