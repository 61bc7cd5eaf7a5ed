//! The table entries of a data plane, laid out for BPF maps. They are derived state: the control
//! plane owns the original state and may rewrite them at any time. The types have no implicit
//! padding, and no enums over bytes that others write.

use core::fmt;
use core::net::IpAddr;

use crate::Name;

/// Version of all data plane memory that outlives a daemon: the maps, and the meaning of their
/// entries. Must be raised with every change of meaning. Must also be raised with changes of sizes,
/// although the daemon compares those itself.
pub const ABI: u32 = 8;

/// Maximum number of links of a switch. The low bits of a link id are the index of its entry.
pub const MAX_LINKS: u32 = 1024;

/// Number of egress switches in an egress set.
pub const EGRESS_SET_SIZE: u32 = 64;

/// Maximum number of interfaces that a switch can redirect to.
pub const MAX_PORTS: u32 = 128;

/// `LinkEntry::port` of a link that only the userspace plane can send on.
pub const PORT_USERSPACE: u32 = u32::MAX;

/// `LinkEntry::port` of a link over UDP. The kernel's routing table determines the interface of the
/// neighbour.
pub const PORT_ROUTED: u32 = u32::MAX - 1;

/// Maximum number of addresses where a switch accepts frames over UDP.
pub const MAX_LOCAL_ADDRESSES: u32 = 1024;

/// Minimum interval between two errors to a neighbour.
pub const COMPLAINT_INTERVAL_NS: u64 = 10_000_000;

/// Minimum interval between two probes from a link that the daemon receives.
pub const PUNT_INTERVAL_NS: u64 = 10_000_000;

/// The group of all neighbouring switches, without endpoints.
pub const NEIGHBOURS: u32 = 0;

/// Maximum number of groups of links that the kernel can copy frames to. The userspace plane
/// handles names with other groups.
pub const MAX_GROUPS: u32 = 256;

/// Maximum number of links in a group that the kernel copies frames to.
pub const MAX_COPIES: u32 = 128;

/// Maximum length of a GDP frame that the kernel copies. A copy and the preceding data in memory
/// must fit a page of 4096 bytes. The kernel drops larger copies silently.
pub const MAX_COPIED_FRAME: usize = 3400;

/// `FibEntry::writer_link` of a name that every endpoint may send to, under its own source. Other
/// domains may send under the sources permitted to them. Used while routes of a previous daemon are
/// retained: its permits refer to links that are being re-established.
pub const ANY_WRITER: u32 = u32::MAX;

/// The role of the neighbour on a link. Stored as its number in [`LinkEntry::role`]; 0 marks a free
/// entry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum LinkRole {
    /// A proxy or another writer and reader. The switch looks up the names of its frames.
    Endpoint = 1,
    /// A switch of the same domain. Its frames already have egress bits.
    Switch = 2,
    /// A switch of another domain. The switch looks up the names of its frames, and does not
    /// forward them to a third domain unless the link has [`LinkEntry::TRANSIT`].
    Border = 3,
}

/// One link: an authenticated adjacency with a neighbour. Its `Debug` form omits the keys.
#[derive(Clone, Copy, Default, PartialEq, Eq)]
#[repr(C)]
pub struct LinkEntry {
    /// The id that this switch assigned to the link; arriving frames carry it. Never 0 for a live
    /// link.
    pub id: u32,
    /// The id that the neighbour assigned to the link; leaving frames carry it.
    pub peer_id: u32,
    /// [`LinkRole`] of the neighbour; 0 for a free entry.
    pub role: u32,
    /// Key of the neighbour's interface in the device map, or [`PORT_ROUTED`] or
    /// [`PORT_USERSPACE`]. A link over UDP has an interface only for an endpoint on the switch's
    /// own host.
    pub port: u32,
    /// SipHash keys of arriving frames, by the key phase in their flags. Both are always keys of
    /// the link: the current one and its successor.
    pub rx_keys: [[u64; 2]; 2],
    /// SipHash keys of leaving frames, by key phase.
    pub tx_keys: [[u64; 2]; 2],
    /// Egress switches reachable through this neighbour; 0 for an endpoint.
    pub reach: u64,
    /// The neighbour's name, which is the required source of an endpoint's frames.
    pub peer: Name,
    /// Largest GDP frame on the link in bytes: header and payload, without the carrier.
    pub mtu: u32,
    /// Key phase of leaving frames: 0 or 1.
    pub tx_phase: u32,
    /// The carrier of frames to the neighbour.
    pub carrier: Carrier,
    /// Number of the link among the links of an endpoint. For the successor of the running daemon;
    /// data planes ignore it.
    pub lane: u16,
    /// [`LinkEntry::TRANSIT`].
    pub flags: u16,
}

impl LinkEntry {
    /// Flag of a border link: frames from this link may go on to a third domain.
    pub const TRANSIT: u16 = 1;

    /// Returns the role of the neighbour, or `None` if the entry is free.
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

/// The carrier of the frames on a link: Ethernet, or UDP over Ethernet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub struct Carrier {
    /// [`Carrier::ETHERNET`], [`Carrier::UDP4`] or [`Carrier::UDP6`].
    pub kind: u8,
    /// [`Carrier::ZERO_CHECKSUM`], [`Carrier::CHECKSUM`].
    pub flags: u8,
    /// IEEE 802.1Q tag control information, in host order; 0: no tag. On Ethernet only.
    pub vlan: u16,
    /// The neighbour's MAC address. Valid on Ethernet, and over UDP if [`LinkEntry::port`] is an
    /// interface.
    pub peer_mac: [u16; 3],
    /// The switch's MAC address, under the same condition.
    pub local_mac: [u16; 3],
    /// UDP port of the neighbour, in network order.
    pub peer_port: u16,
    /// UDP port of the switch, in network order.
    pub local_port: u16,
    /// IP address of the neighbour, in network order; an IPv4 address is in the first word.
    pub peer_ip: [u32; 4],
    /// IP address of the switch, in the same format.
    pub local_ip: [u32; 4],
}

impl Carrier {
    /// Frames are payload of Ethernet frames.
    pub const ETHERNET: u8 = 0;
    /// Frames are payload of UDP over IPv4.
    pub const UDP4: u8 = 1;
    /// Frames are payload of UDP over IPv6.
    pub const UDP6: u8 = 2;

    /// Flag: over IPv6, the neighbour accepts datagrams with a UDP checksum of 0 (RFC 6936).
    pub const ZERO_CHECKSUM: u8 = 1;
    /// Flag: the neighbour's kernel coalesces datagrams that have a UDP checksum (UDP GRO). This
    /// saves the neighbour more than the checksum costs the sender.
    pub const CHECKSUM: u8 = 2;

    /// Returns untagged Ethernet between two MAC addresses.
    pub fn ethernet(peer_mac: [u8; 6], local_mac: [u8; 6]) -> Self {
        Self { peer_mac: mac_words(peer_mac), local_mac: mac_words(local_mac), ..Self::default() }
    }
}

/// An address where the switch receives UDP datagrams with frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[repr(C)]
pub struct LocalAddress {
    /// IP address in network order; an IPv4 address is in the first word, and the others are zero.
    pub ip: [u32; 4],
    /// UDP port in network order.
    pub port: u16,
    /// [`Carrier::UDP4`] or [`Carrier::UDP6`].
    pub kind: u16,
}

impl LocalAddress {
    /// Returns the key of an IP address and a port in host order. `ip` must not be an IPv6-mapped
    /// IPv4 address.
    pub fn new(ip: IpAddr, port: u16) -> Self {
        let (kind, ip) = ip_words(ip);
        Self { ip, port: port.to_be(), kind: kind.into() }
    }
}

/// Returns the kind of carrier and the words of an IP address, in the format of [`Carrier`].
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

/// Returns the IP address that a carrier of this kind stores in these words.
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

/// Returns the words with the same bytes in memory as a MAC address.
pub const fn mac_words([a, b, c, d, e, f]: [u8; 6]) -> [u16; 3] {
    [u16::from_ne_bytes([a, b]), u16::from_ne_bytes([c, d]), u16::from_ne_bytes([e, f])]
}

/// Returns the bytes of a MAC address.
pub fn mac_bytes(words: [u16; 3]) -> [u8; 6] {
    let [a, b, c] = words.map(u16::to_ne_bytes);
    [a[0], a[1], b[0], b[1], c[0], c[1]]
}

/// The route of a name on this switch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub struct FibEntry {
    /// Egress switches that need a copy, stamped at the ingress switch.
    pub egress_bits: u64,
    /// Link id of the local reader, if there is exactly one; otherwise 0.
    pub local_link: u32,
    /// The group of the local readers and all neighbouring switches; [`NEIGHBOURS`] if there are no
    /// local readers.
    pub group: u32,
    /// Link id of a local endpoint that may send to the name, or 0, or [`ANY_WRITER`].
    pub writer_link: u32,
    /// The egress set that `egress_bits` refers to.
    pub egress_set: u8,
    /// Not 0 if other local endpoints may also send to the name. Each of them has a [`Permit`].
    pub more_writers: u8,
    /// Zero.
    pub reserved: u16,
}

/// Allows frames of a link to have a name in their header that neither the link nor the name's
/// [`FibEntry`] allows.
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
    /// The name may be the destination.
    pub const DESTINATION: u32 = 0;
    /// The name may be the source.
    pub const SOURCE: u32 = 1;
}

/// A slot of a group, which maps to the link of one copy. Several copies may leave by one
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

/// The copies of one frame that have left by an interface, on one CPU.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub struct CopyCount {
    /// The low 48 bits of the sequence number of the frame.
    pub sequence: u64,
    pub copies: u32,
    /// Superfluous copies of all frames, since the kernel last reported how many frames of a batch
    /// it sent.
    pub superfluous: u32,
}

/// The configuration of a switch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub struct SwitchConfig {
    /// This switch's own egress bit.
    pub own_bit: u64,
    /// Ethertype of GDP frames, in host order.
    pub ethertype: u32,
    /// Index of the interface that connects endpoints on the switch's own host; 0: none.
    pub host_pair: u32,
}

/// Returns the index of the entry of link `id`.
#[inline(always)]
pub const fn link_index(id: u32) -> u32 {
    id & (MAX_LINKS - 1)
}

const _: () = {
    // The checks of arriving frames use the first two cache lines; the third is for leaving frames.
    assert!(size_of::<LinkEntry>() == 184 && align_of::<LinkEntry>() == 8);
    assert!(core::mem::offset_of!(LinkEntry, carrier) == 128);
    assert!(size_of::<Carrier>() == 52 && align_of::<Carrier>() == 4);
    // With its name and a generation, an entry fills one cache line.
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
    // SAFETY: plain integers in `repr(C)` without padding (the asserted sizes are the sums of the
    // field sizes).
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
