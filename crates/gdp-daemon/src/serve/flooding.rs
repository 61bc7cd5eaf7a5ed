//! This switch's part in the topology: tells it which neighbours there are and what they cost,
//! carries statements between it and the neighbours, and gives the paths to the data planes and the
//! RIB here. The rules are in [`gdp_rib::topology`].

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use gdp_core::cert::Adjoining;
use gdp_core::domain::Relationship;
use gdp_core::peer::Role;
use gdp_link::link::Link;
use gdp_link::port::LinkAddr;
use gdp_proto::control::{Flooded, Refusal, RefusalCode, Request, Response};
use gdp_wire::{LinkRole, Name};
use tokio::sync::watch;
use tokio::time::{Instant, sleep_until};

use super::core::{Core, LinkState};
use super::events::Event;
use super::{Daemon, interfaces, ports};
use gdp_rib::topology::cost::Meter;
use gdp_rib::topology::{Batch, Verified};

/// The switches that a switch has links with.
#[derive(Default, PartialEq, Eq)]
pub struct Adjacencies {
    /// Those of its domain, and what a frame to each costs.
    pub neighbours: BTreeMap<Name, u32>,
    /// Those of them whose links are only held.
    pub silent: BTreeSet<Name>,
    /// Those of other domains, by domain and switch.
    pub borders: BTreeMap<(Name, Name), Adjoining>,
}

/// Keeps the topology up to date until the daemon ends.
pub async fn run(daemon: Arc<Daemon>) {
    loop {
        let (batches, next) = {
            let mut core = daemon.core();
            let (batches, other_paths) = core.follow_topology();
            daemon.set_costs(&core.topology.paths().costs);
            core.follow_borders();
            if core.follow_rib() && other_paths {
                daemon.report.notify_one();
            }
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
            tracing::warn!(neighbour = %format_args!("{neighbour:#}"), %error, "refused what a neighbour says of the \
                                                      topology");
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
    /// This switch's adjacencies with other switches: those that frames may go by.
    pub fn adjacencies(&self) -> Adjacencies {
        const SWITCH: u32 = LinkRole::Switch as u32;
        let live = self.links.values().filter(|state| !self.is_dark(state.to));
        let live = live.map(|state| (true, state.role(), state.link.peer().name, Some(&state.admission.standing)));
        let held = self.held.iter().filter(|held| !self.is_dark(held.to));
        let held = held.map(|held| (false, held.entry.role, held.peer, held.standing.as_ref()));
        let mut all = Adjacencies::default();
        for (is_live, role, switch, standing) in live.chain(held) {
            match standing {
                Some(Relationship::Border { domain, ours, theirs }) => {
                    let (domain, cost) = (*domain, self.cost(&switch));
                    let (transit, ours_transit) = (theirs.transit, ours.transit);
                    let parent = self.parent_rank(&switch);
                    let border = Adjoining { domain, switch, cost, transit, ours_transit, parent };
                    all.borders.insert((domain, switch), border);
                }
                _ if role == SWITCH => {
                    let is_new = all.neighbours.insert(switch, self.cost(&switch)).is_none();
                    if is_new && !is_live {
                        all.silent.insert(switch);
                    }
                }
                _ => {}
            }
        }
        all
    }

    /// Whether the interface that frames to an address leave by has no carrier.
    pub(super) fn is_dark(&self, to: LinkAddr) -> bool {
        matches!(to, LinkAddr::Ethernet { ifindex, .. } if self.dark.contains(&ifindex))
    }

    /// What a frame to a neighbouring switch costs.
    fn cost(&self, switch: &Name) -> u32 {
        let configured = self.neighbours.iter().find(|n| n.place.switch == *switch).and_then(|n| n.cost);
        configured.unwrap_or_else(|| self.meters.get(switch).map_or(1, Meter::cost))
    }

    /// Whether the RIB of a neighbour's domain is a parent of this one's, and before which others.
    fn parent_rank(&self, switch: &Name) -> Option<u8> {
        let index = self.neighbours.iter().position(|n| n.place.switch == *switch && n.parent)?;
        Some(u8::try_from(index).unwrap_or(u8::MAX))
    }

    /// What the data planes hold a link's peer for.
    fn role_on(&self, link: &Link) -> Option<u32> {
        self.links.get(&link.local_id()).map(LinkState::role)
    }

    /// A link is up: if it is to a switch, it is measured; if to one of the domain, the topology
    /// goes by it.
    pub(super) fn meet(&mut self, link: &Link) {
        if self.role_on(link) == Some(LinkRole::Switch as u32) {
            self.topology.link_up(link.local_id());
        }
        if link.peer().role == Role::Switch {
            let now = self.now().clock;
            self.meters.entry(link.peer().name).or_insert_with(|| Meter::new(now, Some(link.rtt())));
        }
    }

    /// The first request over a link was answered within this time; whether the neighbour costs
    /// something else from now on.
    pub(super) fn neighbour_answered(&mut self, link: &Link, rtt: Duration) -> bool {
        let now = self.now().clock;
        self.meters.get_mut(&link.peer().name).is_some_and(|meter| meter.answered(now, rtt))
    }

    /// Takes a sample of the round-trip time to each neighbour; whether one of them costs something
    /// else from now on.
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

    /// The interfaces without a carrier are now these: no frame goes by them. Whether that are
    /// others than before.
    fn set_dark(&mut self, dark: BTreeSet<u32>) -> bool {
        let changed = dark != self.dark;
        self.dark = dark;
        changed
    }

    /// Brings the topology up to date, and with it what follows. Returns what is to be sent over
    /// which link, and whether there are other paths than before, or another RIB.
    fn follow_topology(&mut self) -> (Vec<(Link, Batch)>, bool) {
        let (now, own) = (self.now(), self.name());
        let Adjacencies { neighbours, silent, borders } = self.adjacencies();
        // Where nobody is any more, a new link begins with a new measurement.
        self.meters.retain(|switch, _| self.peers.contains_key(&(*switch, 0)) || self.held.keeps(switch));
        self.topology.set_neighbours(neighbours);
        self.topology.set_silent(silent);
        self.topology.set_borders(borders.into_values());
        self.topology.set_bit(self.routes.own_bit());
        let changed = self.topology.tick(now.clock);
        if changed {
            let changes = self.routes.set_paths(self.topology.paths(), &own);
            tracing::debug!(changes = changes.len(), "other paths");
            let (switches, reached) = (self.topology.states().count(), self.topology.paths().costs.len());
            self.events.tell(Event::Topology { switches, reached });
            self.carry_out(changes);
            if let Some(rib) = &mut self.rib {
                rib.set_paths(now, self.topology.paths().clone());
            }
        }
        let batches = self.topology.batches(now.clock).into_iter();
        let batches = batches.filter_map(|batch| Some((self.links.get(&batch.id.link)?.link.clone(), batch)));
        (batches.collect(), changed)
    }
}
