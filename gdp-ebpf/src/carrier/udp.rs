//! The UDP header, which is the same over IPv4 and IPv6.

/// Also IPv6's "next header".
pub const UDP: u8 = 17;

pub const HOP_LIMIT: u8 = 64;

/// In network order.
#[repr(C)]
pub struct Udp {
    pub source: u16,
    pub destination: u16,
    pub length: u16,
    pub checksum: u16,
}
