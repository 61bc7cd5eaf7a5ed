//! The internet checksum (RFC 1071): of the IPv4 header, and of datagrams to peers that want it
//! ([`Carrier::CHECKSUM`], or IPv6 without [`Carrier::ZERO_CHECKSUM`]).

use gdp_wire::Carrier;
use gdp_wire::packet::{UDP, UDP_LEN};

/// The sum of `bytes` as 16-bit words, not [folded](fold). The words are in the machine's order, as
/// the order of bytes does not matter as long as it is one (RFC 1071, 2 (B)); an odd last byte is
/// the first of a word whose second is zero.
#[inline]
pub fn sum(bytes: &[u8]) -> u64 {
    // Of twice as long words, since 2^16 is 1 in this arithmetic: compilers make vectors of it.
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

/// The ones' complement sum in 16 bits: 0 only of 0.
#[inline]
pub fn fold(sum: u64) -> u16 {
    let sum = (sum & 0xffff_ffff) + (sum >> 32);
    // Three words, the last 0 or 1: no more than 0x1_fffe.
    let sum = (sum & 0xffff) + (sum >> 16 & 0xffff) + (sum >> 32);
    ((sum & 0xffff) + (sum >> 16)) as u16
}

/// The checksum of a datagram (RFC 768, RFC 8200) from us to the peer, in network order. `length`:
/// of the payload. The words of addresses that IPv4 does not have are zero.
#[inline]
pub fn of_datagram(carrier: &Carrier, length: u16, payload: &[u8]) -> u16 {
    let addresses: u64 = carrier.local_ip.iter().chain(&carrier.peer_ip).copied().map(u64::from).sum();
    let length = u64::from(length.wrapping_add(UDP_LEN as u16).to_be());
    let pseudo_header = addresses + u64::from(u16::from(UDP).to_be()) + length;
    let header = u64::from(carrier.local_port) + u64::from(carrier.peer_port) + length;
    match !fold(pseudo_header + header + sum(payload)) {
        // It would say that there is none.
        0 => 0xffff,
        checksum => checksum,
    }
}
