//! The local RIB and other domains. Synchronises the RIB with [`gdp_rib::tiers`], and decides what
//! to send to other domains' RIBs and to this domain's borders.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use gdp_core::cert::Host;
use gdp_core::name::NameProof;
use gdp_core::revocations::SignedRevocation;
use gdp_proto::control::{RefusalCode, Response, TierRequest};
use gdp_rib::rib::{BorderLink, Now};
use gdp_rib::tiers::Sent;
use gdp_rib::topology::Topology;
use gdp_wire::Name;

use super::RibHost;
use crate::domain::Domain;
use crate::serve::core::follow_up::{FederationEffect, FollowUp, refuse};
use crate::serve::federation::{Federation, Known};

/// The delay before a border that did not accept its peerings gets them again.
const RESEND_PEERINGS: Duration = Duration::from_secs(2);

impl RibHost {
    /// Starts the exchange with other domains as a member of `domain`. Passes the known revocations
    /// of domains to the RIB.
    pub fn federate(&mut self, now: Now, domain: Option<&Domain>, run: u64) {
        if let (Some(rib), Some(domain)) = (&mut self.rib, domain) {
            let trust = &domain.trust;
            let known = trust.revocations().filter_map(|kept| trust.revocation(&kept.proof.name().ok()?));
            known.for_each(|claims| rib.domain_revoked(now, claims));
            self.federation = Some(Federation::new(domain.trust.home(), run));
        }
    }

    /// Updates the adjacent domains, the parents, and the borders that reach them, from the
    /// topology.
    pub fn follow_borders(&mut self, now: Now, topology: &Topology) {
        let (Some(rib), Some(federation)) = (&mut self.rib, &mut self.federation) else { return };
        let (mut ways, mut parents) = (BTreeMap::<Name, Vec<BorderLink>>::new(), BTreeSet::new());
        for (border, adjoining) in topology.borders() {
            let to_border = topology.paths().costs.get(&border).copied().unwrap_or(0);
            let cost = u32::try_from(to_border).unwrap_or(u32::MAX).saturating_add(adjoining.cost);
            ways.entry(adjoining.domain).or_default().push(BorderLink { border, peer: adjoining.switch, cost });
            parents.extend(adjoining.parent.map(|rank| (rank, border, adjoining.domain)));
        }
        federation.tiers.set_adjacent(now, ways.keys().copied().collect());
        let mut listed: Vec<Name> = Vec::new();
        for (_, _, domain) in parents {
            if !listed.contains(&domain) {
                listed.push(domain);
            }
        }
        // A parent without links remains one until it is forgotten, because the links may come
        // back.
        let before = federation.tiers.parents().iter().filter(|parent| !ways.contains_key(parent));
        let lost: Vec<Name> = before.filter(|parent| !listed.contains(parent)).copied().collect();
        listed.extend(lost);
        federation.tiers.set_parents(now, listed);
        rib.set_ways(now, ways);
    }

    /// Synchronises RIB and tiers, and returns what to send. `own` is this switch's statement of
    /// its domain.
    pub fn federation_effects(
        &mut self,
        now: Now,
        domain: Option<&Domain>,
        own: Option<Host>,
        topology: &Topology,
    ) -> Vec<FederationEffect> {
        let (Some(rib), Some(federation), Some(domain)) = (&mut self.rib, &mut self.federation, domain) else {
            return Vec::new();
        };
        federation.forget_hosts(now, rib);
        if let Some(own) = own
            && let Err(error) = federation.show(now, &domain.trust, self.switch, own)
        {
            tracing::debug!(%error, "this switch has no membership to show other domains");
        }
        federation.follow(now, rib);
        federation.inform(now, rib);
        let mut effects = federation.messages(now);
        federation.want_peerings(now, &domain.trust, |domain, peering| {
            let mut links = topology.borders().filter(|(_, adjoining)| adjoining.domain == domain);
            links.any(|(border, adjoining)| (border, adjoining.switch) != (peering.border, peering.peer))
        });
        federation.remind_borders(now.clock, |border, peer| {
            topology.borders().any(|(at, adjoining)| (at, adjoining.switch) == (border, peer))
        });
        let run = rib.run();
        let due = federation.wanted.iter_mut().filter_map(|(border, (wanted, due))| {
            due.take_if(|due| *due <= now.clock)?;
            Some(FederationEffect::Peerings { border: *border, run, wanted: wanted.clone() })
        });
        effects.extend(due);
        effects
    }

    /// Records a border's response to its peerings. Schedules a resend if the border refused or did
    /// not answer.
    pub fn peerings_answered(&mut self, now: Now, border: Name, response: Option<Response>) {
        let wanted = self.federation.as_mut().and_then(|federation| federation.wanted.get_mut(&border));
        if let (Some((_, due)), None | Some(Response::Refused(_))) = (wanted, response) {
            due.get_or_insert(now.clock + RESEND_PEERINGS);
        }
    }

    /// Handles a message of the RIB of another domain.
    pub fn tier_request(&mut self, now: Now, domain: Option<&Domain>, from: Name, request: TierRequest) -> FollowUp {
        let (Some(rib), Some(federation), Some(domain)) = (&self.rib, &mut self.federation, domain) else {
            return refuse(RefusalCode::Unreachable, format!("switch {} has no RIB of a domain", self.switch));
        };
        let known = Known { rib, trust: &domain.trust };
        let reply = federation.tiers.request(now, from, request, &known);
        let (revoked, next) = (federation.tiers.take_revoked(), federation.wait(reply, false));
        let mut is_news = false;
        for kept in revoked {
            is_news |= self.take_revoked(now, domain, from, &kept);
        }
        match next {
            FollowUp::Answer(response) if is_news => FollowUp::SaveRevocation(response),
            next => next,
        }
    }

    /// Accepts a revocation by the owner of a name that domain `from` passed on. Returns whether
    /// the RIB accepted it.
    fn take_revoked(&mut self, now: Now, domain: &Domain, from: Name, kept: &SignedRevocation) -> bool {
        let (Some(rib), Ok(name)) = (&mut self.rib, kept.proof.name()) else { return false };
        // Revocations by domains are flooded from switch to switch.
        if domain.trust.knows(&name) {
            return false;
        }
        if let Err(refusal) = rib.revoke_from(now, from, kept) {
            tracing::debug!(%refusal, domain = %format_args!("{from:#}"), "the RIB does not take what was revoked");
            return false;
        }
        self.reconsider(now, Some(domain), name, Some(from));
        true
    }

    /// Passes the outcome of a message to another domain's RIB on to the tiers.
    pub fn tier_answered(
        &mut self,
        now: Now,
        domain: Option<&Domain>,
        (to, sent): (Name, Sent),
        response: Option<Response>,
    ) {
        let (Some(rib), Some(federation), Some(domain)) = (&self.rib, &mut self.federation, domain) else { return };
        let response = match response {
            Some(Response::Tier(response)) => Some(*response),
            Some(Response::Refused(refusal)) => {
                tracing::debug!(%refusal, domain = %format_args!("{to:#}"), "a message to another domain did not arrive");
                None
            }
            _ => None,
        };
        federation.tiers.answered(now, to, sent, response, &Known { rib, trust: &domain.trust });
    }

    /// Registers a reporting switch's statement of its domain. Other domains may see it if the
    /// switch is of this domain.
    pub(super) fn switch_stated(&mut self, now: Now, domain: &Domain, proof: &NameProof, statement: Host) {
        let (Some(federation), Ok(switch)) = (&mut self.federation, proof.name()) else { return };
        // A restarted border has lost the peerings that it should have.
        if let Some((_, due)) = federation.wanted.get_mut(&switch) {
            *due = Some(now.clock);
        }
        if let Err(error) = federation.show(now, &domain.trust, switch, statement) {
            tracing::warn!(%switch, %error, "what a switch shows the RIB, for other domains, does not hold");
        }
    }

    /// Re-evaluates the state of RIB and tiers after a name's owner or a domain revoked something.
    /// `said_by` is the other domain that passed the revocation on, if one did.
    pub fn reconsider(&mut self, now: Now, domain: Option<&Domain>, about: Name, said_by: Option<Name>) {
        let (Some(rib), Some(domain)) = (&mut self.rib, domain) else { return };
        if let Some(claims) = domain.trust.revocation(&about) {
            rib.domain_revoked(now, claims);
        }
        if let Some(federation) = &mut self.federation {
            federation.tiers.reconsider(now, about, said_by, &Known { rib, trust: &domain.trust });
            let home = domain.trust.home();
            if about == home {
                federation.recheck_hosts(domain.trust.revocation(&home));
            }
        }
    }
}
