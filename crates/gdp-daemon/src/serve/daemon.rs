//! A running daemon's shared state, and what its tasks wake each other by.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

use gdp_core::revocations::SignedRevocation;
use gdp_link::port::{Port, PortConfig};
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

/// A running daemon's shared state.
pub struct Daemon {
    pub(super) name: Name,
    pub(super) port_config: PortConfig,
    core: Mutex<Core>,
    pub(super) revocations: StoredRevocations,
    /// Its part, if this is one of several replicas of the RIB.
    pub(super) replica: Option<Replica>,
    /// What is stored of the domain, if this is a member of one.
    domain_store: Option<DomainStore>,
    ports: Mutex<HashMap<String, Arc<Port>>>,
    /// Where links over UDP are accepted.
    pub(super) udp: OnceLock<SocketAddr>,
    /// A lock for each task that runs or waits.
    serialized: Mutex<HashMap<SerializedTask, Arc<tokio::sync::Mutex<()>>>>,
    pub(super) report: Notify,
    pub(super) topology: Notify,
    pub(super) rib_changed: Notify,
    /// What paths from here cost.
    pub(super) costs: watch::Sender<PathCosts>,
    /// Switches have answered the RIB here.
    pub(super) answered: Notify,
    stopping: AtomicBool,
    tasks: Mutex<JoinSet<()>>,
}

/// What is done by one task at a time.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub enum SerializedTask {
    /// Serving a link of this lane of an entity.
    Lane(Name, u8),
    /// Attaching an entity, or detaching it.
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
            serialized: Mutex::default(),
            report: Notify::new(),
            topology: Notify::new(),
            rib_changed: Notify::new(),
            costs: watch::Sender::default(),
            answered: Notify::new(),
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

    pub fn is_stopping(&self) -> bool {
        self.stopping.load(Ordering::Relaxed)
    }

    /// Runs a task until it ends or the daemon does.
    pub fn spawn(&self, task: impl Future<Output = ()> + Send + 'static) {
        let mut tasks = self.tasks.lock();
        if self.is_stopping() {
            return;
        }
        while tasks.try_join_next().is_some() {}
        tasks.spawn(task);
    }

    /// Ends all tasks; no other begins.
    pub async fn end_tasks(&self) {
        self.stopping.store(true, Ordering::Relaxed);
        let mut tasks = std::mem::take(&mut *self.tasks.lock());
        tasks.shutdown().await;
    }

    /// Runs `work` after earlier ones of the same task.
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

    /// Neighbours came or went, cost something else, or say something new; or this switch has
    /// another egress bit.
    pub fn topology_changed(&self) {
        self.topology.notify_one();
    }

    /// The RIB may know less, or more, of this switch's endpoints than are here.
    pub fn report_in_full(&self) {
        self.core().rib_client.report = Report::Due;
        self.report.notify_one();
    }

    /// A RIB has said something: this switch may have another egress bit, which it is to state; and
    /// may have to find out who is the RIB.
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

    /// Returns once what has been revoked by now is in the file; to be called before it is
    /// confirmed.
    pub async fn save_revocations(&self) -> Result<(), Refusal> {
        let taken = self.core().rib_host.rib.as_ref().map_or(0, |rib| rib.revocations_taken());
        let collect = || {
            let core = self.core();
            core.rib_host.rib.as_ref().map(|rib| (rib.revocations_taken(), rib.signed_revocations()))
        };
        self.revocations.save(taken, collect).await
    }

    /// Returns once what is known of the domain by now is in its files; to be called before it is
    /// confirmed.
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
