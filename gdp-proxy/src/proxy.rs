//! Puts the halves together: joins the ROS graphs, attaches to the switch, runs a route per topic and direction, shows counters, and
//! leaves both sides properly.

use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use gdp::Node;
use gdp::domain::PaperFiles;
use gdp::link::RekeySchedule;
use gdp::node::{LinkConfig, NodeConfig};
use tokio::time::{Interval, MissedTickBehavior};

use crate::automatic::{self, Automatic, CatalogStats, Links};
use crate::graph;
use crate::manager::Changed;
use crate::material::RouteMaterial;
use crate::membership::keep_papers;
use crate::reload::{Loaded, Watch};
use crate::routes::{self, RoutePlan, Routes};
use crate::stats::{RouteStats, Stats, StatsFile, VERSION};
use gdp_ros::types::Types;

const STATS_PERIOD: Duration = Duration::from_secs(1);

/// How often the log says that the switch does not answer.
const CONNECT_PATIENCE: Duration = Duration::from_secs(10);

/// Runs until `stop` ends, or something fails that only a new start can mend. `watch`: of the configuration that was loaded.
pub async fn run(
    mut loaded: Loaded,
    watch: Watch,
    stats: Option<StatsFile>,
    stop: impl Future<Output = ()>,
) -> Result<()> {
    // First, and to the end: others need it whether or not this proxy reaches a switch itself.
    let relay = match loaded.material.relay.take() {
        Some(relay) => Some(relay.start().await.context("relay")?),
        None => None,
    };
    let ended = carry(loaded, watch, stats, stop).await;
    if let Some(relay) = relay {
        relay.stop().await;
    }
    ended
}

/// The topics.
async fn carry(
    mut loaded: Loaded,
    mut watch: Watch,
    stats: Option<StatsFile>,
    stop: impl Future<Output = ()>,
) -> Result<()> {
    if let Some(file) = &stats {
        file.probe().with_context(|| format!("{}: cannot be written", file.path().display()))?;
    }
    let mut stop = std::pin::pin!(stop);
    let node = tokio::select! {
        node = connect(&loaded) => node?,
        () = &mut stop => return Ok(()),
    };
    let ros_node = format!("{}{}", graph::NODE, &node.name().to_string()[..8]);
    let types = Arc::new(Types::load(loaded.config.definitions.folders()).context("definitions")?);
    let mut graphs = graph::All::new();
    graph::join(&mut graphs, &loaded.config.graphs, &ros_node).await?;
    tracing::info!(entity = %node.name(), graphs = ?graphs.keys(), "attached to the switch and in the ROS graphs");

    let files = loaded.config.domain.as_ref().map(PaperFiles::from);
    let stamps = loaded.material.papers.as_ref().map(|(_, stamps)| stamps.clone());
    let mut keeping = std::pin::pin!(keep_papers(&node, files.as_ref().zip(stamps)));

    let (mut routes, mut catalogs) = (routes::manager(node.clone(), types), automatic::manager(node.clone()));
    let mut explicit = plans(&loaded, &graphs)?;
    let mut automatic = Automatic::new(&loaded, &graphs, node.name(), None)?;
    want(&mut automatic, &explicit, &mut routes, &mut catalogs);
    watch.look_at(loaded.cards());
    let mut shown = Shown::new(stats);
    let ended = loop {
        tokio::select! {
            () = &mut stop => break Ok(()),
            error = routes.failed() => break Err(error),
            error = catalogs.failed() => break Err(error),
            () = automatic.changed() => {
                want(&mut automatic, &explicit, &mut routes, &mut catalogs);
            }
            () = shown.due() => shown.show(&node, routes.stats(), catalogs.stats()),
            () = watch.changed() => match load_again(&loaded, &watch, &mut graphs, &ros_node).await {
                Ok(new) => {
                    loaded = new;
                    watch.look_at(loaded.cards());
                    explicit = plans(&loaded, &graphs)?;
                    automatic = Automatic::new(&loaded, &graphs, node.name(), Some(automatic))?;
                    let changed = want(&mut automatic, &explicit, &mut routes, &mut catalogs);
                    let Changed { begun, ended, kept } = changed;
                    tracing::info!(begun, ended, kept, "took the changed configuration");
                }
                Err(error) => tracing::error!("the changed configuration is not taken, everything goes on as it was: {error:#}"),
            },
            never = &mut keeping => match never {},
        }
    };

    tracing::info!("leaving");
    let (topics, catalogs) = tokio::join!(routes.close(), catalogs.close());
    shown.show(&node, topics, catalogs);
    drop((automatic, explicit));
    node.close().await;
    graph::leave(graphs).await;
    ended
}

/// Has run what is to run now.
fn want(automatic: &mut Automatic, explicit: &[Arc<RoutePlan>], routes: &mut Routes, catalogs: &mut Links) -> Changed {
    let plans = automatic.plan(explicit);
    catalogs.want(plans.catalogs);
    routes.want(plans.routes)
}

/// The configuration as it is now, with its graphs joined.
async fn load_again(loaded: &Loaded, watch: &Watch, graphs: &mut graph::All, ros_node: &str) -> Result<Loaded> {
    let new = loaded.load_again(watch.path())?;
    graph::join(graphs, &new.config.graphs, ros_node).await?;
    Ok(new)
}

/// The switch may start after the proxy; what waiting cannot mend is an error at once.
async fn connect(Loaded { config, material }: &Loaded) -> Result<Node> {
    let node = NodeConfig {
        identity: material.identity.clone(),
        links: config.links.iter().map(LinkConfig::from).collect(),
        connect_timeout: CONNECT_PATIENCE,
        rekey: RekeySchedule::default(),
        state: config.state.clone(),
        papers: material.papers.as_ref().map(|(papers, _)| papers.clone()),
    };
    let places: Vec<String> = config.links.iter().map(|link| link.to.to_string()).collect();
    let places = places.join(", ");
    loop {
        match Node::connect(node.clone()).await {
            Ok(node) => return Ok(node),
            Err(error) if error.may_pass() => tracing::warn!(links = %places, "no switch yet: {error}"),
            Err(error) => return Err(error).with_context(|| format!("cannot attach at {places}")),
        }
    }
}

/// A route for each direction of the topics.
fn plans(Loaded { config, material }: &Loaded, graphs: &graph::All) -> Result<Vec<Arc<RoutePlan>>> {
    if config.topics.is_empty() && config.expose.is_none() && config.import.is_empty() {
        tracing::warn!("no topics are configured, so nothing is exposed");
    }
    let plan = |(at, material): &(usize, RouteMaterial)| {
        let topic = &config.topics[*at];
        let (label, _) = config.graphs.get(topic.graph.as_deref()).map_err(|reason| anyhow!(reason))?;
        let graph = graphs.get(label).cloned().context("a graph that was not joined")?;
        Ok(Arc::new(RoutePlan { config: topic.clone(), label: label.into(), graph, material: material.clone() }))
    };
    material.routes.iter().map(plan).collect()
}

/// The statistics file, if there is one. Topics are worth more than their statistics: a full disk stops only these, until it is mended.
struct Shown {
    file: Option<StatsFile>,
    ticks: Interval,
    failing: bool,
}

impl Shown {
    fn new(file: Option<StatsFile>) -> Self {
        let mut ticks = tokio::time::interval(STATS_PERIOD);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        Self { file, ticks, failing: false }
    }

    /// Once a period. Safe to cancel.
    async fn due(&mut self) {
        match self.file {
            Some(_) => _ = self.ticks.tick().await,
            None => std::future::pending().await,
        }
    }

    fn show(&mut self, node: &Node, topics: Vec<RouteStats>, catalogs: Vec<CatalogStats>) {
        let Some(file) = &self.file else { return };
        let result = file.replace(&Stats {
            version: VERSION,
            entity: node.name(),
            switch: node.switch().ok(),
            topics,
            catalogs,
            links: node.links(),
            node: node.counters(),
        });
        if let Err(error) = &result
            && !self.failing
        {
            tracing::warn!("{}: cannot be written: {error}; trying again", file.path().display());
        }
        self.failing = result.is_err();
    }
}
