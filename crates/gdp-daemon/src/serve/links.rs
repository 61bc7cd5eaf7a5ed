//! Runs one task per link. It handles the peer's requests, and reports the loss of an endpoint's
//! link to the RIB.

use std::sync::Arc;
use std::time::{Duration, Instant};

use gdp_core::peer::Role;
use gdp_link::link::{CloseCode, Link, LinkKeys, Responder};
use gdp_proto::control::{EntityRequest, Refusal, RefusalCode, Request, Response};

use super::core::relay::relayed;
use super::daemon::{Daemon, SerializedTask};
use super::detach::detach_lost;
use super::entity_requests::{self, Origin};
use super::events::Event;
use super::{costs, domain, flooding, inspection, liveness};
use crate::config::Via;

/// Time, beside three round trips, within which a program that still runs answers over its link.
const ANSWER: Duration = Duration::from_millis(200);

/// Takes a new link into service, or closes it with the reason if its peer may not have it. Waits
/// for the RIB and for another program with the same key, and only if [`must_ask`] returns true.
pub async fn take(daemon: &Arc<Daemon>, link: Link, via: Via) -> Result<(), String> {
    let refuse = |code, reason: String| {
        link.refuse(code, &reason);
        Err(reason)
    };
    let (peer, switch) = (link.peer().name, link.peer().role == Role::Switch);
    let admitted = daemon.core().admit(&link, &via);
    if let Err((code, reason)) = admitted {
        return refuse(code, reason);
    }
    if let Some(question) = question(daemon, &link)
        && let Err(refusal) = domain::ask_admitted(daemon, question).await
    {
        return refuse(CloseCode::NotAdmitted, refusal.reason);
    }
    if let Some(reason) = used_elsewhere(daemon, &link).await {
        return refuse(CloseCode::KeyInUse, reason);
    }
    // Check again, because a revocation may have arrived in the meantime.
    let admitted = daemon.core().admit(&link, &via);
    let admission = match admitted {
        Ok(admission) => admission,
        Err((code, reason)) => return refuse(code, reason),
    };
    if daemon.is_stopping() {
        return refuse(CloseCode::Ended, "shutting down".into());
    }
    let relationship = admission.relationship.as_str();
    let replaced = match daemon.core().link_up(&link, via.clone(), admission) {
        Ok(replaced) => replaced,
        Err(error) => {
            tracing::error!(%error, "the data plane did not take a link");
            return refuse(CloseCode::Full, "the data plane of the switch is full".into());
        }
    };
    if let Some(replaced) = replaced {
        tracing::warn!(
            peer = %format_args!("{peer:#}"),
            "replaced a live link of the same peer; if this goes on, two programs use the same key"
        );
        replaced.close("replaced by a newer link");
    }
    let (role, addr) = (if switch { "switch" } else { "endpoint" }, daemon.peer_address(&link));
    tracing::info!(peer = %format_args!("{peer:#}"), role, relationship, %via, addr, "link up");
    domain::tell_revocations(daemon, &link);
    daemon.spawn(keep_keys(daemon.clone(), link.clone()));
    if switch {
        daemon.topology_changed();
        daemon.report.notify_one();
        daemon.spawn(begin(daemon.clone(), link.clone()));
        daemon.spawn(serve_switch(daemon.clone(), link));
    } else {
        daemon.spawn(serve_endpoint(daemon.clone(), link));
    }
    Ok(())
}

/// Returns whether the RIB must confirm the peer before the link is accepted.
pub fn must_ask(daemon: &Daemon, link: &Link) -> bool {
    daemon.core().switch.link_of_another_run(link).is_some() || question(daemon, link).is_some()
}

/// Returns the reason of a refusal if another program with the peer's key answers over its own
/// link. A program that was killed does not answer, and its successor gets the link.
async fn used_elsewhere(daemon: &Daemon, link: &Link) -> Option<String> {
    let other = daemon.core().switch.link_of_another_run(link)?;
    // An endpoint refuses this request, which is an answer.
    let answer = tokio::time::timeout(ANSWER + 3 * other.rtt(), other.request(&Request::Ready)).await;
    if !matches!(answer, Ok(Ok(_))) {
        return None;
    }
    let (peer, at) = (link.peer().name, daemon.peer_address(&other));
    Some(format!(
        "another program uses the key of {peer:#}, at {at}; stop it, or make a key for each machine \
         (`gdp-ctl key generate`, or for a member `gdp-proxy leave` and `join`)"
    ))
}

fn question(daemon: &Daemon, link: &Link) -> Option<Request> {
    let papers = link.credentials()?;
    daemon.core().question(link, &papers)
}

/// Rotates the link's keys in the data planes until the link closes.
async fn keep_keys(daemon: Arc<Daemon>, link: Link) {
    let id = link.local_id();
    let put = |keys: &LinkKeys| daemon.core().switch.put_keys(id, keys);
    link.keep_keys(|| daemon.core().switch.planes.frames_sent(id), put).await;
}

/// Begins to use a link to a neighbour. It is probed once the neighbour has it, because echoes on
/// an unknown link would count there as drops.
async fn begin(daemon: Arc<Daemon>, link: Link) {
    say_ready(&daemon, &link).await;
    if liveness::is_probed(&link) {
        liveness::watch(daemon, link).await;
    }
}

/// Tells a neighbour to send on this link instead of an earlier one. The time to its answer is the
/// first round-trip sample of the link.
async fn say_ready(daemon: &Daemon, link: &Link) {
    let asked = Instant::now();
    match link.request(&Request::Ready).await {
        Ok(_) => {
            let changed = daemon.core().neighbour_answered(link, asked.elapsed());
            if changed {
                daemon.topology_changed();
            }
        }
        Err(error) => {
            tracing::debug!(peer = %format_args!("{:#}", link.peer().name), %error, "the neighbour did not hear that \
                                                  this switch is ready");
        }
    }
}

/// Answers an endpoint's requests in order, because its statements carry serial numbers.
async fn serve_endpoint(daemon: Arc<Daemon>, link: Link) {
    let peer = link.peer();
    // This waits until an older link of the same lane has been served completely.
    let (served, lane) = (serve_requests(&daemon, &link), SerializedTask::Lane(peer.name, peer.lane));
    daemon.in_turn(lane, served).await;
}

async fn serve_requests(daemon: &Arc<Daemon>, link: &Link) {
    let mut watches_costs = false;
    while let Some((request, responder)) = link.accept_request().await {
        let request = match domain::answer(daemon, link, request).await {
            Ok(response) => {
                answer(responder, response).await;
                continue;
            }
            Err(request) => request,
        };
        let response = match request {
            Request::Entity(request) => entity_request(daemon, link, request).await,
            Request::Ready => {
                daemon.core().switch.prefer(link);
                Response::Done
            }
            Request::Inspect(inspection) => inspection::answer(daemon, link, inspection).await,
            Request::WatchCosts => costs::watch(daemon, link, &mut watches_costs),
            _ => Refusal::new(RefusalCode::Malformed, "an endpoint may not send what switches tell each other").into(),
        };
        answer(responder, response).await;
    }
    end(daemon, link);
    detach_lost(daemon.clone(), link.peer().name).await;
}

/// Answers an entity's request. Attachments take turns, so that the end of one link does not detach
/// an entity that attaches over another.
async fn entity_request(daemon: &Arc<Daemon>, link: &Link, request: EntityRequest) -> Response {
    let EntityRequest::Attach { lane, .. } = &request else {
        return entity_requests::answer(daemon, Origin::Link(link), request).await;
    };
    if *lane != link.peer().lane {
        let reason = format!("this link is number {} of its entity, not {lane}", link.peer().lane);
        return Refusal::new(RefusalCode::Malformed, reason).into();
    }
    let attach = entity_requests::answer(daemon, Origin::Link(link), request);
    daemon.in_turn(SerializedTask::Entity(link.peer().name), attach).await
}

/// Answers a switch's requests concurrently, because a switch relays for many. The number of QUIC
/// streams bounds them.
async fn serve_switch(daemon: Arc<Daemon>, link: Link) {
    while let Some((request, responder)) = link.accept_request().await {
        let (daemon, link) = (daemon.clone(), link.clone());
        daemon.clone().spawn(async move {
            let response = switch_request(&daemon, &link, request).await;
            answer(responder, response).await;
        });
    }
    end(&daemon, &link);
    daemon.topology_changed();
}

async fn switch_request(daemon: &Arc<Daemon>, link: &Link, request: Request) -> Response {
    let request = match domain::answer(daemon, link, request).await {
        Ok(response) => return response,
        Err(request) => request,
    };
    if let Request::Flood { states } = request {
        return flooding::take(daemon, link, states);
    }
    let revocation = relayed(&request).and_then(|request| domain::domain_revocation(daemon, request));
    if let Some((proof, revocation)) = revocation {
        return domain::take_revocation(daemon, proof, revocation, Some(link)).await;
    }
    daemon.answer(|core| core.switch_request(link, request)).await
}

fn end(daemon: &Arc<Daemon>, link: &Link) {
    let reason = link.close_reason().unwrap_or_else(|| "closed".into());
    let name = link.peer().name;
    tracing::info!(peer = %format_args!("{name:#}"), reason, "link down");
    let is_held = {
        let mut core = daemon.core();
        let is_held = core.link_down(link);
        if link.peer().role == Role::Switch && core.switch.link_to(&name).is_none() {
            core.switch.refusals.add(name, format!("the link ended: {reason}"), Instant::now());
        }
        core.events.tell(Event::LinkDown { peer: name, reason });
        is_held
    };
    if is_held {
        tracing::info!(peer = %format_args!("{name:#}"), "its link is held while its data plane answers echoes");
    }
    if is_held && !liveness::is_probed(link) {
        daemon.spawn(liveness::watch(daemon.clone(), link.clone()));
    }
}

async fn answer(responder: Responder, response: Response) {
    if let Err(error) = responder.respond(response).await {
        tracing::debug!(%error, "an answer could not be sent");
    }
}
