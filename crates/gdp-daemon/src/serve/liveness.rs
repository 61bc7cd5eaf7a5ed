//! Probes the data planes of silent peers.
//!
//! QUIC ends in the peer's daemon or process, but its data plane may still forward. The switch
//! therefore keeps such a link with its routes. This task removes the link as soon as echoes go
//! unanswered.

use std::sync::Arc;

use gdp_core::crypto;
use gdp_core::peer::Role;
use gdp_link::link::{Link, liveness::Liveness, liveness::Pace, liveness::Step};
use tokio::time::sleep;

use super::daemon::Daemon;
use super::detach::detach_lost;

/// Probes a stale link until it is removed, its peer has a newer link, or it expires.
pub async fn watch(daemon: Arc<Daemon>, link: Link) {
    let (peer, id) = (link.peer().name, link.local_id());
    tracing::info!(peer = %format_args!("{peer:#}"), "its link is held while its data plane answers echoes");
    let mut liveness = Liveness::new(Pace::of(link.addr()));
    while daemon.core().switch.awaits(&link) {
        let cookie = crypto::random().map_or(0, u64::from_le_bytes);
        let step = {
            let core = daemon.core();
            let step = liveness.step(core.switch.planes.notices().answer(id), cookie);
            if step == Step::Ask {
                core.switch.planes.ask(id, cookie);
            }
            step
        };
        if step == Step::Silent {
            return give_up(&daemon, &link);
        }
        sleep(liveness.pace().interval).await;
    }
}

fn give_up(daemon: &Arc<Daemon>, link: &Link) {
    tracing::info!(peer = %format_args!("{:#}", link.peer().name), "its data plane does not answer either; its link \
                                         is gone");
    let lost = daemon.core().switch.release(link.local_id());
    if link.peer().role == Role::Switch {
        daemon.topology_changed();
    }
    if let Some(entity) = lost {
        daemon.spawn(detach_lost(daemon.clone(), entity));
    }
}
