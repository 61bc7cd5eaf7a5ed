//! The highest DDS domain whose ports exist.

/// The largest domain id whose ports (7400 + 250 · id and up) exist.
pub const MAX_DOMAIN_ID: u16 = 232;
