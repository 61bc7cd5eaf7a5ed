//! The largest data frame on a UDP link.

/// Largest data frame on a UDP link, in bytes: the payload of IPv4 on Ethernet. The MTU of a link
/// may be smaller, by QUIC's path MTU discovery.
pub const UDP_MTU: u32 = 1500 - 20 - 8;
