//! Selects the domains to peer with directly, and the end that dials. A link is made to a domain
//! that exchanges messages with this one, if both allow peering and one of the two is reachable.
//! Both domains select the same pair of borders by the same rule.

use std::collections::{BTreeMap, BTreeSet};
use std::net::SocketAddr;
use std::time::Duration;

use gdp_core::cert::SwitchStatement;
use gdp_wire::Name;

/// Time for which an unused peering stays.
pub const IDLE: Duration = Duration::from_secs(60);

/// Border switches of other domains that a border must connect to, with the addresses of each, best
/// first.
pub type WantedPeerings = BTreeMap<Name, Vec<SocketAddr>>;

/// Link that a border of this domain must make.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Peering {
    pub border: Name,
    pub peer: Name,
    /// Addresses of the peer, best first, at least one.
    pub addrs: Vec<SocketAddr>,
}

/// Domains to reach directly, each with the end of its peering.
#[derive(Debug, Default)]
pub struct Peerings(BTreeMap<Name, Duration>);

impl Peerings {
    /// Updates the domains that exchange messages at present. Returns the domains to reach
    /// directly.
    pub fn follow(&mut self, now: Duration, concerned: impl Iterator<Item = Name>) -> BTreeSet<Name> {
        self.0.extend(concerned.map(|domain| (domain, now + IDLE)));
        self.0.retain(|_, until| *until > now);
        self.0.keys().copied().collect()
    }
}

/// Returns the link that this domain must make to another, or `None` if the other domain dials.
///
/// Each domain prefers reachable borders, and of several selects the one with the lowest name. If
/// both selected borders are reachable, the one with the lower name dials.
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
