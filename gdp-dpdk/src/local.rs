//! What of a packet says that it is for this switch, and where frames leave over UDP: written by whoever knows the host's addresses
//! and routes, read by every loop.

use std::collections::HashMap;

use gdp_wire::LocalAddress;

use crate::carrier::{Ours, Stations};

/// What this host is, as far as packets tell. Replaced as a whole when something changes.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Local {
    /// Of GDP frames, in host order.
    pub ethertype: u16,
    /// Where frames over UDP arrive.
    pub addresses: Vec<LocalAddress>,
    /// VLANs that GDP runs on: port and id.
    pub vlans: Vec<(u32, u16)>,
    /// Where the datagrams of links over UDP leave, by link id.
    pub next_hops: HashMap<u32, NextHop>,
}

/// The port that a packet leaves by, and the stations it goes between.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NextHop {
    pub port: u32,
    pub stations: Stations,
}

/// [`Local`] as packets see it that arrived at one port.
pub struct At<'a> {
    pub local: &'a Local,
    pub port: u32,
}

impl Ours for At<'_> {
    fn ethertype(&self) -> u16 {
        self.local.ethertype
    }

    fn is_ours(&self, address: &LocalAddress) -> bool {
        // A host has a few.
        self.local.addresses.contains(address)
    }

    fn is_our_vlan(&self, id: u16) -> bool {
        self.local.vlans.contains(&(self.port, id))
    }
}
