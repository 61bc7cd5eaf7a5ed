//! Sends the costs of paths to endpoints, which choose among the servers of a service by them.

use std::sync::Arc;
use std::time::Duration;

use gdp_link::link::Link;
use gdp_proto::control::{PathCosts, Request, Response};
use tokio::sync::watch;
use tokio::time::sleep;

use super::daemon::Daemon;

/// The minimum time between two updates to one endpoint.
const PAUSE: Duration = Duration::from_secs(1);

/// Answers an endpoint's first or repeated request, and sends updates until the link closes.
/// `watches` is set if updates already run for this link.
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

/// Publishes new path costs, if they differ from the last ones.
pub fn set(daemon: &Daemon, costs: &PathCosts) {
    daemon.costs.send_if_modified(|before| {
        let changed = before != costs;
        if changed {
            before.clone_from(costs);
        }
        changed
    });
}
