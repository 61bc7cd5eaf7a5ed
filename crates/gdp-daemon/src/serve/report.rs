//! Reports this switch and its endpoints to the RIB. Does so when it first reaches the RIB, and
//! whenever the RIB's state may differ. Runs the timers of the local RIB.

use std::sync::Arc;
use std::time::Duration;

use gdp_proto::control::{RefusalCode, Response};
use gdp_util::backoff::Backoff;
use tokio::time::{Instant, sleep_until, timeout};

use super::core::rib_client::{PendingReport, Report};
use super::daemon::Daemon;

/// The delays between attempts to report: doubled from the first to the second value.
const RETRY: Backoff = Backoff::new(Duration::from_millis(200), Duration::from_secs(5));

/// The maximum sleep between runs of the RIB's timers.
const LONGEST_SLEEP: Duration = Duration::from_secs(10);

/// The minimum sleep between runs of the RIB's timers, unless a change occurs.
const SHORTEST_SLEEP: Duration = Duration::from_millis(10);

/// Reports until the daemon ends.
pub async fn report(daemon: Arc<Daemon>) {
    loop {
        daemon.report.notified().await;
        let mut retry = RETRY;
        while !report_once(&daemon).await {
            // A notification, such as of a new path, starts another attempt at once.
            let _ = timeout(retry.next_delay(), daemon.report.notified()).await;
        }
    }
}

/// Reports once. Returns whether no retry is needed: the report was accepted, none is due, or there
/// is no path. A topology change then starts the next attempt.
async fn report_once(daemon: &Arc<Daemon>) -> bool {
    if let Some(taken) = report_here(daemon).await {
        return taken;
    }
    let Some(PendingReport { by, run, follows, link, request }) = daemon.core().report_to_send() else { return true };
    match link.request(&request).await {
        // The topology has not converged yet.
        Ok(Response::Refused(refusal)) if refusal.code == RefusalCode::Unreachable => {
            tracing::debug!(%refusal, "the report did not get to the RIB");
            false
        }
        Ok(Response::Refused(refusal)) => {
            tracing::warn!(%refusal, "the report to the RIB was refused");
            false
        }
        Err(error) => {
            tracing::debug!(%error, "the report to the RIB was not answered");
            false
        }
        Ok(Response::Reported { run: of_rib }) => {
            tracing::info!(at = %format_args!("{by:#}"), "the RIB has taken this switch's report");
            daemon.core().rib_client.report_accepted(Report::Accepted { by, run }, of_rib, follows)
        }
        Ok(other) => {
            tracing::warn!(?other, "the report to the RIB was answered with something else");
            false
        }
    }
}

/// Reports to the local RIB. Returns `None` if the RIB is elsewhere.
async fn report_here(daemon: &Arc<Daemon>) -> Option<bool> {
    let (by, follows, next) = {
        let mut core = daemon.core();
        core.rib_host.rib.as_ref()?;
        if matches!(core.rib_client.report, Report::Accepted { .. }) {
            return Some(true);
        }
        let next = core.report_here();
        (core.name(), core.rib_client.fence.follows(), core.rib_host.store_first(next))
    };
    daemon.send_effects();
    let response = daemon.complete(next).await;
    let mut core = daemon.core();
    Some(match response {
        // The local RIB runs as long as this daemon, so its run need not be compared.
        Response::Reported { run } => core.rib_client.report_accepted(Report::Accepted { by, run: 0 }, run, follows),
        other => {
            tracing::warn!(?other, "the RIB does not take its own switch's report");
            false
        }
    })
}

/// Runs the timers of the local RIB, for expiry and retries.
pub async fn rib_clock(daemon: Arc<Daemon>) {
    loop {
        let (next, pending) = {
            let mut core = daemon.core();
            let now = core.now();
            let next = core.rib_host.tick(now).and_then(|clock| core.clock.instant(clock));
            (next, core.rib_effects())
        };
        daemon.send(pending);
        let latest = Instant::now() + LONGEST_SLEEP;
        let next = next.map_or(latest, Instant::from_std);
        let wake = next.min(latest).max(Instant::now() + SHORTEST_SLEEP);
        tokio::select! {
            () = sleep_until(wake) => {}
            () = daemon.rib_changed.notified() => {}
        }
    }
}
