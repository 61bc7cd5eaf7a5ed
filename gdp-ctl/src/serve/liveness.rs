//! Links whose peer fell silent. QUIC ends in the peer's daemon, or in its process; what forwards may live on. So the link stays
//! in the data planes while the peer's data plane answers echoes, and routes and neighbours stay what they are. [`super::links`]
//! waits here before it takes a link out of service.

use gdp::crypto;
use gdp::link::liveness::{Liveness, Pace, Step};
use gdp::link::{HOLD, Link, Role};
use std::time::Duration;
use tokio::time::{Instant, sleep, timeout};

use super::Daemon;

/// How long the link to a switch stays when there is a newer one: what the other side sent before it took to the newer one is
/// on its way.
const LINGER: Duration = Duration::from_secs(1);

/// Returns when a closed link is of no use any more: at once, unless its peer fell silent or has made a newer one.
pub async fn outlast(daemon: &Daemon, link: &Link) {
    let peer = format_args!("{:#}", link.peer().name).to_string();
    if link.fell_silent() && !is_replaced(daemon, link) {
        tracing::info!(peer, "fell silent; its link is held as long as its data plane answers");
        match timeout(HOLD, until_silent(daemon, link)).await {
            Ok(End::Replaced) => {}
            Ok(End::Silent) => tracing::info!(peer, "its data plane does not answer either"),
            Err(_) => tracing::info!(peer, "its daemon has been silent for {} s", HOLD.as_secs()),
        }
    }
    if link.peer().role == Role::Switch && is_replaced(daemon, link) {
        sleep(LINGER).await;
    }
}

enum End {
    Silent,
    Replaced,
}

async fn until_silent(daemon: &Daemon, link: &Link) -> End {
    let (id, mut liveness) = (link.local_id(), Liveness::new(Pace::of(link.addr())));
    loop {
        {
            let core = daemon.core();
            let cookie = crypto::random().map_or(0, u64::from_le_bytes);
            match liveness.step(core.planes.notices().answer(id), cookie) {
                Step::Ask => core.planes.ask(id, cookie),
                Step::Silent => return End::Silent,
            }
        }
        let next = Instant::now() + liveness.pace().interval;
        while Instant::now() < next {
            let news = daemon.replaced.notified();
            if is_replaced(daemon, link) {
                return End::Replaced;
            }
            let _ = tokio::time::timeout_at(next, news).await;
        }
    }
}

/// Whether there is a newer link to the same peer.
fn is_replaced(daemon: &Daemon, link: &Link) -> bool {
    daemon.core().peers.get(&link.peer().name) != Some(&link.local_id())
}
