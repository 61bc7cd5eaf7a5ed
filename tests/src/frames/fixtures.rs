//! `tests/fixtures/frames.json`: one switch, and its handling of each of many frames.
//!
//! Byte strings are hexadecimal. Trailing zeros of a long frame are counted instead of written.
//! Everything else follows `docs/wire-format.md`.

use std::net::{IpAddr, SocketAddr};

use serde::{Deserialize, Serialize};

use super::carrier::{self, Carrier, Place};

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fixtures {
    pub about: Vec<String>,
    pub switch: Switch,
    pub cases: Vec<Case>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Switch {
    pub ethertype: u16,
    /// The number of this switch's egress bit.
    pub own_bit: u32,
    pub links: Vec<Link>,
    pub routes: Vec<Route>,
    pub next_hops: Vec<NextHop>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Link {
    pub label: String,
    pub id: u32,
    pub peer_id: u32,
    pub role: Role,
    /// The link leads into another domain, and its frames may continue to a third.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub transit: bool,
    /// The kernel's port number; `null`: the kernel cannot send on the link.
    pub port: Option<u32>,
    /// SipHash keys of 16 bytes, indexed by key phase.
    pub rx_keys: [String; 2],
    pub tx_keys: [String; 2],
    /// Key phase of frames that the switch sends.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub tx_phase: u32,
    /// Numbers of egress bits.
    pub reach: Vec<u32>,
    pub mtu: u32,
    /// The neighbour's MAC address; for a link over UDP, the next hop's.
    pub peer_mac: String,
    pub local_mac: String,
    #[serde(default, skip_serializing_if = "is_zero")]
    pub vlan: u16,
    /// The UDP addresses; `null`: directly on Ethernet.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub udp: Option<Udp>,
    /// The neighbour's name.
    pub peer: String,
    /// Frames sent on the link before the case.
    pub tx_counter: u64,
    /// Link counters of frames that arrived on the link before the case.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub taken: Vec<u64>,
}

/// Addresses and ports of a link over UDP.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Udp {
    pub local: SocketAddr,
    pub peer: SocketAddr,
    /// Whether the kernel must look up the next hop. Over IPv6 this means that the neighbour
    /// accepts datagrams without a checksum.
    pub routed: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    Endpoint,
    Switch,
    Border,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Route {
    pub label: String,
    pub name: String,
    /// Numbers of egress bits.
    pub egress: Vec<u32>,
    pub egress_set: u8,
    /// The links of the local readers.
    pub readers: Vec<u32>,
    /// The links that may send to the name.
    pub writers: Vec<u32>,
    /// The links of other domains that may send as this name.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sources: Vec<u32>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NextHop {
    pub bit: u32,
    pub link: u32,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Case {
    pub name: String,
    pub frame: Bytes,
    pub kernel: Expected,
    /// The result in userspace; `null`: the same as in the kernel.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub userspace: Option<Expected>,
}

/// The result for a frame. Exactly one counter increases by one. Each copy's counter also increases
/// by one.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Expected {
    pub verdict: Verdict,
    pub counter: String,
    /// The frame as sent; absent unless it is sent. A passed frame is unchanged.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<Bytes>,
    /// Sorted by their bytes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub copies: Vec<CopyOut>,
}

/// The result for a frame in the data planes' types; [`Expected`] is the same in the file's types.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fate {
    pub verdict: Verdict,
    pub counter: gdp_wire::Counter,
    /// The whole frame as sent; `None` unless it is sent.
    pub frame: Option<Vec<u8>>,
    /// Sorted by their bytes; dropped copies come first.
    pub copies: Vec<(Option<Vec<u8>>, gdp_wire::Counter)>,
}

impl Fate {
    /// Returns the result for a frame that is not sent.
    pub fn new(verdict: Verdict, counter: gdp_wire::Counter) -> Self {
        Self { verdict, counter, frame: None, copies: Vec::new() }
    }

    pub fn sent(frame: Vec<u8>, counter: gdp_wire::Counter) -> Self {
        Self { frame: Some(frame), ..Self::new(Verdict::Send, counter) }
    }

    pub fn copied(mut copies: Vec<(Option<Vec<u8>>, gdp_wire::Counter)>) -> Self {
        copies.sort();
        Self { copies, ..Self::new(Verdict::Copy, gdp_wire::Counter::Replicated) }
    }
}

impl From<Fate> for Expected {
    fn from(fate: Fate) -> Self {
        let copy = |(frame, counter): (Option<Vec<u8>>, gdp_wire::Counter)| CopyOut {
            frame: frame.as_deref().map(Bytes::new),
            counter: counter.as_str().into(),
        };
        let mut copies: Vec<_> = fate.copies.into_iter().map(copy).collect();
        copies.sort();
        Self {
            verdict: fate.verdict,
            counter: fate.counter.as_str().into(),
            frame: fate.frame.as_deref().map(Bytes::new),
            copies,
        }
    }
}

/// The result for a copy of a frame.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct CopyOut {
    /// The copy as sent; `None`: dropped.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<Bytes>,
    pub counter: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// The frame leaves rewritten, or as an answer to the neighbour that sent it.
    Send,
    /// Copies of the frame leave.
    Copy,
    /// The frame passes to the host, which includes the daemon.
    Pass,
    Drop,
}

#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Bytes {
    pub hex: String,
    #[serde(default, skip_serializing_if = "is_zero")]
    pub zeros: usize,
}

impl Bytes {
    pub fn new(bytes: &[u8]) -> Self {
        let kept = bytes.iter().rposition(|b| *b != 0).map_or(0, |last| last + 1);
        // A few zeros are clearer written out.
        let kept = if bytes.len() - kept < 32 { bytes.len() } else { kept };
        Self { hex: hex(&bytes[..kept]), zeros: bytes.len() - kept }
    }

    pub fn bytes(&self) -> Vec<u8> {
        let mut bytes = unhex(&self.hex);
        bytes.resize(bytes.len() + self.zeros, 0);
        bytes
    }
}

/// Returns the committed fixtures.
pub fn read() -> Fixtures {
    // Relative to this file, because crates at different depths include it.
    let text = include_str!("../../fixtures/frames.json");
    serde_json::from_str(text).unwrap_or_else(|error| panic!("tests/fixtures/frames.json: {error}"))
}

/// The tables of the fixtures' switch, in the form that a data plane accepts.
impl Switch {
    pub fn config(&self) -> gdp_wire::SwitchConfig {
        gdp_wire::SwitchConfig { own_bit: 1 << self.own_bit, ethertype: self.ethertype.into(), host_pair: 0 }
    }

    pub fn links(&self) -> impl Iterator<Item = gdp_wire::LinkEntry> {
        self.links.iter().map(Link::entry)
    }

    /// Returns the routes. Each has the permits that do not fit into its FIB entry.
    pub fn routes(&self) -> impl Iterator<Item = (gdp_wire::Name, gdp_wire::FibEntry, Vec<gdp_wire::Permit>)> {
        (0..).zip(&self.routes).map(|(index, route)| {
            let name = gdp_wire::Name::from_bytes(array(&route.name));
            let (first, more) = route.writers.split_first().unwrap_or((&0, &[]));
            let entry = gdp_wire::FibEntry {
                egress_bits: bits(&route.egress),
                local_link: if let [link] = route.readers[..] { link } else { 0 },
                group: if route.readers.is_empty() { gdp_wire::table::NEIGHBOURS } else { index + 1 },
                writer_link: *first,
                egress_set: route.egress_set,
                more_writers: u8::from(!more.is_empty()),
                reserved: 0,
            };
            let permit = |part: u32| move |link: &u32| gdp_wire::Permit { name, link: *link, part };
            let destinations = more.iter().map(permit(gdp_wire::Permit::DESTINATION));
            let sources = route.sources.iter().map(permit(gdp_wire::Permit::SOURCE));
            (name, entry, destinations.chain(sources).collect())
        })
    }

    /// Returns the links of the local readers of each group.
    pub fn groups(&self) -> impl Iterator<Item = (u32, &[u32])> {
        (1..)
            .zip(&self.routes)
            .filter(|(_, route)| !route.readers.is_empty())
            .map(|(group, route)| (group, &route.readers[..]))
    }

    /// Returns the groups in the kernel's form: member links that receive copies, and a mask of
    /// egress bits. The mask excludes bits that lead to links outside the members.
    pub fn kernel_groups(&self) -> impl Iterator<Item = (u32, Vec<&Link>, u64)> {
        self.groups_with_neighbours().map(|(group, links)| {
            let (members, others): (Vec<_>, Vec<_>) =
                links.into_iter().partition(|link| link.port.is_some() && link.udp.is_none());
            let bits_of = |link: &Link| if link.role == Role::Switch { bits(&link.reach) } else { 1 << self.own_bit };
            (group, members, others.into_iter().fold(u64::MAX, |served, link| served & !bits_of(link)))
        })
    }

    /// Returns all links of each group.
    pub fn groups_with_neighbours(&self) -> impl Iterator<Item = (u32, Vec<&Link>)> {
        let neighbours = [(gdp_wire::table::NEIGHBOURS, &[][..])];
        neighbours.into_iter().chain(self.groups()).map(|(group, readers)| {
            let is_member = |link: &&Link| link.role == Role::Switch || readers.contains(&link.id);
            (group, self.links.iter().filter(is_member).collect())
        })
    }

    /// Returns the local addresses for frames over UDP.
    pub fn own_addresses(&self) -> Vec<SocketAddr> {
        self.links.iter().filter_map(|link| Some(link.udp.as_ref()?.local)).collect()
    }

    /// Returns the VLANs of the links.
    pub fn vlans(&self) -> Vec<u16> {
        self.links.iter().map(|link| link.vlan).filter(|vlan| *vlan != 0).collect()
    }

    /// Returns the position of the GDP frame in a packet for this switch.
    pub fn find(&self, packet: &[u8]) -> Option<Place> {
        carrier::find(packet, self.ethertype, &self.own_addresses(), &self.vlans())
    }

    pub fn link(&self, id: u32) -> Option<&Link> {
        self.links.iter().find(|link| link.id == id)
    }

    pub fn next_hops(&self) -> [u32; 64] {
        let mut links = [0; 64];
        self.next_hops.iter().for_each(|hop| links[hop.bit as usize] = hop.link);
        links
    }
}

impl Link {
    pub fn entry(&self) -> gdp_wire::LinkEntry {
        gdp_wire::LinkEntry {
            id: self.id,
            peer_id: self.peer_id,
            role: match self.role {
                Role::Endpoint => gdp_wire::LinkRole::Endpoint,
                Role::Switch => gdp_wire::LinkRole::Switch,
                Role::Border => gdp_wire::LinkRole::Border,
            } as u32,
            port: match &self.udp {
                Some(udp) if udp.routed => gdp_wire::table::PORT_ROUTED,
                _ => self.port.unwrap_or(gdp_wire::table::PORT_USERSPACE),
            },
            rx_keys: self.rx_keys.each_ref().map(|text| key(text)),
            tx_keys: self.tx_keys.each_ref().map(|text| key(text)),
            reach: bits(&self.reach),
            peer: gdp_wire::Name::from_bytes(array(&self.peer)),
            mtu: self.mtu,
            lane: 0,
            flags: if self.transit { gdp_wire::LinkEntry::TRANSIT } else { 0 },
            tx_phase: self.tx_phase,
            carrier: match &self.udp {
                None => gdp_wire::Carrier {
                    vlan: self.vlan,
                    ..gdp_wire::Carrier::ethernet(mac(&self.peer_mac), mac(&self.local_mac))
                },
                Some(udp) => gdp_wire::Carrier {
                    kind: if udp.peer.is_ipv4() { gdp_wire::Carrier::UDP4 } else { gdp_wire::Carrier::UDP6 },
                    flags: if udp.routed && udp.peer.is_ipv6() { gdp_wire::Carrier::ZERO_CHECKSUM } else { 0 },
                    peer_port: udp.peer.port().to_be(),
                    local_port: udp.local.port().to_be(),
                    peer_ip: words(udp.peer.ip()),
                    local_ip: words(udp.local.ip()),
                    ..Default::default()
                },
            },
        }
    }

    /// Returns the MAC addresses of the link's packets: the neighbour's or the gateway's, and the
    /// switch's own.
    pub fn stations(&self) -> [[u8; 6]; 2] {
        [mac(&self.peer_mac), mac(&self.local_mac)]
    }

    /// Returns the encapsulation of a frame that leaves on the link.
    pub fn leaves_in(&self, flags: u8) -> Carrier {
        let class = flags >> 2 & 7;
        match &self.udp {
            Some(udp) => Carrier::Udp { from: udp.local, to: udp.peer, class: class << 5 | flags & 3 },
            None if self.vlan != 0 => Carrier::Vlan(self.vlan | u16::from(class) << 13),
            None => Carrier::Ethernet,
        }
    }

    /// Returns the encapsulation of a frame that arrives from the neighbour.
    pub fn arrives_in(&self) -> Carrier {
        match &self.udp {
            Some(udp) => Carrier::Udp { from: udp.peer, to: udp.local, class: 0 },
            None => self.leaves_in(0),
        }
    }

    /// Returns the whole Ethernet frame that carries a GDP frame to the neighbour.
    pub fn carry(&self, ethertype: u16, gdp: &[u8]) -> Vec<u8> {
        self.leaves_in(gdp[1]).carry(mac(&self.peer_mac), mac(&self.local_mac), ethertype, gdp)
    }
}

/// Returns an IP address as words in network order.
fn words(ip: IpAddr) -> [u32; 4] {
    let mut octets = [0; 16];
    match ip {
        IpAddr::V4(ip) => octets[..4].copy_from_slice(&ip.octets()),
        IpAddr::V6(ip) => octets = ip.octets(),
    }
    std::array::from_fn(|i| {
        u32::from_ne_bytes([octets[4 * i], octets[4 * i + 1], octets[4 * i + 2], octets[4 * i + 3]])
    })
}

pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

pub fn unhex(text: &str) -> Vec<u8> {
    let byte = |i| u8::from_str_radix(&text[i..i + 2], 16).unwrap_or_else(|error| panic!("{text}: {error}"));
    (0..text.len()).step_by(2).map(byte).collect()
}

pub fn array<const N: usize>(text: &str) -> [u8; N] {
    unhex(text).try_into().unwrap_or_else(|_| panic!("{text}: not {N} bytes"))
}

/// Returns the two words of a SipHash key.
pub fn key(text: &str) -> [u64; 2] {
    let bytes: [u8; 16] = array(text);
    [0, 8].map(|i| u64::from_le_bytes(bytes[i..i + 8].try_into().expect("eight bytes")))
}

fn mac(text: &str) -> [u8; 6] {
    array(&text.replace(':', ""))
}

fn bits(numbers: &[u32]) -> u64 {
    numbers.iter().fold(0, |bits, number| bits | 1 << number)
}

fn is_zero<T: PartialEq + Default>(number: &T) -> bool {
    *number == T::default()
}
