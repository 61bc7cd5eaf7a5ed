//! This switch's part in the topology: tells it which neighbours there are and what they cost, carries statements between it and
//! the neighbours, and gives the paths to the data planes and the RIB here. The rules are in [`crate::topology`].

use std::collections::BTreeSet;
use std::sync::Arc;

use gdp::control::{Flooded, Refusal, RefusalCode, Request, Response};
use gdp::link::Link;
use gdp::port::LinkAddr;
use gdp_wire::{LinkRole, Name};
use tokio::sync::watch;
use tokio::time::{Instant, sleep_until};

use super::core::{Core, LinkState};
use super::{Daemon, interfaces, ports};
use crate::topology::cost::Meter;
use crate::topology::{Batch, Verified};

/// Keeps the topology up to date until the daemon ends.
pub async fn run(daemon: Arc<Daemon>) {
    loop {
        let (batches, next) = {
            let mut core = daemon.core();
            let batches = core.follow_topology();
            daemon.set_costs(&core.topology.paths().costs);
            let now = core.now().clock;
            (batches, core.topology.next_tick(now).and_then(|clock| core.instant(clock)))
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
            tracing::warn!(neighbour = %format_args!("{:#}", link.peer().name), %refusal, "a neighbour refused the topology");
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

/// Takes in what a neighbour of the domain says. Signatures are verified without the lock.
pub fn take(daemon: &Daemon, from: &Link, states: Vec<Flooded>) -> Response {
    let link = from.local_id();
    let news = {
        let mut core = daemon.core();
        if core.role_on(from) == Some(LinkRole::Border as u32) {
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
            tracing::warn!(neighbour = %format_args!("{neighbour:#}"), %error, "refused what a neighbour says of the topology");
            let reason = format!("what switch {neighbour} says of the topology is refused: {error}");
            return Refusal::new(RefusalCode::BadSignature, reason).into();
        }
    }
    daemon.topology_changed();
    Response::Done
}

/// Watches which interfaces have no carrier, until the daemon ends.
pub async fn watch_carrier(daemon: Arc<Daemon>, mut changes: watch::Receiver<()>) {
    loop {
        match interfaces::without_carrier().await {
            Ok(dark) => {
                let changed = daemon.core().set_dark(dark);
                if changed {
                    daemon.topology_changed();
                }
            }
            Err(error) => tracing::warn!(%error, "cannot ask the kernel which interfaces have a carrier"),
        }
        ports::look(&mut changes).await;
    }
}

impl Core {
    /// This switch's adjacencies with other switches of its domain and their costs: those that frames may go by.
    pub fn adjacencies(&self) -> Vec<(Name, u32)> {
        const SWITCH: u32 = LinkRole::Switch as u32;
        let live = self.links.values().filter(|state| state.role() == SWITCH);
        let held = self.held.iter().filter(|held| held.entry.role == SWITCH);
        let links = live.map(|state| (state.link.peer().name, state.to)).chain(held.map(|held| (held.peer, held.to)));
        let is_dark = |to| matches!(to, LinkAddr::Ethernet { ifindex, .. } if self.dark.contains(&ifindex));
        let near: BTreeSet<Name> = links.filter(|(_, to)| !is_dark(*to)).map(|(peer, _)| peer).collect();
        let cost = |switch: &Name| {
            let configured = self.neighbours.iter().find(|n| n.place.switch == *switch).and_then(|n| n.cost);
            configured.unwrap_or_else(|| self.meters.get(switch).map_or(1, Meter::cost))
        };
        near.into_iter().map(|switch| (switch, cost(&switch))).collect()
    }

    /// What the data planes hold a link's peer for.
    fn role_on(&self, link: &Link) -> Option<u32> {
        self.links.get(&link.local_id()).map(LinkState::role)
    }

    /// A link is up: if it is to a switch of the domain, the topology goes by it.
    pub(super) fn meet(&mut self, link: &Link) {
        if self.role_on(link) == Some(LinkRole::Switch as u32) {
            self.topology.link_up(link.local_id());
            let now = self.now().clock;
            self.meters.entry(link.peer().name).or_insert_with(|| Meter::new(now, Some(link.rtt())));
        }
    }

    /// Takes a sample of the round-trip time to each neighbour; whether one of them costs something else from now on.
    pub fn measure(&mut self) -> bool {
        let now = self.now().clock;
        let mut changed = false;
        for (switch, meter) in &mut self.meters {
            let newest = self.peers.get(&(*switch, 0)).and_then(|id| self.links.get(id));
            if let Some(state) = newest.filter(|state| state.link.close_reason().is_none()) {
                changed |= meter.sample(now, state.link.rtt());
            }
        }
        changed
    }

    /// The interfaces without a carrier are now these: no frame goes by them. Whether that are others than before.
    fn set_dark(&mut self, dark: BTreeSet<u32>) -> bool {
        let changed = dark != self.dark;
        self.dark = dark;
        changed
    }

    /// Brings the topology up to date, and with it what follows. Returns what is to be sent over which link.
    fn follow_topology(&mut self) -> Vec<(Link, Batch)> {
        let (now, own) = (self.now(), self.name());
        let near = self.adjacencies();
        // Where nobody is any more, a new link begins with a new measurement.
        self.meters.retain(|switch, _| self.peers.contains_key(&(*switch, 0)) || self.held.keeps(switch));
        self.topology.set_neighbours(near);
        self.topology.set_bit(self.routes.own_bit());
        if self.topology.tick(now.clock) {
            let changes = self.routes.set_paths(self.topology.paths(), &own);
            tracing::debug!(changes = changes.len(), "other paths");
            self.carry_out(changes);
            if let Some(rib) = &mut self.rib {
                rib.set_paths(now, self.topology.paths().clone());
            }
        }
        let batches = self.topology.batches(now.clock).into_iter();
        batches.filter_map(|batch| Some((self.links.get(&batch.id.link)?.link.clone(), batch))).collect()
    }
}
