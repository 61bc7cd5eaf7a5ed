//! The neighbouring switches: configuration, link costs and adjacencies.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use gdp_core::cert::Adjoining;
use gdp_core::peer::{Peer, Role};
use gdp_link::link::Link;
use gdp_rib::topology::cost::{AVOIDED, Meter};
use gdp_rib::topology::damping::Damper;
use gdp_wire::table::EGRESS_SET_SIZE;
use gdp_wire::{LinkRole, Name};

use super::switch::Switch;
use crate::config::{Neighbour, Via};
use crate::domain::Relationship;

/// The maximum number of unconfigured switches with links to this one.
const MAX_UNLISTED: usize = EGRESS_SET_SIZE as usize;

/// The configured neighbours, and the measured costs of links to neighbours.
pub struct Neighbours {
    pub listed: Vec<Neighbour>,
    /// The cost meter of each neighbour. A configured cost takes precedence.
    meters: BTreeMap<Name, Meter>,
    /// The failures of the link to each neighbour.
    dampers: BTreeMap<Name, Damper>,
}

/// The adjacencies of a switch.
#[derive(Default, PartialEq, Eq)]
pub struct Adjacencies {
    /// The cost of a frame to each neighbour of the same domain.
    pub neighbours: BTreeMap<Name, u32>,
    /// The neighbours of the same domain whose links are all stale.
    pub silent: BTreeSet<Name>,
    /// The adjacent switches of other domains, by domain and switch.
    pub borders: BTreeMap<(Name, Name), Adjoining>,
}

impl Neighbours {
    pub fn new(listed: Vec<Neighbour>) -> Self {
        Self { listed, meters: BTreeMap::new(), dampers: BTreeMap::new() }
    }

    pub fn get(&self, switch: &Name) -> Option<&Neighbour> {
        self.listed.iter().find(|neighbour| neighbour.address.switch == *switch)
    }

    /// Checks whether a switch may have a link on its incoming path. A configured neighbour must
    /// come in on its configured port. Another switch needs admission by a domain; `is_member`
    /// means that this switch has one.
    pub fn check(&self, peer: &Peer, via: &Via, switch: &Switch, is_member: bool) -> Result<(), String> {
        let name = peer.name;
        match self.get(&name) {
            Some(neighbour) if neighbour.address.via.same_port(via) => Ok(()),
            Some(_) => Err(format!("switch {name} is a neighbour elsewhere, not {via}")),
            None if !is_member => Err(format!("switch {name} is not listed in the neighbours of this one")),
            None => {
                let live = switch.links.values().map(|state| state.link.peer());
                let others: BTreeSet<Name> = live
                    .filter(|p| p.role == Role::Switch && p.name != name)
                    .map(|p| p.name)
                    .filter(|name| self.get(name).is_none())
                    .collect();
                if others.len() < MAX_UNLISTED {
                    return Ok(());
                }
                Err(format!("{MAX_UNLISTED} switches that are not listed in the neighbours have links to this one"))
            }
        }
    }

    /// Returns the adjacencies with other switches over which frames can go.
    pub fn adjacencies(&self, switch: &Switch) -> Adjacencies {
        const SWITCH: u32 = LinkRole::Switch as u32;
        let live = switch.links.values().filter(|state| switch.has_carrier(state.to));
        let live = live.map(|state| {
            (Some(state.answers), state.role(), state.link.peer().name, Some(&state.admission.relationship))
        });
        let stale = switch.stale.iter().filter(|stale| stale.answers && switch.has_carrier(stale.to));
        let stale = stale.map(|stale| (None, stale.entry.role, stale.peer, stale.relationship.as_ref()));
        let mut all = Adjacencies::default();
        for (live, role, peer, relationship) in live.chain(stale) {
            let cost = if live == Some(false) { AVOIDED } else { self.cost(&peer) };
            match relationship {
                Some(Relationship::Border { domain, ours, theirs }) => {
                    let domain = *domain;
                    let (transit, ours_transit) = (theirs.transit, ours.transit);
                    let parent = self.parent_rank(&peer);
                    let border = Adjoining { domain, switch: peer, cost, transit, ours_transit, parent };
                    all.borders.insert((domain, peer), border);
                }
                _ if role == SWITCH => {
                    // Of several links, the one that answers counts.
                    let before = all.neighbours.get(&peer).copied();
                    all.neighbours.insert(peer, before.map_or(cost, |before| before.min(cost)));
                    if before.is_none() && live.is_none() {
                        all.silent.insert(peer);
                    }
                }
                _ => {}
            }
        }
        all
    }

    /// Returns the cost of a frame to a neighbouring switch whose link answers.
    fn cost(&self, switch: &Name) -> u32 {
        if self.dampers.get(switch).is_some_and(Damper::is_suppressed) {
            return AVOIDED;
        }
        let configured = self.get(switch).and_then(|neighbour| neighbour.cost);
        configured.unwrap_or_else(|| self.meters.get(switch).map_or(1, Meter::cost))
    }

    /// Returns the rank of a neighbour's domain among the parents of this one. Returns `None` if it
    /// is no parent.
    fn parent_rank(&self, switch: &Name) -> Option<u8> {
        let index = self.listed.iter().position(|n| n.address.switch == *switch && n.parent)?;
        Some(u8::try_from(index).unwrap_or(u8::MAX))
    }

    /// Starts to measure a neighbour that had a link with an earlier daemon.
    pub fn adopt(&mut self, now: Duration, switch: Name) {
        self.meters.insert(switch, Meter::new(now, None));
    }

    /// Starts to measure a neighbour whose link has come up.
    pub fn link_up(&mut self, now: Duration, link: &Link) {
        self.meters.entry(link.peer().name).or_insert_with(|| Meter::new(now, Some(link.rtt())));
    }

    /// Records the round-trip time of the first request over a link. Returns whether the
    /// neighbour's cost has changed.
    pub fn answered(&mut self, now: Duration, link: &Link, rtt: Duration) -> bool {
        self.meters.get_mut(&link.peer().name).is_some_and(|meter| meter.answered(now, rtt))
    }

    /// Records that the link to a neighbour has become silent.
    pub fn failed(&mut self, now: Duration, switch: Name) {
        let damper = self.dampers.entry(switch).or_default();
        let before = damper.is_suppressed();
        damper.failed(now);
        if damper.is_suppressed() && !before {
            tracing::warn!(neighbour = %format_args!("{switch:#}"), "its link fails again and again; frames avoid it \
                                                      until it has been steady for a while");
        }
    }

    /// Samples the round-trip time to each neighbour, and ends suppressions. Returns whether the
    /// cost of one has changed.
    pub fn measure(&mut self, now: Duration, switch: &Switch) -> bool {
        let ended = self.dampers.values_mut().filter_map(|damper| damper.follow(now).then_some(())).count();
        let mut changed = ended > 0;
        for (neighbour, meter) in &mut self.meters {
            let newest = switch.newest_link(neighbour);
            if let Some(state) = newest.filter(|state| state.link.close_reason().is_none()) {
                changed |= meter.sample(now, state.link.rtt());
            }
        }
        changed
    }

    /// Drops the meters of neighbours without a link, and failures that are long ago. A new link
    /// starts a new measurement.
    pub fn forget_lost(&mut self, now: Duration, switch: &Switch) {
        self.dampers.retain(|_, damper| !damper.is_clear(now));
        self.meters.retain(|neighbour, _| switch.has_first_lane(neighbour) || switch.stale.keeps(neighbour));
    }
}
