//! The graph of a master and its changes: topics with types, publishers and subscribers, and
//! services.
//!
//! A master notifies only publishers and subscribers of changes, so the node polls its state as ROS
//! tools do. A master does not know the types of services;
//! [`ServiceClient::probe`](crate::ServiceClient::probe) requests them from the server.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use tokio::sync::watch;

use crate::api::master::SystemState;
use crate::topic::subscription::PublisherInfo;

/// A topic of the master, with the publishers that this node is connected to.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Topic {
    /// The type, such as `std_msgs/String`. It is `None` until a publisher or subscriber has
    /// announced it.
    pub kind: Option<String>,
    /// Names of the publishing nodes.
    pub publishers: BTreeSet<String>,
    /// Names of the subscribing nodes.
    pub subscribers: BTreeSet<String>,
}

/// The state of the master, with the publishers that this node is connected to.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Snapshot {
    /// Topics with a publisher or a subscriber.
    pub topics: BTreeMap<String, Topic>,
    /// Services with the names of the nodes that serve them.
    pub services: BTreeMap<String, BTreeSet<String>>,
}

/// A difference between two snapshots.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Change {
    /// The topic is new, or its type, publishers or subscribers have changed.
    Topic {
        name: String,
        topic: Topic,
    },
    /// The topic has no publisher and no subscriber any more.
    TopicRemoved {
        name: String,
    },
    /// The service is new, or other nodes serve it.
    Service {
        name: String,
        nodes: BTreeSet<String>,
    },
    ServiceRemoved {
        name: String,
    },
}

impl Snapshot {
    /// Creates a snapshot. `connected` lists the publishers that this node's subscriptions are
    /// connected to, each with its topic.
    pub(crate) fn new(
        state: &SystemState,
        kinds: &BTreeMap<String, String>,
        connected: &[(String, Arc<PublisherInfo>)],
    ) -> Self {
        let mut topics: BTreeMap<String, Topic> = BTreeMap::new();
        for (name, nodes) in &state.publishers {
            topics.entry(name.clone()).or_default().publishers.extend(nodes.iter().cloned());
        }
        for (name, nodes) in &state.subscribers {
            topics.entry(name.clone()).or_default().subscribers.extend(nodes.iter().cloned());
        }
        for (name, topic) in &mut topics {
            topic.kind = kinds.get(name).filter(|kind| *kind != "*").cloned();
        }
        for (name, publisher) in connected {
            let topic = topics.entry(name.clone()).or_default();
            topic.publishers.insert(publisher.caller_id.clone());
            topic.kind.get_or_insert_with(|| publisher.kind.clone());
        }
        let services = state.services.iter().map(|(name, nodes)| (name.clone(), nodes.iter().cloned().collect()));
        Self { topics, services: services.collect() }
    }

    /// Returns the differences to an earlier snapshot, sorted by name.
    pub fn changes_since(&self, earlier: &Self) -> Vec<Change> {
        let topics = self.topics.iter().filter(|&(name, topic)| earlier.topics.get(name) != Some(topic));
        let topics = topics.map(|(name, topic)| Change::Topic { name: name.clone(), topic: topic.clone() });
        let gone = earlier.topics.keys().filter(|name| !self.topics.contains_key(*name));
        let gone = gone.map(|name| Change::TopicRemoved { name: name.clone() });
        let services = self.services.iter().filter(|&(name, nodes)| earlier.services.get(name) != Some(nodes));
        let services = services.map(|(name, nodes)| Change::Service { name: name.clone(), nodes: nodes.clone() });
        let unserved = earlier.services.keys().filter(|name| !self.services.contains_key(*name));
        let unserved = unserved.map(|name| Change::ServiceRemoved { name: name.clone() });
        topics.chain(gone).chain(services).chain(unserved).collect()
    }
}

/// Watches the graph of a master. While the master does not respond, the graph does not change.
///
/// A restarted master knows only the nodes that register again. Most ROS 1 nodes do not, though
/// their connections continue. So the graph includes the publishers that this node is connected to,
/// even if the master does not list them. Other nodes disappear from the graph. A bridge should
/// therefore keep a topic while its [`Publisher`](crate::Publisher) has a subscriber.
pub struct Graph {
    snapshots: watch::Receiver<Arc<Snapshot>>,
    seen: Arc<Snapshot>,
}

impl Graph {
    pub(crate) fn new(snapshots: watch::Receiver<Arc<Snapshot>>) -> Self {
        Self { snapshots, seen: Arc::default() }
    }

    /// Waits until the graph differs from the last one returned; the first one is all new. May
    /// return several changes at once. Returns `None` when the node has left.
    pub async fn changes(&mut self) -> Option<Vec<Change>> {
        let now = self.snapshots.wait_for(|now| **now != *self.seen).await.ok()?.clone();
        let changes = now.changes_since(&self.seen);
        self.seen = now;
        Some(changes)
    }

    /// Returns the newest snapshot.
    pub fn latest(&self) -> Arc<Snapshot> {
        self.snapshots.borrow().clone()
    }

    /// Returns the snapshot of the last [`Self::changes`].
    pub fn snapshot(&self) -> &Snapshot {
        &self.seen
    }
}

#[cfg(test)]
#[path = "../tests/unit/graph.rs"]
mod tests;
