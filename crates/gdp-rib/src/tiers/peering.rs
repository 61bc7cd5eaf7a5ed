//! Which domains are to be reached directly, and who makes the link: where somebody in this domain
//! exchanges messages with somebody in another, both let each other peer, and one of the two can be
//! reached. Both sides come to the same pair of borders by the same rule.

use std::collections::{BTreeMap, BTreeSet};
use std::net::SocketAddr;
use std::time::Duration;

use gdp_core::cert::SwitchStatement;
use gdp_wire::Name;

/// How long a peering stays that nobody uses any more.
pub const IDLE: Duration = Duration::from_secs(60);

/// The border switches of other domains that a border is to have links with, and the addresses of
/// each, best first.
pub type WantedPeerings = BTreeMap<Name, Vec<SocketAddr>>;

/// A link that a border of this domain is to make.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Peering {
    pub border: Name,
    pub peer: Name,
    /// Where the peer may be reached, best first; at least one.
    pub addrs: Vec<SocketAddr>,
}

/// The domains that are to be reached directly.
#[derive(Debug, Default)]
pub struct Peerings(BTreeMap<Name, Duration>);

impl Peerings {
    /// These are the domains with which messages are exchanged now. Returns those to be reached
    /// directly.
    pub fn follow(&mut self, now: Duration, concerned: impl Iterator<Item = Name>) -> BTreeSet<Name> {
        self.0.extend(concerned.map(|domain| (domain, now + IDLE)));
        self.0.retain(|_, until| *until > now);
        self.0.keys().copied().collect()
    }
}

/// The link that this domain is to make to another, if it is the one to make it. Each names the
/// border that can be reached, then the one with the lower name; of two that can be reached the one
/// with the lower name dials.
pub fn choose(own: &[SwitchStatement], other: &[SwitchStatement]) -> Option<Peering> {
    let (own, other) = (best(own)?, best(other)?);
    let (border, peer) = (own.switch, other.switch);
    let is_dialler = !other.addresses.is_empty() && (own.addresses.is_empty() || border < peer);
    is_dialler.then(|| Peering { border, peer, addrs: other.addresses.clone() })
}

fn best(borders: &[SwitchStatement]) -> Option<&SwitchStatement> {
    borders.iter().min_by_key(|border| (border.addresses.is_empty(), border.switch))
}

#[cfg(test)]
#[path = "../../tests/unit/tiers/peering.rs"]
mod tests;
