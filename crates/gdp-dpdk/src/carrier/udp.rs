//! The UDP header, which is the same over IPv4 and IPv6.

use crate::carrier::packet::Payload;
use gdp_wire::Carrier;
use zerocopy::network_endian::U16;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout, Unaligned};

/// Also IPv6's "next header".
pub const UDP: u8 = 17;

pub const HOP_LIMIT: u8 = 64;

#[derive(FromBytes, IntoBytes, KnownLayout, Immutable, Unaligned)]
#[repr(C)]
pub struct Udp {
    pub source: [u8; 2],
    pub destination: [u8; 2],
    /// Of header and payload.
    pub length: U16,
    pub checksum: [u8; 2],
}

/// What a UDP header says of the length, its own included. Wraps where the frame is longer than a
/// datagram can be.
#[inline]
pub fn udp_length(frame: Payload<'_>) -> U16 {
    ((size_of::<Udp>() + frame.length) as u16).into()
}

impl Udp {
    /// From us to the peer.
    #[inline]
    pub fn new(carrier: &Carrier, length: U16, checksum: [u8; 2]) -> Self {
        let (source, destination) = (carrier.local_port.to_ne_bytes(), carrier.peer_port.to_ne_bytes());
        Self { source, destination, length, checksum }
    }
}
