//! Tells endpoints that choose among the servers of a service what the paths from here cost.

use std::sync::Arc;
use std::time::Duration;

use gdp_link::link::Link;
use gdp_proto::control::{PathCosts, Request, Response};
use tokio::sync::watch;
use tokio::time::sleep;

use super::daemon::Daemon;

/// Between two messages to one endpoint, however often costs change.
const PAUSE: Duration = Duration::from_secs(1);

/// Answers an endpoint that asks, and tells it of changes for as long as the link lives. `watches`:
/// it has asked on this link before.
pub fn watch(daemon: &Arc<Daemon>, link: &Link, watches: &mut bool) -> Response {
    let mut costs = daemon.costs.subscribe();
    let now = costs.borrow_and_update().clone();
    if !std::mem::replace(watches, true) {
        daemon.spawn(tell(link.clone(), costs));
    }
    Response::Costs(now)
}

async fn tell(link: Link, mut costs: watch::Receiver<PathCosts>) {
    let telling = async {
        loop {
            sleep(PAUSE).await;
            if costs.changed().await.is_err() {
                return;
            }
            let now = costs.borrow_and_update().clone();
            if let Err(error) = link.request(&Request::Costs(now)).await {
                tracing::debug!(endpoint = %format_args!("{:#}", link.peer().name), %error, "what paths cost did not \
                                                          arrive");
                costs.mark_changed();
            }
        }
    };
    tokio::select! {
        () = telling => {}
        _ = link.closed() => {}
    }
}

/// Paths from here cost this now.
pub fn set(daemon: &Daemon, costs: &PathCosts) {
    daemon.costs.send_if_modified(|before| {
        let changed = before != costs;
        if changed {
            before.clone_from(costs);
        }
        changed
    });
}
