//! Sends and answers probes and echoes, which show where a name leads, the switches on the path,
//! and the round-trip times.
//!
//! A probe travels in the data plane. Its answer returns hop by hop over the links between
//! switches. Neighbours answer echoes in their data planes.

use std::sync::Arc;
use std::time::{Duration, Instant};

use gdp_proto::control::{Traced, TracedEnd};
use gdp_wire::Name;
use tokio::time::timeout;

use super::core::probes::ProbeError;
use super::core::probing::cookie;
use super::daemon::Daemon;

/// The time limit for an answer.
const TIMEOUT: Duration = Duration::from_secs(1);

/// The answer to a probe, with its round-trip time.
pub struct Hop {
    pub switch: Name,
    pub end: Option<TracedEnd>,
    pub time: Duration,
}

/// Answers probes that end at this switch, until the daemon ends. A lost answer has the same effect
/// as a lost probe.
pub async fn run(daemon: Arc<Daemon>) {
    let notices = daemon.core().switch.planes.notices().clone();
    loop {
        let probe = notices.probe().await;
        let answer = daemon.core().answer_to(&probe);
        let Some((link, answer)) = answer else {
            tracing::debug!(source = %format_args!("{:#}", probe.source), "a probe to which no answer leads back");
            continue;
        };
        daemon.spawn(async move {
            if let Err(error) = link.request(&answer).await {
                tracing::debug!(%error, "an answer to a probe was lost");
            }
        });
    }
}

impl Daemon {
    /// Sends a probe for `name` toward an egress switch, at most `hops` switches far. Returns its
    /// answer, or `None` after a timeout. `asked_by` is the neighbouring domain that requested it.
    pub(super) async fn probe(
        &self,
        asked_by: Option<Name>,
        name: Name,
        switch: Name,
        hops: u8,
    ) -> Result<Option<Hop>, ProbeError> {
        let sent = Instant::now();
        let answer = self.core().send_probe(asked_by, name, switch, hops)?;
        let answer = timeout(TIMEOUT, answer).await.ok().and_then(Result::ok);
        Ok(answer.map(|(Traced { switch, end, .. }, at)| Hop { switch, end, time: at - sent }))
    }

    /// Sends an echo to a neighbour's data plane and returns the round-trip time, or `None` after a
    /// timeout.
    pub(super) async fn echo(&self, peer: Name) -> Result<Option<Duration>, ProbeError> {
        let cookie = cookie()?;
        let (id, notices, sent) = {
            let core = self.core();
            let id = core.switch.link_to(&peer).ok_or(ProbeError::NoLink(peer))?.local_id();
            let sent = Instant::now();
            core.switch.planes.ask(id, cookie);
            (id, core.switch.planes.notices().clone(), sent)
        };
        let answered = timeout(TIMEOUT, notices.answered_with(id, cookie)).await;
        Ok(answered.ok().map(|()| sent.elapsed()))
    }
}
