//! The single entry point for requests of entities, over their links or the admin socket.

use std::sync::Arc;
use std::time::Instant;

use gdp_core::name::NameProof;
use gdp_link::link::Link;
use gdp_proto::admin::words::RefusedThing;
use gdp_proto::control::{EntityRequest, Refusal, RefusalCode, Response};

use super::core::follow_up::FollowUp;
use super::daemon::Daemon;
use super::events::Event;
use super::{domain, recent_refusals};

/// The path by which a request arrived.
#[derive(Clone, Copy)]
pub enum Origin<'a> {
    /// The link of the entity.
    Link(&'a Link),
    /// A program at the admin socket, for this entity if there is one.
    Tool(Option<NameProof>),
}

/// Answers a request of an entity.
pub async fn answer(daemon: &Arc<Daemon>, origin: Origin<'_>, request: EntityRequest) -> Response {
    let (link, entity) = match origin {
        Origin::Link(link) => (Some(link), Some(link.peer().proof)),
        Origin::Tool(entity) => (None, entity),
    };
    if let Some((proof, revocation)) = domain::domain_revocation(daemon, &request) {
        return domain::take_revocation(daemon, proof, revocation, link).await;
    }
    let registers = !matches!(request, EntityRequest::Query { .. } | EntityRequest::Revoke { .. });
    let attaching = link.filter(|_| matches!(request, EntityRequest::Attach { .. }));
    let taken_in = daemon.answer(|core| {
        let next = core.entity_request(entity, link.is_none(), request);
        if let Some(link) = attaching
            && !matches!(next, FollowUp::Answer(Response::Refused(_)))
        {
            // Add it before the answer, so that a concurrent report includes it.
            core.switch.attached.insert(link.peer().name);
        }
        next
    });
    let response = taken_in.await;
    if let (Some(link), Response::Refused(refusal), true) = (link, &response, registers) {
        refused(daemon, link, refusal);
    }
    if let (Some(link), Response::Attached { .. }) = (attaching, &response) {
        let mut core = daemon.core();
        core.switch.link_ready(link);
        core.events.tell(Event::Attached { entity: link.peer().name });
    }
    response
}

/// Counts a refusal. Tells it to listeners and the log, unless it is for want of the RIB.
fn refused(daemon: &Daemon, link: &Link, refusal: &Refusal) {
    let (entity, code, reason, now) = (link.peer().name, refusal.code, &refusal.reason, Instant::now());
    let is_lasting = !matches!(code, RefusalCode::Unreachable | RefusalCode::NotAttached);
    let line = {
        let core = &mut *daemon.core();
        let is_new = core.switch.recent_refusals.add(entity, RefusedThing::Registration, Some(code), reason, now);
        if !is_new || !is_lasting {
            return;
        }
        let reason = recent_refusals::shortened(reason).to_owned();
        core.events.tell(Event::RegistrationRefused { entity, code, reason });
        core.switch.recent_refusals.line(RefusedThing::Registration, now)
    };
    if let Some(suppressed) = line {
        tracing::warn!(entity = %format_args!("{entity:#}"), ?code, %reason, suppressed, "refused a registration");
    }
}
