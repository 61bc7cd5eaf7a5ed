//! Sends what the local RIB produces, and passes the replies to it.

use gdp_link::link::Link;
use gdp_proto::control::{Request, Response, TierLeg, TierMessage, TierRequest};
use gdp_rib::rib::{Effect, Now, UpdateId};
use gdp_wire::Name;

use super::Core;
use super::follow_up::{FederationEffect, OnReply, PendingRequest};
use super::relay::onward;

impl Core {
    /// Drains the output of the local RIB. Applies what is for this switch at once, and returns the
    /// requests to others.
    pub fn rib_effects(&mut self) -> Vec<PendingRequest> {
        let mut pending = Vec::new();
        loop {
            let now = self.now();
            self.federation_effects(now, &mut pending);
            let effects = self.rib_host.effects(now);
            if effects.is_empty() {
                return pending;
            }
            effects.into_iter().for_each(|effect| self.carry_out(now, effect, &mut pending));
        }
    }

    fn carry_out(&mut self, now: Now, effect: Effect, pending: &mut Vec<PendingRequest>) {
        let own = self.name();
        let (target, request, on_reply) = match effect {
            Effect::Fib(push) if push.switch == own => {
                let response = self.push(&push);
                return self.rib_host.pushed(now, &own, push.generation, Some(response));
            }
            Effect::Fib(push) => {
                let on_reply = OnReply::Push(push.switch, push.generation);
                (push.switch, Request::Fib(push), on_reply)
            }
            Effect::Peers(push) => {
                let on_reply = OnReply::PeerUpdate(UpdateId::from(&push));
                if push.switch == own {
                    let is_followed = self.rib_client.check_fence(now.clock, push.peers.run).is_ok();
                    let link = self.switch.link_to(&push.entity).filter(|_| is_followed);
                    return pending.push(PendingRequest { link, request: Request::Peers(push), on_reply });
                }
                (push.switch, Request::Peers(push), on_reply)
            }
            Effect::Detach { switch, entity } if switch == own => {
                let links = self.switch.links_of_endpoint(&entity).into_iter();
                return pending.extend(links.map(|link| PendingRequest {
                    link: Some(link),
                    request: Request::Detach { switch, entity },
                    on_reply: OnReply::Reattach,
                }));
            }
            Effect::Detach { switch, entity } => {
                (switch, Request::Detach { switch, entity }, OnReply::Detach(switch, entity))
            }
        };
        let link = self.link_toward(&target).ok();
        pending.push(PendingRequest { link, request: onward(target, request), on_reply });
    }

    fn federation_effects(&mut self, now: Now, pending: &mut Vec<PendingRequest>) {
        if self.rib_host.federation.is_none() {
            return;
        }
        let own = self.membership.statement(&self.identity);
        let domain = self.membership.domain.as_ref();
        for effect in self.rib_host.federation_effects(now, domain, own, &self.topology) {
            match effect {
                FederationEffect::Message { to, sent, request } => {
                    let (link, request) = self.to_domain(to, request);
                    pending.push(PendingRequest { link, request, on_reply: OnReply::Tier(to, sent) });
                }
                FederationEffect::Peerings { border, run, wanted } if border == self.name() => {
                    if let Err(refusal) = self.rib_client.set_peerings(now.clock, run, wanted) {
                        tracing::warn!(%refusal, "this switch makes none of the peerings that the RIB here wants");
                    }
                }
                FederationEffect::Peerings { border, run, wanted } => {
                    let request = onward(border, Request::Peerings { run, wanted: wanted.into_iter().collect() });
                    let link = self.link_toward(&border).ok();
                    pending.push(PendingRequest { link, request, on_reply: OnReply::Peerings(border) });
                }
            }
        }
    }

    /// Returns a message to the RIB of another domain, and the link to its first hop over the
    /// cheapest border.
    fn to_domain(&self, to: Name, request: TierRequest) -> (Option<Link>, Request) {
        let costs = &self.topology.paths().costs;
        let ways = self.topology.borders().filter(|(_, adjoining)| adjoining.domain == to);
        let cheapest = ways.min_by_key(|(border, adjoining)| {
            (costs.get(border).copied().unwrap_or(0) + u64::from(adjoining.cost), *border, adjoining.switch)
        });
        let message = |leg| Request::Tier(Box::new(TierMessage { leg, request }));
        match cheapest {
            Some((border, adjoining)) if border == self.name() => {
                (self.switch.border_link(&adjoining.switch, to), message(TierLeg::Across))
            }
            Some((border, adjoining)) => {
                let leg = TierLeg::Out { domain: to, peer: adjoining.switch };
                (self.link_toward(&border).ok(), onward(border, message(leg)))
            }
            None => (None, message(TierLeg::Across)),
        }
    }

    /// Passes the reply to a request of the local RIB on to the RIB. `None` means that no reply
    /// came.
    pub fn answered(&mut self, on_reply: OnReply, response: Option<Response>) {
        let (now, rib_host) = (self.clock.now(), &mut self.rib_host);
        match on_reply {
            OnReply::Detach(..) | OnReply::Reattach => {}
            OnReply::Tier(to, sent) => {
                rib_host.tier_answered(now, self.membership.domain.as_ref(), (to, sent), response);
            }
            OnReply::Peerings(border) => rib_host.peerings_answered(now, border, response),
            OnReply::Push(switch, generation) => rib_host.pushed(now, &switch, generation, response),
            OnReply::PeerUpdate(update) => {
                if let Some(rib) = &mut rib_host.rib {
                    rib.update_answered(now, update, matches!(response, Some(Response::Done)));
                }
            }
        }
    }
}
