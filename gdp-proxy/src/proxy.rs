//! Assembles the proxy. It joins the ROS graphs, attaches to the switch, runs a route for each
//! topic and direction, and writes statistics. At the end it leaves the graphs and the fabric in
//! order.

use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow};
use gdp::unstable::{LinkConfig, LinkState, LinkStatus, Node, NodeConfig, NodeCounters};
use gdp_core::crypto::Backend;
use gdp_core::domain::CredentialFiles;
use gdp_link::link::RekeySchedule;
use gdp_util::line_limit::differ_in_digits_at_most;
use gdp_util::service_manager::ServiceManager;
use gdp_util::ticks::Ticks;
use tokio::sync::watch;

use crate::admin;
use crate::automatic::{self, Automatic, CatalogStats, Links};
use crate::call::CallStats;
use crate::carries::Carries;
use crate::config::{Config, LinkEntry};
use crate::diagnostics::{self, Diagnostics};
use crate::directory::{self, Members};
use crate::graph;
use crate::interfaces::Interfaces;
use crate::manager::ChangeCounts;
use crate::reload::{LoadError, Loaded, Watch};
use crate::route_material::RouteMaterial;
use crate::route_status::{RouteStatus, ticks};
use crate::routes::{self, CallPlan, Calls, Planned, RoutePlan, Routes};
use crate::silence;
use crate::stats::{RouteStats, Stats, StatsFile, VERSION};
use gdp_ros::types::Types;

const STATS_PERIOD: Duration = Duration::from_secs(1);

/// Time of one attempt to connect to a switch.
const CONNECT_PATIENCE: Duration = Duration::from_secs(10);

/// Time after which the log reports that no switch has answered.
const SILENCE: Duration = Duration::from_secs(2);

/// Status lines for the service manager. A switch that is away is no reason to restart the proxy.
const CONNECTED: &str = "connected to the switch";
const LOST: &str = "the link to the switch is lost; trying on";
const TRYING: &str = "no switch answers yet; trying on";

/// The log line if nothing says why.
const OPEN: &str = "no answer yet; is `gdp-ctl up` or `gdp-ctl serve` running there, and UDP open on the way?";

/// Runs until `stop` completes, or an error occurs that only a restart can fix. `watch` watches the
/// configuration that was loaded.
pub async fn run(
    mut loaded: Loaded,
    watch: Watch,
    stats: Option<StatsFile>,
    stop: impl Future<Output = ()>,
) -> Result<()> {
    tracing::info!(crypto = %Backend::selected(), "cryptography of messages");
    // The relay starts first and ends last: others need it whether or not this proxy reaches a
    // switch itself.
    let relay = match loaded.material.relay.take() {
        Some(relay) => Some(relay.start().await.context("relay")?),
        None => None,
    };
    let mut manager = ServiceManager::from_environment();
    manager.status("connecting to the switch");
    let ended = carry(loaded, watch, stats, stop, &mut manager).await;
    manager.stopping();
    if let Some(relay) = relay {
        relay.stop().await;
    }
    ended
}

/// Runs the routes, without the relay.
async fn carry(
    mut loaded: Loaded,
    mut watch: Watch,
    stats: Option<StatsFile>,
    stop: impl Future<Output = ()>,
    manager: &mut ServiceManager,
) -> Result<()> {
    watch.taken(&loaded);
    if let Some(file) = &stats {
        file.probe().with_context(|| format!("{}: cannot be written", file.path().display()))?;
    }
    let mut stop = std::pin::pin!(stop);
    let (_serving, mut requests) = admin::serve(&loaded.config)?;
    let node = {
        let mut connecting = std::pin::pin!(connect(&loaded, manager));
        loop {
            tokio::select! {
                node = &mut connecting => break node?,
                () = &mut stop => return Ok(()),
                request = requests.next() => drop(request.send(unattached(&loaded))),
            }
        }
    };
    let ros_node = format!("{}{}", graph::NODE, &node.name().to_string()[..8]);
    let types = Arc::new(Types::load(loaded.config.definitions.folders()).context("definitions")?);
    // From before the graphs look at the interfaces.
    let mut interfaces = Interfaces::new(node.network_changes());
    let mut graphs = graph::All::new();
    graph::join(&mut graphs, &loaded.config.graphs, &ros_node).await?;
    tracing::info!(entity = %node.name(), graphs = ?graphs.keys(), "attached to the switch and in the ROS graphs");

    let files = loaded.config.domain.as_ref().map(CredentialFiles::from);
    let watched = loaded.material.credentials.take().map(|(_, watched)| watched);
    let mut keeping = std::pin::pin!(async {
        match files.as_ref().zip(watched) {
            Some((files, watched)) => node.follow_credentials(files, watched).await,
            None => std::future::pending().await,
        }
    });

    let mut running = Running {
        routes: routes::manager(node.clone(), types.clone()),
        calls: routes::manager(node.clone(), types.clone()),
        catalogs: automatic::manager(node.clone()),
    };
    let mut explicit = Explicit::new(&loaded, &graphs)?;
    let directory_status = directory::status(loaded.material.directory.as_ref());
    let (found_members, mut members) = watch::channel(Members::default());
    let mut following = std::pin::pin!(directory::follow(
        &node,
        loaded.material.directory.take(),
        directory_status.as_ref(),
        &found_members
    ));
    let mut automatic = Automatic::new(&loaded, &graphs, node.name(), &[], None)?;
    running.want(&mut automatic, &explicit);
    manager.ready(CONNECTED);
    let mut is_connected = true;
    let mut looks = ticks();
    let mut stats_writer = StatsWriter::new(stats);
    let mut diagnostics = Diagnostics::wanted(&loaded.config, node.name(), &graphs, &types).await;
    let ended = loop {
        tokio::select! {
            () = &mut stop => break Ok(()),
            () = interfaces.changed() => graphs.values().for_each(|graph| graph.interfaces_changed()),
            error = running.failed() => break Err(error),
            () = automatic.changed() => {
                running.want(&mut automatic, &explicit);
            }
            _ = looks.tick() => {
                running.look();
                manager.alive(Instant::now());
                if is_connected != node.switch().is_ok() {
                    is_connected = !is_connected;
                    manager.status(status(is_connected));
                }
                if let Some(status) = &directory_status {
                    directory::look(status, &node);
                }
            }
            () = stats_writer.due() => stats_writer.show(&running.stats(&node, directory_status.as_ref())),
            request = requests.next() => drop(request.send(running.stats(&node, directory_status.as_ref()))),
            () = diagnostics::due(&mut diagnostics) => {
                if let Some(diagnostics) = &mut diagnostics {
                    let clocks = node.clock_differences();
                    diagnostics.tell(&running.routes.stats(), &clocks, &graphs, &types).await;
                }
            }
            () = watch.changed() => {
                manager.reloading();
                match load_again(&loaded, &watch, &mut graphs, &ros_node).await {
                Ok(new) => {
                    let (new_config, old_config) = (&new.config, &loaded.config);
                    if new_config.diagnostics != old_config.diagnostics || new_config.graphs != old_config.graphs {
                        diagnostics = Diagnostics::wanted(&new.config, node.name(), &graphs, &types).await;
                    }
                    loaded = new;
                    watch.taken(&loaded);
                    explicit = Explicit::new(&loaded, &graphs)?;
                    let known = members.borrow().clone();
                    automatic = Automatic::new(&loaded, &graphs, node.name(), &known, Some(automatic))?;
                    let ChangeCounts { begun, ended, unchanged } = running.want(&mut automatic, &explicit);
                    tracing::info!(begun, ended, unchanged, "took the changed configuration");
                }
                Err(error) => {
                    if watch.refused(&loaded, &error) {
                        tracing::error!("the changed configuration is not taken, everything goes on as it was: \
                                         {error}");
                    }
                }
                }
                manager.ready(status(is_connected));
            }
            Ok(()) = members.changed() => {
                let known = members.borrow_and_update().clone();
                automatic = Automatic::new(&loaded, &graphs, node.name(), &known, Some(automatic))?;
                running.want(&mut automatic, &explicit);
            }
            never = &mut keeping => match never {},
            never = &mut following => match never {},
        }
    };

    manager.stopping();
    tracing::info!("leaving");
    let last = running.close().await;
    stats_writer.show(&last.with_node(&node, directory_status.as_ref()));
    drop((automatic, explicit, diagnostics));
    node.close().await;
    graph::leave(graphs).await;
    ended
}

/// All running routes.
struct Running {
    routes: Routes,
    calls: Calls,
    catalogs: Links,
}

/// The statistics of all running routes.
struct RunningStats {
    topics: Vec<RouteStats>,
    calls: Vec<CallStats>,
    catalogs: Vec<CatalogStats>,
}

impl Running {
    /// Starts and ends routes so that these run: the explicit ones and those that match by pattern.
    fn want(&mut self, automatic: &mut Automatic, explicit: &Explicit) -> ChangeCounts {
        let plans = automatic.plan(&explicit.topics, &explicit.calls);
        self.catalogs.want(plans.catalogs);
        self.routes.want(plans.routes) + self.calls.want(plans.calls)
    }

    /// Waits for an error that only a restart can fix. Safe to cancel.
    async fn failed(&mut self) -> anyhow::Error {
        tokio::select! {
            error = self.routes.failed() => error,
            error = self.calls.failed() => error,
            error = self.catalogs.failed() => error,
        }
    }

    fn look(&self) {
        let now = Instant::now();
        self.routes.look(now);
        self.calls.look(now);
    }

    fn stats(&self, node: &Node, directory: Option<&RouteStatus>) -> Stats {
        let running =
            RunningStats { topics: self.routes.stats(), calls: self.calls.stats(), catalogs: self.catalogs.stats() };
        running.with_node(node, directory)
    }

    /// Ends all routes and returns their last statistics.
    async fn close(self) -> RunningStats {
        let (topics, calls, catalogs) = tokio::join!(self.routes.close(), self.calls.close(), self.catalogs.close());
        RunningStats { topics, calls, catalogs }
    }
}

impl RunningStats {
    fn with_node(self, node: &Node, directory: Option<&RouteStatus>) -> Stats {
        let Self { topics, calls, catalogs } = self;
        let (member_until, member_error) = match node.member_until() {
            None => (None, None),
            Some(Ok(until)) => (Some(until), None),
            Some(Err(error)) => (None, Some(error.to_string())),
        };
        Stats {
            version: VERSION,
            entity: node.name(),
            switch: node.switch().ok(),
            member_until,
            member_error,
            topics,
            calls,
            catalogs,
            directory: directory.map(directory::stats),
            links: node.links(),
            clocks: node.clock_differences(),
            node: node.counters(),
        }
    }
}

/// Returns the statistics while no switch has answered since the start.
fn unattached(Loaded { config, material }: &Loaded) -> Stats {
    let down = |link: &LinkEntry| LinkStatus {
        target: link.to.to_string(),
        state: LinkState::Down,
        reason: Some("no switch has answered since the proxy started".into()),
        main: false,
        switch: None,
        frames_sent: 0,
        frames_unsent: 0,
        copies_sent: 0,
        copies_dropped: 0,
    };
    Stats {
        version: VERSION,
        entity: material.identity.name(),
        switch: None,
        member_until: None,
        member_error: None,
        topics: Vec::new(),
        calls: Vec::new(),
        catalogs: Vec::new(),
        directory: None,
        clocks: Vec::new(),
        links: config.links.iter().map(down).collect(),
        node: NodeCounters::default(),
    }
}

/// Loads the configuration again and joins its graphs.
async fn load_again(
    loaded: &Loaded,
    watch: &Watch,
    graphs: &mut graph::All,
    ros_node: &str,
) -> Result<Loaded, LoadError> {
    let new = loaded.load_again(watch.path(), watch.watcher())?;
    graph::join(graphs, &new.config.graphs, ros_node).await?;
    Ok(new)
}

/// Connects to a switch. It retries while no switch answers, because the switch may start later.
/// Errors that waiting cannot fix are returned at once.
async fn connect(Loaded { config, material }: &Loaded, manager: &mut ServiceManager) -> Result<Node> {
    let node = NodeConfig {
        identity: material.identity.clone(),
        links: config.links.iter().map(LinkConfig::from).collect(),
        connect_timeout: CONNECT_PATIENCE,
        rekey: RekeySchedule::default(),
        state: config.state.clone(),
        credentials: material.credentials.as_ref().map(|(credentials, _)| credentials.clone()),
    };
    let addresses: Vec<String> = config.links.iter().map(|link| link.to.to_string()).collect();
    let addresses = addresses.join(", ");
    tracing::info!(links = %addresses, "connecting to the switch");
    let mut reported: Option<String> = None;
    loop {
        let mut connecting = std::pin::pin!(Node::connect(node.clone()));
        let silence = async {
            tokio::time::sleep(SILENCE).await;
            silence::reason(config.links.iter().map(|link| &link.to)).await
        };
        let connected = tokio::select! {
            connected = &mut connecting => connected,
            reason = silence, if reported.is_none() => {
                let reason = reason.map_or_else(|| OPEN.to_owned(), |reason| format!("no answer yet: {reason}"));
                tracing::warn!(links = %addresses, "{reason} Trying on");
                trying(manager);
                connecting.await
            }
        };
        match connected {
            Ok(node) => return Ok(node),
            Err(error) if error.may_pass() => {
                // The same error again is no news.
                let error = error.to_string();
                if !reported.as_ref().is_some_and(|before| differ_in_digits_at_most(before, &error)) {
                    tracing::warn!(links = %addresses, "no switch yet: {error}; trying on");
                }
                reported = Some(error);
                trying(manager);
            }
            Err(error) => return Err(error).with_context(|| format!("cannot attach at {addresses}")),
        }
    }
}

/// Returns the line for `systemctl status`.
fn status(is_connected: bool) -> &'static str {
    if is_connected { CONNECTED } else { LOST }
}

/// The service manager need not restart a proxy that waits for its switch.
fn trying(manager: &mut ServiceManager) {
    manager.ready(TRYING);
    manager.alive(Instant::now());
}

/// The routes that the configuration lists.
struct Explicit {
    /// One route for each topic and direction.
    topics: Vec<Arc<RoutePlan>>,
    calls: Vec<Arc<CallPlan>>,
}

impl Explicit {
    fn new(Loaded { config, material }: &Loaded, graphs: &graph::All) -> Result<Self> {
        if config.topics.is_empty()
            && config.expose.is_none()
            && config.import.is_empty()
            && config.calls().next().is_none()
        {
            tracing::warn!("no topics, services or actions are configured, so nothing is exposed");
        }
        let topic = |(at, material): &(usize, RouteMaterial)| {
            let topic = &config.topics[*at];
            planned(topic.clone(), topic.graph.as_deref(), material, config, graphs)
        };
        let call = |(at, material): &(usize, RouteMaterial)| {
            let (_, call) = config.calls().nth(*at).context("a service that is not configured")?;
            planned(call.clone(), call.graph.as_deref(), material, config, graphs)
        };
        Ok(Self {
            topics: material.routes.iter().map(topic).collect::<Result<_>>()?,
            calls: material.calls.iter().map(call).collect::<Result<_>>()?,
        })
    }
}

fn planned<R: Carries>(
    of: R::Config,
    graph: Option<&str>,
    material: &RouteMaterial,
    config: &Config,
    graphs: &graph::All,
) -> Result<Arc<Planned<R>>> {
    let (label, _) = config.graphs.get(graph).map_err(|reason| anyhow!(reason))?;
    let graph = graphs.get(label).cloned().context("a graph that was not joined")?;
    Ok(Arc::new(Planned { config: of, label: label.into(), graph, material: material.clone() }))
}

/// Writes the statistics file, if there is one. A full disk stops only the statistics, not the
/// topics, until it has room again.
struct StatsWriter {
    file: Option<StatsFile>,
    ticks: Ticks,
    failing: bool,
}

impl StatsWriter {
    fn new(file: Option<StatsFile>) -> Self {
        Self { file, ticks: Ticks::new(STATS_PERIOD), failing: false }
    }

    /// Waits for the next period. Safe to cancel.
    async fn due(&mut self) {
        match self.file {
            Some(_) => _ = self.ticks.tick().await,
            None => std::future::pending().await,
        }
    }

    fn show(&mut self, stats: &Stats) {
        let Some(file) = &self.file else { return };
        let result = file.replace(stats);
        if let Err(error) = &result
            && !self.failing
        {
            tracing::warn!("{}: cannot be written: {error}; trying again", file.path().display());
        }
        self.failing = result.is_err();
    }
}
