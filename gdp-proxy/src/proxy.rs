//! Puts the halves together: joins the ROS graphs, attaches to the switch, runs a route per topic and direction, shows counters, and
//! leaves both sides properly.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use gdp::Node;
use gdp::domain::PaperFiles;
use gdp::link::RekeySchedule;
use gdp::node::{LinkConfig, NodeConfig};
use tokio::runtime::Handle;
use tokio::sync::watch;
use tokio::task::JoinSet;

use crate::config::Config;
use crate::graph;
use crate::material::Material;
use crate::membership::keep_papers;
use crate::route::Route;
use crate::stats::{Stats, StatsFile, VERSION};
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

    let mut routes = Vec::new();
    let (stopping, stopped) = watch::channel(false);
    let mut running = JoinSet::new();
    for material in material.routes {
        let topic = &config.topics[material.topic];
        let (label, _) = config.graphs.get(topic.graph.as_deref()).map_err(|reason| anyhow!(reason))?;
        let graph = graphs.get(label).cloned().context("a graph that was not joined")?;
        let route = Arc::new(Route::new(topic, label, &material, types.clone()));
        routes.push(route.clone());
        let (node, mut stopped) = (node.clone(), stopped.clone());
        let carry = async move {
            let stop = async { _ = stopped.wait_for(|stopped| *stopped).await };
            let ended = route.run(&graph, &node, material, stop).await;
            ended.map_err(|error| anyhow!(error).context(format!("topic {}", route.topic())))
        };
        // A thread each: RustDDS and the node wake it directly, and no other topic's sealing is ever in its way.
        let runtime = Handle::current();
        running.spawn_blocking(move || runtime.block_on(carry));
    }

    let shown = || Stats {
        version: VERSION,
        entity: node.name(),
        switch: node.switch().ok(),
        topics: routes.iter().map(|route| route.stats()).collect(),
        links: node.links(),
        node: node.counters(),
    };
    let ended = tokio::select! {
        () = stop => Ok(()),
        Some(ended) = running.join_next() => ended.context("a route panicked").flatten(),
        never = show(stats.as_ref(), &shown) => match never {},
        never = keep_papers(&node, watched) => match never {},
    };

    tracing::info!("leaving");
    stopping.send_replace(true);
    while running.join_next().await.is_some() {}
    if let Some(Err(error)) = stats.map(|file| file.replace(&shown())) {
        tracing::warn!(%error, "the last statistics could not be written");
    }
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

/// Replaces the file once per period, for ever; without a file it does nothing, for ever. Topics are worth more than their
/// statistics: a full disk stops only these, until it is mended.
async fn show(file: Option<&StatsFile>, stats: impl Fn() -> Stats) -> Infallible {
    let Some(file) = file else { return std::future::pending().await };
    let mut ticks = tokio::time::interval(STATS_PERIOD);
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut failing = false;
    loop {
        ticks.tick().await;
        let result = file.replace(&stats());
        if let Err(error) = &result
            && !failing
        {
            tracing::warn!("{}: cannot be written: {error}; trying again", file.path().display());
        }
        failing = result.is_err();
    }
}
