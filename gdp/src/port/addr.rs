//! Where the other end of a link is.

use std::fmt;
use std::net::{IpAddr, Ipv6Addr, SocketAddr};

/// The address frames of a link are sent to. Only ever a hint on what arrives: a link is found by its id and tag.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum LinkAddr {
    /// A station on the segment of a local interface.
    Ethernet { ifindex: u32, mac: [u8; 6] },
    /// IPv4 or IPv6; an IPv4 address is never in its IPv6-mapped form.
    Udp(SocketAddr),
}

impl LinkAddr {
    /// A UDP address, with an IPv6-mapped IPv4 address unmapped.
    pub fn udp(addr: SocketAddr) -> Self {
        Self::Udp(SocketAddr::new(addr.ip().to_canonical(), addr.port()))
    }
}

impl fmt::Display for LinkAddr {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Ethernet { ifindex, mac } => write!(f, "eth:{ifindex}/{}", DisplayMac(*mac)),
            Self::Udp(addr) => write!(f, "udp:{addr}"),
        }
    }
}

/// A MAC address as people write it.
pub struct DisplayMac(pub [u8; 6]);

impl fmt::Display for DisplayMac {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [a, b, c, d, e, g] = self.0;
        write!(f, "{a:02x}:{b:02x}:{c:02x}:{d:02x}:{e:02x}:{g:02x}")
    }
}

/// Six pairs of hex digits, with colons between them.
pub fn parse_mac(text: &str) -> Option<[u8; 6]> {
    let mut mac = [0; 6];
    let mut parts = text.split(':');
    for byte in &mut mac {
        let part = parts.next()?;
        if part.len() != 2 || !part.bytes().all(|c| c.is_ascii_hexdigit()) {
            return None;
        }
        *byte = u8::from_str_radix(part, 16).ok()?;
    }
    parts.next().is_none().then_some(mac)
}

/// quinn knows socket addresses only: a MAC address is shown to it as fd47::MAC, port 1.
pub(super) fn mac_to_socket(mac: [u8; 6]) -> SocketAddr {
    let mut octets = [0; 16];
    octets[..2].copy_from_slice(&[0xfd, 0x47]);
    octets[10..].copy_from_slice(&mac);
    SocketAddr::new(Ipv6Addr::from(octets).into(), 1)
}

/// The MAC address in a socket address that [`mac_to_socket`] made.
pub(super) fn socket_to_mac(addr: &SocketAddr) -> [u8; 6] {
    let IpAddr::V6(ip) = addr.ip() else { return [0; 6] };
    let mut mac = [0; 6];
    mac.copy_from_slice(&ip.octets()[10..]);
    mac
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_read_as_people_write_them() {
        let mac = [2, 0, 0, 0, 0xab, 1];
        assert_eq!(LinkAddr::Ethernet { ifindex: 3, mac }.to_string(), "eth:3/02:00:00:00:ab:01");
        assert_eq!(LinkAddr::udp("[::ffff:1.2.3.4]:5".parse().unwrap()).to_string(), "udp:1.2.3.4:5");
        assert_eq!(parse_mac("02:00:00:00:AB:01"), Some(mac));
        for text in
            ["", "02:00:00:00:ab", "02:00:00:00:ab:01:02", "2:0:0:0:ab:1", "+2:00:00:00:ab:01", "02-00-00-00-ab-01"]
        {
            assert_eq!(parse_mac(text), None, "{text}");
        }
        assert_eq!(socket_to_mac(&mac_to_socket(mac)), mac);
    }
}
