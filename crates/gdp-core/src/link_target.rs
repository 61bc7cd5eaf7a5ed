//! Address of a node's switch, as written in configurations: `eth://INTERFACE[/MAC]` or
//! `udp://HOST[:PORT][%INTERFACE]`.

use std::fmt;
use std::str::FromStr;

use crate::mac::{DisplayMac, parse_mac};

/// Address that a node dials.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum LinkTarget {
    /// Switch with this MAC address on the segment of an interface. Without a MAC address, any
    /// switch that answers there.
    Ethernet { interface: String, mac: Option<[u8; 6]> },
    /// Host name or address, and a port. With an interface, only that one is used, whatever the
    /// routing table prefers.
    Udp { host: String, port: u16, interface: Option<String> },
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LinkTargetError {
    #[error("\"{text}\" is no link: did you mean {meant}?")]
    Similar { text: String, meant: LinkTarget },
    #[error(
        "\"{0}\" is no link: expected eth://INTERFACE, eth://INTERFACE/02:00:00:00:00:01, udp://HOST, \
         udp://HOST:PORT or udp://HOST:PORT%INTERFACE"
    )]
    Unknown(String),
}

impl FromStr for LinkTarget {
    type Err = LinkTargetError;

    fn from_str(text: &str) -> Result<Self, LinkTargetError> {
        let parsed = match text.split_once("://") {
            Some(("eth", rest)) => parse_ethernet(rest),
            Some(("udp", rest)) => parse_udp(rest),
            _ => None,
        };
        parsed.ok_or_else(|| {
            let excerpt = text.chars().take(100).collect();
            match similar(text) {
                Some(meant) => LinkTargetError::Similar { text: excerpt, meant },
                None => LinkTargetError::Unknown(excerpt),
            }
        })
    }
}

/// Returns the link over UDP to the address or host in a text without `udp://`, if it has one.
fn similar(text: &str) -> Option<LinkTarget> {
    let address = match text.split_once("://") {
        Some(("eth" | "udp", _)) => return None,
        Some((_, address)) => address,
        None => text,
    };
    // A word alone may be an interface.
    if address.contains(['.', ':']) { parse_udp(address) } else { None }
}

fn parse_ethernet(rest: &str) -> Option<LinkTarget> {
    let (interface, mac) = match rest.split_once('/') {
        Some((interface, mac)) => (interface, Some(parse_mac(mac)?)),
        None => (rest, None),
    };
    is_interface(interface).then(|| LinkTarget::Ethernet { interface: interface.into(), mac })
}

fn is_interface(name: &str) -> bool {
    (1..libc::IFNAMSIZ).contains(&name.len()) && !name.contains(|c: char| c.is_whitespace() || c == '/')
}

fn parse_udp(rest: &str) -> Option<LinkTarget> {
    let (rest, interface) = match rest.split_once('%') {
        Some((rest, interface)) => (rest, Some(interface)),
        None => (rest, None),
    };
    let (host, port) = match rest.strip_prefix('[') {
        Some(bracketed) => {
            let (host, behind) = bracketed.split_once(']')?;
            host.parse::<std::net::Ipv6Addr>().ok()?;
            (host, if behind.is_empty() { None } else { Some(behind.strip_prefix(':')?) })
        }
        None => match rest.split_once(':') {
            Some((host, port)) => (host, Some(port)),
            None => (rest, None),
        },
    };
    let port = port.map_or(Some(gdp_wire::UDP_PORT), |port| port.parse().ok().filter(|port| *port != 0))?;
    let valid = !host.is_empty() && host.len() < 256 && !host.contains(|c: char| c.is_whitespace() || c == '/');
    let valid = valid && interface.is_none_or(is_interface);
    valid.then(|| LinkTarget::Udp { host: host.into(), port, interface: interface.map(String::from) })
}

impl fmt::Display for LinkTarget {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Ethernet { interface, mac: None } => write!(f, "eth://{interface}"),
            Self::Ethernet { interface, mac: Some(mac) } => write!(f, "eth://{interface}/{}", DisplayMac(*mac)),
            Self::Udp { host, port, interface } => {
                match host.contains(':') {
                    true => write!(f, "udp://[{host}]:{port}")?,
                    false => write!(f, "udp://{host}:{port}")?,
                }
                interface.iter().try_for_each(|interface| write!(f, "%{interface}"))
            }
        }
    }
}

#[cfg(test)]
#[path = "../tests/unit/link_target.rs"]
mod tests;
