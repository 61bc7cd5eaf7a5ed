//! Versions of what passes over a link: control messages and frames. ALPN negotiates one, by names
//! `gdp/N`.

/// The versions that a node speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Versions {
    pub oldest: u8,
    pub newest: u8,
}

impl Versions {
    /// The versions of this release. From version 2 on, a node speaks its own version and the one
    /// before, so that a network can be upgraded node by node. No node speaks version 1 any more.
    pub const SPOKEN: Self = Self { oldest: 2, newest: 2 };

    /// Returns the ALPN names to offer, the best first.
    ///
    /// They include versions that are not spoken any more. A peer that speaks nothing newer then
    /// gets a link whose end says why, instead of an alert of TLS.
    pub fn offered(self) -> Vec<Vec<u8>> {
        (1..=self.newest).rev().map(|version| format!("gdp/{version}").into_bytes()).collect()
    }
}

#[cfg(test)]
#[path = "../../tests/unit/link/version.rs"]
mod tests;
