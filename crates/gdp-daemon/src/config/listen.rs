//! The addresses at which a switch accepts links, and reaches neighbours over TLS.

use std::net::SocketAddr;

use gdp_core::link_target::LinkTarget;
use serde::{Deserialize, Deserializer};

/// The `udp` key. Unlike a missing key, `null` turns UDP off.
#[derive(Debug, Default)]
pub enum UdpConfig {
    #[default]
    Absent,
    Off,
    On(SocketAddr),
}

impl<'de> Deserialize<'de> for UdpConfig {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let addr = Option::<String>::deserialize(deserializer)?;
        let Some(addr) = addr else { return Ok(Self::Off) };
        let problem = |_| format!("udp: {addr:?} is not an address and port such as 0.0.0.0:31415 or [::]:31415");
        addr.parse().map(Self::On).map_err(problem).map_err(serde::de::Error::custom)
    }
}

/// Parses the `tls` key.
pub fn parse_tls(text: &str) -> Result<SocketAddr, String> {
    text.parse().map_err(|_| format!("tls: {text:?} is not an address and port such as 0.0.0.0:443 or [::]:443"))
}

/// Parses the key `tls` of a neighbour.
pub fn parse_tls_target(key: &str, text: &str) -> Result<LinkTarget, String> {
    match text.parse() {
        Ok(target @ LinkTarget::Tls { .. }) => Ok(target),
        _ => Err(format!("{key}: tls: {text:?} is not an address such as tls://HOST or wss://HOST:443")),
    }
}
