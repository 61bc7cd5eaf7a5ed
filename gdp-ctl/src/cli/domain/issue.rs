//! `gdp-ctl domain init`, `admit`, `invite` and `peer`: the commands by which a domain issues
//! certificates.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use clap::Args;
use gdp_core::card::NameCard;
use gdp_core::cert::domain::roles;
use gdp_core::cert::{Claims, Invite, MemberCert, Membership, PeerCert, PeerRights, issue};
use gdp_core::domain::Token;
use gdp_core::identity::{Identity, SigningKey};
use gdp_core::link_target::LinkTarget;
use gdp_core::name::domain_metadata;
use gdp_wire::Name;
use schemars::JsonSchema;
use serde::Serialize;

use super::super::credential_file::{IssuedOutput, claim_map};
use super::super::output;
use super::ledger::{Issue, To};
use crate::cli::context::Context;
use crate::cli::domain::authority::{Authority, card_file_of, expect_new};
use crate::cli::entity::parse_entity;
use crate::cli::issuing::{parse_seconds, validity};
use gdp_util::unix_time::unix_seconds;

#[derive(Debug, Args)]
pub struct InitOptions {
    /// Folder for the new files domain.pem and domain.card.
    #[arg(short, long, value_name = "DIR", default_value = ".")]
    output: PathBuf,
    /// Key file that may sign for the domain if domain.pem is lost. It is made if there is none.
    #[arg(long, value_name = "FILE")]
    successor: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct KeyOptions {
    /// Private key file of the domain. The ledger of issued certificates is next to the domain's
    /// card.
    #[arg(long, value_name = "FILE")]
    pub key: PathBuf,
    /// Card of the domain. Default: the key's path with the extension .card.
    #[arg(long, value_name = "FILE")]
    pub card: Option<PathBuf>,
}

impl KeyOptions {
    pub(super) fn open(&self) -> anyhow::Result<Authority> {
        Authority::open(&self.key, self.card.as_deref())
    }
}

#[derive(Debug, Args)]
pub struct AdmitOptions {
    #[command(flatten)]
    key: KeyOptions,
    /// New member: its name, as printed by `gdp-ctl key show`, or its key file.
    #[arg(value_name = "NAME|FILE", value_parser = parse_entity)]
    entity: Name,
    /// Role: `switch`, `rib` or `border` for forwarders, or any other for use in grants: 1 to 32 of
    /// a-z, 0-9, _ and -.
    #[arg(long)]
    role: String,
    /// Validity of the membership, such as 12h or 365d.
    #[arg(long = "for", default_value = "365d", value_parser = parse_seconds, value_name = "TIME")]
    lifetime: u32,
    /// Membership certificate: a new file, which the member needs.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

#[derive(Debug, Args)]
pub struct InviteOptions {
    #[command(flatten)]
    key: KeyOptions,
    /// Role of the new member, as for `gdp-ctl domain admit`.
    #[arg(long)]
    role: String,
    /// Address that the new member dials: udp://HOST:PORT, or eth://INTERFACE for the member's own
    /// interface.
    #[arg(long, value_name = "LINK")]
    at: LinkTarget,
    /// Switch at that address: its name, as printed by `gdp-ctl status` there, or its key file.
    #[arg(long, value_name = "NAME|FILE", value_parser = parse_entity)]
    switch: Option<Name>,
    /// Validity of the invitation, such as 30m or 24h.
    #[arg(long = "for", default_value = "24h", value_parser = parse_seconds, value_name = "TIME")]
    lifetime: u32,
    /// Validity of the resulting membership, such as 12h or 365d.
    #[arg(long, default_value = "365d", value_parser = parse_seconds, value_name = "TIME")]
    member_for: u32,
}

#[derive(Debug, Args)]
pub struct PeerOptions {
    #[command(flatten)]
    key: KeyOptions,
    /// Other domain: 64 hex digits.
    domain: Name,
    /// Rights of the other domain: peering (links of border switches), transit (sends through this
    /// domain into a third one), visit (its robots attach here).
    #[arg(long, value_name = "RIGHT,…")]
    rights: PeerRights,
    /// Validity of the certificate, such as 7d.
    #[arg(long = "for", default_value = "365d", value_parser = parse_seconds, value_name = "TIME")]
    lifetime: u32,
    /// Certificate: a new file, for `peers:` in the configuration of this domain's own border
    /// switches and robots.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

/// Output of `gdp-ctl domain init`.
#[derive(Debug, Serialize, JsonSchema)]
pub struct InitOutput {
    name: Name,
    key: PathBuf,
    card: PathBuf,
}

pub fn init(options: &InitOptions, context: &Context) -> anyhow::Result<()> {
    let folder = &options.output;
    gdp_util::ownership::create(folder).with_context(|| format!("cannot create the folder {}", folder.display()))?;
    let output = create_domain(folder, options.successor.as_deref())?;
    let name = output.name.to_string();
    context.output.print(&output, || [name])
}

/// Creates domain.pem and domain.card in an existing folder, and the key of the successor.
pub fn create_domain(folder: &Path, successor: Option<&Path>) -> anyhow::Result<InitOutput> {
    let key_file = folder.join("domain.pem");
    let card_file = card_file_of(&key_file);
    expect_new(&card_file)?;
    let successor = successor.map(|file| Identity::load_or_generate(file, "domain")).transpose()?;
    let successor = successor.map(|identity| identity.key().verify_key());
    let identity = Identity::load_or_generate(&key_file, "domain")?;
    let card = NameCard::new(identity.key().verify_key(), domain_metadata(successor.as_ref()))?;
    output::write_new(&card_file, &card.to_json())?;
    Ok(InitOutput { name: card.name(), key: key_file, card: card_file })
}

pub fn admit(options: &AdmitOptions, context: &Context) -> anyhow::Result<()> {
    let file = expect_new(&options.output)?;
    let authority = options.key.open()?;
    let (not_before, not_after) = validity(u64::from(options.lifetime));
    let (domain, serial) = (authority.identity.name(), authority.serial);
    let (entity, role) = (options.entity, options.role.clone());
    let claims = MemberCert { domain, entity, role: role.clone(), serial, not_before, not_after };
    let membership = Membership::issue(&authority.identity, &claims)?;
    membership.verify(domain, authority.ledger.revocation.as_ref(), unix_seconds())?;
    let to = To::Member { entity, role };
    authority.remember(Issue { serial, to, label: None, not_before, not_after, ends: not_after, file: Some(file) })?;
    output::write_new(&options.output, &membership.to_pem())?;
    context
        .output
        .print(&IssuedOutput::new(&claims, serial, &options.output), || [options.output.display().to_string()])
}

pub fn invite(options: &InviteOptions, context: &Context) -> anyhow::Result<()> {
    let (role, at, switch) = (options.role.clone(), options.at.clone(), options.switch);
    if roles::is_switch(&role) {
        if switch.is_none() {
            bail!("a switch has to know which one it dials: add --switch NAME, as `gdp-ctl status` there prints it");
        }
        check_address(&at)?;
    }
    let authority = options.key.open()?;
    let invited = SigningKey::generate()?;
    let (not_before, not_after) = validity(u64::from(options.lifetime));
    let (_, member_until) = validity(u64::from(options.member_for));
    let member_until = member_until.max(not_after);
    let (domain, serial, key) = (authority.identity.name(), authority.serial, invited.verify_key());
    let claims = Invite { domain, key, role: role.clone(), serial, not_before, not_after, member_until };
    let signed = issue(authority.identity.key(), &claims)?;
    let token = Token::new(authority.identity.proof(), signed, invited, at, switch)?;
    let token = token.with_successor(authority.ledger.issuance_log.card().successor());
    let to = To::Invited { role };
    authority.remember(Issue { serial, to, label: None, not_before, not_after, ends: member_until, file: None })?;
    let line = token.to_line();
    let (kind, claims, serial) = (Invite::KIND, claim_map(&claims), serial.to_string());
    let output = IssuedOutput { kind, claims, serial, file: None, token: Some(line.to_string()) };
    context.output.print(&output, || [line.to_string()])
}

pub fn peer(options: &PeerOptions, context: &Context) -> anyhow::Result<()> {
    let file = expect_new(&options.output)?;
    let authority = options.key.open()?;
    let (not_before, not_after) = validity(u64::from(options.lifetime));
    let (domain, serial) = (authority.identity.name(), authority.serial);
    let (peer, rights) = (options.domain, options.rights);
    let claims = PeerCert { domain, peer, rights, serial, not_before, not_after };
    let signed = issue(authority.identity.key(), &claims)?;
    signed.verify_peer(&authority.identity.proof(), authority.ledger.revocation.as_ref(), unix_seconds())?;
    let to = To::Peer { domain: peer, rights };
    authority.remember(Issue { serial, to, label: None, not_before, not_after, ends: not_after, file: Some(file) })?;
    output::write_new(&options.output, &signed.to_pem())?;
    context
        .output
        .print(&IssuedOutput::new(&claims, serial, &options.output), || [options.output.display().to_string()])
}

/// Checks that a daemon's configuration can contain this address.
pub(super) fn check_address(at: &LinkTarget) -> anyhow::Result<()> {
    match at {
        LinkTarget::Ethernet { mac: None, .. } => Ok(()),
        LinkTarget::Udp { host, interface: None, .. } if host.parse::<std::net::IpAddr>().is_ok() => Ok(()),
        _ => bail!(
            "{at}: a switch dials an address, as udp://192.0.2.1:31415 or udp://[2001:db8::1]:31415, or eth://INTERFACE"
        ),
    }
}
