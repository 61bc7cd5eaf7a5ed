//! What a data plane holds: the entries of its tables, laid out for BPF maps. Derived state; the
//! control plane owns the truth and rewrites these at will. No implicit padding, no enums over
//! bytes that anybody else writes.

use core::fmt;
use core::net::IpAddr;

use crate::Name;

/// The version of everything a data plane keeps in memory that outlives a daemon: the maps, and
/// what their entries mean. To be raised with every change of meaning; of sizes as well, though a
/// daemon compares those itself.
pub const ABI: u32 = 6;

/// Links a switch can have at once; the low bits of a link id are the index of its entry.
pub const MAX_LINKS: u32 = 1024;

/// Egress switches a set of egress bits can name.
pub const EGRESS_SET_SIZE: u32 = 64;

/// Interfaces a switch can redirect to.
pub const MAX_PORTS: u32 = 128;

/// `LinkEntry::port` of a link that the kernel cannot send on: the userspace plane does.
pub const PORT_USERSPACE: u32 = u32::MAX;

/// `LinkEntry::port` of a link over UDP: the kernel's routing table says which interface leads to
/// the neighbour.
pub const PORT_ROUTED: u32 = u32::MAX - 1;

/// Addresses that a switch takes frames over UDP at.
pub const MAX_LOCAL_ADDRESSES: u32 = 1024;

/// A neighbour is sent an error no sooner than this after the one before.
pub const COMPLAINT_INTERVAL_NS: u64 = 10_000_000;

/// A daemon is given a probe that came on a link no sooner than this after the one before.
pub const PUNT_INTERVAL_NS: u64 = 10_000_000;

/// The group of all neighbouring switches, and no endpoint.
pub const NEIGHBOURS: u32 = 0;

/// Groups of links that the kernel can copy frames to; a name with another one is the userspace
/// plane's.
pub const MAX_GROUPS: u32 = 256;

/// Links in a group that the kernel copies frames to.
pub const MAX_COPIES: u32 = 128;

/// Bytes of a GDP frame that the kernel copies. Its copies, with what lies before them in memory,
/// must fit a page of 4096 bytes; those that do not vanish without a trace.
pub const MAX_COPIED_FRAME: usize = 3400;

/// `FibEntry::writer_link` where any endpoint may send to the name, as its own source, and other
/// domains as those they may: while what a daemon left that is no more is held, which knew its
/// writers by links that are being made anew.
pub const ANY_WRITER: u32 = u32::MAX;

/// Who is at the other end of a link. Stored as its number in [`LinkEntry::role`]; 0 is a free
/// entry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum LinkRole {
    /// A proxy or another writer and reader: names are looked up on what it sends.
    Endpoint = 1,
    /// A switch of the same domain: it stamped the egress bits.
    Switch = 2,
    /// A switch of another domain: names are looked up on what it sends, and none of that goes on
    /// to a third domain, unless the link's entry says [`LinkEntry::TRANSIT`].
    Border = 3,
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
    /// Key in the device map of the interface the neighbour is behind, [`PORT_ROUTED`] or
    /// [`PORT_USERSPACE`]. Over UDP an interface is given only for an endpoint on the switch's own
    /// host.
    pub port: u32,
    /// SipHash keys of frames that arrive, by the key phase in their flags. Both are always keys of
    /// the link: the one in use and the one that follows it.
    pub rx_keys: [[u64; 2]; 2],
    /// SipHash keys of frames that leave, by key phase.
    pub tx_keys: [[u64; 2]; 2],
    /// Egress switches this neighbour leads to; 0 for an endpoint.
    pub reach: u64,
    /// The neighbour's name. An endpoint's frames must have it as their source.
    pub peer: Name,
    /// Largest GDP frame (header and payload, without what carries it) the link takes, in bytes.
    pub mtu: u32,
    /// Key phase of frames that leave: 0 or 1.
    pub tx_phase: u32,
    /// What carries frames to the neighbour.
    pub carrier: Carrier,
    /// Which of the links of an endpoint it is. For the daemon after the present one; data planes
    /// do not look at it.
    pub lane: u16,
    /// [`LinkEntry::TRANSIT`].
    pub flags: u16,
}

impl LinkEntry {
    /// Flag of a border link: what comes by it may go on to a third domain.
    pub const TRANSIT: u16 = 1;

    /// Who is at the other end; none: the entry is free.
    pub fn role(&self) -> Option<LinkRole> {
        [LinkRole::Endpoint, LinkRole::Switch, LinkRole::Border].into_iter().find(|role| *role as u32 == self.role)
    }
}

impl fmt::Debug for LinkEntry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { id, peer_id, role, port, rx_keys: _, tx_keys: _, reach, peer, mtu, tx_phase, carrier, lane, flags } =
            self;
        write!(
            f,
            "LinkEntry({id:#x} to {peer_id:#x} of {peer:#}, role {role}, port {port}, reach {reach:#x}, mtu {mtu}, \
             key phase \
             {tx_phase}, {carrier:?}, lane {lane}, flags {flags:#x})"
        )
    }
}

/// What carries the frames that leave by a link: Ethernet, or UDP on it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub struct Carrier {
    /// [`Carrier::ETHERNET`], [`Carrier::UDP4`] or [`Carrier::UDP6`].
    pub kind: u8,
    /// [`Carrier::ZERO_CHECKSUM`], [`Carrier::CHECKSUM`].
    pub flags: u8,
    /// IEEE 802.1Q tag control information, in host order; 0: no tag. On Ethernet only.
    pub vlan: u16,
    /// The neighbour's MAC address. On Ethernet, and over UDP where [`LinkEntry::port`] is an
    /// interface.
    pub peer_mac: [u16; 3],
    /// Ours, likewise.
    pub local_mac: [u16; 3],
    /// UDP port of the neighbour, in network order.
    pub peer_port: u16,
    /// Ours, in network order.
    pub local_port: u16,
    /// IP address of the neighbour, in network order; an IPv4 address is in the first word.
    pub peer_ip: [u32; 4],
    /// Ours, likewise.
    pub local_ip: [u32; 4],
}

impl Carrier {
    /// Frames are payload of Ethernet frames.
    pub const ETHERNET: u8 = 0;
    /// Frames are payload of UDP over IPv4.
    pub const UDP4: u8 = 1;
    /// Frames are payload of UDP over IPv6.
    pub const UDP6: u8 = 2;

    /// Flag: over IPv6, the neighbour takes datagrams whose UDP checksum is 0 (RFC 6936).
    pub const ZERO_CHECKSUM: u8 = 1;
    /// Flag: the neighbour's kernel joins datagrams that have a UDP checksum (UDP GRO), which saves
    /// it more than the sum costs.
    pub const CHECKSUM: u8 = 2;

    /// Untagged Ethernet between two stations.
    pub fn ethernet(peer_mac: [u8; 6], local_mac: [u8; 6]) -> Self {
        Self { peer_mac: mac_words(peer_mac), local_mac: mac_words(local_mac), ..Self::default() }
    }
}

/// An address that UDP datagrams with frames arrive at.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[repr(C)]
pub struct LocalAddress {
    /// In network order; an IPv4 address is in the first word, and the others are zero.
    pub ip: [u32; 4],
    /// In network order.
    pub port: u16,
    /// [`Carrier::UDP4`] or [`Carrier::UDP6`].
    pub kind: u16,
}

impl LocalAddress {
    /// Of an IP address, which is not an IPv6-mapped IPv4 address, and a port in host order.
    pub fn new(ip: IpAddr, port: u16) -> Self {
        let (kind, ip) = ip_words(ip);
        Self { ip, port: port.to_be(), kind: kind.into() }
    }
}

/// The kind of carrier and the words of an IP address, as [`Carrier`] has them.
pub fn ip_words(ip: IpAddr) -> (u8, [u32; 4]) {
    match ip {
        IpAddr::V4(ip) => (Carrier::UDP4, [u32::from_ne_bytes(ip.octets()), 0, 0, 0]),
        IpAddr::V6(ip) => {
            let octets = ip.octets();
            let (words, _) = octets.as_chunks();
            (Carrier::UDP6, core::array::from_fn(|i| u32::from_ne_bytes(words[i])))
        }
    }
}

/// The IP address that a carrier of this kind has in these words.
pub fn ip_of(kind: u8, words: [u32; 4]) -> IpAddr {
    if kind == Carrier::UDP4 {
        return IpAddr::from(words[0].to_ne_bytes());
    }
    let mut octets = [0; 16];
    octets.as_chunks_mut().0.iter_mut().zip(words).for_each(|(octets, word)| *octets = word.to_ne_bytes());
    IpAddr::from(octets)
}

/// A VLAN of an interface that GDP runs on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[repr(C)]
pub struct Vlan {
    /// Index of the interface that takes the tagged frames.
    pub ifindex: u32,
    /// 1 to 4094.
    pub id: u32,
}

/// A MAC address as words that have the same bytes in memory.
pub const fn mac_words([a, b, c, d, e, f]: [u8; 6]) -> [u16; 3] {
    [u16::from_ne_bytes([a, b]), u16::from_ne_bytes([c, d]), u16::from_ne_bytes([e, f])]
}

/// The bytes of a MAC address.
pub fn mac_bytes(words: [u16; 3]) -> [u8; 6] {
    let [a, b, c] = words.map(u16::to_ne_bytes);
    [a[0], a[1], b[0], b[1], c[0], c[1]]
}

/// Where a name leads from this switch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub struct FibEntry {
    /// Egress switches that want a copy, stamped at the ingress switch.
    pub egress_bits: u64,
    /// Link id of the local reader, if there is exactly one; otherwise 0.
    pub local_link: u32,
    /// The group of the local readers and all neighbouring switches; [`NEIGHBOURS`] if there are no
    /// local readers.
    pub group: u32,
    /// Link id of a local endpoint that may send to the name, or 0, or [`ANY_WRITER`].
    pub writer_link: u32,
    /// The egress set that `egress_bits` speaks of.
    pub egress_set: u8,
    /// Not 0 if other local endpoints may send to the name, too: each has a [`Permit`].
    pub more_writers: u8,
    /// Zero.
    pub reserved: u16,
}

/// That frames of a link may have a name in their header, where neither the link nor the name's
/// [`FibEntry`] says so.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(C)]
pub struct Permit {
    pub name: Name,
    /// Id of the link.
    pub link: u32,
    /// [`Permit::DESTINATION`] or [`Permit::SOURCE`].
    pub part: u32,
}

impl Permit {
    /// As their destination.
    pub const DESTINATION: u32 = 0;
    /// As their source.
    pub const SOURCE: u32 = 1;
}

/// A place in a group: which link gets the copy with this index, of those that leave by one
/// interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(C)]
pub struct GroupSlot {
    pub group: u32,
    /// Index of the interface.
    pub interface: u32,
    /// 0 for the first copy that leaves there.
    pub index: u32,
}

/// Copies of one frame that have left by an interface, on one CPU.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub struct CopyCount {
    /// Number of the frame, the low 48 bits.
    pub sequence: u64,
    pub copies: u32,
    /// Copies that nobody needed, of all frames, since the kernel last told how many frames of a
    /// batch left.
    pub superfluous: u32,
}

/// What a switch knows of itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub struct SwitchConfig {
    /// This switch's own egress bit.
    pub own_bit: u64,
    /// Ethertype of GDP frames, in host order.
    pub ethertype: u32,
    /// The interface by which endpoints on the switch's own host reach it; 0: there is none.
    pub host_pair: u32,
}

/// Index of the entry of link `id`.
#[inline(always)]
pub const fn link_index(id: u32) -> u32 {
    id & (MAX_LINKS - 1)
}

const _: () = {
    // What arrives is checked with the first two cache lines; the third is for what leaves.
    assert!(size_of::<LinkEntry>() == 184 && align_of::<LinkEntry>() == 8);
    assert!(core::mem::offset_of!(LinkEntry, carrier) == 128);
    assert!(size_of::<Carrier>() == 52 && align_of::<Carrier>() == 4);
    // With its name and a generation, one.
    assert!(size_of::<FibEntry>() == 24 && align_of::<FibEntry>() == 8);
    assert!(size_of::<Permit>() == 40 && align_of::<Permit>() == 8);
    assert!(size_of::<GroupSlot>() == 12 && align_of::<GroupSlot>() == 4);
    assert!(size_of::<CopyCount>() == 16 && align_of::<CopyCount>() == 8);
    assert!(size_of::<LocalAddress>() == 20 && align_of::<LocalAddress>() == 4);
    assert!(size_of::<Vlan>() == 8 && align_of::<Vlan>() == 4);
    assert!(size_of::<SwitchConfig>() == 16 && align_of::<SwitchConfig>() == 8);
    assert!(MAX_LINKS.is_power_of_two());
};

#[cfg(feature = "aya")]
mod pod {
    // SAFETY: plain integers in `repr(C)` without padding (the sizes above are the sums of the
    // fields').
    unsafe impl aya::Pod for super::LinkEntry {}
    // SAFETY: as above.
    unsafe impl aya::Pod for super::FibEntry {}
    // SAFETY: as above.
    unsafe impl aya::Pod for super::SwitchConfig {}
    // SAFETY: as above.
    unsafe impl aya::Pod for super::Permit {}
    // SAFETY: as above.
    unsafe impl aya::Pod for super::GroupSlot {}
    // SAFETY: as above.
    unsafe impl aya::Pod for super::CopyCount {}
    // SAFETY: as above.
    unsafe impl aya::Pod for super::LocalAddress {}
    // SAFETY: as above.
    unsafe impl aya::Pod for super::Vlan {}
    // SAFETY: four u64.
    unsafe impl aya::Pod for crate::Name {}
}

#[cfg(test)]
#[path = "../tests/unit/table.rs"]
mod tests;
