//! Who gets a link, and keeps it; and what follows when links come and go.

use gdp_core::peer::Role;
use gdp_dataplane::PlaneError;
use gdp_link::link::Link;
use gdp_proto::control::Request;
use gdp_util::unix_time::unix_seconds;
use gdp_wire::{LinkRole, Name};

use super::Core;
use crate::config::Via;
use crate::domain::{Admission, Credentials};

impl Core {
    /// Whether a peer may have a link where it came in, and as what; if not, why.
    pub fn admit(&self, link: &Link, via: &Via) -> Result<Admission, String> {
        let peer = link.peer();
        if peer.name == self.name() {
            return Err(format!("the peer has the key of this switch, {}: give each a key of its own", peer.name));
        }
        let admission = self.membership.admit(link, link.credentials().as_deref())?;
        match peer.role {
            Role::Endpoint => self.switch.check_room()?,
            Role::Switch => self.neighbours.check(peer, via, &self.switch, self.membership.domain.is_some())?,
        }
        Ok(admission)
    }

    /// What the RIB is to be asked before a member that was admitted by an invitation is taken for
    /// one. A neighbour that the configuration names is taken if there is no way to the RIB but by
    /// it: there is nobody else to ask.
    pub fn question(&self, link: &Link, credentials: &Credentials) -> Option<Request> {
        let question = self.membership.question(self.name(), link, credentials)?;
        (!self.is_only_way_to_rib(&link.peer().name)).then_some(question)
    }

    fn is_only_way_to_rib(&self, neighbour: &Name) -> bool {
        let paths = self.topology.paths();
        let other_way = |(rib, _): &(Name, u64)| paths.next.get(rib).is_some_and(|next| next != neighbour);
        self.rib_host.rib.is_none()
            && self.neighbours.get(neighbour).is_some()
            && !paths.rib.as_ref().is_some_and(other_way)
    }

    /// The peer of a link shows other credentials: whether it may keep the link by them.
    pub fn renew_link(&mut self, link: &Link, credentials: &Credentials) -> Result<(), String> {
        if self.membership.domain.is_none() {
            return Ok(());
        }
        let admission = self.membership.admit(link, Some(credentials))?;
        self.switch.readmit(link, admission)
    }

    /// Admits the peers of links again, of all or only of those whose time has come. Returns links
    /// to be closed, with the reason, and endpoints whose last link was a stale one.
    pub fn recheck(&mut self, only_ended: bool) -> (Vec<(Link, String)>, Vec<Name>) {
        let (Some(domain), now) = (&self.membership.domain, unix_seconds()) else { return Default::default() };
        let admit = |link: &Link| domain.trust.admit(Role::Switch, link.peer(), link.credentials().as_deref(), now);
        self.switch.readmit_all(now, only_ended, admit)
    }

    /// Takes a link into service: if it is to a switch, its cost is measured; if to one of the
    /// domain, the topology goes by it. Returns the link to the same peer that it replaces.
    pub fn link_up(&mut self, link: &Link, via: Via, admission: Admission) -> Result<Option<Link>, PlaneError> {
        let replaced = self.switch.link_up(link, via, admission)?;
        if self.switch.role_on(link) == Some(LinkRole::Switch as u32) {
            self.topology.link_up(link.local_id());
        }
        if link.peer().role == Role::Switch {
            self.neighbours.link_up(self.clock.now().clock, link);
        }
        Ok(replaced)
    }

    /// A link is closed. Returns whether it is stale from now on, and to be
    /// [watched](crate::serve::liveness).
    pub fn link_down(&mut self, link: &Link) -> bool {
        self.topology.link_down(link.local_id());
        self.switch.link_down(link)
    }
}
