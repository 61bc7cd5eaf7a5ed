//! Completes requests: runs the steps before each answer, and sends the resulting requests of the
//! local RIB.

use std::sync::Arc;
use std::time::Duration;

use futures::future::join_all;
use gdp_link::link::Link;
use gdp_proto::control::{Refusal, RefusalCode, Request, Response};
use gdp_util::backoff::Backoff;
use gdp_wire::Name;
use tokio::time::{sleep, timeout};

use super::core::Core;
use super::core::follow_up::{FollowUp, OnReply, PendingRequest, Statement};
use super::core::relay::onward;
use super::daemon::Daemon;
use super::federation::records;

/// The maximum wait until switches have the routes of an accepted statement.
const SETTLE: Duration = Duration::from_secs(1);

/// The maximum wait for the RIB of another domain.
const TIER_TIMEOUT: Duration = Duration::from_secs(10);

/// The delays between attempts to tell a switch of an unknown attachment, which then take 21 s.
const DETACH: Backoff = Backoff::new(Duration::from_millis(200), Duration::from_secs(5));
const DETACH_ATTEMPTS: u32 = 8;

impl Daemon {
    /// Handles a request under the lock, and answers it after the steps that it needs.
    pub async fn answer(self: &Arc<Self>, request: impl FnOnce(&mut Core) -> FollowUp) -> Response {
        let (next, pending) = {
            let mut core = self.core();
            let next = request(&mut core);
            (core.rib_host.store_first(next), core.rib_effects())
        };
        self.send(pending);
        self.rib_changed.notify_one();
        self.complete(next).await
    }

    /// Runs the steps that a handled request needs, and answers it.
    pub async fn complete(self: &Arc<Self>, next: FollowUp) -> Response {
        match next {
            FollowUp::Answer(response) => response,
            FollowUp::Store(ticket, next) => match ticket.stored().await {
                Ok(()) => Box::pin(self.complete(*next)).await,
                Err(refusal) => self.refuse_unsaved(&next, refusal),
            },
            FollowUp::SaveRevocation(response) => {
                self.save_revocations().await.map_or_else(Response::from, |()| response)
            }
            FollowUp::SaveInvitation { .. } => match self.save_domain().await {
                Ok(()) => Response::Done,
                Err(refusal) => self.refuse_unsaved(&next, refusal),
            },
            FollowUp::Await { waiting, is_query } => match timeout(TIER_TIMEOUT, waiting).await {
                Ok(Ok(response)) if is_query => records(response),
                Ok(Ok(response)) => Response::Tier(Box::new(response)),
                _ => Refusal::new(RefusalCode::Unreachable, "no RIB of another domain has answered").into(),
            },
            FollowUp::Trace(tracing) => self.trace_on(*tracing).await,
            FollowUp::Settle(response, statement) => {
                self.settled(&statement).await.map_or_else(Response::from, |()| response)
            }
            FollowUp::Reattach(links, request) => {
                let asked = links.iter().map(async |link| reattached(self, link, link.request(&request).await.ok()));
                join_all(asked).await;
                Response::Done
            }
            FollowUp::Report => {
                self.report.notify_one();
                Response::Done
            }
            FollowUp::Forward(link, request) => match link.request(&request).await {
                Ok(response) => response,
                Err(error) => {
                    let peer = link.peer().name;
                    Refusal::new(RefusalCode::Unreachable, format!("no answer through {peer}: {error}")).into()
                }
            },
        }
    }

    /// Withdraws an admission by invitation that could not be saved, and refuses the request.
    fn refuse_unsaved(&self, next: &FollowUp, refusal: Refusal) -> Response {
        if let (FollowUp::SaveInvitation { new: Some(serial) }, Some(domain)) =
            (next, &mut self.core().membership.domain)
        {
            domain.invitations.forget(*serial);
        }
        refusal.into()
    }

    /// Waits until the switches have the routes of a statement, so that the entity's next frames
    /// are not lost. Waits at most one second for silent switches. Refuses the statement if a
    /// switch has no room.
    async fn settled(self: &Arc<Self>, statement: &Statement) -> Result<(), Refusal> {
        let settled = async {
            loop {
                let answered = self.answered.notified();
                if self.core().rib_host.rib.as_ref().is_none_or(|rib| statement.is_settled(rib)) {
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
        let room = match &mut self.core().rib_host.rib {
            Some(rib) => statement.check_room(rib),
            None => Ok(()),
        };
        if room.is_err() {
            self.send_effects();
        }
        room
    }

    /// Sends the pending output of the local RIB after a change in it.
    pub fn send_effects(self: &Arc<Self>) {
        let pending = self.core().rib_effects();
        self.send(pending);
        self.rib_changed.notify_one();
    }

    /// Sends requests of the local RIB, and passes the replies to it.
    pub fn send(self: &Arc<Self>, pending: Vec<PendingRequest>) {
        self.wake_after_rib();
        self.answered.notify_waiters();
        for PendingRequest { link, request, on_reply } in pending {
            let daemon = self.clone();
            self.spawn(async move {
                let asked = async {
                    let answer = link.as_ref()?.request(&request).await;
                    answer.inspect_err(|error| tracing::debug!(%error, "what the RIB sent was not answered")).ok()
                };
                let response = match on_reply {
                    // No switch of this domain answers for another domain's RIB, so the wait needs
                    // a limit here.
                    OnReply::Tier(..) => timeout(TIER_TIMEOUT, asked).await.ok().flatten(),
                    _ => asked.await,
                };
                match (on_reply, &link) {
                    (OnReply::Detach(..), _) if matches!(response, Some(Response::Done)) => {}
                    (OnReply::Detach(switch, entity), _) => daemon.detach(switch, entity).await,
                    (OnReply::Reattach, Some(link)) => reattached(&daemon, link, response),
                    (on_reply, _) => {
                        daemon.core().answered(on_reply, response);
                        daemon.send_effects();
                    }
                }
            });
        }
    }

    /// Tells a switch once more that the local RIB does not know an attachment, until it answers.
    /// After a start of the RIB, the topology may not have converged.
    async fn detach(&self, switch: Name, entity: Name) {
        let mut retry = DETACH;
        for _ in 0..DETACH_ATTEMPTS {
            sleep(retry.next_delay()).await;
            let link = self.core().link_toward(&switch).ok();
            let Some(link) = link else { continue };
            match link.request(&onward(switch, Request::Detach { switch, entity })).await {
                Ok(Response::Refused(refusal)) if refusal.code == RefusalCode::Unreachable => {}
                Ok(_) => return,
                Err(error) => tracing::debug!(%error, "a switch was not told of an unknown attachment"),
            }
        }
    }
}

/// Handles the answer of an endpoint that was asked to attach again.
///
/// If the endpoint could not, this switch reports in full, because the RIB's answer makes it ask
/// again. If the endpoint refused, its link is closed, so that it starts with a new one.
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
