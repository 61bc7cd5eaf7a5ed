//! The criteria for packets to this switch, and the next hops of links over UDP. The component that
//! knows the host's addresses and routes writes them. Every loop reads them.

use gdp_wire::LocalAddress;
use gdp_wire::table::{MAX_LINKS, link_index};

use crate::carrier::{Ours, Stations};

/// Properties of this host that packets depend on. Any change replaces the whole value.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Local {
    /// Ethertype of GDP frames, in host order.
    pub ethertype: u16,
    /// Addresses at which frames over UDP arrive.
    pub addresses: Vec<LocalAddress>,
    /// VLANs on which GDP runs: port and VLAN id.
    pub vlans: Vec<(u32, u16)>,
    /// Next hops of links over UDP, by link id.
    pub next_hops: NextHops,
}

/// Next hops by link id. They are stored at the link's index, as in the tables: a new link replaces
/// the previous link with its index.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct NextHops(Vec<Option<(u32, NextHop)>>);

impl NextHops {
    #[inline]
    pub fn get(&self, id: u32) -> Option<&NextHop> {
        match self.0.get(link_index(id) as usize) {
            Some(Some((of, hop))) if *of == id => Some(hop),
            _ => None,
        }
    }

    pub fn set(&mut self, id: u32, hop: Option<NextHop>) {
        // Without links over UDP, allocate nothing.
        if self.0.is_empty() && hop.is_some() {
            self.0 = vec![None; MAX_LINKS as usize];
        }
        if let Some(place) = self.0.get_mut(link_index(id) as usize) {
            *place = hop.map(|hop| (id, hop));
        }
    }
}

impl FromIterator<(u32, NextHop)> for NextHops {
    fn from_iter<I: IntoIterator<Item = (u32, NextHop)>>(hops: I) -> Self {
        let mut all = Self::default();
        hops.into_iter().for_each(|(id, hop)| all.set(id, Some(hop)));
        all
    }
}

/// Egress port of a packet, with its MAC addresses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NextHop {
    pub port: u32,
    pub peer: [u16; 3],
    pub local: [u16; 3],
}

impl NextHop {
    #[inline]
    pub fn stations(&self) -> Stations<'_> {
        Stations { peer: &self.peer, local: &self.local }
    }
}

/// [`Local`] for packets that arrived at one port.
pub struct At<'a> {
    pub local: &'a Local,
    pub port: u32,
}

impl Ours for At<'_> {
    fn ethertype(&self) -> u16 {
        self.local.ethertype
    }

    fn is_ours(&self, address: &LocalAddress) -> bool {
        // A linear search suffices, because a host has few addresses.
        self.local.addresses.contains(address)
    }

    fn is_our_vlan(&self, id: u16) -> bool {
        self.local.vlans.contains(&(self.port, id))
    }
}
