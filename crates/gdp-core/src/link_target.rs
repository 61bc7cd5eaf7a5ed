//! Address of a node's switch, as written in configurations: `eth://INTERFACE[/MAC]`,
//! `udp://HOST[:PORT][%INTERFACE]`, `tls://HOST[:PORT]` or `wss://HOST[:PORT]`.

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
    /// Host name or address, and a TCP port. The datagrams of the link are inside TLS, and in a
    /// WebSocket if `websocket`.
    Tls { host: String, port: u16, websocket: bool },
}

/// Maximum length of an interface's name, in bytes: that of Linux.
const MAX_INTERFACE: usize = 15;

/// The TCP port of links over TLS, if none is named: that of HTTPS.
pub const TLS_PORT: u16 = 443;

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LinkTargetError {
    #[error("\"{text}\" is no link: did you mean {meant}?")]
    Similar { text: String, meant: LinkTarget },
    #[error(
        "\"{0}\" is no link: expected eth://INTERFACE, eth://INTERFACE/02:00:00:00:00:01, udp://HOST, \
         udp://HOST:PORT, udp://HOST:PORT%INTERFACE, tls://HOST, tls://HOST:PORT or wss://HOST:PORT"
    )]
    Unknown(String),
}

impl FromStr for LinkTarget {
    type Err = LinkTargetError;

    fn from_str(text: &str) -> Result<Self, LinkTargetError> {
        let parsed = match text.split_once("://") {
            Some(("eth", rest)) => parse_ethernet(rest),
            Some(("udp", rest)) => parse_udp(rest),
            Some(("tls", rest)) => parse_tls(rest, false),
            Some(("wss", rest)) => parse_tls(rest, true),
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
        Some(("eth" | "udp" | "tls" | "wss", _)) => return None,
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
    (1..=MAX_INTERFACE).contains(&name.len()) && !name.contains(|c: char| c.is_whitespace() || c == '/')
}

fn parse_udp(rest: &str) -> Option<LinkTarget> {
    let (rest, interface) = match rest.split_once('%') {
        Some((rest, interface)) => (rest, Some(interface)),
        None => (rest, None),
    };
    let (host, port) = parse_host(rest, gdp_wire::UDP_PORT)?;
    interface.is_none_or(is_interface).then(|| LinkTarget::Udp {
        host: host.into(),
        port,
        interface: interface.map(String::from),
    })
}

fn parse_tls(rest: &str, websocket: bool) -> Option<LinkTarget> {
    let (host, port) = parse_host(rest, TLS_PORT)?;
    Some(LinkTarget::Tls { host: host.into(), port, websocket })
}

/// Parses `HOST`, `HOST:PORT` or the same with an IPv6 address in brackets.
fn parse_host(rest: &str, default_port: u16) -> Option<(&str, u16)> {
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
    let port = port.map_or(Some(default_port), |port| port.parse().ok().filter(|port| *port != 0))?;
    let valid = !host.is_empty() && host.len() < 256 && !host.contains(|c: char| c.is_whitespace() || c == '/');
    valid.then_some((host, port))
}

impl fmt::Display for LinkTarget {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Ethernet { interface, mac: None } => write!(f, "eth://{interface}"),
            Self::Ethernet { interface, mac: Some(mac) } => write!(f, "eth://{interface}/{}", DisplayMac(*mac)),
            Self::Tls { host, port, websocket } => write_host(f, if *websocket { "wss" } else { "tls" }, host, *port),
            Self::Udp { host, port, interface } => {
                write_host(f, "udp", host, *port)?;
                interface.iter().try_for_each(|interface| write!(f, "%{interface}"))
            }
        }
    }
}

fn write_host(f: &mut fmt::Formatter, scheme: &str, host: &str, port: u16) -> fmt::Result {
    match host.contains(':') {
        true => write!(f, "{scheme}://[{host}]:{port}"),
        false => write!(f, "{scheme}://{host}:{port}"),
    }
}

#[cfg(test)]
#[path = "../tests/unit/link_target.rs"]
mod tests;
