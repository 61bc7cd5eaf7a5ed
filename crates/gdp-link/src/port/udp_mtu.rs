//! The largest data frame on a UDP link.

/// Largest data frame on a UDP link, in bytes: what fits into IPv4 on Ethernet. A link takes as
/// much of it as its path does, which QUIC finds out.
pub const UDP_MTU: u32 = 1500 - 20 - 8;
