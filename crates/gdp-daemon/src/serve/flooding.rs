//! This switch's part in the link-state topology.
//!
//! Passes adjacencies and costs to the topology, floods link states to neighbours, and gives the
//! paths to the data planes and the local RIB. The rules are in [`gdp_rib::topology`].

use std::sync::Arc;

use gdp_link::link::Link;
use gdp_proto::control::{Flooded, Refusal, RefusalCode, Request, Response};
use gdp_wire::LinkRole;
use tokio::time::{Instant, sleep_until};

use super::costs;
use super::daemon::Daemon;
use gdp_rib::topology::{Batch, Verified};

/// Keeps the topology up to date until the daemon ends.
pub async fn run(daemon: Arc<Daemon>) {
    loop {
        let (batches, next) = {
            let mut core = daemon.core();
            let (batches, other_paths) = core.follow_topology();
            costs::set(&daemon, &core.topology.paths().costs);
            if core.follow_rib() && other_paths {
                daemon.report.notify_one();
            }
            let now = core.now().clock;
            (batches, core.topology.next_tick(now).and_then(|clock| core.clock.instant(clock)))
        };
        daemon.send_effects();
        for (link, batch) in batches {
            daemon.spawn(send(daemon.clone(), link, batch));
        }
        let tick = async {
            match next {
                Some(at) => sleep_until(Instant::from_std(at)).await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            () = daemon.topology.notified() => {}
            () = tick => {}
        }
    }
}

async fn send(daemon: Arc<Daemon>, link: Link, batch: Batch) {
    let Batch { id, states } = batch;
    let arrived = match link.request(&Request::Flood { states }).await {
        Ok(Response::Refused(refusal)) => {
            tracing::warn!(neighbour = %format_args!("{:#}", link.peer().name), %refusal, "a neighbour refused the \
                                                      topology");
            false
        }
        Ok(_) => true,
        Err(error) => {
            tracing::debug!(neighbour = %format_args!("{:#}", link.peer().name), %error, "the topology did not arrive");
            false
        }
    };
    {
        let mut core = daemon.core();
        let now = core.now().clock;
        core.topology.answered(now, id, arrived);
    }
    daemon.topology_changed();
}

/// Accepts link states that a neighbour of the domain floods. Verifies signatures without holding
/// the lock.
pub fn take(daemon: &Daemon, from: &Link, states: Vec<Flooded>) -> Response {
    let link = from.local_id();
    let news = {
        let mut core = daemon.core();
        if core.switch.role_on(from) == Some(LinkRole::Border as u32) {
            let reason = "the topology of a domain is no business of its neighbours";
            return Refusal::new(RefusalCode::NotEntitled, reason).into();
        }
        core.topology.news(link, states)
    };
    let verified = news.and_then(|news| news.into_iter().map(Verified::new).collect());
    match verified {
        Ok(states) => {
            let mut core = daemon.core();
            let now = core.now().clock;
            core.topology.learn(now, link, states);
        }
        Err(error) => {
            let neighbour = from.peer().name;
            tracing::warn!(neighbour = %format_args!("{neighbour:#}"), %error, "refused what a neighbour says of the \
                                                      topology");
            let reason = format!("what switch {neighbour} says of the topology is refused: {error}");
            return Refusal::new(RefusalCode::BadSignature, reason).into();
        }
    }
    daemon.topology_changed();
    Response::Done
}
