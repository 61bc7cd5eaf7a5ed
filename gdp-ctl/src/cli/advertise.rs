//! `gdp-ctl advertise` and `withdraw`: statements of an entity, signed here with its key and sent
//! through the daemon.

use std::path::PathBuf;

use anyhow::{Context as _, anyhow, bail};
use clap::{Args, ValueEnum};
use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, Advert, AdvertOp, Issued, RtCert, Signed, issue};
use gdp_core::identity::Identity;
use gdp_core::name::Name;
use gdp_proto::control::{EntityRequest, NameRole, Record, Response};
use schemars::JsonSchema;
use serde::Serialize;

use super::credential_file::CredentialFile;
use super::entity;
use super::key::EntityKind;
use super::query;
use crate::cli::context::Context;
use crate::cli::issuing::{parse_seconds, serial_now, validity};
use crate::client::Client;
use gdp_proto::admin::Request;
use gdp_proto::admin::status::HelloReply;
use gdp_util::date::rounded;
use gdp_util::terminal::note;
use gdp_util::unix_time::unix_seconds;

/// Validity in seconds of the RtCert that permits the switch to carry the entity's statement.
const ROUTE_SECONDS: u64 = 300;

/// Maximum number of seconds by which the RIB's clock may be ahead.
const CLOCKS_DIFFER: u64 = 300;

#[derive(Debug, Args)]
pub struct Options {
    /// Card of the name to advertise.
    card: PathBuf,
    #[command(flatten)]
    entity: Entity,
    /// Certificate of the owner for the entity. Not needed with the owner's own key.
    #[arg(long, value_name = "FILE")]
    cert: Option<PathBuf>,
    /// Lifetime of the advertisement, such as 90s, 15m, 2h or 7d.
    #[arg(long = "for", default_value = "1h", value_parser = parse_seconds, value_name = "TIME")]
    lifetime: u32,
}

#[derive(Debug, Args)]
pub struct WithdrawOptions {
    /// Card of the name to withdraw.
    card: PathBuf,
    #[command(flatten)]
    entity: Entity,
}

#[derive(Debug, Args)]
struct Entity {
    /// Private key file of the entity.
    #[arg(long, value_name = "FILE")]
    key: PathBuf,
    /// Kind of the entity, if the key's file does not state it. Default: proxy.
    #[arg(long, value_enum)]
    kind: Option<EntityKind>,
}

/// Output of `gdp-ctl advertise` and `withdraw`.
#[derive(Debug, Serialize, JsonSchema)]
pub struct AdvertiseOutput {
    name: Name,
    entity: Name,
    switch: Name,
    /// In seconds; only for an advertisement.
    #[serde(skip_serializing_if = "Option::is_none")]
    lifetime: Option<u32>,
}

pub fn advertise(options: &Options, context: &Context) -> anyhow::Result<()> {
    let card = NameCard::load(&options.card)?;
    let entity = options.entity.load()?;
    let ad_cert = certificate(options, &card, &entity)?;
    let mut session = Session::begin(&entity, context)?;
    let advert = session.statement(&entity, AdvertOp::Publish, card.name(), options.lifetime)?;
    session.ask(&entity, EntityRequest::Advertise { proof: card.proof(), ad_cert, advert, everywhere: false })?;
    let output = session.output(&card, &entity, Some(options.lifetime));
    context.output.print(&output, || {
        let switch = session.switch;
        [format!(
            "{:#} is advertised by {:#} at switch {switch:#} for {}",
            card.name(),
            entity.name(),
            rounded(u64::from(options.lifetime))
        )]
    })?;
    let (records, _) = query::ask(&mut context.client()?, &card.name().into())?;
    let is_reader = |record: &Record| matches!(record.role(), Ok(NameRole::Subscriber | NameRole::Caller));
    if !records.iter().any(is_reader) {
        let card = options.card.display();
        note(format_args!(
            "gdp-ctl: no reader yet, so there is no route. Who has a grant (`gdp-ctl grant add {card} --read …`) and \
             subscribes makes one"
        ));
    }
    Ok(())
}

pub fn withdraw(options: &WithdrawOptions, context: &Context) -> anyhow::Result<()> {
    let card = NameCard::load(&options.card)?;
    let entity = options.entity.load()?;
    let mut session = Session::begin(&entity, context)?;
    let advert = session.statement(&entity, AdvertOp::Withdraw, card.name(), 1)?;
    session.ask(&entity, EntityRequest::Withdraw { advert })?;
    let output = session.output(&card, &entity, None);
    context.output.print(&output, || [format!("{:#} is withdrawn by {:#}", card.name(), entity.name())])
}

impl Entity {
    fn load(&self) -> anyhow::Result<Identity> {
        Ok(entity::load(&self.key, self.kind)?)
    }
}

/// Returns the certificate of the file. Without a file, the owner issues a certificate to itself.
fn certificate(options: &Options, card: &NameCard, entity: &Identity) -> anyhow::Result<Issued<AdCert>> {
    if let Some(file) = &options.cert {
        let CredentialFile::Ad(cert) = CredentialFile::load(file)? else {
            bail!("{}: not a certificate to publish; `gdp-ctl cert show` tells what it is", file.display());
        };
        let meant = cert.cert.claims_unverified().map_err(|error| anyhow!("{}: {error}", file.display()))?.entity;
        let other = |kind: &&EntityKind| Identity::new(entity.key().clone(), kind.as_str()).name() == meant;
        if meant != entity.name()
            && let Some(kind) = EntityKind::value_variants().iter().find(other)
        {
            bail!(
                "{} is for the key {} as a {}; add --kind {}",
                file.display(),
                options.entity.key.display(),
                kind.as_str(),
                kind.as_str()
            );
        }
        return Ok(cert);
    }
    let key = entity.key();
    if key.verify_key() != *card.owner_key() {
        bail!(
            "{} is not the owner's key of {}, so it needs the owner's certificate: have the owner run `gdp-ctl grant \
             add {} \
             --key OWNER.pem --publish --entity {} -o FILE`, then add --cert FILE",
            options.entity.key.display(),
            card.name(),
            options.card.display(),
            entity.name()
        );
    }
    let (not_before, not_after) = validity(u64::from(options.lifetime) + CLOCKS_DIFFER);
    let claims = AdCert {
        name: card.name(),
        entity: entity.name(),
        scope: Vec::new(),
        serial: serial_now(),
        not_before,
        not_after,
    };
    Ok(issue(key, &claims)?.into())
}

/// A session with the RIB on behalf of an entity, through the daemon's switch.
struct Session {
    client: Client,
    switch: Name,
    serial: u64,
}

impl Session {
    fn begin(entity: &Identity, context: &Context) -> anyhow::Result<Self> {
        let mut client = context.client()?;
        let HelloReply { name: switch, .. } = client.ask(&Request::Hello)?;
        let claims = RtCert { entity: entity.name(), switch, not_after: unix_seconds() + ROUTE_SECONDS };
        let request = EntityRequest::Attach { rt_cert: issue(entity.key(), &claims)?, resumes: true, lane: 0 };
        match client.ask(&Request::Entity { entity: Some(entity.proof()), request: request.into() })? {
            Response::Attached { serial } => Ok(Self { client, switch, serial }),
            _ => bail!("the RIB answered another question"),
        }
    }

    fn output(&self, card: &NameCard, entity: &Identity, lifetime: Option<u32>) -> AdvertiseOutput {
        AdvertiseOutput { name: card.name(), entity: entity.name(), switch: self.switch, lifetime }
    }

    fn statement(
        &mut self,
        entity: &Identity,
        op: AdvertOp,
        name: Name,
        lifetime: u32,
    ) -> anyhow::Result<Signed<Advert>> {
        self.serial = self.serial.checked_add(1).context("the serials of this entity are used up; make a new key")?;
        let (switch, serial, box_key) = (self.switch, self.serial, entity.box_public());
        let claims = Advert { op, name, entity: entity.name(), switch, serial, lifetime, box_key };
        Ok(issue(entity.key(), &claims)?)
    }

    fn ask(&mut self, entity: &Identity, request: EntityRequest) -> anyhow::Result<Response> {
        Ok(self.client.ask(&Request::Entity { entity: Some(entity.proof()), request: request.into() })?)
    }
}
