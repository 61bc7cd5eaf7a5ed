//! Looks up the egress of datagrams in the kernel's routes and neighbour table, as the kernel does
//! for its own datagrams.

use std::io;
use std::net::IpAddr;

use super::super::netlink::{Netlink, attribute, number};

/// Message kinds and attributes from `linux/rtnetlink.h` and `linux/neighbour.h`.
const NDA_DST: u16 = 1;
const NDA_LLADDR: u16 = 2;
const ROUTE_HEADER: usize = 12;
const NEIGHBOUR_HEADER: usize = 12;
/// States of a neighbour that is incomplete or has failed to answer.
const NUD_UNUSABLE: u16 = 0x01 | 0x20;

/// The kernel's routes, in the network namespace of the thread that opened them.
pub struct Routes(Netlink);

/// Egress of a datagram: the interface, and the MAC address of the next hop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Leaves {
    pub interface: u32,
    pub mac: [u8; 6],
}

impl Routes {
    pub fn open() -> io::Result<Self> {
        Netlink::open(libc::NETLINK_ROUTE).map(Self)
    }

    /// Returns the egress; `None` if there is no route, or the neighbour is unresolved.
    pub fn lookup(&self, from: IpAddr, to: IpAddr) -> Option<Leaves> {
        let family = if to.is_ipv4() { libc::AF_INET } else { libc::AF_INET6 } as u8;
        let (from, to) = (octets(from), octets(to));
        let bits = to.len() as u8 * 8;
        let header = [family, bits, bits, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        let attributes = [(libc::RTA_DST, &to[..]), (libc::RTA_SRC, &from[..])];
        let answer = self.0.ask(libc::RTM_GETROUTE, &header, &attributes).ok()?;
        let attributes = answer.get(ROUTE_HEADER..)?;
        let interface = number(attributes, libc::RTA_OIF)?;
        let station = attribute(attributes, libc::RTA_GATEWAY).unwrap_or(&to);
        Some(Leaves { interface, mac: self.station(family, interface, station)? })
    }

    fn station(&self, family: u8, interface: u32, ip: &[u8]) -> Option<[u8; 6]> {
        let mut header = [0; NEIGHBOUR_HEADER];
        header[0] = family;
        header[4..8].copy_from_slice(&interface.to_ne_bytes());
        let answer = self.0.ask(libc::RTM_GETNEIGH, &header, &[(NDA_DST, ip)]).ok()?;
        let state = u16::from_ne_bytes([*answer.get(8)?, *answer.get(9)?]);
        let mac = attribute(answer.get(NEIGHBOUR_HEADER..)?, NDA_LLADDR)?;
        if state & NUD_UNUSABLE != 0 { None } else { mac.try_into().ok() }
    }
}

fn octets(ip: IpAddr) -> Vec<u8> {
    match ip {
        IpAddr::V4(ip) => ip.octets().into(),
        IpAddr::V6(ip) => ip.octets().into(),
    }
}
