//! The shared state of a running daemon, and the notifications between its tasks.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

use gdp_core::revocations::SignedRevocation;
use gdp_link::link::Link;
use gdp_link::port::{LinkAddr, Port, PortConfig};
use gdp_link::tunnel::TunnelPeers;
use gdp_proto::control::{PathCosts, Refusal};
use gdp_wire::Name;
use parking_lot::{Mutex, MutexGuard};
use tokio::sync::{Notify, watch};
use tokio::task::JoinSet;

use super::core::Core;
use super::core::rib_client::Report;
use super::domain_store::DomainStore;
use super::replica::Replica;
use super::revocation_store::StoredRevocations;
use crate::domain::Used;

/// The shared state of a running daemon.
pub struct Daemon {
    pub(super) name: Name,
    pub(super) port_config: PortConfig,
    core: Mutex<Core>,
    pub(super) revocations: StoredRevocations,
    /// This daemon's part as one of several replicas of the RIB, if it is one.
    pub(super) replica: Option<Replica>,
    /// The stored state of the domain, if this switch is a member of one.
    domain_store: Option<DomainStore>,
    ports: Mutex<HashMap<String, Arc<Port>>>,
    /// The address that accepts links over UDP.
    pub(super) udp: OnceLock<SocketAddr>,
    /// The peers whose links are inside TLS.
    pub(super) tunnels: TunnelPeers,
    /// One lock for each task that runs or waits.
    serialized: Mutex<HashMap<SerializedTask, Arc<tokio::sync::Mutex<()>>>>,
    pub(super) report: Notify,
    pub(super) topology: Notify,
    pub(super) rib_changed: Notify,
    /// The costs of the paths from this switch.
    pub(super) costs: watch::Sender<PathCosts>,
    /// Notified when switches have answered the local RIB.
    pub(super) answered: Notify,
    /// Notified when the data plane at the other end of a link to a switch no longer answers.
    pub(super) silent: Notify,
    /// Notified after each round of the periodic work.
    pub(super) worked: Notify,
    stopping: AtomicBool,
    tasks: Mutex<JoinSet<()>>,
}

/// A kind of work of which only one instance runs at a time.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub enum SerializedTask {
    /// Serving a link on this lane of an entity.
    Lane(Name, u8),
    /// Attaching or detaching an entity.
    Entity(Name),
}

impl Daemon {
    pub fn new(
        port_config: PortConfig,
        core: Core,
        revocations: StoredRevocations,
        replica: Option<Replica>,
        domain_store: Option<DomainStore>,
    ) -> Self {
        Self {
            name: core.name(),
            port_config,
            core: Mutex::new(core),
            revocations,
            replica,
            domain_store,
            ports: Mutex::default(),
            udp: OnceLock::new(),
            tunnels: TunnelPeers::default(),
            serialized: Mutex::default(),
            report: Notify::new(),
            topology: Notify::new(),
            rib_changed: Notify::new(),
            costs: watch::Sender::default(),
            answered: Notify::new(),
            silent: Notify::new(),
            worked: Notify::new(),
            stopping: AtomicBool::new(false),
            tasks: Mutex::default(),
        }
    }

    pub fn core(&self) -> MutexGuard<'_, Core> {
        let mut core = self.core.lock();
        core.end_term();
        core
    }

    pub fn ports(&self) -> MutexGuard<'_, HashMap<String, Arc<Port>>> {
        self.ports.lock()
    }

    /// Returns the address of a link's peer, for people. Over TLS it is the real one, not that of
    /// the tunnel's loopback socket.
    pub fn peer_address(&self, link: &Link) -> String {
        let addr = link.addr();
        let peer = if let LinkAddr::Udp(addr) = addr { self.tunnels.get(addr) } else { None };
        peer.map_or_else(|| addr.to_string(), |peer| format!("tls:{peer}"))
    }

    pub fn is_stopping(&self) -> bool {
        self.stopping.load(Ordering::Relaxed)
    }

    /// Runs a task until it or the daemon ends.
    pub fn spawn(&self, task: impl Future<Output = ()> + Send + 'static) {
        let mut tasks = self.tasks.lock();
        if self.is_stopping() {
            return;
        }
        while tasks.try_join_next().is_some() {}
        tasks.spawn(task);
    }

    /// Ends all tasks, and prevents new ones.
    pub async fn end_tasks(&self) {
        self.stopping.store(true, Ordering::Relaxed);
        let mut tasks = std::mem::take(&mut *self.tasks.lock());
        tasks.shutdown().await;
    }

    /// Runs `work` after earlier work under the same key.
    pub async fn in_turn<T>(&self, task: SerializedTask, work: impl Future<Output = T>) -> T {
        let lock = self.serialized.lock().entry(task).or_default().clone();
        let turn = lock.lock().await;
        let result = work.await;
        drop(turn);
        drop(lock);
        let mut all = self.serialized.lock();
        if all.get(&task).is_some_and(|unused| Arc::strong_count(unused) == 1) {
            all.remove(&task);
        }
        result
    }

    /// Wakes the topology task, because an adjacency, a cost, a link state or this switch's egress
    /// bit has changed.
    pub fn topology_changed(&self) {
        self.topology.notify_one();
    }

    /// Schedules a full report, because the RIB's list of this switch's endpoints may be wrong.
    pub fn report_in_full(&self) {
        self.core().rib_client.report = Report::Due;
        self.report.notify_one();
    }

    /// Wakes the tasks that follow a message of a RIB. The topology task floods a new egress bit.
    /// The report task finds the current RIB if a report is due.
    pub fn wake_after_rib(&self) {
        let (other_bit, is_report_due) = {
            let core = self.core();
            (core.switch.routes.own_bit() != core.topology.bit(), core.rib_client.report == Report::Due)
        };
        if other_bit {
            self.topology_changed();
        }
        if is_report_due {
            self.report.notify_one();
        }
    }

    /// Waits until all current revocations are in the file. Callers confirm a revocation only after
    /// this.
    pub async fn save_revocations(&self) -> Result<(), Refusal> {
        let taken = self.core().rib_host.rib.as_ref().map_or(0, |rib| rib.revocations_taken());
        let collect = || {
            let core = self.core();
            core.rib_host.rib.as_ref().map(|rib| (rib.revocations_taken(), rib.signed_revocations()))
        };
        self.revocations.save(taken, collect).await
    }

    /// Waits until the current state of the domain is in its files. Callers confirm a change only
    /// after this.
    pub async fn save_domain(&self) -> Result<(), Refusal> {
        let Some(store) = &self.domain_store else { return Ok(()) };
        let changes = self.core().membership.domain.as_ref().map_or(0, |domain| domain.changes);
        let collect = || {
            let core = self.core();
            let domain = core.membership.domain.as_ref()?;
            let revocations: Vec<SignedRevocation> = domain.trust.revocations().cloned().collect();
            let used: Vec<Used> = domain.invitations.all().copied().collect();
            Some((domain.changes, (revocations, used)))
        };
        store.save(changes, collect).await
    }
}
