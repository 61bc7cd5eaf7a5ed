//! A command as a node of the fabric, with the user's key, and its queries to the RIB.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};

use anyhow::{Context as _, bail};
use gdp::unstable::{LinkConfig, Node, NodeConfig};
use gdp_core::card::NameCard;
use gdp_core::identity::Identity;
use gdp_core::link_target::LinkTarget;
use gdp_core::name::NamePrefix;
use gdp_proto::control::{NameRole, Record};
use gdp_wire::Name;

use crate::client::Client;
use gdp::Keyring;
use gdp_proto::admin::Request;
use gdp_proto::admin::status::HelloReply;

/// Maximum number of records that are asked for.
const MAX_RECORDS: usize = 100_000;

/// The command's node in the fabric, with its keyring.
pub struct Fabric {
    pub node: Node,
    pub keyring: Keyring,
}

/// The entities of a name in the RIB.
#[derive(Debug, Default)]
pub struct Entities {
    /// Publishers or servers.
    pub writers: Vec<Name>,
    /// Subscribers or callers.
    pub readers: Vec<Name>,
}

impl Fabric {
    /// Attaches to a switch.
    pub async fn join(keyring: Keyring, identity: Identity, links: Vec<LinkConfig>) -> anyhow::Result<Self> {
        let credentials = keyring.credentials.as_ref().map(|files| files.load()).transpose()?;
        let first = links.first().context("no link to a switch")?.target.clone();
        let target = first.to_string();
        let config = NodeConfig { credentials, links, ..NodeConfig::new(identity, first) };
        let node = Node::connect(config).await.with_context(|| format!("cannot attach at {target}"))?;
        Ok(Self { node, keyring })
    }

    /// Returns the entities of a name, without this node itself.
    pub async fn entities(&self, card: &NameCard) -> anyhow::Result<Entities> {
        let mut entities = Entities::default();
        for record in &self.records(&card.name().into()).await?.0 {
            let (role, entity) = role(record)?;
            let side = match role {
                NameRole::Publisher | NameRole::Server => &mut entities.writers,
                NameRole::Subscriber | NameRole::Caller => &mut entities.readers,
            };
            if entity != self.node.name() && !side.contains(&entity) {
                side.push(entity);
            }
        }
        Ok(entities)
    }

    /// Returns the verified records of the names with this prefix, and whether there are more than
    /// [`MAX_RECORDS`].
    pub async fn records(&self, prefix: &NamePrefix) -> anyhow::Result<(Vec<Record>, bool)> {
        let mut records: Vec<Record> = Vec::new();
        loop {
            let after = records.last().map(Record::key).transpose()?;
            let (page, truncated) = self.node.query(prefix.clone(), after).await?;
            let is_last = !truncated || page.is_empty();
            records.extend(page);
            if is_last || records.len() >= MAX_RECORDS {
                return Ok((records, truncated));
            }
        }
    }
}

fn role(record: &Record) -> anyhow::Result<(NameRole, Name)> {
    Ok((record.role()?, record.entity.name()?))
}

/// Returns the address at which the local daemon accepts links over UDP.
pub fn local_switch(client: &mut Client) -> anyhow::Result<LinkTarget> {
    let HelloReply { udp, .. } = client.ask(&Request::Hello)?;
    let Some(mut addr) = udp else {
        bail!(
            "the daemon of this machine takes no links over UDP; say where a switch is with --switch, as \
             eth://INTERFACE"
        );
    };
    match addr.ip() {
        IpAddr::V4(Ipv4Addr::UNSPECIFIED) => addr.set_ip(Ipv4Addr::LOCALHOST.into()),
        IpAddr::V6(Ipv6Addr::UNSPECIFIED) => addr.set_ip(Ipv6Addr::LOCALHOST.into()),
        _ => {}
    }
    Ok(LinkTarget::Udp { host: addr.ip().to_string(), port: addr.port(), interface: None })
}
