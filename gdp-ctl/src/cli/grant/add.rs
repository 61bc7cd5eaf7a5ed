//! `gdp-ctl grant add`: a certificate for one entity, one role or one delegate.

use std::path::PathBuf;

use anyhow::{Context as _, bail};
use clap::{ArgGroup, Args};
use gdp_core::cert::{AdCert, Delegation, Grantee, ReadGrant, Signed, Validity, issue};
use gdp_core::identity::VerifyKey;
use gdp_wire::Name;

use super::super::credential_file::IssuedOutput;
use super::super::issuance_log::IssuanceLog;
use super::super::output;
use super::issuer::Issuer;
use super::ledger::{Grant, Holder};
use crate::cli::context::Context;
use crate::cli::entity::{parse_entity, parse_public_key};
use crate::cli::issuing::parse_seconds;

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
    /// Entity that receives the grant: its name, as printed by `gdp-ctl key show`, or its key file.
    #[arg(long, value_name = "NAME|FILE", value_parser = parse_entity)]
    entity: Option<Name>,
    /// Role whose members in --domain receive the grant (only with --read).
    #[arg(long, requires = "domain", conflicts_with = "publish")]
    role: Option<String>,
    /// Domain that assigns --role.
    #[arg(long, value_name = "NAME", requires = "role")]
    domain: Option<Name>,
    /// Key that may issue such grants to others: 66 hex digits, as `gdp-ctl -j key show` prints
    /// them, or the key file.
    #[arg(long, value_name = "KEY", value_parser = parse_public_key)]
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
        let file = options.output.display();
        bail!("{file}: a file of this name exists and is not overwritten; `gdp-ctl grant renew {file}` renews it");
    }
    let issuance_log = IssuanceLog::open(&options.card)?;
    let delegation = options.delegation.as_ref().map(|file| {
        let text = std::fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
        let signed = Signed::<Delegation>::from_pem(&text).with_context(|| file.display().to_string())?;
        anyhow::Ok((file.as_path(), signed))
    });
    let issuer = Issuer::open(&options.key, &options.card, &issuance_log, delegation.transpose()?, options.lifetime)?;
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
