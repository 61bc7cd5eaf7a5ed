//! The section `relay`: `true`, or a mapping with the settings that differ from the default.

use std::fmt;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::value::MapAccessDeserializer;
use serde::de::{Error, MapAccess, Visitor};
use serde::{Deserialize, Deserializer};

/// A switch beside the proxy, for endpoints that reach no other switch.
#[derive(Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RelayConfig {
    /// The relay's private key (`gdp-ctl key generate FILE --kind switch`). The relay's admin
    /// socket and state files are beside it.
    pub identity: PathBuf,
    /// The relay's membership as a switch of the proxy's domain. The default is `relay.member` if
    /// the proxy has a domain.
    pub membership: Option<PathBuf>,
    /// UDP address at which the relay accepts links and from which it makes its own.
    pub udp: SocketAddr,
    /// Ethernet interfaces on which the relay also accepts links. They need CAP_NET_RAW.
    pub interfaces: Vec<String>,
}

impl Default for RelayConfig {
    fn default() -> Self {
        Self {
            identity: "relay.pem".into(),
            membership: None,
            udp: SocketAddr::new(Ipv4Addr::UNSPECIFIED.into(), gdp_wire::UDP_PORT),
            interfaces: Vec::new(),
        }
    }
}

/// Returns the schema of [`relay`].
pub(super) fn schema(generator: &mut SchemaGenerator) -> Schema {
    let mapping = generator.subschema_for::<RelayConfig>();
    json_schema!({"anyOf": [{"type": "boolean"}, mapping]})
}

/// Accepts `true`, `false` or a mapping. An untagged enum would not name a misspelt key.
pub(super) fn relay<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<RelayConfig>, D::Error> {
    deserializer.deserialize_any(RelayVisitor)
}

struct RelayVisitor;

impl<'de> Visitor<'de> for RelayVisitor {
    type Value = Option<RelayConfig>;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("true, false, or a mapping such as {udp: \"0.0.0.0:31415\"}")
    }

    fn visit_bool<E: Error>(self, wanted: bool) -> Result<Self::Value, E> {
        Ok(wanted.then(RelayConfig::default))
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Self::Value, A::Error> {
        RelayConfig::deserialize(MapAccessDeserializer::new(map)).map(Some)
    }
}
