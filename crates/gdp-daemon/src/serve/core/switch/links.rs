//! Puts links into service, updates them, and takes them out of service.

use std::time::Instant;

use gdp_core::peer::{GRACEFUL_RESTART_TIME, Role};
use gdp_dataplane::PlaneError;
use gdp_link::link::{KeyedEntry, Link, LinkKeys};
use gdp_rib::crossing::Allowance;
use gdp_wire::table::{EGRESS_SET_SIZE, MAX_LINKS, PORT_USERSPACE};
use gdp_wire::{LinkRole, Name};

use super::Switch;
use crate::config::Via;
use crate::domain::{Admission, DomainError};
use crate::serve::core::link_state::{LinkState, flags_of, inspections, link_role, role_on};
use crate::serve::events::Event;
use crate::serve::graceful_restart::{GRACE, Reservation, StaleLink};

/// The maximum number of endpoint links. Any endpoint may make one, so the rest are reserved for
/// switches.
const MAX_ENDPOINTS: usize = (MAX_LINKS - EGRESS_SET_SIZE) as usize;

impl Switch {
    /// Checks whether another endpoint link fits.
    pub fn check_room(&self) -> Result<(), String> {
        let live = self.links.values().filter(|state| state.link.peer().role == Role::Endpoint).count();
        let stale = self.stale.iter().filter(|stale| stale.role == LinkRole::Endpoint).count();
        if live + stale < MAX_ENDPOINTS {
            return Ok(());
        }
        Err(format!("{MAX_ENDPOINTS} endpoints have links to this switch, the most it takes"))
    }

    /// Takes a link into service. Returns the link to the same peer that this one replaces.
    pub fn link_up(&mut self, link: &Link, via: Via, admission: Admission) -> Result<Option<Link>, PlaneError> {
        let (id, peer, lane) = (link.local_id(), link.peer().name, link.peer().lane);
        let (mut entry, to) = (KeyedEntry::from(link.entry(PORT_USERSPACE)), link.addr());
        let role = role_on(link, &admission);
        (entry.role, entry.flags) = (role as u32, flags_of(&admission));
        if let Err(error) = self.planes.set_link(*entry, to) {
            // Some of the data planes may have accepted the link.
            let _ = self.planes.remove_link(id);
            return Err(error);
        }
        let replaced = self.peers.insert((peer, lane), id);
        let replaced = replaced.and_then(|old| self.links.get(&old)).map(|old| old.link.clone());
        self.refusals.forget(&peer);
        self.events.tell(Event::LinkUp {
            peer,
            role: link_role(entry.role),
            relationship: (&admission.relationship).into(),
            via: via.to_string(),
            address: to.to_string(),
        });
        let (since, traces, inspections) = (Instant::now(), Allowance::default(), inspections());
        self.links.insert(
            id,
            LinkState { link: link.clone(), via, since, admission, traces, inspections, entry, to, answers: true },
        );
        let changes = self.routes.link_up(role, peer, lane, id);
        self.apply(changes);
        Ok(replaced)
    }

    /// Switches routes to a link on which the peer accepts data frames. Shortens the expiry of the
    /// peer's stale links of this lane.
    pub fn link_ready(&mut self, link: &Link) {
        let (peer, id) = (link.peer().name, link.local_id());
        if let Some(role) = self.links.get(&id).and_then(|state| state.entry.role()) {
            let changes = self.routes.link_ready(role, peer, id);
            self.apply(changes);
            self.stale.replaced(&peer, link.peer().lane, Instant::now());
        }
    }

    /// Makes this link the one that an endpoint prefers for frames that go over only one of its
    /// links.
    pub fn prefer(&mut self, link: &Link) {
        let changes = self.routes.link_preferred(link.peer().name, link.local_id());
        self.apply(changes);
    }

    /// Records that a peer got no link, and why. Returns whether the reason is new.
    pub fn refused(&mut self, peer: Name, via: &Via, reason: &str) -> bool {
        self.events.tell(Event::LinkRefused { peer, via: via.to_string(), reason: reason.to_owned() });
        self.refusals.add(peer, reason.to_owned(), Instant::now())
    }

    /// Handles a closed link. Returns whether it is stale and must be
    /// [watched](crate::serve::liveness).
    ///
    /// The link stays in the data planes for a while if frames may still arrive on it. That is so
    /// if another link of the peer has replaced it, and the peer has yet to learn this. It is also
    /// so if the peer fell silent: its data plane may forward without its daemon. Only the second
    /// case counts as stale here.
    pub fn link_down(&mut self, link: &Link) -> bool {
        let (id, peer, lane) = (link.local_id(), link.peer().name, link.peer().lane);
        if self.peers.get(&(peer, lane)) == Some(&id) {
            self.peers.remove(&(peer, lane));
        }
        let Some(LinkState { link, admission, entry, to, answers, .. }) = self.links.remove(&id) else { return false };
        let role = role_on(&link, &admission);
        let is_replaced = self.routes.is_replaced(role, &peer, id);
        let is_silent = !is_replaced && link.fell_silent() && self.routes.link_silent(role, &peer, id);
        if !is_replaced && !is_silent {
            self.remove_link(role, peer, id);
            return false;
        }
        let time = if is_replaced { GRACE } else { GRACEFUL_RESTART_TIME };
        let (until, id) = (Instant::now() + time, Reservation::Closed { link });
        let stale =
            StaleLink { peer, lane, role, entry, to, until, answers, relationship: Some(admission.relationship), id };
        if let Some(first) = self.stale.keep(stale) {
            self.release(first);
        }
        is_silent
    }

    /// Returns whether this link is stale and its peer has no other link on that lane.
    pub fn awaits(&self, link: &Link) -> bool {
        self.stale.contains(link.local_id()) && !self.peers.contains_key(&(link.peer().name, link.peer().lane))
    }

    /// Records whether the data plane at the other end of a link answers echoes.
    pub fn set_answering(&mut self, id: u32, answers: bool) {
        if let Some(state) = self.links.get_mut(&id) {
            state.answers = answers;
        } else if let Some(stale) = self.stale.get_mut(id) {
            stale.answers = answers;
        }
    }

    /// Returns whether the data plane at the other end of a live link answers echoes. A link that
    /// is not live counts as if it did.
    pub fn answers(&self, link: &Link) -> bool {
        self.links.get(&link.local_id()).is_none_or(|state| state.answers)
    }

    /// Removes a stale link because it has expired, or because nothing forwards at its other end.
    /// Returns its peer, if that is an attached endpoint without any other link.
    pub fn release(&mut self, id: u32) -> Option<Name> {
        let StaleLink { peer, role, .. } = self.stale.take(id)?;
        self.remove_link(role, peer, id);
        let is_lost = role == LinkRole::Endpoint && self.is_lost(&peer);
        (is_lost && self.attached.contains(&peer)).then_some(peer)
    }

    /// Returns whether no link to a peer is left, stale ones included.
    fn is_lost(&self, peer: &Name) -> bool {
        self.links_of(peer).next().is_none() && !self.stale.keeps(peer)
    }

    fn remove_link(&mut self, role: LinkRole, peer: Name, id: u32) {
        let (changes, with_it) = self.routes.link_removed(role, peer, id);
        self.apply(changes);
        for id in [id].into_iter().chain(with_it) {
            self.stale.take(id);
            if let Err(error) = self.planes.remove_link(id) {
                tracing::error!(link = id, %error, "the data plane keeps a link that is gone");
            }
        }
    }

    /// Updates a link whose peer renewed its credentials. Fails if the peer's relationship changed,
    /// which needs a new link.
    pub fn readmit(&mut self, link: &Link, admission: Admission) -> Result<(), String> {
        let Some(state) = self.links.get_mut(&link.local_id()) else { return Ok(()) };
        if admission.relationship.as_str() != state.admission.relationship.as_str() {
            let (was, is) = (state.admission.relationship.as_str(), admission.relationship.as_str());
            return Err(format!("the peer was taken as {was} and is {is} now: make the link anew"));
        }
        let is_other = flags_of(&admission) != state.entry.flags;
        state.admission = admission;
        if is_other {
            self.put_flags(link.local_id());
        }
        Ok(())
    }

    /// Readmits the peers of all links, or only of those whose admission expired before `now`, in
    /// Unix seconds. Returns the links to close with the reason, and the endpoints that lost their
    /// last link, a stale one.
    pub fn readmit_all(
        &mut self,
        now: u64,
        only_ended: bool,
        admit: impl Fn(&Link) -> Result<Admission, DomainError>,
    ) -> (Vec<(Link, String)>, Vec<Name>) {
        let (mut refused, mut changed) = (Vec::new(), Vec::new());
        let is_due = |state: &&mut LinkState| !only_ended || state.admission.until < now;
        for state in self.links.values_mut().filter(is_due).filter(|state| state.link.close_reason().is_none()) {
            match admit(&state.link) {
                Ok(admission) if admission.relationship.as_str() == state.admission.relationship.as_str() => {
                    changed.extend((flags_of(&admission) != state.entry.flags).then_some(state.entry.id));
                    state.admission = admission;
                }
                Ok(admission) => {
                    let is = admission.relationship.as_str();
                    refused.push((state.link.clone(), format!("the peer is {is} now: make the link anew")));
                }
                Err(error) => refused.push((state.link.clone(), error.to_string())),
            }
        }
        // Stale links expire soon by themselves.
        let may_stay = |stale: &StaleLink| only_ended || stale.link().is_none_or(|link| admit(link).is_ok());
        let over: Vec<u32> = self.stale.iter().filter(|stale| !may_stay(stale)).map(|stale| stale.entry.id).collect();
        changed.into_iter().for_each(|id| self.put_flags(id));
        let lost = over.into_iter().filter_map(|id| self.release(id)).collect();
        (refused, lost)
    }

    /// Writes the rights of the peer's domain to the data planes.
    fn put_flags(&mut self, id: u32) {
        let Some(state) = self.links.get_mut(&id) else { return };
        state.entry.flags = flags_of(&state.admission);
        if let Err(error) = self.planes.set_link(*state.entry, state.to) {
            tracing::error!(link = id, %error, "the data plane did not take what the domain of a peer may do now");
        }
    }

    /// Writes new link keys to the data planes. Returns `false` if the link is gone, or a data
    /// plane refuses.
    pub fn put_keys(&mut self, id: u32, keys: &LinkKeys) -> bool {
        let Some(state) = self.links.get_mut(&id) else { return false };
        keys.put(&mut state.entry);
        let result = self.planes.set_link(*state.entry, state.to);
        if let Err(error) = &result {
            tracing::error!(link = id, %error, "the data plane did not take a link's new keys; it keeps those it has");
        }
        result.is_ok()
    }

    /// Updates the data planes when a peer's QUIC-validated address, the path MTU or the
    /// encapsulation toward it has changed.
    pub fn follow_addresses(&mut self) {
        for state in self.links.values_mut() {
            let (to, mtu, carrier) = (state.link.addr(), state.link.mtu(), state.link.carrier());
            if (to, mtu, carrier) == (state.to, state.entry.mtu, state.entry.carrier) {
                continue;
            }
            let peer = format_args!("{:#}", state.link.peer().name).to_string();
            if to != state.to {
                tracing::info!(peer, from = %state.to, %to, "a peer moved");
            }
            if mtu != state.entry.mtu {
                tracing::debug!(peer, from = state.entry.mtu, to = mtu, "the MTU of a link changed");
            }
            (state.to, state.entry.mtu, state.entry.carrier) = (to, mtu, carrier);
            if let Err(error) = self.planes.set_link(*state.entry, to) {
                tracing::error!(%error, "the data plane did not take what changed on a link");
            }
        }
    }

    /// Closes the links over veth interfaces to endpoints on this host, because the interfaces are
    /// gone. The endpoints make new links and send through the daemon.
    pub fn close_links_by_pair(&self) {
        for state in self.links.values().filter(|state| state.link.is_by_pair()) {
            state.link.close("the interfaces between the switch and its host are gone");
        }
    }
}
