//! Decides which peers get and keep a link, and updates topology and costs when links come and go.

use gdp_core::peer::Role;
use gdp_dataplane::PlaneError;
use gdp_link::link::{CloseCode, Link};
use gdp_proto::control::Request;
use gdp_util::unix_time::unix_seconds;
use gdp_wire::{LinkRole, Name};

use super::Core;
use crate::config::Via;
use crate::domain::{Admission, Credentials};

impl Core {
    /// Returns the relationship under which a peer gets a link on its incoming path. Fails with the
    /// code and the reason if it gets none.
    pub fn admit(&self, link: &Link, via: &Via) -> Result<Admission, (CloseCode, String)> {
        let peer = link.peer();
        if peer.name == self.name() {
            let reason = format!("the peer has the key of this switch, {}: give each a key of its own", peer.name);
            return Err((CloseCode::KeyInUse, reason));
        }
        let not_admitted = |reason| (CloseCode::NotAdmitted, reason);
        let admission = self.membership.admit(link, link.credentials().as_deref()).map_err(not_admitted)?;
        match peer.role {
            Role::Endpoint => self.switch.check_room().map_err(|reason| (CloseCode::Full, reason))?,
            Role::Switch => {
                let has_domain = self.membership.domain.is_some();
                self.neighbours.check(peer, via, &self.switch, has_domain).map_err(not_admitted)?;
            }
        }
        Ok(admission)
    }

    /// Returns the request that asks the RIB to confirm a member that was admitted by an
    /// invitation. Returns `None` for a configured neighbour that is the only path to the RIB.
    /// There is no other switch to ask.
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

    /// Checks whether a peer keeps its link with renewed credentials. Fails with the reason if not.
    pub fn renew_link(&mut self, link: &Link, credentials: &Credentials) -> Result<(), String> {
        if self.membership.domain.is_none() {
            return Ok(());
        }
        let admission = self.membership.admit(link, Some(credentials))?;
        self.switch.readmit(link, admission)
    }

    /// Readmits the peers of all links, or only of those whose admission has expired. Returns the
    /// links to close with the reason, and the endpoints that lost their last link, a stale one.
    pub fn recheck(&mut self, only_ended: bool) -> (Vec<(Link, String)>, Vec<Name>) {
        let (Some(domain), now) = (&self.membership.domain, unix_seconds()) else { return Default::default() };
        let admit = |link: &Link| domain.trust.admit(Role::Switch, link.peer(), link.credentials().as_deref(), now);
        self.switch.readmit_all(now, only_ended, admit)
    }

    /// Takes a link into service. Starts to measure the cost of a link to a switch. Adds a link to
    /// a switch of the same domain to the topology. Returns the link to the same peer that this one
    /// replaces.
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

    /// Handles a closed link. Returns whether the link is now stale and must be
    /// [watched](crate::serve::liveness).
    pub fn link_down(&mut self, link: &Link) -> bool {
        self.topology.link_down(link.local_id());
        self.switch.link_down(link)
    }
}
