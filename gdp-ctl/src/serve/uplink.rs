//! Tells the RIB over every new uplink that this switch is there, and who is attached to it. Keeps the RIB's clock, if the RIB is
//! here.

use std::sync::Arc;
use std::time::Duration;

use gdp::control::{Request, Response};
use tokio::time::{Instant, sleep_until, timeout};

use super::Daemon;

/// Between attempts to report: doubled from the first to the second.
const RETRY: (Duration, Duration) = (Duration::from_millis(200), Duration::from_secs(5));

/// The RIB's clock is looked at this often at least.
const LONGEST_SLEEP: Duration = Duration::from_secs(10);

/// And not more often than this, unless something happened.
const SHORTEST_SLEEP: Duration = Duration::from_millis(10);

/// Reports until the daemon ends.
pub async fn report(daemon: Arc<Daemon>) {
    loop {
        daemon.report.notified().await;
        let mut wait = RETRY.0;
        while !report_once(&daemon).await {
            // News, such as a new uplink, is worth another attempt at once.
            let _ = timeout(wait, daemon.report.notified()).await;
            wait = (wait * 2).min(RETRY.1);
        }
    }
}

/// Whether there is nothing left to report for now.
async fn report_once(daemon: &Arc<Daemon>) -> bool {
    let (uplink, request) = {
        let mut core = daemon.core();
        if core.uplink_ready {
            return true;
        }
        let (switch, now, own_bit) = (core.identity.proof(), core.now(), core.routes.own_bit());
        let attached: Vec<_> = core.attached.iter().copied().collect();
        if let Some(rib) = &mut core.rib {
            if let Response::Refused(refusal) = rib.report(now, &switch, &attached, own_bit) {
                tracing::error!(%refusal, "the RIB does not take its own switch's report");
            }
            core.uplink_ready = true;
            drop(core);
            daemon.send_effects();
            return true;
        }
        let Some(uplink) = core.uplink.and_then(|uplink| core.link_to(&uplink)) else {
            // The next link will ask for a report again.
            return true;
        };
        (uplink, Request::Report { switch, attached, own_bit })
    };
    match uplink.request(&request).await {
        Ok(Response::Refused(refusal)) => {
            tracing::warn!(%refusal, "the report to the RIB was refused");
            false
        }
        Err(error) => {
            tracing::debug!(%error, "the report to the RIB was not answered");
            uplink.close_reason().is_some()
        }
        Ok(_) => {
            let below = {
                let mut core = daemon.core();
                // Still the same link?
                let same = core.uplink.and_then(|peer| core.link_to(&peer));
                core.uplink_ready = same.is_some_and(|link| link.local_id() == uplink.local_id());
                tracing::info!(uplink = %format_args!("{:#}", uplink.peer().name), "the RIB has taken this switch's report");
                let links = core.downstream.iter().filter_map(|(switch, id)| Some((*switch, core.links.get(id)?)));
                links.map(|(switch, state)| (switch, state.link.clone())).collect::<Vec<_>>()
            };
            // The RIB may have forgotten the switches behind this one: let them report as well.
            for (switch, link) in below {
                daemon.spawn(async move { drop(link.request(&Request::Detach { switch, entity: switch }).await) });
            }
            true
        }
    }
}

/// Lets end in the RIB what ends by itself, and retries what is to be retried.
pub async fn rib_clock(daemon: Arc<Daemon>) {
    loop {
        let next = {
            let mut core = daemon.core();
            let now = core.now();
            let next = core.rib.as_mut().and_then(|rib| {
                rib.tick(now);
                rib.next_tick()
            });
            next.and_then(|clock| core.instant(clock))
        };
        daemon.dispatch_effects();
        let latest = Instant::now() + LONGEST_SLEEP;
        let next = next.map_or(latest, Instant::from_std);
        let wake = next.min(latest).max(Instant::now() + SHORTEST_SLEEP);
        tokio::select! {
            () = sleep_until(wake) => {}
            () = daemon.rib_changed.notified() => {}
        }
    }
}
