//! Locates names from this switch's view, sends probes toward them, and handles traces of other
//! domains.

use std::collections::BTreeSet;
use std::time::Instant;

use gdp_core::crypto;
use gdp_core::domain::Relationship;
use gdp_core::name::NamePrefix;
use gdp_dataplane::notices::Punted;
use gdp_link::link::Link;
use gdp_proto::control::{Refusal, RefusalCode, Request, TraceLeg, TraceOn, Traced};
use gdp_rib::crossing::check_path;
use gdp_wire::table::EGRESS_SET_SIZE;
use gdp_wire::{Header, LinkRole, Name};
use tokio::sync::oneshot;

use super::Core;
use super::follow_up::{FollowUp, TraceEntry, Tracing, refuse};
use super::probes::{Location, MAX_EGRESS, ProbeError};
use super::relay::onward;

impl Core {
    /// Returns the one known name with this prefix, and its location.
    pub fn locate(&self, prefix: &NamePrefix) -> Result<Location, ProbeError> {
        let name = match prefix.full() {
            Some(name) => name,
            None => self.known_name(prefix)?,
        };
        let is_near = self.switch.link_to(&name).is_some();
        let egress: Vec<Name> = if name == self.name() || self.topology.paths().reaches(&name) {
            vec![name]
        } else {
            self.egress_of(&name).collect()
        };
        if egress.is_empty() && !is_near {
            Err(ProbeError::NoWay(name))
        } else {
            Ok(Location { name, is_near, egress })
        }
    }

    /// Returns the egress switches of a name that are in the topology.
    pub fn egress_of(&self, name: &Name) -> impl Iterator<Item = Name> {
        let paths = self.topology.paths();
        let bits = self.switch.planes.route(name).map_or(0, |entry| entry.egress_bits);
        let of = move |bit: u8| (bits >> bit & 1 != 0).then(|| paths.bits.get(&bit).copied()).flatten();
        (0..EGRESS_SET_SIZE as u8).filter_map(of)
    }

    fn known_name(&self, prefix: &NamePrefix) -> Result<Name, ProbeError> {
        let switches = self.topology.states().map(|state| state.switch).chain([self.name()]);
        let near = switches.chain(self.switch.links.values().map(|state| state.link.peer().name));
        let mut found: BTreeSet<Name> = near.filter(|name| prefix.matches(name)).collect();
        found.extend(self.switch.planes.names_like(prefix, 2));
        let mut found = found.into_iter();
        match (found.next(), found.next()) {
            (Some(name), None) => Ok(name),
            (None, _) => Err(ProbeError::Unknown(prefix.clone())),
            _ => Err(ProbeError::Ambiguous(prefix.clone())),
        }
    }

    /// Returns the answer to a probe that ended here, and the link to send it over.
    ///
    /// Returns `None` for a probe from another domain, which must not see the inside of this one.
    /// No answer would reach it either. Returns `None` too if there is no path back.
    pub fn answer_to(&self, probe: &Punted) -> Option<(Link, Request)> {
        if self.switch.links.get(&probe.link)?.role() != LinkRole::Switch as u32 {
            return None;
        }
        let own_bit = self.switch.routes.own_bit().map_or(0, |bit| 1u64 << bit);
        let end = (probe.egress_bits == own_bit).then(|| self.switch.end_of(&probe.destination));
        let answer = Traced { cookie: probe.cookie, switch: self.name(), end };
        Some((self.link_toward(&probe.source).ok()?, onward(probe.source, Request::Traced(answer))))
    }

    /// Sends a probe for `name` toward an egress switch, at most `hops` switches far. `asked_by` is
    /// the neighbouring domain that requested it.
    pub fn send_probe(
        &mut self,
        asked_by: Option<Name>,
        name: Name,
        switch: Name,
        hops: u8,
    ) -> Result<oneshot::Receiver<(Traced, Instant)>, ProbeError> {
        let bit = self.topology.paths().bit(&switch).ok_or(ProbeError::NoPath(switch))?;
        let link = self.switch.planes.next_hop(bit);
        if link == 0 {
            return Err(ProbeError::NoPath(switch));
        }
        let cookie = cookie()?;
        let answer = self.probes.wait(asked_by, cookie)?;
        self.switch.planes.probe(link, Header::probe(name, self.name(), bit, hops.max(1)), cookie);
        Ok(answer)
    }

    /// Continues a trace of a switch of this domain over a border link of this switch.
    pub fn trace_leaves(&self, request: TraceOn) -> FollowUp {
        let TraceLeg::Out { domain, peer } = request.leg else {
            return refuse(RefusalCode::Malformed, "a trace that crosses a border is not passed on");
        };
        match self.switch.border_link(&peer, domain) {
            Some(link) => FollowUp::Trace(Box::new(Tracing::Leaves { link, domain, request })),
            None => {
                let reason = format!("switch {} has no link to switch {peer} of domain {domain} now", self.name());
                refuse(RefusalCode::Unreachable, reason)
            }
        }
    }

    /// Handles a trace that a neighbouring switch requests over its link.
    pub fn trace_enters(&mut self, from: &Link, request: TraceOn) -> FollowUp {
        match self.trace_entry(from, request) {
            Ok(entry) => FollowUp::Trace(Box::new(Tracing::Enters(entry))),
            Err(refusal) => FollowUp::Answer(refusal.into()),
        }
    }

    fn trace_entry(&mut self, from: &Link, request: TraceOn) -> Result<TraceEntry, Refusal> {
        let (id, now) = (from.local_id(), self.now().clock);
        let (Some(domain), TraceLeg::Across) = (self.switch.domain_of(from), request.leg) else {
            return Err(Refusal::new(RefusalCode::Malformed, "traces come over a border, or are passed on"));
        };
        let (Some(home), Some(state)) = (self.membership.home(), self.switch.links.get_mut(&id)) else {
            return Err(Refusal::new(RefusalCode::Unreachable, "the link is gone"));
        };
        if !state.traces.take(now) {
            let reason = format!("domain {domain:#} has asked for too many traces; try again in a second");
            return Err(Refusal::new(RefusalCode::Limit, reason));
        }
        let is_transit = matches!(&state.admission.relationship, Relationship::Border { ours, .. } if ours.transit);
        check_path(&request.path, &domain, &home)?;
        // The refusal is the same for an unknown name and for one to which the domain may not send.
        if !self.switch.planes.writers(&request.name).contains(&id) {
            let reason = format!("domain {home:#} takes nothing for {:#} from domain {domain:#}", request.name);
            return Err(Refusal::new(RefusalCode::NotFound, reason));
        }
        let egress: Vec<Name> = self.egress_of(&request.name).take(MAX_EGRESS).collect();
        if self.probes.room(Some(domain)) < egress.len() {
            let reason = format!("probes of other traces for domain {domain:#} are under way; try again in a second");
            return Err(Refusal::new(RefusalCode::Limit, reason));
        }
        let (from, visibility) = (from.peer().name, self.membership.trace_visibility);
        Ok(TraceEntry { request, home, asked_by: domain, from, may_cross: is_transit, visibility, egress })
    }
}

/// Returns a random number that identifies the answer to a probe.
pub fn cookie() -> Result<u64, ProbeError> {
    crypto::random().map(u64::from_ne_bytes).map_err(|error| ProbeError::Random(error.to_string()))
}
