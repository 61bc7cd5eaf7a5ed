//! The highest DDS domain ID whose ports exist.

/// The highest DDS domain ID whose ports (7400 + 250 · ID and up) exist.
pub const MAX_DOMAIN_ID: u16 = 232;
