//! What a data plane holds: the entries of its tables, laid out for BPF maps. Derived state; the control plane owns
//! the truth and rewrites these at will. No implicit padding, no enums over bytes that anybody else writes.

use core::fmt;

use crate::{Name, replay};

/// The version of everything a data plane keeps in memory that outlives a daemon: the maps, and what their entries mean. To
/// be raised with every change of meaning; of sizes as well, though a daemon compares those itself.
pub const ABI: u32 = 1;

/// Links a switch can have at once; the low bits of a link id are the index of its entry.
pub const MAX_LINKS: u32 = 1024;

/// Egress switches a set of egress bits can name.
pub const EGRESS_SET_SIZE: u32 = 64;

/// Interfaces a switch can redirect to; a port is below it.
pub const MAX_PORTS: u32 = 64;

/// `LinkEntry::port` of a link that the kernel cannot redirect to: the userspace plane sends on it.
pub const PORT_USERSPACE: u32 = u32::MAX;

/// `FibEntry::writer_link` where any endpoint may send to the name, as its own source: while what a daemon left that is no more
/// is held, which knew its writers by links that are being made anew.
pub const ANY_WRITER: u32 = u32::MAX;

/// Who is at the other end of a link. Stored as its number in [`LinkEntry::role`]; 0 is a free entry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum LinkRole {
    /// A proxy or another writer and reader: names are looked up on what it sends.
    Endpoint = 1,
    /// A switch of the same domain: it stamped the egress bits.
    Switch = 2,
}

/// One link: an authenticated adjacency with a neighbour. Its `Debug` form leaves the keys out.
#[derive(Clone, Copy, Default, PartialEq, Eq)]
#[repr(C)]
pub struct LinkEntry {
    /// The id this switch gave the link; frames arrive with it. Never 0 for a live link.
    pub id: u32,
    /// The id the neighbour gave it; frames leave with it.
    pub peer_id: u32,
    /// [`LinkRole`] of the neighbour; 0 for a free entry.
    pub role: u32,
    /// Key of the neighbour's interface in the device map, or [`PORT_USERSPACE`].
    pub port: u32,
    /// SipHash key of frames that arrive.
    pub rx_key: [u64; 2],
    /// SipHash key of frames that leave.
    pub tx_key: [u64; 2],
    /// Egress switches this neighbour leads to; 0 for an endpoint.
    pub reach: u64,
    /// Largest GDP frame (header and payload, without what carries it) the link takes, in bytes.
    pub mtu: u32,
    /// The neighbour's MAC address, on Ethernet links.
    pub peer_mac: [u16; 3],
    /// Ours.
    pub local_mac: [u16; 3],
    /// The neighbour's name. An endpoint's frames must have it as their source.
    pub peer: Name,
}

impl fmt::Debug for LinkEntry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { id, peer_id, role, port, rx_key: _, tx_key: _, reach, mtu, peer_mac: _, local_mac: _, peer } = self;
        write!(
            f,
            "LinkEntry({id:#x} to {peer_id:#x} of {peer:#}, role {role}, port {port}, reach {reach:#x}, mtu {mtu})"
        )
    }
}

/// Where a name leads from this switch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub struct FibEntry {
    /// Egress switches that want a copy, stamped at the ingress switch.
    pub egress_bits: u64,
    /// Link id of the local endpoint that takes the name, or 0.
    pub local_link: u32,
    /// The egress set that `egress_bits` speaks of.
    pub egress_set: u32,
    /// Link id of a local endpoint that may send to the name, or 0, or [`ANY_WRITER`].
    pub writer_link: u32,
    /// Not 0 if other local endpoints may, too: each has a [`Permit`].
    pub more_writers: u32,
}

/// That an endpoint may send to a name, where that is not in the name's [`FibEntry`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(C)]
pub struct Permit {
    pub name: Name,
    /// Id of the endpoint's link.
    pub link: u32,
    /// Zero.
    pub reserved: u32,
}

/// What a switch knows of itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub struct SwitchConfig {
    /// This switch's own egress bit.
    pub own_bit: u64,
    /// Ethertype of GDP frames, in host order.
    pub ethertype: u32,
    /// Zero.
    pub reserved: u32,
}

/// What [`crate::forward::decide`] asks of a data plane. Lookups must be bounded and must not block.
pub trait Tables {
    /// The link with this id, if it is live.
    fn link(&self, id: u32) -> Option<&LinkEntry>;

    /// Where this name leads.
    fn route(&self, name: &Name) -> Option<FibEntry>;

    /// Link id of the neighbour on the path to egress switch `bit` (0 … 63); 0 if there is none.
    fn next_hop(&self, bit: u32) -> u32;

    /// This switch's own egress bit.
    fn own_bit(&self) -> u64;

    /// Whether this link has a [`Permit`] for a name. Asked only where the name's entry says that there are some.
    fn is_permitted(&self, link: &LinkEntry, name: &Name) -> bool;

    /// What frames have arrived on this link, shared by all planes that take frames from it.
    fn window(&self, link: &LinkEntry) -> Option<impl replay::Words>;

    /// The count for a frame that leaves by this link: 1 for the first.
    fn next_count(&self, link: &LinkEntry) -> u64;
}

/// Index of the entry of link `id`.
#[inline(always)]
pub const fn link_index(id: u32) -> u32 {
    id & (MAX_LINKS - 1)
}

const _: () = {
    // No more than two cache lines.
    assert!(size_of::<LinkEntry>() == 104 && align_of::<LinkEntry>() == 8);
    // With its name and a generation, one.
    assert!(size_of::<FibEntry>() == 24 && align_of::<FibEntry>() == 8);
    assert!(size_of::<Permit>() == 40 && align_of::<Permit>() == 8);
    assert!(size_of::<SwitchConfig>() == 16 && align_of::<SwitchConfig>() == 8);
    assert!(MAX_LINKS.is_power_of_two());
};

#[cfg(feature = "aya")]
mod pod {
    // SAFETY: plain integers in `repr(C)` without padding (the sizes above are the sums of the fields').
    unsafe impl aya::Pod for super::LinkEntry {}
    // SAFETY: as above.
    unsafe impl aya::Pod for super::FibEntry {}
    // SAFETY: as above.
    unsafe impl aya::Pod for super::SwitchConfig {}
    // SAFETY: as above.
    unsafe impl aya::Pod for super::Permit {}
    // SAFETY: four u64.
    unsafe impl aya::Pod for crate::Name {}
}

#[cfg(test)]
mod tests {
    use super::LinkEntry;

    #[test]
    fn nothing_prints_a_link_key() {
        let entry = LinkEntry { id: 7, rx_key: [0x4242; 2], tx_key: [0x5353; 2], ..LinkEntry::default() };
        let text = format!("{entry:?} {entry:#x?}");
        for secret in ["4242", "5353", &0x4242.to_string(), &0x5353.to_string()] {
            assert!(!text.contains(secret), "{text}");
        }
    }
}
