//! This daemon's part in the tiers: beside the RIB, it keeps the RIB and [`gdp_rib::tiers`]
//! informed of each other; on a border switch, it passes messages between RIBs on, and attests
//! whose they are. The rules are in [`gdp_rib::tiers`].

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use gdp_core::cert::domain::roles;
use gdp_core::cert::{Host, MAX_ADDRESSES, SwitchStatement, issue};
use gdp_core::domain::Relationship;
use gdp_core::name::NameProof;
use gdp_core::revocations::Kept;
use gdp_link::link::Link;
use gdp_proto::control::{
    EntityRequest, Refusal, RefusalCode, Request, Response, TierEntry, TierLeg, TierMessage, TierRequest, TierResponse,
};
use gdp_wire::Name;

use super::control::onward;
use super::core::{Core, Expects, Next, Outgoing, ask, refuse};
use super::federation::{Federation, Known};
use super::peering::Wanted;
use gdp_rib::rib::BorderLink;
use gdp_rib::tiers::{Effect, Sent};
use gdp_util::unix_time::{unix_nanos, unix_seconds};

/// After so long a border is told again which peerings are wanted of it.
const PEERINGS_AGAIN: Duration = Duration::from_secs(2);

/// How long another domain's RIB is waited for.
pub const TIMEOUT: Duration = Duration::from_secs(10);

impl Core {
    /// The RIB here tells other domains, and hears of them, as a member of its own; it knows what
    /// they have taken back.
    pub fn federate(&mut self, run: u64) {
        let now = self.now();
        if let (Some(rib), Some(domain)) = (&mut self.rib, &self.domain) {
            let trust = &domain.trust;
            let known = trust.revocations().filter_map(|kept| trust.revocation(&kept.proof.name().ok()?));
            known.for_each(|claims| rib.domain_revoked(now, claims));
            self.federation = Some(Federation::new(domain.trust.home(), run));
        }
    }

    /// Which domains are parents and which have a link with this one, and by which borders they are
    /// reached.
    pub(super) fn follow_borders(&mut self) {
        let now = self.now();
        let (Some(rib), Some(federation)) = (&mut self.rib, &mut self.federation) else { return };
        let (mut ways, mut parents) = (BTreeMap::<Name, Vec<BorderLink>>::new(), BTreeSet::new());
        for (border, adjoining) in self.topology.borders() {
            let to_border = self.topology.paths().costs.get(&border).copied().unwrap_or(0);
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
        // A parent whose links are gone stays one until it is forgotten: the links may come back.
        let before = federation.tiers.parents().iter().filter(|parent| !ways.contains_key(parent));
        let gone: Vec<Name> = before.filter(|parent| !listed.contains(parent)).copied().collect();
        listed.extend(gone);
        federation.tiers.set_parents(now, listed);
        rib.set_ways(now, ways);
    }

    /// Brings RIB and tiers in line with each other. Returns what is to be sent to other domains.
    pub(super) fn federation_effects(&mut self) -> Vec<Outgoing> {
        let (now, own, shown) = (self.now(), self.name(), self.shown());
        let (Some(rib), Some(federation), Some(domain)) = (&mut self.rib, &mut self.federation, &self.domain) else {
            return Vec::new();
        };
        federation.forget_hosts(now, rib);
        if let Some(shown) = shown
            && let Err(error) = federation.show(now, &domain.trust, own, shown)
        {
            tracing::debug!(%error, "this switch has no membership to show other domains");
        }
        federation.follow(now, rib);
        federation.inform(now, rib);
        let mut outgoing = Vec::new();
        for effect in federation.tiers.effects(now) {
            match effect {
                Effect::Answer { ticket, response } => {
                    if let Some(answer) = federation.waiting.remove(&ticket) {
                        // Whoever asked may be gone.
                        let _ = answer.send(response);
                    }
                }
                Effect::Ask { to, sent, request } => outgoing.push((to, sent, request)),
            }
        }
        let topology = &self.topology;
        federation.want_peerings(now, &domain.trust, |domain, peering| {
            let mut links = topology.borders().filter(|(_, adjoining)| adjoining.domain == domain);
            links.any(|(border, adjoining)| (border, adjoining.switch) != (peering.border, peering.peer))
        });
        federation.remind_borders(now.clock, |border, peer| {
            topology.borders().any(|(at, adjoining)| (at, adjoining.switch) == (border, peer))
        });
        let run = rib.run();
        let due = federation.wanted.iter_mut().filter_map(|(border, (wanted, due))| {
            due.take_if(|due| *due <= now.clock).map(|_| (*border, wanted.clone()))
        });
        let due: Vec<(Name, Wanted)> = due.collect();
        let mut outgoing: Vec<Outgoing> =
            outgoing.into_iter().map(|(to, sent, request)| self.to_domain(to, sent, request)).collect();
        for (border, wanted) in due {
            if border == own {
                if let Err(refusal) = self.set_peerings(run, wanted) {
                    tracing::warn!(%refusal, "this switch makes none of the peerings that the RIB here wants");
                }
                continue;
            }
            let request = onward(border, Request::Peerings { run, wanted: wanted.into_iter().collect() });
            let (link, expects) = (self.link_toward(&border).ok(), Expects::Peerings(border));
            outgoing.push(Outgoing { link, request, expects });
        }
        outgoing
    }

    /// What the RIB may show other domains of this switch; none: it is a member of no domain. It
    /// states anew of which domain it is whenever its membership is renewed, and so before the
    /// statement ends.
    pub(super) fn shown(&mut self) -> Option<Host> {
        let domain = self.domain.as_ref()?;
        let membership = &domain.trust.papers().membership;
        if self.shown.as_ref().is_none_or(|shown| shown.membership != *membership) {
            let own = domain.trust.own(unix_seconds()).ok()?;
            let addresses = if own.role == roles::BORDER { self.public.clone() } else { Vec::new() };
            let (switch, serial) = (self.identity.name(), unix_nanos());
            let claims = SwitchStatement { switch, domain: own.domain, addresses, serial, not_after: own.not_after };
            let statement = issue(self.identity.key(), &claims).ok()?;
            self.shown = Some(Host { proof: self.identity.proof(), statement, membership: membership.clone() });
        }
        self.shown.clone()
    }

    /// The RIB of this run wants this switch to have these links into other domains.
    pub(super) fn set_peerings(&mut self, run: u64, mut wanted: Wanted) -> Result<(), Refusal> {
        self.check_fence(run)?;
        wanted.values_mut().for_each(|addrs| addrs.truncate(MAX_ADDRESSES));
        self.peerings.send_if_modified(|held| {
            let changed = *held != wanted;
            *held = wanted;
            changed
        });
        Ok(())
    }

    /// Whether a border has heard which peerings are wanted of it; if not, it is told again.
    pub(super) fn peerings_answered(&mut self, border: Name, response: Option<Response>) {
        let again = self.now().clock + PEERINGS_AGAIN;
        let wanted = self.federation.as_mut().and_then(|federation| federation.wanted.get_mut(&border));
        if let (Some((_, due)), None | Some(Response::Refused(_))) = (wanted, response) {
            due.get_or_insert(again);
        }
    }

    fn to_domain(&self, to: Name, sent: Sent, request: TierRequest) -> Outgoing {
        let costs = &self.topology.paths().costs;
        let ways = self.topology.borders().filter(|(_, adjoining)| adjoining.domain == to);
        let cheapest = ways.min_by_key(|(border, adjoining)| {
            (costs.get(border).copied().unwrap_or(0) + u64::from(adjoining.cost), *border, adjoining.switch)
        });
        let message = |leg| Request::Tier(Box::new(TierMessage { leg, request }));
        let (link, request) = match cheapest {
            Some((border, adjoining)) if border == self.name() => {
                (self.border_link(&adjoining.switch, to), message(TierLeg::Across))
            }
            Some((border, adjoining)) => {
                let leg = TierLeg::Out { domain: to, peer: adjoining.switch };
                (self.link_toward(&border).ok(), onward(border, message(leg)))
            }
            None => (None, message(TierLeg::Across)),
        };
        Outgoing { link, request, expects: Expects::Tier(to, sent) }
    }

    /// The link to a border switch of another domain, while it is one.
    pub(super) fn border_link(&self, peer: &Name, domain: Name) -> Option<Link> {
        let link = self.link_to(peer)?;
        (self.domain_of(&link) == Some(domain)).then_some(link)
    }

    /// The domain whose border is at the other end of a link.
    pub(super) fn domain_of(&self, link: &Link) -> Option<Name> {
        match self.links.get(&link.local_id())?.admission.standing {
            Relationship::Border { domain, .. } => Some(domain),
            _ => None,
        }
    }

    /// A message between RIBs came over a link into another domain.
    pub(super) fn tier_across(&mut self, from: &Link, message: TierMessage) -> Next {
        let (TierLeg::Across, Some(domain)) = (message.leg, self.domain_of(from)) else {
            return refuse(RefusalCode::Malformed, "messages between RIBs come over a border, or are passed on");
        };
        let message = TierMessage { leg: TierLeg::In { from: domain }, ..message };
        self.for_rib(Request::Tier(Box::new(message)))
    }

    /// A message between RIBs that has come to the switch it was for: a border that is to send it
    /// across, or the RIB's.
    pub(super) fn tier_arrived(&mut self, message: TierMessage) -> Next {
        match message.leg {
            TierLeg::Out { domain, peer } => match self.border_link(&peer, domain) {
                Some(link) => {
                    let message = TierMessage { leg: TierLeg::Across, ..message };
                    Next::Forward(link, Request::Tier(Box::new(message)))
                }
                None => {
                    let own = self.name();
                    let reason = format!("switch {own} has no link to switch {peer} of domain {domain} any more");
                    refuse(RefusalCode::Unreachable, reason)
                }
            },
            TierLeg::In { from } => self.tier_request(from, message.request),
            TierLeg::Across => refuse(RefusalCode::Malformed, "a message that crosses a border is not passed on"),
        }
    }

    fn tier_request(&mut self, from: Name, request: TierRequest) -> Next {
        let now = self.now();
        let (Some(rib), Some(federation), Some(domain)) = (&self.rib, &mut self.federation, &self.domain) else {
            return refuse(RefusalCode::Unreachable, format!("switch {} has no RIB of a domain", self.name()));
        };
        let known = Known { rib, trust: &domain.trust };
        let reply = federation.tiers.request(now, from, request, &known);
        let (heard, next) = (federation.tiers.take_revoked(), federation.wait(reply, false));
        let mut is_news = false;
        for kept in heard {
            is_news |= self.take_revoked(from, &kept);
        }
        match next {
            Next::Answer(response) if is_news => Next::Keep(response),
            next => next,
        }
    }

    /// Takes in what the owner of a name has taken back, as the domain `from` said. Whether it did.
    fn take_revoked(&mut self, from: Name, kept: &Kept) -> bool {
        let now = self.now();
        let (Some(rib), Some(domain), Ok(name)) = (&mut self.rib, &self.domain, kept.proof.name()) else {
            return false;
        };
        // What domains take back goes from switch to switch.
        if domain.trust.knows(&name) {
            return false;
        }
        if let Err(refusal) = rib.revoke_abroad(now, from, kept) {
            tracing::debug!(%refusal, domain = %format_args!("{from:#}"), "the RIB does not take what was revoked");
            return false;
        }
        self.reconsider(name, Some(from));
        true
    }

    /// What became of a message to another domain's RIB.
    pub(super) fn tier_answered(&mut self, to: Name, sent: Sent, response: Option<Response>) {
        let now = self.now();
        let (Some(rib), Some(federation), Some(domain)) = (&self.rib, &mut self.federation, &self.domain) else {
            return;
        };
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

    /// A switch has reported, and shows of which domain it is: if it is of this one, other domains
    /// may see it.
    pub(super) fn host_shown(&mut self, proof: &NameProof, shown: Host) {
        let now = self.now();
        let (Some(federation), Some(domain), Ok(switch)) = (&mut self.federation, &self.domain, proof.name()) else {
            return;
        };
        // A border that has begun anew has forgotten what is wanted of it.
        if let Some((_, due)) = federation.wanted.get_mut(&switch) {
            *due = Some(now.clock);
        }
        if let Err(error) = federation.show(now, &domain.trust, switch, shown) {
            tracing::warn!(%switch, %error, "what a switch shows the RIB, for other domains, does not hold");
        }
    }

    /// An owner of a name, or a domain, has taken something back. `said_by`: the domain that told,
    /// if another one did.
    pub(super) fn reconsider(&mut self, about: Name, said_by: Option<Name>) {
        let now = self.now();
        if let (Some(rib), Some(domain)) = (&mut self.rib, &self.domain)
            && let Some(claims) = domain.trust.revocation(&about)
        {
            rib.domain_revoked(now, claims);
        }
        if let (Some(rib), Some(federation), Some(domain)) = (&self.rib, &mut self.federation, &self.domain) {
            federation.tiers.reconsider(now, about, said_by, &Known { rib, trust: &domain.trust });
            let home = domain.trust.home();
            if about == home {
                federation.recheck_hosts(domain.trust.revocation(&home));
            }
        }
    }

    /// Puts to the RIB here what an entity asks. A query that misses climbs.
    pub(super) fn ask_rib(
        &mut self,
        switch: Name,
        entity: Option<&NameProof>,
        by_tool: bool,
        request: &EntityRequest,
    ) -> Next {
        let now = self.now();
        let Some(rib) = &mut self.rib else {
            return refuse(RefusalCode::Unreachable, format!("the RIB is not at switch {}", self.name()));
        };
        let next = ask(rib, now, switch, entity, by_tool, request);
        match (request, &next) {
            (EntityRequest::Query { prefix, after: None }, Next::Answer(Response::Records { records, .. }))
                if records.is_empty() =>
            {
                let (Some(name), Some(federation)) = (prefix.full(), &mut self.federation) else { return next };
                let reply = federation.tiers.query(now, name);
                federation.wait(reply, true)
            }
            (EntityRequest::Revoke { proof, .. }, Next::Keep(_)) => {
                if let Ok(name) = proof.name() {
                    self.reconsider(name, None);
                }
                next
            }
            _ => next,
        }
    }
}

/// What other domains answered to a query, as an entity is told it.
pub(super) fn records(response: TierResponse) -> Response {
    match response {
        TierResponse::Answer { entries, truncated } => {
            let records = entries.into_iter().filter_map(|entry| match entry {
                TierEntry::Part(abroad) => Some(abroad.record),
                _ => None,
            });
            Response::Records { records: records.collect(), truncated }
        }
        TierResponse::Refused(refusal) => refusal.into(),
        _ => Response::Records { records: Vec::new(), truncated: false },
    }
}
