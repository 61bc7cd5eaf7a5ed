//! Headers of the packets that carry frames: Ethernet, IEEE 802.1Q, IPv4, IPv6 and UDP. The XDP
//! programs and the DPDK plane share the rules for parsing and writing them. Each of the two
//! accesses the bytes in its own manner.
//!
//! All words are in network order. `H` is the type of 16-bit words and `W` of 32-bit words. Both
//! are integers in the XDP programs, which can access unaligned words, and byte arrays elsewhere.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout, Unaligned};

use crate::{Carrier, LocalAddress};

/// Ethertypes, in host order.
pub const IPV4: u16 = 0x0800;
pub const IPV6: u16 = 0x86dd;
pub const VLAN: u16 = 0x8100;

/// Protocol number of UDP, also the "next header" value of IPv6.
pub const UDP: u8 = 17;

const HOP_LIMIT: u8 = 64;
/// Version 4, header length of five words.
const VERSION_LENGTH: u8 = 0x45;
const DO_NOT_FRAGMENT: u16 = 0x4000;
/// Mask of the "more fragments" flag and the fragment offset.
const FRAGMENT: u16 = 0x3fff;

pub const ETHERNET_LEN: usize = size_of::<Ethernet<[u8; 2]>>();
pub const TAGGED_LEN: usize = ETHERNET_LEN + size_of::<Tag<[u8; 2]>>();
pub const IPV4_LEN: usize = size_of::<Ipv4<[u8; 2], [u8; 4]>>();
pub const IPV6_LEN: usize = size_of::<Ipv6<[u8; 2], [u8; 4]>>();
pub const UDP_LEN: usize = size_of::<Udp<[u8; 2]>>();
/// Bytes before a frame over UDP.
pub const UDP4_LEN: usize = ETHERNET_LEN + IPV4_LEN + UDP_LEN;
pub const UDP6_LEN: usize = ETHERNET_LEN + IPV6_LEN + UDP_LEN;

const _: () = assert!(ETHERNET_LEN == 14 && TAGGED_LEN == 18 && UDP4_LEN == 42 && UDP6_LEN == 62);
const _: () = assert!(size_of::<Ipv4<u16, u32>>() == IPV4_LEN && size_of::<Ipv6<u16, u32>>() == IPV6_LEN);

/// A word in network order, as in a packet.
pub trait Word<T>: Copy {
    fn get(self) -> T;
    fn of(word: T) -> Self;
}

macro_rules! word {
    ($integer:ty, $bytes:expr) => {
        impl Word<$integer> for $integer {
            #[inline(always)]
            fn get(self) -> $integer {
                self
            }

            #[inline(always)]
            fn of(word: $integer) -> Self {
                word
            }
        }

        impl Word<$integer> for [u8; $bytes] {
            #[inline(always)]
            fn get(self) -> $integer {
                <$integer>::from_ne_bytes(self)
            }

            #[inline(always)]
            fn of(word: $integer) -> Self {
                word.to_ne_bytes()
            }
        }
    };
}

word!(u16, 2);
word!(u32, 4);

#[derive(Clone, Copy, FromBytes, IntoBytes, KnownLayout, Immutable, Unaligned)]
#[repr(C)]
pub struct Ethernet<H> {
    pub destination: [H; 3],
    pub source: [H; 3],
    pub ethertype: H,
}

/// The IEEE 802.1Q tag, between the first ethertype [`VLAN`] and the payload.
#[derive(Clone, Copy, FromBytes, IntoBytes, KnownLayout, Immutable, Unaligned)]
#[repr(C)]
pub struct Tag<H> {
    /// Priority (3 bits), drop eligibility (1 bit), VLAN id (12 bits).
    control: H,
    ethertype: H,
}

#[derive(Clone, Copy, FromBytes, IntoBytes, KnownLayout, Immutable, Unaligned)]
#[repr(C)]
pub struct Ipv4<H, W> {
    version_length: u8,
    /// DSCP and ECN.
    pub traffic: u8,
    length: H,
    id: H,
    fragment: H,
    time_to_live: u8,
    protocol: u8,
    checksum: H,
    pub source: W,
    pub destination: W,
}

#[derive(Clone, Copy, FromBytes, IntoBytes, KnownLayout, Immutable, Unaligned)]
#[repr(C)]
pub struct Ipv6<H, W> {
    /// Version (4 bits), traffic class (8 bits), flow label (20 bits).
    version_class: W,
    /// Length of the data after this header.
    length: H,
    next: u8,
    hop_limit: u8,
    source: [W; 4],
    destination: [W; 4],
}

#[derive(Clone, Copy, FromBytes, IntoBytes, KnownLayout, Immutable, Unaligned)]
#[repr(C)]
pub struct Udp<H> {
    source: H,
    destination: H,
    /// Length of header and payload.
    length: H,
    pub checksum: H,
}

impl<H: Word<u16>> Ethernet<H> {
    /// Writes the header. `ethertype` is in host order. Copies word by word, for two reasons. A
    /// copy of six bytes becomes a function call in an XDP program. Elsewhere, copying a complete
    /// header reads across the boundaries of the preceding writes, which is slow.
    #[inline(always)]
    pub fn address(&mut self, destination: &[u16; 3], source: &[u16; 3], ethertype: u16) {
        let mut i = 0;
        while i < 3 {
            self.destination[i] = H::of(destination[i]);
            self.source[i] = H::of(source[i]);
            i += 1;
        }
        self.ethertype = H::of(ethertype.to_be());
    }

    /// Returns the ethertype in host order.
    #[inline(always)]
    pub fn ethertype(&self) -> u16 {
        u16::from_be(self.ethertype.get())
    }
}

impl<H: Word<u16>> Tag<H> {
    /// Writes the tag of a frame. The priority is the high three bits of `traffic`. `ethertype` is
    /// that of the frame, in host order.
    #[inline(always)]
    pub fn set(&mut self, vlan: u16, traffic: u8, ethertype: u16) {
        self.control = H::of((vlan & 0xfff | u16::from(traffic >> 5) << 13).to_be());
        self.ethertype = H::of(ethertype.to_be());
    }

    #[inline(always)]
    pub fn vlan(&self) -> u16 {
        u16::from_be(self.control.get()) & 0xfff
    }

    /// Returns the ethertype of the payload, in host order.
    #[inline(always)]
    pub fn ethertype(&self) -> u16 {
        u16::from_be(self.ethertype.get())
    }
}

impl<H: Word<u16>, W: Word<u32>> Ipv4<H, W> {
    /// Returns the destination and the payload length of a datagram in `length` bytes from this
    /// header on. Returns `None` for options, fragments and inconsistent lengths; those packets go
    /// to the host.
    #[inline(always)]
    pub fn datagram(&self, udp: &Udp<H>, length: usize) -> Option<(LocalAddress, usize)> {
        let is_fragment = u16::from_be(self.fragment.get()) & FRAGMENT != 0;
        if self.version_length != VERSION_LENGTH || self.protocol != UDP || is_fragment {
            return None;
        }
        let (ip_length, udp_length) = (u16::from_be(self.length.get()) as usize, udp.length());
        let fits = udp_length >= UDP_LEN && IPV4_LEN + udp_length <= ip_length && ip_length <= length;
        let to = [self.destination.get(), 0, 0, 0];
        fits.then(|| (udp.to(to, Carrier::UDP4), udp_length - UDP_LEN))
    }

    /// Returns the header of a datagram from the switch to the peer. `length` is that of the frame.
    #[inline(always)]
    pub fn new(carrier: &Carrier, traffic: u8, length: u16) -> Self {
        let (length, fragment) = (length.wrapping_add((IPV4_LEN + UDP_LEN) as u16).to_be(), DO_NOT_FRAGMENT.to_be());
        let (source, destination) = (carrier.local_ip[0], carrier.peer_ip[0]);
        // RFC 1071: the byte order is irrelevant as long as it is consistent. The sum uses values
        // rather than the header in memory: long reads immediately after short writes are slow.
        let sum = u16::from_ne_bytes([VERSION_LENGTH, traffic]) as u32
            + length as u32
            + fragment as u32
            + u16::from_ne_bytes([HOP_LIMIT, UDP]) as u32
            + (source & 0xffff)
            + (source >> 16)
            + (destination & 0xffff)
            + (destination >> 16);
        let sum = (sum & 0xffff) + (sum >> 16);
        let sum = (sum & 0xffff) + (sum >> 16);
        Self {
            version_length: VERSION_LENGTH,
            traffic,
            length: H::of(length),
            id: H::of(0),
            fragment: H::of(fragment),
            time_to_live: HOP_LIMIT,
            protocol: UDP,
            checksum: H::of(!(sum as u16)),
            source: W::of(source),
            destination: W::of(destination),
        }
    }
}

impl<H: Word<u16>, W: Word<u32>> Ipv6<H, W> {
    /// As [`Ipv4::datagram`]. Packets with extension headers, including fragments, go to the host.
    #[inline(always)]
    pub fn datagram(&self, udp: &Udp<H>, length: usize) -> Option<(LocalAddress, usize)> {
        if u32::from_be(self.version_class.get()) >> 28 != 6 || self.next != UDP {
            return None;
        }
        let (ip_length, udp_length) = (u16::from_be(self.length.get()) as usize, udp.length());
        let fits = udp_length >= UDP_LEN && udp_length <= ip_length && IPV6_LEN + ip_length <= length;
        let [a, b, c, d] = self.destination;
        let to = [a.get(), b.get(), c.get(), d.get()];
        fits.then(|| (udp.to(to, Carrier::UDP6), udp_length - UDP_LEN))
    }

    /// Returns DSCP and ECN.
    #[inline(always)]
    pub fn traffic(&self) -> u8 {
        (u32::from_be(self.version_class.get()) >> 20) as u8
    }

    /// Writes the header of a datagram from the switch to the peer. `length` is that of the frame.
    #[inline(always)]
    pub fn set(&mut self, carrier: &Carrier, traffic: u8, length: u16) {
        self.version_class = W::of((6 << 28 | u32::from(traffic) << 20).to_be());
        self.length = H::of(length.wrapping_add(UDP_LEN as u16).to_be());
        (self.next, self.hop_limit) = (UDP, HOP_LIMIT);
        let mut i = 0;
        while i < 4 {
            self.source[i] = W::of(carrier.local_ip[i]);
            self.destination[i] = W::of(carrier.peer_ip[i]);
            i += 1;
        }
    }
}

impl<H: Word<u16>> Udp<H> {
    /// Returns the header of a datagram from the switch to the peer. `length` is that of the frame;
    /// `checksum` is in network order.
    #[inline(always)]
    pub fn new(carrier: &Carrier, length: u16, checksum: u16) -> Self {
        Self {
            source: H::of(carrier.local_port),
            destination: H::of(carrier.peer_port),
            length: H::of(length.wrapping_add(UDP_LEN as u16).to_be()),
            checksum: H::of(checksum),
        }
    }

    #[inline(always)]
    fn length(&self) -> usize {
        u16::from_be(self.length.get()) as usize
    }

    #[inline(always)]
    fn to(&self, ip: [u32; 4], kind: u8) -> LocalAddress {
        LocalAddress { ip, port: self.destination.get(), kind: kind.into() }
    }
}
