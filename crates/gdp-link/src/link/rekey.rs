//! Keeps a link's keys fresh: the task that lets [`super::ratchet`] run on the clock and on the
//! control connection. Who holds the link's entry in tables writes the keys there; when, and in
//! which order with what the peer is told, is decided here.

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
    /// Replaces the keys of the link's data frames by the schedule of its port, and follows those
    /// of the peer. Runs until the link is closed, or `put` or cryptography fails: then the keys
    /// stay what they are, which the peer bears.
    ///
    /// `sent`: how many data frames have left by the link. `put` writes keys to all data planes
    /// that hold the link, and returns once every frame that arrives, or is tagged, from then on
    /// meets them; `false` if it could not.
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
                // Not while the ratchet is locked: who is asked may lock it, to look at the link.
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

    /// Whether the peer has answered that it is ready for the next change.
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

/// The peer may be gone, or have asked again.
async fn answer(responder: Option<Responder>, response: Response) {
    if let Some(responder) = responder {
        let _ = responder.respond(response).await;
    }
}
