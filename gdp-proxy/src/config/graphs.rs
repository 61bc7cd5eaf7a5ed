//! The ROS graphs that a proxy is in: DDS domains of ROS 2, routers of rmw_zenoh, and masters of
//! ROS 1.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Deserialize;

use crate::ros2;

/// Bound on the graphs of one proxy.
const MAX_GRAPHS: usize = 16;

/// The ROS graphs by their names in the configuration. The default is one graph of ROS 2 with
/// ROS_DOMAIN_ID.
#[derive(Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(try_from = "BTreeMap<String, GraphConfig>")]
pub struct Graphs(BTreeMap<String, GraphConfig>);

#[derive(Clone, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(try_from = "Said")]
pub enum GraphConfig {
    Ros1(Ros1Config),
    Ros2(Ros2Config),
    Zenoh(ZenohConfig),
}

/// A graph of ROS 2 by `domain_id`, of ROS 1 by `master`, or of rmw_zenoh by `zenoh`.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Said {
    /// The DDS domain ID (ROS_DOMAIN_ID).
    domain_id: Option<DomainId>,
    /// The URI of the ROS 1 master, such as `http://localhost:11311`.
    master: Option<String>,
    /// The address at which ROS 1 nodes reach the proxy (ROS_IP).
    host: Option<String>,
    /// The locator of the Zenoh router, such as `tcp/localhost:7447`.
    zenoh: Option<String>,
}

#[derive(Clone, Debug, PartialEq, Eq, JsonSchema)]
pub struct Ros2Config {
    /// The DDS domain ID (ROS_DOMAIN_ID).
    pub domain_id: DomainId,
}

#[derive(Clone, Debug, PartialEq, Eq, JsonSchema)]
pub struct Ros1Config {
    /// URI of the master (ROS_MASTER_URI).
    pub master: String,
    /// Address at which other ROS 1 nodes reach this machine (ROS_IP or ROS_HOSTNAME).
    pub host: Option<String>,
}

/// A graph of ROS 2 nodes with rmw_zenoh.
#[derive(Clone, Debug, PartialEq, Eq, JsonSchema)]
pub struct ZenohConfig {
    /// Locator of the router: `tcp/HOST:PORT`.
    pub router: String,
    /// The domain of the nodes (ROS_DOMAIN_ID).
    pub domain_id: DomainId,
}

impl TryFrom<Said> for GraphConfig {
    type Error = &'static str;

    fn try_from(said: Said) -> Result<Self, Self::Error> {
        match said {
            Said { domain_id: Some(domain_id), master: None, host: None, zenoh: None } => {
                Ok(Self::Ros2(Ros2Config { domain_id }))
            }
            Said { domain_id: None, master: Some(master), host, zenoh: None } => {
                Ok(Self::Ros1(Ros1Config { master, host }))
            }
            Said { domain_id, master: None, host: None, zenoh: Some(router) } => match is_locator(&router) {
                true => Ok(Self::Zenoh(ZenohConfig { router, domain_id: domain_id.unwrap_or_else(of_environment) })),
                false => Err("zenoh is the address of a router, tcp/HOST:7447"),
            },
            _ => Err("a graph is one of ROS 2, {domain_id: 0}, or of rmw_zenoh, {zenoh: tcp/HOST:7447}, \
                 or of ROS 1, {master: 'http://HOST:11311', host: ADDRESS}"),
        }
    }
}

impl Default for Graphs {
    fn default() -> Self {
        let graph = GraphConfig::Ros2(Ros2Config { domain_id: of_environment() });
        Self(BTreeMap::from([("ros2".into(), graph)]))
    }
}

/// Returns ROS_DOMAIN_ID, or 0.
fn of_environment() -> DomainId {
    let id = std::env::var("ROS_DOMAIN_ID").ok().and_then(|id| id.parse::<u64>().ok()?.try_into().ok());
    id.unwrap_or_default()
}

/// Whether a text is the address of a router. Whether a host of that name exists shows later.
fn is_locator(text: &str) -> bool {
    let address = text.strip_prefix("tcp/").and_then(|address| address.rsplit_once(':'));
    address.is_some_and(|(host, port)| is_host(host) && port.parse::<u16>().is_ok_and(|port| port > 0))
}

fn is_host(host: &str) -> bool {
    let is_good = |c: u8| c.is_ascii_alphanumeric() || matches!(c, b'.' | b'-' | b'_' | b':' | b'[' | b']' | b'%');
    !host.is_empty() && host.bytes().all(is_good)
}

impl TryFrom<BTreeMap<String, GraphConfig>> for Graphs {
    type Error = String;

    fn try_from(graphs: BTreeMap<String, GraphConfig>) -> Result<Self, String> {
        match graphs.len() {
            1..=MAX_GRAPHS => Ok(Self(graphs)),
            other => Err(format!("{other} graphs; a proxy has 1 to {MAX_GRAPHS}")),
        }
    }
}

impl Graphs {
    pub fn iter(&self) -> impl Iterator<Item = (&str, &GraphConfig)> {
        self.0.iter().map(|(name, graph)| (name.as_str(), graph))
    }

    /// Returns the graph with this name, or the only graph if there is no name.
    pub fn get(&self, name: Option<&str>) -> Result<(&str, &GraphConfig), String> {
        let names = || self.0.keys().map(String::as_str).collect::<Vec<_>>().join(", ");
        match name {
            Some(name) => {
                let found = self.0.get_key_value(name).map(|(name, graph)| (name.as_str(), graph));
                found.ok_or_else(|| format!("there is no graph {name} under graphs; there is {}", names()))
            }
            None if self.0.len() > 1 => Err(format!("missing, and there are several graphs: write one of {}", names())),
            None => self.iter().next().ok_or_else(|| "there is no graph".into()),
        }
    }
}

/// A DDS domain ID whose RTPS ports exist.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(try_from = "u64")]
pub struct DomainId(u16);

impl DomainId {
    pub fn get(self) -> u16 {
        self.0
    }
}

impl TryFrom<u64> for DomainId {
    type Error = String;

    fn try_from(id: u64) -> Result<Self, String> {
        match u16::try_from(id) {
            Ok(id @ 0..=ros2::MAX_DOMAIN_ID) => Ok(Self(id)),
            _ => Err(format!("there is no DDS domain {id}: write the ROS_DOMAIN_ID, 0 to {}", ros2::MAX_DOMAIN_ID)),
        }
    }
}
