//! Replaces a link's keys on schedule.
//!
//! The task here drives [`super::ratchet`] with the clock and the control connection. The owner of
//! the link's table entries writes the keys. This module decides when it writes them, and in which
//! order with the messages to the peer.

use super::streams::Announcement;
use std::future::poll_fn;
use std::pin::Pin;
use std::task::Poll;
use std::time::Instant;

use parking_lot::MutexGuard;
use tokio::sync::mpsc;
use tokio::time::sleep_until;

use super::ratchet::{AnnouncementOutcome, Ratchet, RekeyStep};
use super::{Link, LinkKeys, Responder, streams};
use gdp_core::crypto::CryptoError;
use gdp_proto::control::{Refusal, RefusalCode, Request, Response};

impl Link {
    /// Replaces the keys of the link's data frames by the schedule of its port, and follows the
    /// changes of the peer. Runs until the link closes, or until `put` or cryptography fails. After
    /// a failure the keys stay unchanged, which the peer tolerates.
    ///
    /// `sent` returns the number of data frames sent on the link. `put` writes keys to all data
    /// planes that contain the link. It returns once every frame that arrives or is tagged later
    /// uses them, or returns `false` if it failed.
    pub async fn keep_keys(&self, sent: impl Fn() -> u64, put: impl FnMut(&LinkKeys) -> bool) {
        let mut announcements = self.0.announcements.lock().await;
        tokio::select! {
            _ = self.0.connection.closed() => {}
            result = self.rekey(&mut announcements, sent, put) => {
                if let Err(error) = result {
                    tracing::error!(link = ?self, %error, "the keys of a link stay what they are until it is made \
                                                           anew");
                }
            }
        }
    }

    async fn rekey(
        &self,
        announcements: &mut mpsc::Receiver<Announcement>,
        sent: impl Fn() -> u64,
        mut put: impl FnMut(&LinkKeys) -> bool,
    ) -> Result<(), CryptoError> {
        let mut asking: Option<Pin<Box<dyn Future<Output = bool> + Send + '_>>> = None;
        let mut waiting: Option<Responder> = None;
        loop {
            loop {
                // Called before the ratchet is locked, because `sent` may lock it to inspect the
                // link.
                let sent = sent();
                let (step, keys) = {
                    let mut ratchet = self.ratchet();
                    let Some(step) = ratchet.poll(Instant::now(), sent)? else { break };
                    (step, ratchet.keys())
                };
                if !put(&keys) {
                    return Ok(());
                }
                match step {
                    RekeyStep::Announce(generation) => asking = Some(Box::pin(self.announce(generation))),
                    RekeyStep::Confirm => answer(waiting.take(), Response::Done).await,
                }
            }
            let wake = self.ratchet().wake_at(Instant::now());
            let answered = poll_fn(|context| match &mut asking {
                Some(asking) => asking.as_mut().poll(context),
                None => Poll::Pending,
            });
            tokio::select! {
                () = sleep_until(wake.into()) => {}
                confirmed = answered => {
                    asking = None;
                    let keys = {
                        let mut ratchet = self.ratchet();
                        ratchet.answered(confirmed, Instant::now())?.then(|| ratchet.keys())
                    };
                    if keys.is_some_and(|keys| !put(&keys)) {
                        return Ok(());
                    }
                }
                Some((generation, responder)) = announcements.recv() => {
                    let heard = self.ratchet().announced(generation, Instant::now());
                    match heard {
                        AnnouncementOutcome::Later => waiting = Some(responder),
                        AnnouncementOutcome::Known => answer(Some(responder), Response::Done).await,
                        AnnouncementOutcome::Impossible => {
                            let reason = format!("generation {generation} of a key does not follow the one in use");
                            answer(Some(responder), Refusal::new(RefusalCode::Malformed, reason).into()).await;
                        }
                    }
                }
            }
        }
    }

    /// Announces a generation, and returns whether the peer has confirmed it.
    async fn announce(&self, generation: u64) -> bool {
        let response = streams::request(&self.0.connection, &Request::Ratcheted { generation }).await;
        if !matches!(response, Ok(Response::Done)) {
            tracing::debug!(link = ?self, ?response, generation, "the peer has not confirmed a new key; asking again");
        }
        matches!(response, Ok(Response::Done))
    }

    pub(super) fn ratchet(&self) -> MutexGuard<'_, Ratchet> {
        self.0.ratchet.lock()
    }
}

/// Sends a response. Ignores errors: the peer may have disconnected or repeated its request.
async fn answer(responder: Option<Responder>, response: Response) {
    if let Some(responder) = responder {
        let _ = responder.respond(response).await;
    }
}
