//! The one accepted form of an ECDSA signature. `(r, s)` and `(r, n − s)` verify alike, `n` being
//! the order of P-256. Everybody signs and accepts the lower of the two only, so nobody can change
//! the bytes of a signature without its key. Signatures are public: nothing here is secret.

use crate::crypto::lengths::SIGNATURE_LEN;

/// The order of P-256 (FIPS 186-5), big endian.
const ORDER: [u8; 32] = [
    0xff, 0xff, 0xff, 0xff, 0x00, 0x00, 0x00, 0x00, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xbc, 0xe6, 0xfa,
    0xad, 0xa7, 0x17, 0x9e, 0x84, 0xf3, 0xb9, 0xca, 0xc2, 0xfc, 0x63, 0x25, 0x51,
];

/// Half of the order, rounded down.
const HALF: [u8; 32] = half(ORDER);

/// Returns whether `s`, the second half of the signature, is at most half of the order.
pub fn is_low(signature: &[u8; SIGNATURE_LEN]) -> bool {
    signature[32..] <= HALF[..]
}

/// Returns the lower form of a valid signature.
pub fn lower(mut signature: [u8; SIGNATURE_LEN]) -> [u8; SIGNATURE_LEN] {
    if !is_low(&signature) {
        let mut borrow = false;
        for (s, n) in signature[32..].iter_mut().zip(ORDER).rev() {
            let (difference, first) = n.overflowing_sub(*s);
            let (difference, second) = difference.overflowing_sub(borrow.into());
            (*s, borrow) = (difference, first || second);
        }
    }
    signature
}

const fn half(order: [u8; 32]) -> [u8; 32] {
    let (mut half, mut at, mut carry) = ([0; 32], 0, 0);
    while at < order.len() {
        half[at] = carry << 7 | order[at] >> 1;
        carry = order[at] & 1;
        at += 1;
    }
    half
}
