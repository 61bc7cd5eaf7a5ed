//! The keys `udp` and `tls`: the addresses at which a switch accepts links.

use std::net::SocketAddr;

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
