//! `gdp-ctl grant add`: a certificate for one entity, one role or one delegate.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use clap::{ArgGroup, Args};
use gdp_core::card::NameCard;
use gdp_core::cert::{
    AboutName, AdCert, Claims, Delegation, Grantee, Issued, ReadGrant, Revocation, Signed, Validity, issue,
};
use gdp_core::identity::{SigningKey, VerifyKey};
use gdp_wire::Name;

use super::super::credential_file::IssuedOutput;
use super::super::issuance_log::IssuanceLog;
use super::super::output;
use super::super::revocation::next_serial;
use super::ledger::{Grant, Holder};
use crate::cli::context::Context;
use crate::cli::issuing::{parse_seconds, validity};
use gdp_util::unix_time::unix_seconds;

#[derive(Debug, Args)]
#[command(group = ArgGroup::new("to").required(true).args(["entity", "role", "delegate"]))]
#[command(group = ArgGroup::new("right").required(true).multiple(true).args(["publish", "read"]))]
pub struct Options {
    /// Name card. The ledger of grants is next to it, in CARD.grants.
    card: PathBuf,
    /// Private key file of the owner, or of the delegate with --delegation.
    #[arg(long, value_name = "FILE")]
    key: PathBuf,
    /// Delegation that the owner issued for the delegate's key.
    #[arg(long, value_name = "FILE", conflicts_with = "delegate")]
    delegation: Option<PathBuf>,
    /// Right to publish, or to serve requests.
    #[arg(long)]
    publish: bool,
    /// Right to subscribe, or to make requests.
    #[arg(long)]
    read: bool,
    /// Entity that receives the grant: 64 hex digits, as printed by `gdp-ctl key show`.
    #[arg(long, value_name = "NAME")]
    entity: Option<Name>,
    /// Role whose members in --domain receive the grant (only with --read).
    #[arg(long, requires = "domain", conflicts_with = "publish")]
    role: Option<String>,
    /// Domain that assigns --role.
    #[arg(long, value_name = "NAME", requires = "role")]
    domain: Option<Name>,
    /// Key that may issue such grants to others: 66 hex digits, as printed by `gdp-ctl key show`.
    #[arg(long, value_name = "KEY")]
    delegate: Option<VerifyKey>,
    /// Domain that may learn the name; repeat for several. Default: only the domain in which the
    /// name is advertised.
    #[arg(long, value_name = "NAME", requires = "publish", conflicts_with = "delegate")]
    scope: Vec<Name>,
    /// Validity of the grant, such as 90s, 15m, 2h or 7d.
    #[arg(long = "for", default_value = "365d", value_parser = parse_seconds, value_name = "TIME")]
    lifetime: u32,
    /// Certificate: a new file, which the robot needs.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

pub fn run(options: Options, context: &Context) -> anyhow::Result<()> {
    if options.output.exists() {
        bail!("{}: a file of this name exists and is not overwritten", options.output.display());
    }
    let issuance_log = IssuanceLog::open(&options.card)?;
    let issuer = Issuer::open(&options, &issuance_log)?;
    let (name, serial, Validity { not_before, not_after }) = (issuer.card.name(), issuer.serial, issuer.validity);
    let (publish, read) = (options.publish, options.read);
    let (to, (text, output)) = match (options.delegate, options.entity, &options.role, options.domain) {
        (Some(delegate), ..) => {
            let claims = Delegation { name, delegate, publish, read, serial, not_before, not_after };
            let signed = issue(&issuer.key, &claims)?;
            (Holder::Delegate(delegate), (signed.to_pem(), IssuedOutput::new(&claims, serial, &options.output)))
        }
        (None, Some(_), ..) if publish && read => bail!("one certificate is for --publish or for --read; make two"),
        (None, Some(entity), ..) if publish => {
            let claims = AdCert { name, entity, scope: options.scope, serial, not_before, not_after };
            (Holder::Entity(entity), issuer.issue(&claims, &options.output)?)
        }
        (None, entity, role, domain) => {
            let to = match (entity, role, domain) {
                (Some(entity), ..) => Grantee::Entity(entity),
                (None, Some(role), Some(domain)) => Grantee::Role { domain, role: role.clone() },
                _ => bail!("--entity, --role with --domain, or --delegate says to whom"),
            };
            let claims = ReadGrant { name, to: to.clone(), serial, not_before, not_after };
            (to.into(), issuer.issue(&claims, &options.output)?)
        }
    };
    // Record the grant first: a grant that is not in the ledger would not be revoked.
    let mut grants = issuer.grants;
    let file = std::path::absolute(&options.output)?;
    grants.push(Grant { serial, publish, read, to, not_before, not_after, file });
    issuance_log.keep_ledger(grants)?;
    output::write_new(&options.output, &text)?;
    context.output.print(&output, || [options.output.display().to_string()])
}

/// The issuer, and the common properties of the certificates that it issues now.
struct Issuer<'b> {
    card: &'b NameCard,
    key: SigningKey,
    delegation: Option<Signed<Delegation>>,
    revocation: Option<Revocation>,
    grants: Vec<Grant>,
    serial: u64,
    validity: Validity,
}

impl<'b> Issuer<'b> {
    fn open(options: &Options, issuance_log: &'b IssuanceLog) -> anyhow::Result<Self> {
        let (card, key) = (issuance_log.card(), SigningKey::load(&options.key)?);
        let (grants, revocation) =
            (issuance_log.ledger::<Grant>()?, issuance_log.revocation()?.map(|(_, revocation)| revocation));
        let mut serial = next_serial(&grants, revocation.as_ref())?;
        let (not_before, not_after) = validity(u64::from(options.lifetime));
        let mut validity = Validity { not_before, not_after };
        let delegation = match &options.delegation {
            Some(file) => {
                let text = std::fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
                let signed = Signed::<Delegation>::from_pem(&text).with_context(|| file.display().to_string())?;
                let claims =
                    signed.verify(card.owner_key(), unix_seconds()).with_context(|| file.display().to_string())?;
                if claims.delegate != key.verify_key() {
                    bail!("{} is for another key than {}", file.display(), options.key.display());
                }
                validity = validity.and(claims.validity());
                serial = serial.max(claims.serial);
                Some(signed)
            }
            None if key.verify_key() != *card.owner_key() => bail!(
                "{} is not the owner of {} ({}): its public key is {}, the card names {}; a delegate adds --delegation",
                options.key.display(),
                card.name(),
                options.card.display(),
                key.verify_key(),
                card.owner_key()
            ),
            None => None,
        };
        Ok(Self { card, key, delegation, revocation, grants, serial, validity })
    }

    /// Returns the text of a certificate and its output. Fails if the recipient would refuse the
    /// certificate.
    fn issue<T: AboutName>(&self, claims: &T, file: &Path) -> anyhow::Result<(String, IssuedOutput)> {
        let issued = Issued { cert: issue(&self.key, claims)?, delegation: self.delegation.clone() };
        issued.verify(&self.card.proof(), self.revocation.as_ref(), unix_seconds())?;
        Ok((issued.to_pem(), IssuedOutput::new(claims, self.serial, file)))
    }
}
