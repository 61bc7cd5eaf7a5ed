//! The parts of a packet around a GDP frame, and whose they are.

use gdp_wire::LocalAddress;

/// Where the frame lies in a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameLocation {
    /// Bytes in front of it.
    pub at: usize,
    /// Bytes there are of it, and perhaps of padding behind it; perhaps none. They are all in the
    /// packet.
    pub available: usize,
    /// Whether it may also be QUIC.
    pub over_udp: bool,
    /// The byte that IP has for DSCP and ECN; 0 on Ethernet.
    pub traffic: u8,
}

/// What on an interface is taken for a carrier of frames.
pub trait Ours {
    /// Ethertype of GDP frames, in host order.
    fn ethertype(&self) -> u16;

    /// Whether the switch takes frames over UDP at the address.
    fn is_ours(&self, address: &LocalAddress) -> bool;

    /// Whether GDP runs on the VLAN with this id (0 … 4095) of the interface.
    fn is_our_vlan(&self, id: u16) -> bool;
}

/// The MAC addresses that a packet goes between, as [`Carrier`] has them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stations<'a> {
    pub peer: &'a [u16; 3],
    pub local: &'a [u16; 3],
}

/// A frame that headers are put in front of.
#[derive(Clone, Copy, Debug)]
pub struct Payload<'a> {
    /// Bytes of the frame.
    pub length: usize,
    /// Those that are at hand: all of them, if the carrier [`has_checksum`].
    pub bytes: &'a [u8],
}
