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

use crate::config::Config;
use crate::graph;
use crate::material::{Material, RouteMaterial};
use crate::membership::keep_papers;
use crate::routes::{self, RoutePlan};
use crate::stats::{RouteStats, Stats, StatsFile, VERSION};
use gdp_ros::types::Types;

const STATS_PERIOD: Duration = Duration::from_secs(1);

/// How often the log says that the switch does not answer.
const CONNECT_PATIENCE: Duration = Duration::from_secs(10);

/// Runs until `stop` ends, or something fails that only a new start can mend.
pub async fn run(
    config: Config,
    mut material: Material,
    stats: Option<StatsFile>,
    stop: impl Future<Output = ()>,
) -> Result<()> {
    // First, and to the end: others need it whether or not this proxy reaches a switch itself.
    let relay = match material.relay.take() {
        Some(relay) => Some(relay.start().await.context("relay")?),
        None => None,
    };
    let ended = carry(config, material, stats, stop).await;
    if let Some(relay) = relay {
        relay.stop().await;
    }
    ended
}

/// The topics.
async fn carry(
    config: Config,
    material: Material,
    stats: Option<StatsFile>,
    stop: impl Future<Output = ()>,
) -> Result<()> {
    if config.topics.is_empty() {
        tracing::warn!("no topics are configured, so nothing is exposed");
    }
    if let Some(file) = &stats {
        file.probe().with_context(|| format!("{}: cannot be written", file.path().display()))?;
    }
    let mut stop = std::pin::pin!(stop);
    let node = tokio::select! {
        node = connect(&config, &material) => node?,
        () = &mut stop => return Ok(()),
    };
    let entity = node.name().to_string();
    let types = Arc::new(Types::load(config.definitions.folders()).context("definitions")?);
    let graphs = graph::join(&config.graphs, &format!("{}{}", graph::NODE, &entity[..8])).await?;
    tracing::info!(entity = %node.name(), graphs = ?graphs.keys(), "attached to the switch and in the ROS graphs");

    let files = config.domain.as_ref().map(PaperFiles::from);
    let watched = files.as_ref().zip(material.papers.as_ref().map(|(_, stamps)| stamps.clone()));

    let mut routes = routes::manager(node.clone(), types);
    routes.want(plans(&config, material.routes, &graphs)?);
    let mut shown = Shown::new(stats);
    let mut keeping = std::pin::pin!(keep_papers(&node, watched));
    let ended = loop {
        tokio::select! {
            () = &mut stop => break Ok(()),
            error = routes.failed() => break Err(error),
            () = shown.due() => shown.show(&node, routes.stats()),
            never = &mut keeping => match never {},
        }
    };

    tracing::info!("leaving");
    let topics = routes.close().await;
    shown.show(&node, topics);
    node.close().await;
    graph::leave(graphs).await;
    ended
}

/// The switch may start after the proxy; what waiting cannot mend is an error at once.
async fn connect(config: &Config, material: &Material) -> Result<Node> {
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
fn plans(config: &Config, materials: Vec<RouteMaterial>, graphs: &graph::All) -> Result<Vec<Arc<RoutePlan>>> {
    let plan = |material: RouteMaterial| {
        let topic = &config.topics[material.topic];
        let found = config.graphs.get(topic.graph.as_deref());
        let (label, _) = found.map_err(|reason| anyhow!(reason))?;
        let graph = graphs.get(label).cloned().context("a graph that was not joined")?;
        Ok(Arc::new(RoutePlan { config: topic.clone(), label: label.into(), graph, material }))
    };
    materials.into_iter().map(plan).collect()
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

    fn show(&mut self, node: &Node, topics: Vec<RouteStats>) {
        let Some(file) = &self.file else { return };
        let result = file.replace(&Stats {
            version: VERSION,
            entity: node.name(),
            switch: node.switch().ok(),
            topics,
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
