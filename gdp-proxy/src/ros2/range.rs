//! The range of ROS 2 discovery, from the environment.

use std::net::{IpAddr, ToSocketAddrs};

/// Bound on the static peers.
const MAX_PEERS: usize = 64;

/// The range of discovery.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Range {
    /// Discovery is limited to this host.
    Localhost,
    /// Discovery reaches as far as multicast.
    Subnet,
}

/// Errors of a configured range that the proxy does not support.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum RangeError {
    #[error("ROS_AUTOMATIC_DISCOVERY_RANGE is {0:?}: write LOCALHOST, SUBNET or SYSTEM_DEFAULT")]
    Unknown(String),
    #[error(
        "ROS_AUTOMATIC_DISCOVERY_RANGE is OFF: a proxy finds its topics by discovery; write LOCALHOST, or take the \
         graph out of the configuration"
    )]
    Off,
    #[error("ROS_STATIC_PEERS: {0:?} has no IPv4 address; write addresses or host names, separated by semicolons")]
    Peer(String),
    #[error("ROS_STATIC_PEERS names {0} hosts where at most {MAX_PEERS} are allowed")]
    TooManyPeers(usize),
    #[error(
        "ROS_STATIC_PEERS is set, and the range of discovery is LOCALHOST: a proxy then announces no address that \
         other hosts reach; set ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET, or unset ROS_STATIC_PEERS"
    )]
    PeersBeyond,
}

/// Returns the IPv4 addresses of the hosts in ROS_STATIC_PEERS, to which the participant announces
/// itself by unicast. Looks host names up, which may take seconds.
pub fn static_peers(range: Range, variable: impl Fn(&str) -> Option<String>) -> Result<Vec<IpAddr>, RangeError> {
    let peers = variable("ROS_STATIC_PEERS").unwrap_or_default();
    let peers: Vec<&str> = peers.split(';').map(str::trim).filter(|peer| !peer.is_empty()).collect();
    match peers.len() {
        0 => return Ok(vec![]),
        1..=MAX_PEERS if range == Range::Localhost => return Err(RangeError::PeersBeyond),
        1..=MAX_PEERS => {}
        more => return Err(RangeError::TooManyPeers(more)),
    }
    let address = |peer: &str| {
        let mut found = (peer, 0).to_socket_addrs().ok()?.map(|address| address.ip());
        found.find(IpAddr::is_ipv4)
    };
    peers.into_iter().map(|peer| address(peer).ok_or_else(|| RangeError::Peer(peer.to_owned()))).collect()
}

impl Range {
    /// Reads the environment as `rcl` does: ROS_LOCALHOST_ONLY=1 has precedence over
    /// ROS_AUTOMATIC_DISCOVERY_RANGE.
    pub fn from_variables(variable: impl Fn(&str) -> Option<String>) -> Result<Self, RangeError> {
        if variable("ROS_LOCALHOST_ONLY").as_deref() == Some("1") {
            return Ok(Self::Localhost);
        }
        match variable("ROS_AUTOMATIC_DISCOVERY_RANGE").as_deref() {
            Some("LOCALHOST") => Ok(Self::Localhost),
            None | Some("" | "SUBNET" | "SYSTEM_DEFAULT") => Ok(Self::Subnet),
            Some("OFF") => Err(RangeError::Off),
            Some(other) => Err(RangeError::Unknown(other.to_owned())),
        }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/ros2/range.rs"]
mod tests;
