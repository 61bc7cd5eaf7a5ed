//! The daemon: ports and links, the switch's part of the control plane, the RIB if it is here, the
//! admin socket. Thin tasks around [`core`]; the rules are in [`gdp_rib::rib`] and [`routes`], the
//! data planes in [`gdp_dataplane`].

pub mod admin;
mod control;
pub mod core;
mod costs;
pub mod crossing;
mod domain;
mod ends;
pub mod events;
mod federation;
mod fence;
mod flooding;
mod graceful_restart;
pub mod interfaces;
mod links;
mod liveness;
mod peering;
mod ports;
mod ready;
mod refusals;
mod replica;
mod report;
mod retries;
mod revocation_store;
pub mod routes;
mod status;
mod term;
mod tiers;
mod trace;
mod warnings;

use std::collections::HashMap;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use gdp_core::identity::Identity;
use gdp_core::secret_file::SecretFileError;
use gdp_link::link::{LinkError, LinkIds};
use gdp_link::port::{Port, PortConfig};
use gdp_proto::control::PathCosts;
use gdp_wire::Name;
use parking_lot::{Mutex, MutexGuard};
use tokio::sync::{Notify, watch};
use tokio::task::JoinSet;

use self::control::Report;
use self::core::Core;
use self::domain::StoredDomain;
pub use self::ready::Ready;
use self::replica::Replica;
use self::revocation_store::StoredRevocations;
use crate::config::{Config, DataPlane};
use gdp_dataplane::{PinLocation, PlaneConfig, PlaneError, Planes, Wanted, host_pair};
use gdp_util::unix_time::unix_nanos;

/// How often the addresses of peers are looked at, because QUIC moves without saying so; how far
/// they are; and links that are held.
const FOLLOW: Duration = Duration::from_millis(500);

/// Why a daemon does not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    #[error(transparent)]
    Identity(#[from] SecretFileError),
    #[error(transparent)]
    Membership(#[from] domain::MembershipError),
    #[error("cannot create the folder {}: {source}", path.display())]
    Folder { path: PathBuf, source: std::io::Error },
    #[error(transparent)]
    Plane(#[from] PlaneError),
    #[error(transparent)]
    Link(#[from] LinkError),
    #[error("cannot ask the kernel for its interfaces: {0}")]
    Netlink(#[from] rtnetlink::Error),
    #[error(
        "this daemon has no interface and no UDP address, so nobody can reach it; name interfaces, or set udp: \
         0.0.0.0:31415"
    )]
    NoPort,
    #[error(transparent)]
    Admin(#[from] admin::AdminError),
    #[error(transparent)]
    Store(#[from] crate::store::StoreError),
}

/// A running daemon's shared state.
pub struct Daemon {
    name: Name,
    port_config: PortConfig,
    core: Mutex<Core>,
    revocations: StoredRevocations,
    /// Its part, if this is one of several replicas of the RIB.
    replica: Option<Replica>,
    /// What is kept of the domain, if this is a member of one.
    domain: Option<StoredDomain>,
    ports: Mutex<HashMap<String, Arc<Port>>>,
    /// Where links over UDP are taken.
    udp: OnceLock<SocketAddr>,
    /// Who is at each place, and who waits to be.
    turns: Mutex<HashMap<SerializedTask, Arc<tokio::sync::Mutex<()>>>>,
    report: Notify,
    topology: Notify,
    rib_changed: Notify,
    /// What paths from here cost.
    costs: watch::Sender<PathCosts>,
    /// Switches have answered the RIB here.
    answered: Notify,
    stopping: AtomicBool,
    tasks: Mutex<JoinSet<()>>,
}

/// What is done by one at a time.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum SerializedTask {
    /// Serving a link of this lane of an entity.
    Lane(Name, u8),
    /// Attaching an entity, or detaching it.
    Entity(Name),
}

/// A daemon that runs until [`Running::stop`].
pub struct Running {
    daemon: Arc<Daemon>,
    udp: Option<Arc<Port>>,
    admin: admin::Listening,
    ready: Ready,
}

/// Starts a daemon: everything that can be wrong is wrong here, or waited for.
pub async fn start(config: Config) -> Result<Running, StartError> {
    make_folder(&config.identity)?;
    let identity = Identity::load_or_generate(&config.identity, "switch")?;
    let wanted = match config.data_plane {
        DataPlane::Auto => Wanted::Auto,
        DataPlane::Xdp => Wanted::Xdp,
        DataPlane::Dpdk => Wanted::Dpdk,
        DataPlane::Userspace => Wanted::Userspace,
    };
    let planes = Planes::open(PlaneConfig {
        wanted,
        ebpf_object: config.ebpf_object.clone(),
        fib_capacity: config.fib_capacity,
        dpdk: config.dpdk.clone(),
        // Like the settings themselves, it is gone when the machine starts anew.
        dpdk_settings: Some(config.socket.with_extension("settings")),
        pins: config.bpffs.clone().map(|bpffs| PinLocation { bpffs, switch: identity.name() }),
        ..PlaneConfig::default()
    })?;
    let link_ids = LinkIds::new();
    let has_rib = config.rib && config.etcd.is_none();
    let mut core = Core::new(identity.clone(), config.neighbours.clone(), has_rib, planes);
    core.take_over(&link_ids);
    let revocations = StoredRevocations::recall(&config.identity, &mut core)?;
    let port_config = PortConfig { rekey: config.rekey, ..PortConfig::switch(identity.clone(), link_ids) };
    let mut domain = None;
    if let Some(domain_config) = &config.domain {
        let (kept, member) = StoredDomain::recall(domain_config, &identity, &config.identity)?;
        port_config.papers.set(member.trust.papers().clone());
        (domain, core.domain) = (Some(kept), Some(member));
        core.federate(unix_nanos());
        core.public = config.public.clone();
        core.shown_inside = domain_config.trace;
    }
    let shown = port_config.papers.clone();
    let daemon = Arc::new(Daemon {
        name: identity.name(),
        port_config,
        core: Mutex::new(core),
        revocations,
        replica: config.etcd.as_ref().map(Replica::new).transpose()?,
        domain,
        ports: Mutex::default(),
        udp: OnceLock::new(),
        turns: Mutex::default(),
        report: Notify::new(),
        topology: Notify::new(),
        rib_changed: Notify::new(),
        costs: watch::Sender::default(),
        answered: Notify::new(),
        stopping: AtomicBool::new(false),
        tasks: Mutex::default(),
    });
    let interfaces = interfaces_to_use(&config).await?;
    let changes = ports::watch_interfaces(&daemon);
    let admin = admin::listen(&daemon, &config.socket)?;
    let mut opened = Vec::new();
    for name in &interfaces {
        opened.push(match ports::open_ethernet(&daemon, name) {
            Ok(port) => Some(port),
            Err(error) if is_absent(&error) || config.all_interfaces && !is_denied(&error) => {
                tracing::warn!("{name} is not used for now: {error}");
                None
            }
            Err(error) => return Err(error),
        });
    }
    let (udp, no_pair) = match config.udp {
        Some(bind) => {
            let (port, no_pair) = ports::open_udp(&daemon, bind).await?;
            (Some((bind, port)), no_pair)
        }
        None => {
            // An earlier daemon may have been killed, and configured otherwise.
            ports::remove_host_pair(&daemon).await;
            (None, None)
        }
    };
    if interfaces.is_empty() && udp.is_none() {
        return Err(StartError::NoPort);
    }
    let mut ready = Ready {
        switch: daemon.name,
        rib: config.rib,
        udp: udp.as_ref().and_then(|(_, port)| port.udp_addr()),
        ethernet: Vec::new(),
        awaited: Vec::new(),
        planes: Vec::new(),
        no_xdp: None,
        in_userspace: no_pair.into_iter().collect(),
        socket: config.socket.clone(),
    };
    for (name, port) in interfaces.iter().zip(&opened) {
        if port.is_some() { &mut ready.ethernet } else { &mut ready.awaited }.push(name.clone());
    }
    ready.look_at(&daemon.core().planes);
    for (name, port) in interfaces.into_iter().zip(opened) {
        daemon.spawn(ports::run_ethernet(daemon.clone(), name, port, changes.clone()));
    }
    if let Some((bind, port)) = &udp {
        port.udp_addr().map(|addr| daemon.udp.set(addr));
        daemon.spawn(ports::run_udp(daemon.clone(), port.clone(), *bind, changes.clone()));
        let wanted = daemon.core().peerings.subscribe();
        daemon.spawn(peering::run(daemon.clone(), port.clone(), wanted));
    }
    daemon.spawn(report::report(daemon.clone()));
    daemon.spawn(flooding::run(daemon.clone()));
    daemon.spawn(trace::run(daemon.clone()));
    daemon.spawn(flooding::watch_carrier(daemon.clone(), changes));
    daemon.spawn(report::rib_clock(daemon.clone()));
    daemon.spawn(replica::run(daemon.clone()));
    daemon.spawn(follow_addresses(daemon.clone()));
    daemon.report.notify_one();
    if let Some(config) = config.domain {
        daemon.spawn(domain::watch(daemon.clone(), config, shown));
    }
    Ok(Running { daemon, udp: udp.map(|(_, port)| port), admin, ready })
}

impl Running {
    pub fn name(&self) -> Name {
        self.daemon.name
    }

    /// Where links over UDP are taken.
    pub fn udp_addr(&self) -> Option<SocketAddr> {
        self.udp.as_ref()?.udp_addr()
    }

    /// What it had when it was ready.
    pub fn ready(&self) -> &Ready {
        &self.ready
    }

    /// What `gdp-ctl status` shows.
    pub async fn status(&self) -> serde_json::Value {
        status::status(&self.daemon).await
    }

    /// Whether the kernel forwards on if this process ends without [`Self::stop`].
    pub fn outlives(&self) -> bool {
        self.daemon.core().planes.outlives()
    }

    /// If this is the leader of several replicas of the RIB, it is no more when this returns, so
    /// that another one leads at once.
    pub async fn resign(&self) {
        if let Some(replica) = &self.daemon.replica {
            replica.resign().await;
        }
    }

    /// Tells peers, closes everything and takes the XDP programs off.
    pub async fn stop(self) {
        self.resign().await;
        self.daemon.stopping.store(true, Ordering::Relaxed);
        // First, so that nobody opens again what is closed here.
        let mut tasks = std::mem::take(&mut *self.daemon.tasks.lock());
        tasks.shutdown().await;
        // What they were to keep. If it cannot be kept, that is in the log.
        let _ = self.daemon.keep_domain().await;
        let _ = self.daemon.keep_revocations().await;
        let mut ports: Vec<_> = std::mem::take(&mut *self.daemon.ports()).into_values().collect();
        ports.extend(self.udp);
        futures::future::join_all(ports.iter().map(|port| port.close("shutting down"))).await;
        drop(ports);
        self.daemon.core().planes.detach_all();
        ports::remove_host_pair(&self.daemon).await;
        drop(self.admin);
    }
}

impl Daemon {
    fn core(&self) -> MutexGuard<'_, Core> {
        let mut core = self.core.lock();
        core.end_term();
        core
    }

    fn ports(&self) -> MutexGuard<'_, HashMap<String, Arc<Port>>> {
        self.ports.lock()
    }

    fn is_stopping(&self) -> bool {
        self.stopping.load(Ordering::Relaxed)
    }

    /// Runs a task until it ends or the daemon does.
    fn spawn(&self, task: impl Future<Output = ()> + Send + 'static) {
        let mut tasks = self.tasks.lock();
        if self.is_stopping() {
            return;
        }
        while tasks.try_join_next().is_some() {}
        tasks.spawn(task);
    }

    /// Neighbours came or went, cost something else, or say something new; or this switch has
    /// another egress bit.
    fn topology_changed(&self) {
        self.topology.notify_one();
    }

    /// The RIB may hold less, or more, of this switch's endpoints than are here.
    fn report_in_full(&self) {
        self.core().report = Report::Due;
        self.report.notify_one();
    }

    fn turns(&self, place: SerializedTask) -> Arc<tokio::sync::Mutex<()>> {
        self.turns.lock().entry(place).or_default().clone()
    }

    /// Forgets a place that nobody is at or waits for.
    fn leave(&self, place: SerializedTask) {
        let mut turns = self.turns.lock();
        if turns.get(&place).is_some_and(|held| Arc::strong_count(held) == 1) {
            turns.remove(&place);
        }
    }
}

async fn follow_addresses(daemon: Arc<Daemon>) {
    loop {
        tokio::time::sleep(FOLLOW).await;
        let (lost, neighbours_changed) = {
            let mut core = daemon.core();
            core.follow_addresses();
            let cost_changed = core.measure();
            let (lost, neighbours_lost) = core.end_hold(std::time::Instant::now());
            (lost, neighbours_lost || cost_changed)
        };
        if neighbours_changed {
            daemon.topology_changed();
        }
        for entity in lost {
            tracing::info!(entity = %format_args!("{entity:#}"), "an endpoint did not come back");
            daemon.spawn(links::detach_lost(daemon.clone(), entity));
        }
    }
}

/// The interfaces that are to have links on Ethernet.
async fn interfaces_to_use(config: &Config) -> Result<Vec<String>, StartError> {
    let mut used = config.named_interfaces();
    if config.all_interfaces {
        let found = interfaces::list().await?;
        let all = found.into_iter().filter(|i| i.up && i.ethernet && !host_pair::is_end(&i.name));
        used.extend(all.map(|interface| interface.name).filter(|name| !config.named_interfaces().contains(name)));
    }
    Ok(used)
}

fn is_absent(error: &StartError) -> bool {
    matches!(os_error(error), Some(libc::ENODEV | libc::ENETDOWN))
}

fn is_denied(error: &StartError) -> bool {
    matches!(os_error(error), Some(libc::EPERM | libc::EACCES))
}

fn os_error(error: &StartError) -> Option<i32> {
    let StartError::Link(LinkError::Io { source, .. }) = error else { return None };
    source.raw_os_error()
}

fn make_folder(file: &std::path::Path) -> Result<(), StartError> {
    use std::os::unix::fs::DirBuilderExt;
    let Some(folder) = file.parent().filter(|folder| !folder.as_os_str().is_empty()) else { return Ok(()) };
    std::fs::DirBuilder::new()
        .recursive(true)
        .mode(0o700)
        .create(folder)
        .map_err(|source| StartError::Folder { path: folder.into(), source })
}
