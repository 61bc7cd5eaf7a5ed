//! The internet checksum (RFC 1071) of the IPv4 header, and of datagrams to peers that require it
//! ([`Carrier::CHECKSUM`], or IPv6 without [`Carrier::ZERO_CHECKSUM`]).

use gdp_wire::Carrier;
use gdp_wire::packet::{UDP, UDP_LEN};

/// Returns the sum of `bytes` as 16-bit words, not [folded](fold). The words are in native byte
/// order, because any consistent order gives the same result (RFC 1071, 2 (B)). An odd last byte is
/// the first byte of a word whose second byte is zero.
#[inline]
pub fn sum(bytes: &[u8]) -> u64 {
    // Add 32-bit words, since 2^16 equals 1 in this arithmetic. Compilers vectorize this.
    let (words, rest) = bytes.as_chunks::<4>();
    let sum: u64 = words.iter().map(|word| u64::from(u32::from_ne_bytes(*word))).sum();
    let last = match *rest {
        [a] => [a, 0, 0, 0],
        [a, b] => [a, b, 0, 0],
        [a, b, c] => [a, b, c, 0],
        _ => [0; 4],
    };
    sum + u64::from(u32::from_ne_bytes(last))
}

/// Returns the ones' complement sum in 16 bits, which is 0 only for 0.
#[inline]
pub fn fold(sum: u64) -> u16 {
    let sum = (sum & 0xffff_ffff) + (sum >> 32);
    // Add three words, the last 0 or 1: the sum is at most 0x1_fffe.
    let sum = (sum & 0xffff) + (sum >> 16 & 0xffff) + (sum >> 32);
    ((sum & 0xffff) + (sum >> 16)) as u16
}

/// Returns the checksum of a datagram (RFC 768, RFC 8200) from this switch to the peer, in network
/// order. `length`: length of the payload. Unused address words of IPv4 are zero.
#[inline]
pub fn of_datagram(carrier: &Carrier, length: u16, payload: &[u8]) -> u16 {
    let addresses: u64 = carrier.local_ip.iter().chain(&carrier.peer_ip).copied().map(u64::from).sum();
    let length = u64::from(length.wrapping_add(UDP_LEN as u16).to_be());
    let pseudo_header = addresses + u64::from(u16::from(UDP).to_be()) + length;
    let header = u64::from(carrier.local_port) + u64::from(carrier.peer_port) + length;
    match !fold(pseudo_header + header + sum(payload)) {
        // A zero would mean that there is no checksum.
        0 => 0xffff,
        checksum => checksum,
    }
}
