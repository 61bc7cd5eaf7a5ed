//! Which domains are to be reached directly, and who makes the link: where somebody in this domain exchanges messages with somebody in
//! another, both let each other peer, and one of the two can be reached. Both sides come to the same pair of borders by the same rule.

use std::collections::{BTreeMap, BTreeSet};
use std::net::SocketAddr;
use std::time::Duration;

use gdp::cert::SwitchStatement;
use gdp_wire::Name;

/// How long a peering stays that nobody uses any more.
pub const IDLE: Duration = Duration::from_secs(60);

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
    /// These are the domains with which messages are exchanged now. Returns those to be reached directly.
    pub fn follow(&mut self, now: Duration, concerned: impl Iterator<Item = Name>) -> BTreeSet<Name> {
        self.0.extend(concerned.map(|domain| (domain, now + IDLE)));
        self.0.retain(|_, until| *until > now);
        self.0.keys().copied().collect()
    }
}

/// The link that this domain is to make to another, if it is the one to make it. Each names the border that can be reached, then the one
/// with the lower name; of two that can be reached the one with the lower name dials.
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
mod tests {
    use super::*;

    const NOW: Duration = Duration::from_secs(1);

    #[test]
    fn one_of_two_domains_dials_and_never_one_that_cannot_be_reached() {
        for (a, b) in [(&[1][..], &[2][..]), (&[1], &[-2]), (&[-1], &[2]), (&[-1, 4], &[2, -3]), (&[-1, -4], &[9, 8])] {
            let (a, b) = (borders(a), borders(b));
            let (from_a, from_b) = (choose(&a, &b), choose(&b, &a));
            assert!(from_a.is_some() != from_b.is_some(), "{from_a:?} {from_b:?}");
            let peering = from_a.or(from_b).unwrap();
            let dialled = a.iter().chain(&b).find(|border| border.switch == peering.peer).unwrap();
            assert_eq!(dialled.addresses, peering.addrs);
        }
        assert_eq!(choose(&borders(&[-1]), &borders(&[-2])), None, "behind NAT on both sides");
        assert_eq!(choose(&borders(&[]), &borders(&[2])), None);
    }

    #[test]
    fn a_peering_outlives_a_short_silence() {
        let (mut peerings, other) = (Peerings::default(), name(1));
        assert_eq!(peerings.follow(NOW, [other].into_iter()), [other].into());
        assert_eq!(peerings.follow(NOW + IDLE / 2, [].into_iter()), [other].into());
        assert_eq!(peerings.follow(NOW + IDLE, [].into_iter()), [].into());
    }

    /// One for each number; those with a negative one can only dial.
    fn borders(numbers: &[i8]) -> Vec<SwitchStatement> {
        let border = |number: &i8| {
            let at = |port| SocketAddr::from(([192, 0, 2, *number as u8], port));
            let addresses = if *number > 0 { vec![at(31415), at(443)] } else { Vec::new() };
            let switch = name(number.unsigned_abs());
            SwitchStatement { switch, domain: name(0), addresses, serial: 1, not_after: 1 }
        };
        numbers.iter().map(border).collect()
    }

    fn name(i: u8) -> Name {
        Name::from_bytes([i; 32])
    }
}
