//! What of a packet says that it is for this switch, and where frames leave over UDP: written by
//! whoever knows the host's addresses and routes, read by every loop.

use gdp_wire::LocalAddress;
use gdp_wire::table::{MAX_LINKS, link_index};

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
    pub next_hops: NextHops,
}

/// By link id. At the link's index, as in the tables: a link takes the place of the one that had
/// its index before.
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
        // Without links over UDP there is nothing to keep.
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

/// The port that a packet leaves by, and the stations it goes between.
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
