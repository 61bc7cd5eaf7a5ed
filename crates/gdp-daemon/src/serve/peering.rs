//! Peerings on demand, on a border switch. Makes the links into other domains that the RIB wants,
//! and closes those that it no longer wants.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::Arc;

use gdp_link::port::Port;
use gdp_rib::tiers::peering::WantedPeerings;
use gdp_wire::Name;
use tokio::sync::watch;
use tokio::task::{AbortHandle, JoinSet};

use super::daemon::Daemon;
use super::ports::keep_link;
use crate::config::Via;

/// Maintains the wanted links until the daemon ends.
pub async fn run(daemon: Arc<Daemon>, port: Arc<Port>, mut wanted: watch::Receiver<WantedPeerings>) {
    let (mut tasks, mut kept) = (JoinSet::new(), BTreeMap::<Name, (Vec<SocketAddr>, AbortHandle)>::new());
    loop {
        let now = wanted.borrow_and_update().clone();
        kept.retain(|switch, (addrs, task)| {
            let stays = now.get(switch) == Some(addrs);
            if !stays {
                task.abort();
                let link = daemon.core().switch.link_to(switch);
                link.inspect(|link| link.close("nobody exchanges messages by this peering any more"));
            }
            stays
        });
        for (switch, addrs) in now {
            kept.entry(switch).or_insert_with(|| {
                let (daemon, port) = (daemon.clone(), port.clone());
                let ways = addrs.iter().copied().map(Via::Udp).collect();
                (addrs, tasks.spawn(async move { keep_link(&daemon, &port, switch, ways).await }))
            });
        }
        while tasks.try_join_next().is_some() {}
        if wanted.changed().await.is_err() {
            return;
        }
    }
}
