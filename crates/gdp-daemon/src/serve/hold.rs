//! Links that stay in the data plane though nobody answers on them, or another has replaced them: their peers may still send
//! on them, or forward without a daemon. Each has a time at which it goes; [`super::core`] removes it then.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use gdp_core::domain::Standing;
use gdp_link::link::{KeyedEntry, Link, LinkId};
use gdp_link::port::LinkAddr;
use gdp_wire::{LinkRole, Name};

/// How long a link is kept that another has replaced: until frames that were sent on it have arrived.
pub const GRACE: Duration = Duration::from_secs(5);

/// Links to one peer that are kept.
const MOST: usize = 8;

/// A link that is kept.
pub struct HeldLink {
    pub peer: Name,
    pub lane: u8,
    pub role: LinkRole,
    pub entry: KeyedEntry,
    pub to: LinkAddr,
    pub until: Instant,
    /// What the peer was to this switch's domain, unless the link is from before this daemon.
    pub standing: Option<Standing>,
    /// So that no new link gets the same index in the tables.
    pub id: Kept,
}

impl HeldLink {
    /// The link itself, unless it is from before this daemon.
    pub fn link(&self) -> Option<&Link> {
        match &self.id {
            Kept::Closed { link } => Some(link),
            Kept::Adopted { .. } => None,
        }
    }
}

/// What reserves the id of a link that is kept.
pub enum Kept {
    Adopted { _id: LinkId },
    Closed { link: Link },
}

/// All that are kept, by id.
#[derive(Default)]
pub struct Hold(HashMap<u32, HeldLink>);

impl Hold {
    /// Keeps a link. Returns one to the same peer that has to go for it.
    pub fn keep(&mut self, link: HeldLink) -> Option<u32> {
        let same_peer = self.0.values().filter(|held| held.peer == link.peer);
        let crowded = same_peer.clone().count() >= MOST;
        let first = same_peer.filter(|_| crowded).min_by_key(|held| held.until).map(|held| held.entry.id);
        self.0.insert(link.entry.id, link);
        first
    }

    pub fn take(&mut self, id: u32) -> Option<HeldLink> {
        self.0.remove(&id)
    }

    pub fn contains(&self, id: u32) -> bool {
        self.0.contains_key(&id)
    }

    pub fn get_mut(&mut self, id: u32) -> Option<&mut HeldLink> {
        self.0.get_mut(&id)
    }

    pub fn iter(&self) -> impl Iterator<Item = &HeldLink> {
        self.0.values()
    }

    /// Whether any link to the peer is kept.
    pub fn keeps(&self, peer: &Name) -> bool {
        self.0.values().any(|held| held.peer == *peer)
    }

    /// The peer takes frames on a new link: what it sent on others of that lane arrives soon, or never.
    pub fn replaced(&mut self, peer: &Name, lane: u8, now: Instant) {
        let same = |held: &&mut HeldLink| held.peer == *peer && held.lane == lane;
        for held in self.0.values_mut().filter(same) {
            held.until = held.until.min(now + GRACE);
        }
    }

    /// Those whose time is over.
    pub fn over(&self, now: Instant) -> Vec<u32> {
        self.0.values().filter(|held| held.until <= now).map(|held| held.entry.id).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gdp_core::peer::GRACEFUL_RESTART_TIME;
    use gdp_link::link::LinkIds;
    use gdp_wire::LinkEntry;

    #[test]
    fn links_go_when_their_time_is_over_and_sooner_once_replaced() {
        let (ids, now) = (LinkIds::new(), Instant::now());
        let mut hold = Hold::default();
        assert_eq!(hold.keep(link(&ids, 1, 0x401, now + GRACEFUL_RESTART_TIME)), None);
        assert_eq!(hold.keep(link(&ids, 2, 0x402, now + GRACEFUL_RESTART_TIME)), None);
        assert!(ids.reserve(0x801).is_none(), "no new link takes its place in the tables");
        hold.replaced(&name(1), 1, now);
        assert!(hold.over(now + GRACE).is_empty(), "it was another lane");
        hold.replaced(&name(1), 0, now);
        assert!(hold.over(now + GRACE / 2).is_empty());
        assert_eq!(hold.over(now + GRACE), [0x401]);
        drop(hold.take(0x401));
        assert!(!hold.keeps(&name(1)) && hold.keeps(&name(2)));
        assert!(ids.reserve(0x801).is_some());
        assert_eq!(hold.over(now + GRACEFUL_RESTART_TIME), [0x402]);
    }

    #[test]
    fn a_peer_has_a_few_and_the_one_that_ends_first_goes() {
        let (ids, now) = (LinkIds::new(), Instant::now());
        let mut hold = Hold::default();
        for i in 0..MOST as u32 {
            assert_eq!(hold.keep(link(&ids, 1, 0x400 + i, now + GRACE * (i + 1))), None);
        }
        assert_eq!(hold.keep(link(&ids, 2, 0x420, now)), None);
        assert_eq!(hold.keep(link(&ids, 1, 0x430, now + GRACEFUL_RESTART_TIME)), Some(0x400));
    }

    fn link(ids: &LinkIds, peer: u8, id: u32, until: Instant) -> HeldLink {
        let entry = LinkEntry { id, ..LinkEntry::default() }.into();
        let to = LinkAddr::Ethernet { ifindex: 1, mac: [0; 6] };
        let kept = Kept::Adopted { _id: ids.reserve(id).unwrap() };
        let role = LinkRole::Switch;
        HeldLink { peer: name(peer), lane: 0, role, entry, to, until, standing: None, id: kept }
    }

    fn name(i: u8) -> Name {
        Name::from_bytes([i; 32])
    }
}
