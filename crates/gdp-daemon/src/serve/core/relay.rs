//! Relays control requests hop by hop.
//!
//! Requests to the RIB go to its switch. Requests of the RIB go to the switch that they name. Each
//! takes the links between the domain's switches along the paths of the topology. A relaying switch
//! need not understand the request.

use gdp_link::link::Link;
use gdp_proto::control::{EntityRequest, MAX_HOPS, RefusalCode, Request, Response, TierLeg, TierMessage};
use gdp_wire::{LinkRole, Name};

use super::Core;
use super::follow_up::{FollowUp, refuse};
use super::rib_client::Report;

impl Core {
    /// Handles a request of a neighbouring switch.
    pub fn switch_request(&mut self, from: &Link, request: Request) -> FollowUp {
        match request {
            Request::Ready => {
                self.switch.link_ready(from);
                FollowUp::Answer(Response::Done)
            }
            Request::Onward { to, hops, request } => self.relay(from, to, hops, *request),
            Request::Tier(message) => self.tier_across(from, *message),
            Request::TraceOn(request) => self.trace_enters(from, request),
            _ => refuse(RefusalCode::Malformed, "what is for the RIB or from it is passed on with whom it is for"),
        }
    }

    /// Delivers a relayed request here, or forwards it to the next hop.
    fn relay(&mut self, from: &Link, to: Name, hops: u8, request: Request) -> FollowUp {
        let (own, peer) = (self.name(), from.peer().name);
        if self.switch.role_on(from) != Some(LinkRole::Switch as u32) {
            return refuse(RefusalCode::Unsupported, "nothing of this kind is asked across a border between domains");
        }
        if !self.topology.paths().reaches(&peer) {
            let reason = format!("switch {peer} is not on the map of switch {own} yet; try again in a moment");
            return refuse(RefusalCode::Unreachable, reason);
        }
        if to == own {
            return self.deliver(request);
        }
        let Some(hops) = hops.checked_sub(1) else {
            let reason = format!("no hop is left at switch {own} on the way to switch {to}: the paths lead in a loop");
            return refuse(RefusalCode::Unreachable, reason);
        };
        match self.link_toward(&to) {
            Ok(link) if link.peer().name == peer => {
                let reason =
                    format!("switch {own} gets to switch {to} by switch {peer}, which asks it: the paths change");
                refuse(RefusalCode::Unreachable, reason)
            }
            Ok(link) => FollowUp::Forward(link, Request::Onward { to, hops, request: Box::new(request) }),
            Err(refusal) => FollowUp::Answer(refusal.into()),
        }
    }

    /// Delivers a request that has arrived at its destination: one of the RIB, or one for the local
    /// RIB.
    fn deliver(&mut self, request: Request) -> FollowUp {
        let (own, now) = (self.name(), self.now());
        let origin = match &request {
            Request::Fib(push) if push.switch == own => return FollowUp::Answer(self.push(push)),
            Request::Peers(push) if push.switch == own => {
                let is_followed = self.rib_client.check_fence(now.clock, push.peers.run);
                return match (is_followed, self.switch.link_to(&push.entity)) {
                    (Err(refusal), _) => FollowUp::Answer(refusal.into()),
                    (Ok(()), Some(link)) => FollowUp::Forward(link, request),
                    (Ok(()), None) => refuse(RefusalCode::Unreachable, format!("{} has no link here", push.entity)),
                };
            }
            Request::Detach { switch, entity } if *switch == own => return self.reattach(*entity),
            Request::Relay { switch, .. } | Request::Detach { switch, .. } | Request::Admitted { switch, .. } => {
                *switch
            }
            Request::Report { switch, .. } => match switch.name() {
                Ok(origin) => origin,
                Err(_) => return refuse(RefusalCode::Malformed, "the key of the reporting switch is not valid"),
            },
            _ => return self.deliver_here(request),
        };
        if self.rib_host.rib.is_none() {
            return refuse(RefusalCode::Unreachable, format!("the RIB is not at switch {own}"));
        }
        if !self.topology.paths().reaches(&origin) {
            let reason = format!("switch {origin} is not on the map of the RIB yet; try again in a moment");
            return refuse(RefusalCode::Unreachable, reason);
        }
        self.for_rib(request)
    }

    /// Delivers requests that concern other domains, and answers to probes.
    fn deliver_here(&mut self, request: Request) -> FollowUp {
        let now = self.now();
        match request {
            Request::Tier(message) => match message.leg {
                TierLeg::Out { domain, peer } => match self.switch.border_link(&peer, domain) {
                    Some(link) => {
                        let message = TierMessage { leg: TierLeg::Across, ..*message };
                        FollowUp::Forward(link, Request::Tier(Box::new(message)))
                    }
                    None => {
                        let own = self.name();
                        let reason = format!("switch {own} has no link to switch {peer} of domain {domain} any more");
                        refuse(RefusalCode::Unreachable, reason)
                    }
                },
                TierLeg::In { from } => {
                    self.rib_host.tier_request(now, self.membership.domain.as_ref(), from, message.request)
                }
                TierLeg::Across => refuse(RefusalCode::Malformed, "a message that crosses a border is not passed on"),
            },
            Request::TraceOn(request) => self.trace_leaves(request),
            Request::Peerings { run, wanted } => {
                let accepted = self.rib_client.set_peerings(now.clock, run, wanted.into_iter().collect());
                FollowUp::Answer(accepted.map_or_else(Response::from, |()| Response::Done))
            }
            Request::Traced(answer) => {
                self.probes.answer(answer);
                FollowUp::Answer(Response::Done)
            }
            _ => refuse(RefusalCode::Malformed, "switches pass on what is for the RIB or from it, and this is not"),
        }
    }

    /// Restores state that the RIB lacks: this switch reports again, or the endpoint attaches
    /// again.
    fn reattach(&mut self, entity: Name) -> FollowUp {
        if entity == self.name() {
            self.rib_client.report = Report::Due;
            return FollowUp::Report;
        }
        let links = self.switch.links_of_endpoint(&entity);
        FollowUp::Reattach(links, Request::Detach { switch: self.name(), entity })
    }
}

/// Returns the entity's request inside a relayed request, if there is one.
pub fn relayed(request: &Request) -> Option<&EntityRequest> {
    match request {
        Request::Onward { request, .. } => match &**request {
            Request::Relay { request, .. } => Some(request),
            _ => None,
        },
        _ => None,
    }
}

/// Wraps a request to switch `to` for the first hop.
pub fn onward(to: Name, request: Request) -> Request {
    Request::Onward { to, hops: MAX_HOPS, request: Box::new(request) }
}
