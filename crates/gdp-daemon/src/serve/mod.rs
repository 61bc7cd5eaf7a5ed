//! The daemon: ports and links, the switch's part of the control plane, the RIB if it is here, and
//! the admin socket.
//!
//! Thin tasks surround [`core`]. The rules are in [`gdp_rib::rib`] and [`routes`], and the data
//! planes in [`gdp_dataplane`].

pub mod admin;
mod answering;
mod core;
mod costs;
mod crossing;
mod daemon;
mod detach;
mod domain;
mod domain_store;
mod election;
mod ends;
mod entity_requests;
pub mod events;
mod federation;
mod flooding;
mod graceful_restart;
mod inspection;
mod interface_watch;
pub mod interfaces;
mod links;
mod liveness;
pub mod metrics;
mod peering;
mod port_owner;
mod ports;
mod ready;
mod recent_refusals;
mod refusals;
mod replica;
mod report;
mod retries;
mod revocation_store;
mod routes;
mod start_error;
mod status;
mod suspicion;
mod term;
mod trace;
mod warnings;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use gdp_core::identity::Identity;
use gdp_dataplane::{PinLocation, PlaneConfig, Planes, Wanted, host_pair};
use gdp_http::Listener;
use gdp_link::link::LinkIds;
use gdp_link::port::{Port, PortConfig};
use gdp_link::tunnel::TlsListener;
use gdp_util::line_socket::Listening;
use gdp_util::ticks::next_tick;
use gdp_wire::Name;

use self::core::Core;
use self::daemon::Daemon;
use self::domain_store::DomainStore;
pub use self::ready::Ready;
use self::replica::Replica;
use self::revocation_store::StoredRevocations;
pub use self::start_error::StartError;
use crate::config::{Config, DataPlane};

/// The interval at which the daemon checks peers' addresses, because QUIC migrates without a
/// notice. It also samples round-trip times and ends stale links.
const FOLLOW: Duration = Duration::from_millis(500);

/// A daemon that runs until [`Running::stop`].
pub struct Running {
    daemon: Arc<Daemon>,
    udp: Option<Arc<Port>>,
    admin: Listening,
    ready: Ready,
}

/// Starts a daemon. All configuration errors occur here, except those that the daemon waits out.
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
        // Like the settings themselves, this file does not survive a reboot.
        dpdk_settings: Some(config.socket.with_extension("settings")),
        pins: config.bpffs.clone().map(|bpffs| PinLocation { bpffs, switch: identity.name(), replaces: config.keep }),
        ..PlaneConfig::default()
    })?;
    let link_ids = LinkIds::new();
    let has_rib = config.rib && config.etcd.is_none();
    let mut core = Core::new(identity.clone(), config.neighbours.clone(), has_rib, planes);
    core.take_over(&link_ids);
    let revocations = StoredRevocations::recall(&config.identity, core.rib_host.rib.as_mut())?;
    let port_config = PortConfig { rekey: config.rekey, ..PortConfig::switch(identity.clone(), link_ids) };
    let mut domain_store = None;
    if let Some(domain_config) = &config.domain {
        let (store, member) = DomainStore::recall(domain_config, &identity, &config.identity)?;
        port_config.credentials.set(member.trust.credentials().clone());
        domain_store = Some(store);
        core.join_domain(member, config.public.clone(), domain_config.trace);
    }
    let credentials = port_config.credentials.clone();
    let replica = config.etcd.as_ref().map(Replica::new).transpose()?;
    let daemon = Arc::new(Daemon::new(port_config, core, revocations, replica, domain_store));
    let tls = match config.tls {
        Some(addr) => Some(TlsListener::bind(addr).await.map_err(|source| StartError::Tls { addr, source })?),
        None => None,
    };
    let interfaces = interfaces_to_use(&config).await?;
    let changes = ports::watch_interfaces(&daemon);
    let admin = admin::listen(&daemon, &config.socket)?;
    let metrics = config.metrics.map(|address| gdp_http::metrics::listen(address, config.metrics_token.as_deref()));
    let metrics = metrics.transpose()?;
    config.udp.map_or(Ok(()), port_owner::expect_free)?;
    let mut opened = Vec::new();
    for name in &interfaces {
        opened.push(match ports::open_ethernet(&daemon, name) {
            Ok(port) => Some(port),
            Err(error) if error.is_absent() || config.all_interfaces && !error.is_denied() => {
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
            // An earlier daemon with another configuration may have been killed.
            ports::remove_host_pair(&daemon).await;
            (None, None)
        }
    };
    let udp_addr = udp.as_ref().and_then(|(_, port)| port.udp_addr());
    if interfaces.is_empty() && udp.is_none() {
        return Err(StartError::NoPort);
    }
    let mut ready = Ready {
        switch: daemon.name,
        rib: config.rib,
        udp: udp_addr,
        tls: tls.as_ref().and_then(|listener| listener.local_addr().ok()),
        ethernet: Vec::new(),
        awaited: Vec::new(),
        planes: Vec::new(),
        no_xdp: None,
        in_userspace: no_pair.into_iter().collect(),
        socket: config.socket.clone(),
        metrics: metrics.as_ref().map(Listener::address),
    };
    for (name, port) in interfaces.iter().zip(&opened) {
        if port.is_some() { &mut ready.ethernet } else { &mut ready.awaited }.push(name.clone());
    }
    ready.look_at(&daemon.core().switch.planes);
    let is_reached = !interfaces.is_empty() || udp_addr.is_some_and(|addr| !addr.ip().is_loopback());
    if config.domain.is_none() && is_reached {
        daemon.core().membership.is_open = true;
        tracing::warn!(
            "this switch is of no domain: every endpoint that reaches it gets a link, and can publish names of its \
             own; `gdp-ctl up` makes a domain, and `domain:` in the configuration joins one"
        );
    }
    let named = interfaces.clone();
    for (name, port) in interfaces.into_iter().zip(opened) {
        daemon.spawn(ports::run_ethernet(daemon.clone(), name, port, changes.clone()));
    }
    if let Some((bind, port)) = &udp {
        udp_addr.map(|addr| daemon.udp.set(addr));
        daemon.spawn(ports::run_udp(daemon.clone(), port.clone(), *bind, changes.clone()));
        let wanted = daemon.core().rib_client.peerings.subscribe();
        daemon.spawn(peering::run(daemon.clone(), port.clone(), wanted));
    }
    if let Some((listener, udp)) = tls.zip(udp_addr) {
        daemon.spawn(listener.run(udp, daemon.tunnels.clone()));
    }
    if let Some(listener) = metrics {
        metrics::serve(&daemon, listener);
    }
    daemon.spawn(suspicion::run(daemon.clone()));
    daemon.spawn(report::report(daemon.clone()));
    daemon.spawn(flooding::run(daemon.clone()));
    daemon.spawn(trace::run(daemon.clone()));
    daemon.spawn(interface_watch::run(daemon.clone(), named, changes));
    daemon.spawn(report::rib_clock(daemon.clone()));
    daemon.spawn(election::run(daemon.clone()));
    daemon.spawn(follow_addresses(daemon.clone()));
    daemon.report.notify_one();
    if let Some(config) = config.domain {
        daemon.spawn(domain::watch(daemon.clone(), config, credentials));
    }
    Ok(Running { daemon, udp: udp.map(|(_, port)| port), admin, ready })
}

impl Running {
    pub fn name(&self) -> Name {
        self.daemon.name
    }

    /// Returns the address that accepts links over UDP.
    pub fn udp_addr(&self) -> Option<SocketAddr> {
        self.udp.as_ref()?.udp_addr()
    }

    /// Returns the resources that the daemon had when it was ready.
    pub fn ready(&self) -> &Ready {
        &self.ready
    }

    /// Returns the status that `gdp-ctl status` shows.
    pub async fn status(&self) -> serde_json::Value {
        serde_json::to_value(status::status(&self.daemon).await).unwrap_or_default()
    }

    /// Returns whether the kernel continues to forward if this process ends without [`Self::stop`].
    pub fn outlives(&self) -> bool {
        self.daemon.core().switch.planes.outlives()
    }

    /// Waits for the next round of the periodic work, twice a second. It uses the state that all
    /// requests and links use, so a daemon that hangs has no further round. Safe to cancel.
    pub async fn worked(&self) {
        self.daemon.worked.notified().await;
    }

    /// Resigns as leader of several replicas of the RIB, so that another replica leads at once.
    pub async fn resign(&self) {
        if let Some(replica) = &self.daemon.replica {
            replica.resign().await;
        }
    }

    /// Closes all links and ports, notifies the peers, and detaches the XDP programs.
    pub async fn stop(self) {
        self.resign().await;
        // End the tasks first, so that none reopens what is closed below.
        self.daemon.end_tasks().await;
        // Save what the ended tasks had to save. A failure is in the log.
        let _ = self.daemon.save_domain().await;
        let _ = self.daemon.save_revocations().await;
        let mut ports: Vec<_> = std::mem::take(&mut *self.daemon.ports()).into_values().collect();
        ports.extend(self.udp);
        futures::future::join_all(ports.iter().map(|port| port.close("shutting down"))).await;
        drop(ports);
        self.daemon.core().switch.planes.detach_all();
        ports::remove_host_pair(&self.daemon).await;
        drop(self.admin);
    }
}

async fn follow_addresses(daemon: Arc<Daemon>) {
    loop {
        tokio::time::sleep_until(next_tick(FOLLOW, std::time::Instant::now()).into()).await;
        let (lost, neighbours_changed) = {
            let mut core = daemon.core();
            core.switch.follow_addresses();
            let cost_changed = core.measure();
            let (lost, neighbours_lost) = core.end_stale_links(std::time::Instant::now());
            (lost, neighbours_lost || cost_changed)
        };
        if neighbours_changed {
            daemon.topology_changed();
        }
        for entity in lost {
            tracing::info!(entity = %format_args!("{entity:#}"), "an endpoint did not come back");
            daemon.spawn(detach::detach_lost(daemon.clone(), entity));
        }
        daemon.worked.notify_one();
    }
}

/// Returns the interfaces to use for links on Ethernet.
async fn interfaces_to_use(config: &Config) -> Result<Vec<String>, StartError> {
    let mut used = config.named_interfaces();
    if config.all_interfaces {
        let found = interfaces::list().await?;
        let all = found.into_iter().filter(|i| i.up && i.ethernet && !host_pair::is_end(&i.name));
        used.extend(all.map(|interface| interface.name).filter(|name| !config.named_interfaces().contains(name)));
    }
    Ok(used)
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
