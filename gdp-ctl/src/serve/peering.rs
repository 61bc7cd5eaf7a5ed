//! Peerings on demand, on a border switch: makes the links into other domains that the RIB wants, and lets go of those that it wants no
//! more.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::Arc;

use gdp::port::Port;
use gdp_wire::Name;
use tokio::sync::watch;
use tokio::task::{AbortHandle, JoinSet};

use super::Daemon;
use super::ports::keep_link;
use crate::config::{Place, Via};

/// The border switches of other domains that this one is to have links with, and where they are.
pub type Wanted = BTreeMap<Name, SocketAddr>;

/// Keeps the wanted links until the daemon ends.
pub async fn run(daemon: Arc<Daemon>, port: Arc<Port>, mut wanted: watch::Receiver<Wanted>) {
    let (mut tasks, mut kept) = (JoinSet::new(), BTreeMap::<Name, (SocketAddr, AbortHandle)>::new());
    loop {
        let now = wanted.borrow_and_update().clone();
        kept.retain(|switch, (addr, task)| {
            let stays = now.get(switch) == Some(addr);
            if !stays {
                task.abort();
                let link = daemon.core().link_to(switch);
                link.inspect(|link| link.close("nobody exchanges messages by this peering any more"));
            }
            stays
        });
        for (switch, addr) in now {
            kept.entry(switch).or_insert_with(|| {
                let (daemon, port, place) = (daemon.clone(), port.clone(), Place { switch, via: Via::Udp(addr) });
                (addr, tasks.spawn(async move { keep_link(&daemon, &port, place).await }))
            });
        }
        while tasks.try_join_next().is_some() {}
        if wanted.changed().await.is_err() {
            return;
        }
    }
}
