//! This switch's forwarding state: the links, the FIB, and the data planes that hold both.

mod links;

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::time::Instant;

use gdp_core::peer::{GRACEFUL_RESTART_TIME, Role};
use gdp_dataplane::{PlaneRoute, Planes};
use gdp_link::link::{Link, LinkIds};
use gdp_link::port::LinkAddr;
use gdp_proto::control::{FibPush, MAX_BEYOND, Refusal, RefusalCode, Response, TracedEnd};
use gdp_wire::{LinkRole, Name};

use super::link_state::LinkState;
use crate::domain::Relationship;
use crate::serve::events::{Event, Events};
use crate::serve::graceful_restart::{GracefulRestart, Reservation, StaleLink};
use crate::serve::interfaces::SmallMtu;
use crate::serve::recent_refusals::RecentRefusals;
use crate::serve::refusals::Refusals;
use crate::serve::routes::{PlaneChange, Routes};

/// The maximum number of refused routes in one retry. Several are tried because routes need
/// different resources.
const MAX_REFUSALS: usize = 16;

/// The links of this switch, its FIB and its data planes.
pub struct Switch {
    pub name: Name,
    pub planes: Planes,
    pub routes: Routes,
    pub links: HashMap<u32, LinkState>,
    /// The stale links. The data planes have them besides `links`.
    pub stale: GracefulRestart,
    /// The newest link to each peer, by peer and lane. Only endpoints have several lanes.
    peers: BTreeMap<(Name, u8), u32>,
    /// The endpoints that the RIB has attached to this switch.
    pub attached: HashSet<Name>,
    /// The reasons why peers got no link.
    pub refusals: Refusals,
    /// What was refused in the last minute.
    pub recent_refusals: RecentRefusals,
    events: Events,
    /// The indices of interfaces without carrier.
    no_carrier: BTreeSet<u32>,
    /// The interfaces whose MTU is too small for links.
    pub small_mtus: BTreeMap<String, SmallMtu>,
    /// The routes that the data plane refused, and the reason of the last refusal.
    pending_routes: (BTreeMap<Name, PlaneRoute>, String),
    /// The time until which the data planes keep the ports and programs of an earlier daemon.
    adopted_until: Option<Instant>,
}

impl Switch {
    pub fn new(name: Name, planes: Planes, events: Events) -> Self {
        Self {
            name,
            planes,
            routes: Routes::default(),
            links: HashMap::new(),
            stale: GracefulRestart::default(),
            peers: BTreeMap::new(),
            attached: HashSet::new(),
            refusals: Refusals::default(),
            recent_refusals: RecentRefusals::new(Instant::now()),
            events,
            no_carrier: BTreeSet::new(),
            small_mtus: BTreeMap::new(),
            pending_routes: Default::default(),
            adopted_until: None,
        }
    }

    /// Keeps the data-plane state of an earlier daemon for the graceful-restart time, until peers
    /// and RIB replace it. The endpoints of its links count as attached; they attach again when
    /// they detect the restart. Returns the neighbouring switches.
    pub fn take_over(&mut self, ids: &LinkIds) -> Vec<Name> {
        let Some(left) = self.planes.left().cloned() else { return Vec::new() };
        let until = Instant::now() + GRACEFUL_RESTART_TIME;
        let (mut links, mut neighbours) = (Vec::new(), Vec::new());
        for (entry, to) in &left.links {
            let (Some(role), Some(id)) = (entry.role(), ids.reserve(entry.id)) else { continue };
            let id = Reservation::Adopted { _id: id };
            links.push((entry.clone(), role));
            let (peer, lane) = (entry.peer, entry.lane as u8);
            let (entry, relationship) = (entry.clone(), None);
            self.stale.keep(StaleLink { peer, lane, role, entry, to: *to, until, answers: true, relationship, id });
            match role {
                LinkRole::Endpoint => drop(self.attached.insert(peer)),
                LinkRole::Switch | LinkRole::Border => neighbours.push(peer),
            }
        }
        let changes = self.routes.adopt(&left, &links);
        self.apply(changes);
        self.adopted_until = Some(until);
        let routes = left.routes.len();
        tracing::info!(
            links = links.len(),
            routes,
            "took over from a daemon that ended without being stopped; its links are held"
        );
        neighbours
    }

    /// Removes expired stale links. Returns the endpoints that are no longer attached.
    pub fn end_stale_links(&mut self, now: Instant) -> Vec<Name> {
        let lost = self.stale.over(now).into_iter().filter_map(|id| self.release(id)).collect();
        if self.adopted_until.take_if(|until| *until <= now).is_some() {
            tracing::info!("nothing is held any longer from the daemon before this one");
            let mut changes = self.routes.end_any_writer();
            changes.extend(self.routes.end_stale_paths());
            self.apply(changes);
            if let Err(error) = self.planes.end_adoption() {
                tracing::error!(%error, "the data plane keeps something of the daemon before this one");
            }
        }
        lost
    }

    /// Applies a FIB push of the RIB.
    pub fn push(&mut self, push: &FibPush) -> Response {
        match self.routes.push(push) {
            Ok(changes) => {
                let (generation, changes_made) = (push.generation, changes.len());
                tracing::debug!(generation, changes = changes_made, "FIB push");
                self.events.tell(Event::Routes { generation, changes: changes_made });
                self.apply(changes);
                match self.pending_routes() {
                    None => Response::Done,
                    // After any other refusal, the RIB sends the whole FIB again.
                    Some(reason) => Refusal::new(RefusalCode::Limit, reason).into(),
                }
            }
            Err(error) => Refusal::new(RefusalCode::Malformed, error.to_string()).into(),
        }
    }

    /// Returns how many names have no route in the data plane, and why. Returns `None` if none
    /// lacks one.
    pub fn pending_routes(&self) -> Option<String> {
        let (names, reason) = &self.pending_routes;
        (!names.is_empty()).then(|| format!("{} names have no route at switch {}: {reason}", names.len(), self.name))
    }

    /// Applies changes to the data planes. Retries routes that the data plane refused before.
    pub fn apply(&mut self, changes: Vec<PlaneChange>) {
        for change in changes {
            let result = match change {
                PlaneChange::OwnBit(bit) => self.planes.set_own_bit(bit),
                PlaneChange::Reach { link, bits } => {
                    let live = self.links.get_mut(&link).map(|state| (&mut state.entry, state.to));
                    match live.or_else(|| self.stale.get_mut(link).map(|stale| (&mut stale.entry, stale.to))) {
                        Some((entry, to)) => {
                            entry.reach = bits;
                            self.planes.set_link(**entry, to)
                        }
                        None => Ok(()),
                    }
                }
                PlaneChange::NextHops(next_hops) => self.planes.set_next_hops(&next_hops),
                PlaneChange::Set(name, route) => {
                    // Apply each route on its own, so that one refused name delays no other.
                    match self.planes.set_route(name, &route) {
                        Ok(()) => _ = self.pending_routes.0.remove(&name),
                        Err(error) => {
                            self.pending_routes.0.insert(name, route);
                            self.pending_routes.1 = error.to_string();
                        }
                    }
                    Ok(())
                }
                PlaneChange::Remove(name) => {
                    self.pending_routes.0.remove(&name);
                    self.planes.remove_route(&name)
                }
            };
            if let Err(error) = result {
                tracing::error!(%error, "the data plane refused a change");
            }
        }
        self.retry_pending_routes();
    }

    fn retry_pending_routes(&mut self) {
        let mut refusals = 0;
        let (planes, (routes, reason)) = (&mut self.planes, &mut self.pending_routes);
        routes.retain(|name, route| {
            if refusals == MAX_REFUSALS {
                return true;
            }
            match planes.set_route(*name, route) {
                Ok(()) => false,
                Err(error) => {
                    (refusals, *reason) = (refusals + 1, error.to_string());
                    true
                }
            }
        });
        if let Some(reason) = self.pending_routes() {
            tracing::error!("{reason}");
        }
    }

    /// Returns the link to a peer, if it is up. Returns the preferred one of an endpoint with
    /// several links.
    pub fn link_to(&self, peer: &Name) -> Option<Link> {
        let preferred = self.routes.link_to(peer).filter(|id| self.links.contains_key(id));
        let id = preferred.or_else(|| self.links_of(peer).next())?;
        self.links.get(&id).map(|state| state.link.clone())
    }

    /// Returns the link to a border switch, if that is a border of `domain`.
    pub fn border_link(&self, peer: &Name, domain: Name) -> Option<Link> {
        let link = self.link_to(peer)?;
        (self.domain_of(&link) == Some(domain)).then_some(link)
    }

    /// Returns the peer's domain, if the peer of a link is a border of another domain.
    pub fn domain_of(&self, link: &Link) -> Option<Name> {
        self.links.get(&link.local_id())?.domain()
    }

    /// Returns the role that the data planes give the peer of a link.
    pub fn role_on(&self, link: &Link) -> Option<u32> {
        self.links.get(&link.local_id()).map(LinkState::role)
    }

    /// Returns the links of an endpoint.
    pub fn links_of_endpoint(&self, entity: &Name) -> Vec<Link> {
        let links = self.links_of(entity).filter_map(|id| Some(self.links.get(&id)?.link.clone()));
        links.filter(|link| link.peer().role == Role::Endpoint).collect()
    }

    /// Returns the ids of the links to a peer.
    pub fn links_of(&self, peer: &Name) -> impl Iterator<Item = u32> {
        self.peers.range((*peer, 0)..=(*peer, u8::MAX)).map(|(_, id)| *id)
    }

    /// Returns the newest link on a peer's first lane. A switch has only this lane.
    pub fn newest_link(&self, peer: &Name) -> Option<&LinkState> {
        self.peers.get(&(*peer, 0)).and_then(|id| self.links.get(id))
    }

    /// Returns an open link of the same endpoint, on any lane, whose program started at another
    /// time than that of a new one.
    pub fn link_of_another_run(&self, new: &Link) -> Option<Link> {
        let mut links = self.links_of(&new.peer().name).filter_map(|id| Some(&self.links.get(&id)?.link));
        links.find(|link| link.close_reason().is_none() && link.is_of_another_run(new)).cloned()
    }

    pub fn has_first_lane(&self, peer: &Name) -> bool {
        self.peers.contains_key(&(*peer, 0))
    }

    /// Returns the peer of each link, stale links included, by link id.
    pub fn peers_by_link(&self) -> BTreeMap<u32, Name> {
        let live = self.links.iter().map(|(id, state)| (*id, state.link.peer().name));
        live.chain(self.stale.iter().map(|stale| (stale.entry.id, stale.peer))).collect()
    }

    /// Returns where this switch delivers frames for a name. The result is empty if it is no egress
    /// switch of the name.
    pub fn end_of(&self, name: &Name) -> TracedEnd {
        let mut end = TracedEnd::default();
        let Some(entry) = self.planes.route(name) else { return end };
        for id in self.planes.readers(&entry) {
            match self.links.get(&id).map(|state| (&state.admission.relationship, state.link.peer().name)) {
                Some((Relationship::Border { domain, .. }, switch)) if end.beyond.len() < MAX_BEYOND => {
                    end.beyond.push((*domain, switch));
                }
                Some((Relationship::Border { .. }, _)) => {}
                _ => end.links += 1,
            }
        }
        end
    }

    /// Returns whether the interface for an address has carrier. An interface without a report
    /// counts as having it.
    pub fn has_carrier(&self, to: LinkAddr) -> bool {
        !matches!(to, LinkAddr::Ethernet { ifindex, .. } if self.no_carrier.contains(&ifindex))
    }

    /// Sets the interfaces without carrier, which send no frames. Returns whether the set has
    /// changed.
    pub fn set_no_carrier(&mut self, interfaces: BTreeSet<u32>) -> bool {
        let changed = interfaces != self.no_carrier;
        self.no_carrier = interfaces;
        changed
    }
}
