//! The parts of a packet around a GDP frame, and the criteria for packets to this switch.

use gdp_wire::LocalAddress;

/// Location of the frame in a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameLocation {
    /// Offset of the frame in bytes.
    pub at: usize,
    /// Number of bytes of the frame, possibly zero, including any trailing padding. All are within
    /// the packet.
    pub available: usize,
    /// Whether it may also be QUIC.
    pub over_udp: bool,
    /// The IP byte with DSCP and ECN; 0 on Ethernet.
    pub traffic: u8,
}

/// Criteria for packets on an interface that carry frames to this switch.
pub trait Ours {
    /// Returns the ethertype of GDP frames, in host order.
    fn ethertype(&self) -> u16;

    /// Returns whether the switch accepts frames over UDP at the address.
    fn is_ours(&self, address: &LocalAddress) -> bool;

    /// Returns whether GDP runs on the VLAN with this id (0 … 4095) of the interface.
    fn is_our_vlan(&self, id: u16) -> bool;
}

/// The destination and source MAC address of a packet, as stored in [`Carrier`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stations<'a> {
    pub peer: &'a [u16; 3],
    pub local: &'a [u16; 3],
}

/// A frame to which headers are prepended.
#[derive(Clone, Copy, Debug)]
pub struct Payload<'a> {
    /// Length of the frame in bytes.
    pub length: usize,
    /// The available bytes of the frame: all of them, if the carrier [`has_checksum`].
    pub bytes: &'a [u8],
}
