//! The range of ROS 2 discovery, from the environment.

use std::net::{IpAddr, SocketAddr, ToSocketAddrs};
use std::sync::mpsc;
use std::time::{Duration, Instant};

/// Bound on the static peers.
const MAX_PEERS: usize = 64;

/// Timeout of looking up all of them.
const LOOKUP: Duration = Duration::from_secs(3);

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
}

/// Returns the IPv4 addresses of the hosts in ROS_STATIC_PEERS, to which the participant announces
/// itself by unicast. Logs hosts that it leaves out: those whose name has no address yet, those
/// beyond [`MAX_PEERS`], and all if the range is this host. Takes at most [`LOOKUP`].
pub fn static_peers(range: Range, variable: impl Fn(&str) -> Option<String>) -> Vec<IpAddr> {
    let peers = variable("ROS_STATIC_PEERS").unwrap_or_default();
    let peers: Vec<&str> = peers.split(';').map(str::trim).filter(|peer| !peer.is_empty()).collect();
    if range == Range::Localhost && !peers.is_empty() {
        tracing::warn!(
            "ROS_STATIC_PEERS is not used: with the range LOCALHOST this participant announces no address that other \
             hosts reach; set ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET"
        );
        return vec![];
    }
    if peers.len() > MAX_PEERS {
        tracing::warn!("of the {} hosts in ROS_STATIC_PEERS, the first {MAX_PEERS} are used", peers.len());
    }
    let (found, looked_up) = mpsc::channel();
    for peer in peers.iter().take(MAX_PEERS) {
        let (peer, found) = ((*peer).to_owned(), found.clone());
        // A resolver may take longer than anybody waits for it.
        std::thread::spawn(move || {
            let address = (peer.as_str(), 0).to_socket_addrs().ok();
            let address = address.and_then(|mut all| all.find(SocketAddr::is_ipv4)).map(|address| address.ip());
            // Nobody listens any more after the timeout.
            _ = found.send((peer, address));
        });
    }
    drop(found);
    let (deadline, mut missing) = (Instant::now() + LOOKUP, peers);
    missing.truncate(MAX_PEERS);
    let mut addresses = Vec::new();
    while let Ok((peer, address)) = looked_up.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
        if let Some(address) = address {
            addresses.push(address);
            missing.retain(|other| *other != peer);
        }
    }
    for peer in missing {
        tracing::warn!("ROS_STATIC_PEERS: {peer:?} has no IPv4 address now, and is not announced to until a restart");
    }
    addresses.sort_unstable();
    addresses.dedup();
    addresses
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
