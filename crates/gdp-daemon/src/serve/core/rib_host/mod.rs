//! The local RIB. It answers requests, and stores the changes if it leads several replicas.

mod tiers;

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use gdp_core::cert::{Advert, Host, Signed};
use gdp_core::crypto;
use gdp_core::name::NameProof;
use gdp_core::peer::GRACEFUL_RESTART_TIME;
use gdp_proto::control::{EntityRequest, NameRole, RefusalCode, Response};
use gdp_rib::rib::fib::Pushed;
use gdp_rib::rib::{Effect, Item, Limits, Now, Rib, RibRun, encode_item};
use gdp_util::unix_time::unix_nanos;
use gdp_wire::Name;

use super::follow_up::{FollowUp, Statement, refuse};
use crate::domain::Domain;
use crate::serve::events::{Event, Events};
use crate::serve::federation::Federation;
use crate::serve::term::Term;
use crate::store::items::ItemChange;

/// The number of random low bits in the number of a RIB run. The 40 high bits have room for etcd
/// revisions, or for the time in units of 17 ms.
const RUN_BITS: u32 = 24;

/// The RIB of the domain, if this switch hosts it.
pub struct RibHost {
    switch: Name,
    pub rib: Option<Rib>,
    /// The exchange with other domains, if this switch is a member of a domain.
    pub federation: Option<Federation>,
    /// The leader term, if this RIB leads several replicas.
    term: Option<Arc<Term>>,
    /// The reason why this replica has no RIB, if known.
    pub no_rib: Option<String>,
    /// The serials of invitations with new admissions that are not stored yet.
    unstored_invitations: BTreeSet<u64>,
    events: Events,
    /// The counts of names and switches in the last event.
    counts: (usize, usize),
}

impl RibHost {
    /// Creates the state. `has_rib` means that this switch hosts the RIB, without replicas.
    pub fn new(switch: Name, has_rib: bool, events: Events) -> Self {
        let run = RibRun { id: run_id(unix_nanos() >> RUN_BITS), settling: GRACEFUL_RESTART_TIME };
        Self {
            switch,
            rib: has_rib.then(|| Rib::new(switch, run, Limits::default())),
            federation: None,
            term: None,
            no_rib: None,
            unstored_invitations: BTreeSet::new(),
            events,
            counts: (0, 0),
        }
    }

    /// Makes this replica the leader, with this RIB.
    pub fn lead(&mut self, rib: Rib, term: Arc<Term>) {
        (self.rib, self.term, self.no_rib) = (Some(rib), Some(term), None);
    }

    /// Drops the RIB of a leader whose lease has expired. Returns whether it did.
    pub fn end_term(&mut self) -> bool {
        let is_over = self.term.take_if(|term| term.is_over()).is_some();
        if is_over {
            (self.rib, self.federation) = (None, None);
        }
        is_over
    }

    /// Answers a request of an entity. A query that finds nothing goes to other domains.
    pub fn request(
        &mut self,
        now: Now,
        domain: Option<&Domain>,
        origin: Name,
        (entity, by_tool): (Option<&NameProof>, bool),
        request: &EntityRequest,
    ) -> FollowUp {
        let Some(rib) = &mut self.rib else { return self.refuse_without_rib() };
        let response = rib.request(now, origin, entity, by_tool, request);
        match (request, &response) {
            (_, Response::Refused(_)) => FollowUp::Answer(response),
            (EntityRequest::Advertise { advert, .. } | EntityRequest::Subscribe { advert, .. }, _) => {
                match statement(advert).filter(|statement| !statement.is_settled(rib)) {
                    Some(statement) => FollowUp::Settle(response, statement),
                    None => FollowUp::Answer(response),
                }
            }
            (EntityRequest::Revoke { proof, .. }, Response::Done) => {
                if let Ok(name) = proof.name() {
                    self.reconsider(now, domain, name, None);
                }
                FollowUp::SaveRevocation(response)
            }
            (EntityRequest::Query { prefix, after: None }, Response::Records { records, .. }) if records.is_empty() => {
                match (prefix.full(), &mut self.federation) {
                    (Some(name), Some(federation)) => federation.query(now, name),
                    _ => FollowUp::Answer(response),
                }
            }
            _ => FollowUp::Answer(response),
        }
    }

    fn refuse_without_rib(&self) -> FollowUp {
        refuse(RefusalCode::Unreachable, format!("the RIB is not at switch {}", self.switch))
    }

    /// Accepts the report of a switch. `statement` proves to other domains that the switch is of
    /// this domain.
    pub fn report(
        &mut self,
        now: Now,
        domain: Option<&Domain>,
        switch: &NameProof,
        (attached, own_bit): (&[Name], Option<u8>),
        statement: Option<Host>,
    ) -> FollowUp {
        let Some(rib) = &mut self.rib else { return self.refuse_without_rib() };
        let response = rib.report(now, switch, attached, own_bit);
        if let (Some(statement), Some(domain)) = (statement, domain) {
            self.switch_stated(now, domain, switch, statement);
        }
        FollowUp::Answer(response)
    }

    /// Handles the loss of an entity's link to a switch.
    pub fn detach(&mut self, now: Now, switch: &Name, entity: &Name) -> FollowUp {
        match &mut self.rib {
            Some(rib) => FollowUp::Answer(rib.detach(now, switch, entity)),
            None => self.refuse_without_rib(),
        }
    }

    /// Returns what the RIB has to send now. Returns nothing without a RIB.
    pub fn effects(&mut self, now: Now) -> Vec<Effect> {
        let Some(rib) = &mut self.rib else { return Vec::new() };
        let (names, switches) = (rib.name_count(), rib.switch_count());
        if std::mem::replace(&mut self.counts, (names, switches)) != (names, switches) {
            self.events.tell(Event::Rib { names, switches });
        }
        rib.effects(now)
    }

    /// Records a switch's response to the FIB push of this generation. `None` means that no
    /// response came.
    pub fn pushed(&mut self, now: Now, switch: &Name, generation: u64, response: Option<Response>) {
        let outcome = match response {
            Some(Response::Refused(refusal)) if refusal.code == RefusalCode::Limit => Pushed::Partly(refusal.reason),
            Some(Response::Refused(refusal)) => {
                tracing::debug!(%refusal, "a switch refused a FIB push");
                Pushed::Failed
            }
            Some(_) => Pushed::Done,
            None => Pushed::Failed,
        };
        if let Some(rib) = &mut self.rib {
            rib.pushed(now, switch, generation, outcome);
        }
    }

    /// Runs the timers that are due. Returns the time of the next one, on the daemon's clock.
    pub fn tick(&mut self, now: Now) -> Option<Duration> {
        let rib = self.rib.as_mut()?;
        rib.tick(now);
        rib.next_tick().into_iter().chain(self.federation.as_ref().and_then(Federation::next_tick)).min()
    }

    /// Delays a positive answer until the changes of the local RIB are stored. The caller must hold
    /// the lock under which it handled the request.
    pub fn store_first(&mut self, next: FollowUp) -> FollowUp {
        let (Some(term), Some(rib)) = (&self.term, &mut self.rib) else { return next };
        if let FollowUp::SaveInvitation { new: Some(serial) } = &next {
            self.unstored_invitations.insert(*serial);
        }
        let is_positive = !matches!(next, FollowUp::Answer(Response::Refused(_) | Response::Records { .. }));
        let is_stored = !rib.has_changed() && self.unstored_invitations.is_empty() && !term.is_writing();
        // A switch that reports follows this RIB, so etcd must confirm that this RIB leads.
        let is_report = matches!(next, FollowUp::Answer(Response::Reported { .. }));
        if is_positive && (is_report || !is_stored) { FollowUp::Store(term.ticket(), Box::new(next)) } else { next }
    }

    /// Moves changed and unstored items to `changed`. Returns the last ticket that they cover, and
    /// how to store them. Returns `None` without a RIB or a leader term.
    pub fn unstored(
        &mut self,
        now: Now,
        domain: Option<&Domain>,
        changed: &mut BTreeSet<Item>,
    ) -> Option<(u64, Vec<ItemChange>)> {
        let (rib, term) = (self.rib.as_mut()?, self.term.as_ref()?);
        changed.append(&mut rib.take_changed());
        changed.extend(std::mem::take(&mut self.unstored_invitations).into_iter().map(Item::Invitation));
        term.set_writing(!changed.is_empty());
        let value = |item: &Item| match item {
            Item::Invitation(serial) => encode_item(domain?.invitations.get(*serial)?).ok(),
            item => rib.stored(now, item),
        };
        Some((term.last_ticket(), changed.iter().map(|item| (*item, value(item))).collect()))
    }
}

/// Returns the statement that an advertisement or a subscription makes.
fn statement(advert: &Signed<Advert>) -> Option<Statement> {
    let Advert { name, entity, op, switch, .. } = advert.claims_unverified().ok()?;
    Some(Statement { name, entity, role: NameRole::of(op)?, switch })
}

/// Returns the number of a RIB run, which is higher than that of any run with a lower `term`. The
/// random low bits tell runs apart if terms start over.
pub fn run_id(term: u64) -> u64 {
    let random = crypto::random::<8>().map_or_else(|_| unix_nanos(), u64::from_ne_bytes);
    term << RUN_BITS | random & ((1 << RUN_BITS) - 1)
}
