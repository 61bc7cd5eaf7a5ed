//! Addresses and interfaces on which the kernel accepts frames over UDP. They are the addresses of
//! the daemon's socket and the interfaces that have them.

use std::collections::{HashMap, HashSet};
use std::net::SocketAddr;

use gdp_link::port::Interface;
use gdp_wire::LocalAddress;

use crate::host_pair::{self, Ends};
use crate::udp;

pub struct UdpPort {
    bound: SocketAddr,
    /// The host pair for endpoints on this host.
    pub pair: Option<Ends>,
    /// Interfaces that have one of the socket's addresses, and the switch's end of the host pair.
    pub devices: HashSet<u32>,
    /// Whether to log interfaces that are added from now on.
    pub logs: bool,
}

impl UdpPort {
    pub fn new(bound: SocketAddr, pair: Option<Ends>) -> Self {
        Self { bound, pair, devices: HashSet::new(), logs: false }
    }

    /// Returns the current addresses, and the interfaces by index; `None` if the addresses cannot
    /// be read.
    pub fn taken(&self) -> Option<(HashSet<LocalAddress>, HashMap<u32, String>)> {
        let taken = match udp::addresses() {
            Ok(mut addresses) => {
                addresses.retain(|address| !host_pair::is_end(&address.interface));
                udp::taken_at(self.bound, addresses)
            }
            Err(error) => {
                tracing::warn!(%error, "the addresses of interfaces cannot be read; UDP is taken where it was");
                return None;
            }
        };
        let pair = self.pair.as_ref();
        let by_pair = pair.map(|pair| LocalAddress::new(pair.addresses.switch_ip.into(), self.bound.port()));
        let addresses = taken.iter().map(|(address, _)| *address).chain(by_pair).collect();
        // `Interface::find` fails for interfaces that are not Ethernet.
        let interfaces = taken.iter().filter(|(_, at)| !at.loopback).map(|(_, at)| at.interface.as_str());
        let interfaces = interfaces.chain(pair.map(|pair| pair.switch.name.as_str()));
        let found = interfaces.collect::<HashSet<_>>().into_iter().filter_map(|name| Interface::find(name).ok());
        Some((addresses, found.map(|interface| (interface.index, interface.name)).collect()))
    }
}
