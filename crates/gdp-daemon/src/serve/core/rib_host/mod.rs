//! The RIB, if it is at this switch: answers requests, and stores what they change if it is the
//! leader of several replicas.

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

/// Those of a run's number that are random. The others have the revisions of etcd for a lifetime,
/// and the time in units of 17 ms.
const RUN_BITS: u32 = 24;

/// The RIB of the domain, if it is here.
pub struct RibHost {
    switch: Name,
    pub rib: Option<Rib>,
    /// If this is a member of a domain.
    pub federation: Option<Federation>,
    /// The RIB's term, if it is the leader of several replicas.
    term: Option<Arc<Term>>,
    /// Why a replica has no RIB, as far as it knows.
    pub no_rib: Option<String>,
    /// Invitations that have admitted somebody, which is not stored yet.
    unstored_invitations: BTreeSet<u64>,
    events: Events,
    /// The counts of names and switches in the last event.
    counts: (usize, usize),
}

impl RibHost {
    /// `has_rib`: the RIB is here, without replicas.
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

    /// This replica leads with this RIB from now on.
    pub fn lead(&mut self, rib: Rib, term: Arc<Term>) {
        (self.rib, self.term, self.no_rib) = (Some(rib), Some(term), None);
    }

    /// A leader whose lease is over has no RIB. Whether that is so from now on.
    pub fn end_term(&mut self) -> bool {
        let is_over = self.term.take_if(|term| term.is_over()).is_some();
        if is_over {
            (self.rib, self.federation) = (None, None);
        }
        is_over
    }

    /// Answers what an entity asks. A query that misses climbs.
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

    /// Takes the report of a switch. `statement`: that it is of this domain, for other domains.
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

    /// An entity's link to a switch is gone.
    pub fn detach(&mut self, now: Now, switch: &Name, entity: &Name) -> FollowUp {
        match &mut self.rib {
            Some(rib) => FollowUp::Answer(rib.detach(now, switch, entity)),
            None => self.refuse_without_rib(),
        }
    }

    /// What the RIB has to send now; nothing without one.
    pub fn effects(&mut self, now: Now) -> Vec<Effect> {
        let Some(rib) = &mut self.rib else { return Vec::new() };
        let (names, switches) = (rib.name_count(), rib.switch_count());
        if std::mem::replace(&mut self.counts, (names, switches)) != (names, switches) {
            self.events.tell(Event::Rib { names, switches });
        }
        rib.effects(now)
    }

    /// What a switch answered to the push of this generation; none: nothing.
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

    /// Does what is due by now. Returns when there is something to do next.
    pub fn tick(&mut self, now: Now) -> Option<Duration> {
        let rib = self.rib.as_mut()?;
        rib.tick(now);
        rib.next_tick().into_iter().chain(self.federation.as_ref().and_then(Federation::next_tick)).min()
    }

    /// What follows from a request: if the RIB here has changed with it, that is to be stored
    /// before the request is answered. To be called under the lock under which the request was
    /// taken in.
    pub fn store_first(&mut self, next: FollowUp) -> FollowUp {
        let (Some(term), Some(rib)) = (&self.term, &mut self.rib) else { return next };
        if let FollowUp::SaveInvitation { new: Some(serial) } = &next {
            self.unstored_invitations.insert(*serial);
        }
        let is_positive = !matches!(next, FollowUp::Answer(Response::Refused(_) | Response::Records { .. }));
        let is_stored = !rib.has_changed() && self.unstored_invitations.is_empty() && !term.is_writing();
        // A switch that reports follows this RIB: etcd is to say that it leads.
        let is_report = matches!(next, FollowUp::Answer(Response::Reported { .. }));
        if is_positive && (is_report || !is_stored) { FollowUp::Store(term.ticket(), Box::new(next)) } else { next }
    }

    /// Moves what has changed and is not stored to `changed`, and says how it is to be stored, and
    /// for which tickets. None without a RIB.
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

/// What an entity states by an advertisement or a subscription.
fn statement(advert: &Signed<Advert>) -> Option<Statement> {
    let Advert { name, entity, op, switch, .. } = advert.claims_unverified().ok()?;
    Some(Statement { name, entity, role: NameRole::of(op)?, switch })
}

/// The number of a run of a RIB: higher than that of one with a lower `term`; and another one,
/// should terms be counted anew.
pub fn run_id(term: u64) -> u64 {
    let random = crypto::random::<8>().map_or_else(|_| unix_nanos(), u64::from_ne_bytes);
    term << RUN_BITS | random & ((1 << RUN_BITS) - 1)
}
