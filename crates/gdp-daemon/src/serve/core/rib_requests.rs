//! Requests to the RIB. The local RIB answers them; without one, this switch forwards them to the
//! RIB's switch.

use gdp_core::name::NameProof;
use gdp_link::link::Link;
use gdp_proto::control::{EntityRequest, Refusal, RefusalCode, Request, TierLeg, TierMessage};
use gdp_wire::Name;

use super::Core;
use super::follow_up::{FollowUp, refuse};
use super::relay::onward;
use super::rib_client::Report;
use crate::serve::events::Event;

impl Core {
    /// Handles a request of an entity, over its link or (`by_tool`) over the admin socket.
    pub fn entity_request(&mut self, entity: Option<NameProof>, by_tool: bool, request: EntityRequest) -> FollowUp {
        // A user of the admin socket operates this switch, and may list names.
        let lists = by_tool && matches!(request, EntityRequest::Query { .. });
        let entity = entity.or_else(|| lists.then(|| self.identity.proof()));
        self.for_rib(Request::Relay { switch: self.name(), entity, by_tool, request })
    }

    /// Reports to the RIB that an entity's link is gone.
    pub fn detach(&mut self, entity: Name) -> FollowUp {
        if self.switch.attached.remove(&entity) {
            self.events.tell(Event::Detached { entity });
        }
        self.for_rib(Request::Detach { switch: self.name(), entity })
    }

    /// Passes a message between RIBs from a border link to this domain's RIB.
    pub fn tier_across(&mut self, from: &Link, message: TierMessage) -> FollowUp {
        let (TierLeg::Across, Some(domain)) = (message.leg, self.switch.domain_of(from)) else {
            return refuse(RefusalCode::Malformed, "messages between RIBs come over a border, or are passed on");
        };
        let message = TierMessage { leg: TierLeg::In { from: domain }, ..message };
        self.for_rib(Request::Tier(Box::new(message)))
    }

    /// Passes a request of a switch to the local RIB, or forwards it to the RIB's switch.
    pub fn for_rib(&mut self, request: Request) -> FollowUp {
        if self.rib_host.rib.is_none() {
            return self.to_rib(request);
        }
        let (now, domain, rib_host) = (self.clock.now(), self.membership.domain.as_ref(), &mut self.rib_host);
        match request {
            Request::Admitted { entity, membership, .. } => {
                self.membership.admit_invited(entity, &membership, now.unix)
            }
            Request::Tier(message) => match message.leg {
                TierLeg::In { from } => rib_host.tier_request(now, domain, from, message.request),
                TierLeg::Out { .. } | TierLeg::Across => {
                    refuse(RefusalCode::Malformed, "not a message to the RIB here")
                }
            },
            Request::Relay { switch, entity, by_tool, request } => {
                rib_host.request(now, domain, switch, (entity.as_ref(), by_tool), &request)
            }
            Request::Report { switch, attached, own_bit, membership } => {
                rib_host.report(now, domain, &switch, (&attached, own_bit), membership.map(|membership| *membership))
            }
            Request::Detach { switch, entity } => rib_host.detach(now, &switch, &entity),
            _ => refuse(RefusalCode::Malformed, "not a request to a RIB"),
        }
    }

    fn to_rib(&self, request: Request) -> FollowUp {
        let way = self.rib_at().and_then(|rib| Ok((rib, self.link_toward(&rib)?)));
        match way {
            Ok((rib, link)) => FollowUp::Forward(link, onward(rib, request)),
            Err(refusal) => FollowUp::Answer(refusal.into()),
        }
    }

    /// Returns the RIB's switch, once the RIB has accepted this switch's report. Fails with the
    /// reason if there is none to ask.
    pub fn rib_at(&self) -> Result<Name, Refusal> {
        let own = self.name();
        let unreachable = |why: String| Refusal::new(RefusalCode::Unreachable, why);
        let Some((by, run)) = self.topology.rib() else {
            let stated = self.topology.states().find(|state| state.rib).map(|state| state.switch);
            let why = match (stated, &self.rib_host.no_rib) {
                (Some(rib), _) => format!("no path to switch {rib}, where it was"),
                (None, Some(why)) => why.clone(),
                (None, None) => "no switch that it knows says that the RIB is there".into(),
            };
            return Err(unreachable(format!("switch {own} has no way to the RIB: {why}")));
        };
        if self.rib_client.report != (Report::Accepted { by, run }) {
            let why =
                format!("switch {own} has no way to the RIB yet: the one at switch {by} has not taken its report");
            return Err(unreachable(why));
        }
        Ok(by)
    }
}
