//! The internet checksum (RFC 1071): of the IPv4 header, and of datagrams to peers that want it ([`Carrier::CHECKSUM`], or IPv6
//! without [`Carrier::ZERO_CHECKSUM`]).
//!
//! [`Carrier::CHECKSUM`]: gdp_wire::Carrier::CHECKSUM
//! [`Carrier::ZERO_CHECKSUM`]: gdp_wire::Carrier::ZERO_CHECKSUM

use zerocopy::IntoBytes;

use super::udp4::{UDP, Udp};

/// The sum of `bytes` as 16-bit words, not [folded](fold). The words are in the machine's order, as the order of bytes does not
/// matter as long as it is one (RFC 1071, 2 (B)); an odd last byte is the first of a word whose second is zero.
#[inline]
pub fn sum(bytes: &[u8]) -> u64 {
    // Of twice as long words, since 2^16 is 1 in this arithmetic: compilers make vectors of it.
    let (words, rest) = bytes.as_chunks::<4>();
    let sum: u64 = words.iter().map(|word| u64::from(u32::from_ne_bytes(*word))).sum();
    let mut last = [0; 4];
    last.iter_mut().zip(rest).for_each(|(last, byte)| *last = *byte);
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

/// The bytes of the checksum of a datagram (RFC 768, RFC 8200) whose header has none yet. `addresses`: [`sum`] of both IP addresses.
#[inline]
pub fn of_datagram(addresses: u64, udp: &Udp, payload: &[u8]) -> [u8; 2] {
    let pseudo_header = addresses + sum(&[0, UDP]) + sum(udp.length.as_bytes());
    match !fold(pseudo_header + sum(udp.as_bytes()) + sum(payload)) {
        // It would say that there is none.
        0 => [0xff; 2],
        checksum => checksum.to_ne_bytes(),
    }
}
