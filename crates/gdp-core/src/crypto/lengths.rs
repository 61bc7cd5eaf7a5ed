//! Lengths in bytes of keys, nonces, tags and signatures.

pub const TAG_LEN: usize = 16;

pub const NONCE_LEN: usize = 12;

pub const SIGNATURE_LEN: usize = 64;

/// Bytes of a SEC1 compressed P-256 point.
pub const PUBLIC_KEY_LEN: usize = 33;
