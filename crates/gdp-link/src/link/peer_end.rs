//! The parameters of a peer's end of a link.

use gdp_core::domain::Credentials;
use std::net::Ipv4Addr;
use std::time::Duration;

/// The parameters that the peer announced for its end of the link.
#[derive(Clone, Debug)]
pub struct PeerEnd {
    pub id: u32,
    pub mtu: u32,
    pub zero_checksum: bool,
    pub host: Option<u64>,
    pub frames_at: Option<Ipv4Addr>,
    pub run: Option<u64>,
    pub echo_interval: Option<Duration>,
    pub credentials: Option<Credentials>,
}
