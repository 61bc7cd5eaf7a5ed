//! The proxy's node in a graph of rmw_zenoh.

use std::sync::Arc;

use bytes::Bytes;
use gdp_ros_zenoh::{Locator, Snapshot, ZenohError, ZenohNode};
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;

use super::reader::ZenohReader;
use super::view;
use crate::config::ZenohConfig;
use crate::graph::event::GraphError;
use crate::peer_proxies::{self, PeerProxies, Voice};
use crate::ros2::{Graph, Qos, TopicName, TypeName};

/// A graph of rmw_zenoh, until it is [left](Self::leave).
pub struct ZenohGraph {
    pub(super) node: ZenohNode,
    graph: watch::Receiver<Arc<Graph>>,
    peer_proxies: Arc<PeerProxies>,
    tasks: [JoinHandle<()>; 2],
}

/// The key on which proxies announce themselves. No node subscribes to it, because `**` does not
/// match a part that begins with `@`.
const PRESENCE: &str = "@gdp_proxy";

impl From<ZenohError> for GraphError {
    fn from(error: ZenohError) -> Self {
        Self::Zenoh(error.to_string())
    }
}

/// Checks the address of the router.
pub fn check(config: &ZenohConfig) -> Result<(), GraphError> {
    locator(config).map(drop)
}

fn locator(config: &ZenohConfig) -> Result<Locator, GraphError> {
    Locator::parse(&config.router).map_err(|error| GraphError::Zenoh(error.to_string()))
}

impl ZenohGraph {
    /// Joins as the ROS node `name` in the root namespace. The router may start later.
    pub fn join(config: &ZenohConfig, name: &str) -> Result<Self, GraphError> {
        let domain = config.domain_id.get();
        let side = format!("{PRESENCE}/{domain}");
        let (node, side) = ZenohNode::start(locator(config)?, domain.into(), name, &side);
        let (sender, graph) = watch::channel(Arc::default());
        let peer_proxies: Arc<PeerProxies> = Arc::default();
        let voice = SideVoice { tell: Box::new(node.teller()), side };
        let tasks =
            [tokio::spawn(show(node.graph(), sender)), tokio::spawn(peer_proxies::beat(peer_proxies.clone(), voice))];
        Ok(Self { node, graph, peer_proxies, tasks })
    }

    pub fn peer_proxies(&self) -> &Arc<PeerProxies> {
        &self.peer_proxies
    }

    /// Returns what others in the graph publish, subscribe to, serve and call, with every change.
    pub fn graph(&self) -> watch::Receiver<Arc<Graph>> {
        self.graph.clone()
    }

    pub fn reader(&self, topic: &TopicName, kind: Option<&TypeName>, qos: Option<Qos>) -> ZenohReader<'_> {
        ZenohReader::new(self, topic, kind, qos)
    }

    pub async fn leave(self) {
        for task in self.tasks {
            task.abort();
            _ = task.await;
        }
        self.node.leave().await;
    }
}

/// Shows each snapshot in the terms of ROS.
async fn show(mut snapshots: watch::Receiver<Arc<Snapshot>>, graph: watch::Sender<Arc<Graph>>) {
    while snapshots.changed().await.is_ok() {
        let snapshot = snapshots.borrow_and_update().clone();
        graph.send_replace(Arc::new(view::graph(&snapshot)));
    }
}

/// The channel between the proxies of a graph.
struct SideVoice {
    tell: Box<dyn Fn(String) -> Result<(), ZenohError> + Send + Sync>,
    side: mpsc::Receiver<Bytes>,
}

impl Voice for SideVoice {
    async fn tell(&mut self, text: String) {
        if let Err(error) = (self.tell)(text) {
            tracing::debug!("other proxies in the graph were not told: {error}");
        }
    }

    async fn hear(&mut self) -> Option<Vec<u8>> {
        Some(self.side.recv().await?.to_vec())
    }
}
