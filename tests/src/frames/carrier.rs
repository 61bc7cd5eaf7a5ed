//! Encapsulation of GDP frames, byte by byte after the RFCs: Ethernet, IEEE 802.1Q, RFC 791 and
//! 768, RFC 8200.

use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, SocketAddrV4, SocketAddrV6};

/// The encapsulation of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Carrier {
    Ethernet,
    /// The VLAN's tag control information.
    Vlan(u16),
    /// The datagram's addresses, and IPv4's type of service or IPv6's traffic class.
    Udp {
        from: SocketAddr,
        to: SocketAddr,
        class: u8,
    },
}

/// The position of a GDP frame in a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// Offset of the frame in bytes.
    pub at: usize,
    /// Length of the frame in bytes, possibly with padding.
    pub length: usize,
    pub over_udp: bool,
    /// IPv4's type of service or IPv6's traffic class; 0 on Ethernet.
    pub class: u8,
}

impl Carrier {
    /// Returns the whole Ethernet frame around a GDP frame.
    pub fn carry(&self, to_mac: [u8; 6], from_mac: [u8; 6], ethertype: u16, gdp: &[u8]) -> Vec<u8> {
        let macs = [to_mac, from_mac].concat();
        let udp_length = (gdp.len() + 8) as u16;
        let udp = |from: u16, to: u16| [from, to, udp_length, 0].map(u16::to_be_bytes).concat();
        match *self {
            Self::Ethernet => [&macs, &ethertype.to_be_bytes()[..], gdp].concat(),
            Self::Vlan(control) => {
                [&macs, &[0x81, 0][..], &control.to_be_bytes(), &ethertype.to_be_bytes(), gdp].concat()
            }
            Self::Udp { from: SocketAddr::V4(from), to: SocketAddr::V4(to), class } => {
                let ip = ipv4(from, to, class, udp_length + 20);
                [&macs, &[0x08, 0][..], &ip, &udp(from.port(), to.port()), gdp].concat()
            }
            Self::Udp { from: SocketAddr::V6(from), to: SocketAddr::V6(to), class } => {
                let ip = ipv6(from, to, class, udp_length);
                [&macs, &[0x86, 0xdd][..], &ip, &udp(from.port(), to.port()), gdp].concat()
            }
            Self::Udp { from, to, .. } => panic!("from {from} to {to}"),
        }
    }
}

/// Finds the frame in a packet for the given addresses and VLANs, following the RFCs.
pub fn find(packet: &[u8], ethertype: u16, own: &[SocketAddr], vlans: &[u16]) -> Option<Place> {
    let word = |at: usize| Some(u16::from_be_bytes([*packet.get(at)?, *packet.get(at + 1)?]));
    let directly = |at: usize| Some(Place { at, length: packet.len().checked_sub(at)?, over_udp: false, class: 0 });
    let datagram = |at: usize, end: usize, to: SocketAddr, class: u8| {
        let length = usize::from(word(at + 4)?);
        let fits = length >= 8 && at + length <= end && end <= packet.len();
        (fits && own.contains(&to)).then(|| Place { at: at + 8, length: length - 8, over_udp: true, class })
    };
    match word(12)? {
        found if found == ethertype => directly(14),
        0x8100 if word(16)? == ethertype && vlans.contains(&(word(14)? & 0xfff)) => directly(18),
        0x0800 if *packet.get(14)? == 0x45 && *packet.get(23)? == 17 && word(20)? & 0x3fff == 0 => {
            let to = Ipv4Addr::from(<[u8; 4]>::try_from(packet.get(30..34)?).ok()?);
            datagram(34, 14 + usize::from(word(16)?), SocketAddrV4::new(to, word(36)?).into(), packet[15])
        }
        0x86dd if packet.get(14)? >> 4 == 6 && *packet.get(20)? == 17 => {
            let to = Ipv6Addr::from(<[u8; 16]>::try_from(packet.get(38..54)?).ok()?);
            datagram(
                54,
                54 + usize::from(word(18)?),
                SocketAddrV6::new(to, word(56)?, 0, 0).into(),
                packet[14] << 4 | packet[15] >> 4,
            )
        }
        _ => None,
    }
}

/// Returns the RFC 1071 checksum of a header whose checksum field is 0. Returns 0 for a header with
/// a correct checksum.
pub fn internet_checksum(bytes: &[u8]) -> u16 {
    let mut sum: u32 =
        bytes.chunks(2).map(|pair| u32::from(pair[0]) << 8 | pair.get(1).map_or(0, |b| u32::from(*b))).sum();
    while sum > 0xffff {
        sum = (sum >> 16) + (sum & 0xffff);
    }
    !(sum as u16)
}

fn ipv4(from: SocketAddrV4, to: SocketAddrV4, class: u8, length: u16) -> Vec<u8> {
    let [high, low] = length.to_be_bytes();
    let mut header = vec![0x45, class, high, low, 0, 0, 0x40, 0, 64, 17, 0, 0];
    header.extend(from.ip().octets());
    header.extend(to.ip().octets());
    let checksum = internet_checksum(&header);
    header[10..12].copy_from_slice(&checksum.to_be_bytes());
    header
}

fn ipv6(from: SocketAddrV6, to: SocketAddrV6, class: u8, length: u16) -> Vec<u8> {
    let [high, low] = length.to_be_bytes();
    let mut header = vec![0x60 | class >> 4, class << 4, 0, 0, high, low, 17, 64];
    header.extend(from.ip().octets());
    header.extend(to.ip().octets());
    header
}
