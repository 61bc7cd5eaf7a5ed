//! The daemon's state and decisions, behind one lock that no task holds across an await.
//!
//! Each part has one task. This module has the operations that span several parts. The surrounding
//! tasks (such as [`super::links`] and [`super::report`]) do the waiting.

mod admission;
pub mod clock;
mod effects;
pub mod follow_up;
pub mod link_state;
mod membership;
pub mod neighbours;
pub mod probes;
pub mod probing;
pub mod relay;
mod reports;
pub mod rib_client;
pub mod rib_host;
mod rib_requests;
mod switch;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use gdp_core::identity::Identity;
use gdp_dataplane::Planes;
use gdp_link::link::{Link, LinkIds};
use gdp_proto::control::{FibPush, Refusal, RefusalCode, Response};
use gdp_rib::rib::{Now, Rib};
use gdp_rib::topology::{Batch, Topology};
use gdp_util::unix_time::unix_nanos;
use gdp_wire::Name;

use self::clock::Clock;
use self::membership::Membership;
use self::neighbours::{Adjacencies, Neighbours};
use self::probes::Probes;
use self::rib_client::RibClient;
use self::rib_host::RibHost;
use self::switch::Switch;
use crate::config::{Inside, Neighbour};
use crate::domain::Domain;
use crate::serve::events::{Event, Events};
use crate::serve::term::Term;

/// The daemon's state.
pub struct Core {
    pub identity: Identity,
    pub clock: Clock,
    pub events: Events,
    pub switch: Switch,
    pub neighbours: Neighbours,
    pub topology: Topology,
    pub membership: Membership,
    pub rib_host: RibHost,
    pub rib_client: RibClient,
    pub probes: Probes,
}

impl Core {
    /// Creates the state. `has_rib` means that this switch hosts the RIB, without replicas.
    pub fn new(identity: Identity, neighbours: Vec<Neighbour>, has_rib: bool, planes: Planes) -> Self {
        let (name, events) = (identity.name(), Events::default());
        let mut topology = Topology::new(identity.clone(), unix_nanos());
        topology.set_rib(has_rib);
        Self {
            identity,
            clock: Clock::start(),
            switch: Switch::new(name, planes, events.clone()),
            neighbours: Neighbours::new(neighbours),
            topology,
            membership: Membership::default(),
            rib_host: RibHost::new(name, has_rib, events.clone()),
            rib_client: RibClient::default(),
            probes: Probes::default(),
            events,
        }
    }

    pub fn name(&self) -> Name {
        self.switch.name
    }

    pub fn now(&self) -> Now {
        self.clock.now()
    }

    /// Makes this switch a member of a domain. `public` lists the addresses at which other domains
    /// reach it.
    pub fn join_domain(&mut self, domain: Domain, public: Vec<SocketAddr>, trace_visibility: Inside) {
        self.membership = Membership::new(domain, public, trace_visibility);
        self.federate();
    }

    /// Keeps the data-plane state of an earlier daemon for the graceful-restart time.
    pub fn take_over(&mut self, ids: &LinkIds) {
        let now = self.now().clock;
        self.switch.take_over(ids).into_iter().for_each(|neighbour| self.neighbours.adopt(now, neighbour));
    }

    /// Removes expired stale links. Returns the endpoints that are no longer attached, and whether
    /// the adjacencies changed.
    pub fn end_stale_links(&mut self, now: Instant) -> (Vec<Name>, bool) {
        let before = self.neighbours.adjacencies(&self.switch);
        let lost = self.switch.end_stale_links(now);
        (lost, self.neighbours.adjacencies(&self.switch) != before)
    }

    /// Samples the round-trip time to the neighbours, and ends suppressions. Returns whether the
    /// cost of one has changed.
    pub fn measure(&mut self) -> bool {
        self.neighbours.measure(self.clock.now().clock, &self.switch)
    }

    /// Records whether the data plane at the other end of a link to a switch answers echoes.
    pub fn set_answering(&mut self, link: &Link, answers: bool) {
        self.switch.set_answering(link.local_id(), answers);
        if !answers {
            self.neighbours.failed(self.clock.now().clock, link.peer().name);
        }
    }

    /// Records the round-trip time of the first request over a link. Returns whether the
    /// neighbour's cost has changed.
    pub fn neighbour_answered(&mut self, link: &Link, rtt: Duration) -> bool {
        self.neighbours.answered(self.clock.now().clock, link, rtt)
    }

    /// Updates the topology, and with it the routes, the data planes and the RIB. Returns the
    /// link-state batches to send with their links, and whether the paths or the RIB's location
    /// changed.
    pub fn follow_topology(&mut self) -> (Vec<(Link, Batch)>, bool) {
        let (now, own) = (self.now(), self.name());
        let Adjacencies { neighbours, silent, borders } = self.neighbours.adjacencies(&self.switch);
        self.neighbours.forget_lost(now.clock, &self.switch);
        self.topology.set_neighbours(neighbours);
        self.topology.set_silent(silent);
        self.topology.set_borders(borders.into_values());
        self.topology.set_bit(self.switch.routes.own_bit());
        let changed = self.topology.tick(now.clock);
        if changed {
            let changes = self.switch.routes.set_paths(self.topology.paths(), &own);
            tracing::debug!(changes = changes.len(), "other paths");
            let (switches, reached) = (self.topology.states().count(), self.topology.paths().costs.len());
            self.events.tell(Event::Topology { switches, reached });
            self.switch.apply(changes);
            if let Some(rib) = &mut self.rib_host.rib {
                rib.set_paths(now, self.topology.paths().clone());
            }
        }
        self.rib_host.follow_borders(now, &self.topology);
        let batches = self.topology.batches(now.clock).into_iter();
        let batches = batches.filter_map(|batch| {
            let state = self.switch.links.get(&batch.id.link)?;
            Some((state.link.clone(), batch))
        });
        (batches.collect(), changed)
    }

    /// Returns whether this switch must report to a remote RIB, because the RIB at its current
    /// location has not accepted a report.
    pub fn follow_rib(&mut self) -> bool {
        self.rib_host.rib.is_none() && self.rib_client.follow(self.topology.rib())
    }

    /// Returns the link to the next hop on the path to another switch.
    pub fn link_toward(&self, to: &Name) -> Result<Link, Refusal> {
        let next = self.topology.paths().next.get(to);
        next.and_then(|next| self.switch.link_to(next)).ok_or_else(|| {
            let reason = format!("switch {} knows no path to switch {to}", self.name());
            Refusal::new(RefusalCode::Unreachable, reason)
        })
    }

    /// Applies a FIB push of a RIB, unless another RIB has taken its place.
    pub fn push(&mut self, push: &FibPush) -> Response {
        match self.rib_client.check_fence(self.clock.now().clock, push.run) {
            Ok(()) => self.switch.push(push),
            Err(refusal) => refusal.into(),
        }
    }

    /// Starts the exchange between the local RIB and other domains.
    pub fn federate(&mut self) {
        self.rib_host.federate(self.clock.now(), self.membership.domain.as_ref(), unix_nanos());
    }

    /// Lets the local RIB re-evaluate its state after a name's owner or a domain revoked something.
    pub fn reconsider(&mut self, about: Name) {
        self.rib_host.reconsider(self.clock.now(), self.membership.domain.as_ref(), about, None);
    }

    /// Makes this replica the leader, with this RIB.
    pub fn lead(&mut self, mut rib: Rib, term: Arc<Term>) {
        rib.set_paths(self.now(), self.topology.paths().clone());
        self.rib_host.lead(rib, term);
        self.federate();
        self.topology.set_rib(true);
    }

    /// Drops the RIB of a leader whose lease has expired.
    pub fn end_term(&mut self) {
        if self.rib_host.end_term() {
            self.topology.set_rib(false);
        }
    }
}
