//! One task to a link: takes the peer's requests in, and tells the RIB when an endpoint's link is
//! gone.

use std::sync::Arc;
use std::time::{Duration, Instant};

use futures::future::join_all;
use gdp_core::peer::Role;
use gdp_link::link::{Link, LinkKeys, Responder};
use gdp_proto::control::{EntityRequest, Refusal, RefusalCode, Request, Response};
use gdp_wire::Name;
use tokio::time::timeout;

use super::control::Report;
use super::core::{Expects, Next, Statement};
use super::events::Event;
use super::{Daemon, SerializedTask, control, costs, domain, flooding, liveness, tiers};
use crate::config::Via;

/// How long an accepted statement waits for switches to take their routes.
const SETTLE: Duration = Duration::from_secs(1);

/// Takes a new link into service, or closes it and says why if its peer may not have one here.
/// Waits only for the RIB, and only if [`must_ask`] says so.
pub async fn take(daemon: &Arc<Daemon>, link: Link, via: Via) -> Result<(), String> {
    let refuse = |reason: String| {
        link.close(&reason);
        Err(reason)
    };
    let (peer, switch) = (link.peer().name, link.peer().role == Role::Switch);
    let admitted = daemon.core().admit(&link, &via);
    if let Err(reason) = admitted {
        return refuse(reason);
    }
    if let Some(question) = question(daemon, &link)
        && let Err(refusal) = daemon.ask_admitted(question).await
    {
        return refuse(refusal.reason);
    }
    // Something may have been revoked meanwhile.
    let admitted = daemon.core().admit(&link, &via);
    let admission = match admitted {
        Ok(admission) => admission,
        Err(reason) => return refuse(reason),
    };
    if daemon.is_stopping() {
        return refuse("shutting down".into());
    }
    let standing = admission.standing.as_str();
    let replaced = match daemon.core().link_up(&link, via.clone(), admission) {
        Ok(replaced) => replaced,
        Err(error) => {
            tracing::error!(%error, "the data plane did not take a link");
            return refuse("the data plane of the switch is full".into());
        }
    };
    if let Some(replaced) = replaced {
        tracing::warn!(
            peer = %format_args!("{peer:#}"),
            "replaced a live link of the same peer; if this goes on, two programs use the same key"
        );
        replaced.close("replaced by a newer link");
    }
    let role = if switch { "switch" } else { "endpoint" };
    tracing::info!(peer = %format_args!("{peer:#}"), role, standing, %via, addr = %link.addr(), "link up");
    daemon.tell_revocations(&link);
    daemon.spawn(keep_keys(daemon.clone(), link.clone()));
    if switch {
        daemon.topology_changed();
        daemon.report.notify_one();
        daemon.spawn(say_ready(daemon.clone(), link.clone()));
        daemon.spawn(serve_switch(daemon.clone(), link));
    } else {
        daemon.spawn(serve_endpoint(daemon.clone(), link));
    }
    Ok(())
}

/// Whether the RIB is asked before the link is taken.
pub fn must_ask(daemon: &Daemon, link: &Link) -> bool {
    question(daemon, link).is_some()
}

fn question(daemon: &Daemon, link: &Link) -> Option<Request> {
    let papers = link.papers()?;
    daemon.core().question(link, &papers)
}

/// Replaces the link's keys in the data planes now and then, as long as it lives.
async fn keep_keys(daemon: Arc<Daemon>, link: Link) {
    let id = link.local_id();
    let put = |keys: &LinkKeys| daemon.core().put_keys(id, keys);
    link.keep_keys(|| daemon.core().planes.frames_sent(id), put).await;
}

/// The neighbour goes on sending on an earlier link until it hears this. How soon it answers is the
/// first that is known of the link.
async fn say_ready(daemon: Arc<Daemon>, link: Link) {
    let asked = Instant::now();
    match link.request(&Request::Ready).await {
        Ok(_) => {
            let changed = daemon.core().neighbour_answered(&link, asked.elapsed());
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

/// An endpoint's requests are answered one after the other: its statements carry serials.
async fn serve_endpoint(daemon: Arc<Daemon>, link: Link) {
    // Waits until an older link of the same lane is dealt with.
    let (entity, place) = (link.peer().name, SerializedTask::Lane(link.peer().name, link.peer().lane));
    let turns = daemon.turns(place);
    let turn = turns.lock().await;
    let mut watches_costs = false;
    while let Some((request, responder)) = link.accept_request().await {
        let request = match domain::answer(&daemon, &link, request).await {
            Ok(response) => {
                answer(responder, response).await;
                continue;
            }
            Err(request) => request,
        };
        let response = match request {
            Request::Entity(request) => entity_request(&daemon, &link, request).await,
            Request::Ready => {
                daemon.core().prefer(&link);
                Response::Done
            }
            Request::WatchCosts => costs::watch(&daemon, &link, &mut watches_costs),
            _ => Refusal::new(RefusalCode::Malformed, "an endpoint may not send what switches tell each other").into(),
        };
        answer(responder, response).await;
    }
    end(&daemon, &link);
    detach_lost(daemon.clone(), entity).await;
    drop(turn);
    drop(turns);
    daemon.leave(place);
}

/// Ends the attachment of an endpoint that has no link.
pub async fn detach_lost(daemon: Arc<Daemon>, entity: Name) {
    let turns = daemon.turns(SerializedTask::Entity(entity));
    let turn = turns.lock().await;
    detach(&daemon, entity).await;
    drop(turn);
    drop(turns);
    daemon.leave(SerializedTask::Entity(entity));
}

/// Tells the RIB of a lost attachment. An entity that is back on another link says itself whether
/// what it stated still stands.
async fn detach(daemon: &Arc<Daemon>, entity: Name) {
    let lost = {
        let core = daemon.core();
        core.attached.contains(&entity) && core.link_to(&entity).is_none() && !core.held.keeps(&entity)
    };
    if !lost {
        return;
    }
    let next = {
        let mut core = daemon.core();
        let next = core.detach(entity);
        core.store_first(next)
    };
    if let Response::Refused(refusal) = daemon.complete(next).await {
        tracing::warn!(%refusal, "the RIB could not be told of a lost attachment; reporting in full");
        daemon.report_in_full();
    }
}

/// The end of one link does not detach what is about to be attached by another.
async fn entity_request(daemon: &Arc<Daemon>, link: &Link, request: EntityRequest) -> Response {
    let EntityRequest::Attach { lane, .. } = &request else { return take_request(daemon, link, request).await };
    if *lane != link.peer().lane {
        let reason = format!("this link is number {} of its entity, not {lane}", link.peer().lane);
        return Refusal::new(RefusalCode::Malformed, reason).into();
    }
    let place = SerializedTask::Entity(link.peer().name);
    let turns = daemon.turns(place);
    let turn = turns.lock().await;
    let response = take_request(daemon, link, request).await;
    drop(turn);
    drop(turns);
    daemon.leave(place);
    response
}

async fn take_request(daemon: &Arc<Daemon>, link: &Link, request: EntityRequest) -> Response {
    if let Some((proof, revocation)) = daemon.is_of_domain(&request) {
        return daemon.take_revocation(proof, revocation, Some(link.local_id())).await;
    }
    let attach = matches!(request, EntityRequest::Attach { .. });
    let next = {
        let mut core = daemon.core();
        let next = core.entity_request(Some(&link.peer().proof), false, request);
        if attach && !matches!(next, Next::Answer(Response::Refused(_))) {
            // Before the answer, so that a report in the meantime does not leave it out.
            core.attached.insert(link.peer().name);
        }
        core.store_first(next)
    };
    let response = daemon.complete(next).await;
    if attach && matches!(response, Response::Attached { .. }) {
        let mut core = daemon.core();
        core.link_ready(link);
        core.events.tell(Event::Attached { entity: link.peer().name });
    }
    response
}

/// Switches speak for many: their requests are answered side by side, as many as the link has
/// streams.
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
    if let Some((proof, revocation)) = control::relayed(&request).and_then(|request| daemon.is_of_domain(request)) {
        return daemon.take_revocation(proof, revocation, Some(link.local_id())).await;
    }
    let next = {
        let mut core = daemon.core();
        let next = core.switch_request(link, request);
        core.store_first(next)
    };
    daemon.notice_bit();
    daemon.notice_report();
    daemon.complete(next).await
}

fn end(daemon: &Arc<Daemon>, link: &Link) {
    let reason = link.close_reason().unwrap_or_else(|| "closed".into());
    let name = link.peer().name;
    tracing::info!(peer = %format_args!("{name:#}"), reason, "link down");
    let is_held = {
        let mut core = daemon.core();
        let is_held = core.link_down(link);
        if link.peer().role == Role::Switch && core.link_to(&name).is_none() {
            core.refusals.add(name, format!("the link ended: {reason}"), Instant::now());
        }
        core.events.tell(Event::LinkDown { peer: name, reason });
        is_held
    };
    if is_held {
        daemon.spawn(liveness::watch(daemon.clone(), link.clone()));
    }
}

async fn answer(responder: Responder, response: Response) {
    if let Err(error) = responder.respond(response).await {
        tracing::debug!(%error, "an answer could not be sent");
    }
}

/// An endpoint was asked to attach again. One that could not is asked again, because the RIB
/// answers the next report so; one that would not has to begin with a new link.
fn reattached(daemon: &Daemon, link: &Link, response: Option<Response>) {
    let entity = link.peer().name;
    match response {
        Some(Response::Done) => {
            tracing::info!(entity = %format_args!("{entity:#}"), "the RIB did not know the attachment; it was made \
                                                   again");
        }
        _ if link.close_reason().is_some() => {}
        None => daemon.report_in_full(),
        Some(Response::Refused(refusal)) if refusal.code == RefusalCode::Unreachable => daemon.report_in_full(),
        Some(_) => {
            tracing::info!(entity = %format_args!("{entity:#}"), "the RIB does not know the attachment; closing the \
                                                   link");
            link.close("the RIB does not know this attachment: attach again");
        }
    }
}

impl Daemon {
    /// A push may have brought this switch another egress bit, which it is to state.
    fn notice_bit(&self) {
        let changed = {
            let core = self.core();
            core.routes.own_bit() != core.topology.bit()
        };
        if changed {
            self.topology_changed();
        }
    }

    /// A push may have been refused, so that this switch is to find out who is the RIB.
    fn notice_report(&self) {
        let is_due = self.core().report == Report::Due;
        if is_due {
            self.report.notify_one();
        }
    }

    /// Does what a request needs before it can be answered, and what follows from it.
    pub(super) async fn complete(self: &Arc<Self>, next: Next) -> Response {
        self.send_effects();
        match next {
            Next::Answer(response) => response,
            Next::Store(ticket, next) => self.store(ticket, *next).await,
            Next::Keep(response) => self.keep_revocations().await.map_or_else(Response::from, |()| response),
            Next::Await { waiting, is_query } => match timeout(tiers::TIMEOUT, waiting).await {
                Ok(Ok(response)) if is_query => tiers::records(response),
                Ok(Ok(response)) => Response::Tier(Box::new(response)),
                _ => Refusal::new(RefusalCode::Unreachable, "no RIB of another domain has answered").into(),
            },
            Next::Trace(tracing) => self.trace_on(*tracing).await,
            Next::KeepInvitation { new } => self.keep_invitation(new).await,
            Next::Settle(response, statement) => match self.settled(&statement).await {
                Ok(()) => response,
                Err(refusal) => refusal.into(),
            },
            Next::Reattach(links, request) => {
                let asked = links.iter().map(async |link| reattached(self, link, link.request(&request).await.ok()));
                join_all(asked).await;
                Response::Done
            }
            Next::Report => {
                self.report.notify_one();
                Response::Done
            }
            Next::Forward(link, request) => match link.request(&request).await {
                Ok(response) => response,
                Err(error) => {
                    let peer = link.peer().name;
                    Refusal::new(RefusalCode::Unreachable, format!("no answer through {peer}: {error}")).into()
                }
            },
        }
    }

    /// Waits until the switches hold the routes that follow from a statement, so that what its
    /// entity sends next is not lost; but not for long on one that does not answer. Refuses the
    /// statement if one has no room.
    async fn settled(self: &Arc<Self>, statement: &Statement) -> Result<(), Refusal> {
        let settled = async {
            loop {
                let answered = self.answered.notified();
                if self.core().rib.as_ref().is_none_or(|rib| statement.is_settled(rib)) {
                    return;
                }
                answered.await;
            }
        };
        if timeout(SETTLE, settled).await.is_err() {
            tracing::warn!(
                name = %format_args!("{:#}", statement.name),
                "a switch does not answer; what is sent to the name may be lost until it does"
            );
        }
        let room = match &mut self.core().rib {
            Some(rib) => statement.check_room(rib),
            None => Ok(()),
        };
        if room.is_err() {
            self.send_effects();
        }
        room
    }

    /// Sends what the RIB here has to say after something changed in it.
    pub(super) fn send_effects(self: &Arc<Self>) {
        self.dispatch_effects();
        self.rib_changed.notify_one();
    }

    pub(super) fn dispatch_effects(self: &Arc<Self>) {
        let outgoing = self.core().rib_effects();
        self.notice_bit();
        self.notice_report();
        self.answered.notify_waiters();
        for message in outgoing {
            let daemon = self.clone();
            self.spawn(async move {
                let asked = async {
                    let answer = message.link.as_ref()?.request(&message.request).await;
                    answer.inspect_err(|error| tracing::debug!(%error, "what the RIB sent was not answered")).ok()
                };
                let response = match &message.expects {
                    // Nobody of this domain answers for another.
                    Expects::Tier(..) => timeout(tiers::TIMEOUT, asked).await.ok().flatten(),
                    _ => asked.await,
                };
                if let (Expects::Reattach, Some(link)) = (&message.expects, &message.link) {
                    reattached(&daemon, link, response);
                } else if !matches!(message.expects, Expects::Nothing) {
                    daemon.core().answered(message.expects, response);
                    daemon.send_effects();
                }
            });
        }
    }
}
