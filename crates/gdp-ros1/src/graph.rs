//! The graph of a master: topics with types, publishers and subscribers, and services; and the
//! changes of it.
//!
//! A master tells nobody of changes but those who publish or subscribe themselves, so its state is
//! asked for from time to time, as ROS tools do. It does not know the types of services:
//! [`ServiceClient::probe`](crate::ServiceClient::probe) asks the server.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use tokio::sync::watch;

use crate::api::master::SystemState;
use crate::topic::subscription::PublisherInfo;

/// A topic, as the master knows it, and with the publishers that this node is connected to.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Topic {
    /// Such as `std_msgs/String`; `None` until somebody who publishes or subscribes has said it.
    pub kind: Option<String>,
    /// Nodes.
    pub publishers: BTreeSet<String>,
    /// Nodes.
    pub subscribers: BTreeSet<String>,
}

/// All that the master knows at a time, and what this node's own connections show besides.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Snapshot {
    /// Those that somebody publishes or subscribes to.
    pub topics: BTreeMap<String, Topic>,
    /// With the nodes that serve them.
    pub services: BTreeMap<String, BTreeSet<String>>,
}

/// What is different in a snapshot.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Change {
    /// It is new, or something about it is: its type is known now, or others publish or subscribe.
    Topic {
        name: String,
        topic: Topic,
    },
    /// Nobody publishes it or subscribes to it any more.
    TopicRemoved {
        name: String,
    },
    /// It is new, or others serve it.
    Service {
        name: String,
        nodes: BTreeSet<String>,
    },
    ServiceRemoved {
        name: String,
    },
}

impl Snapshot {
    /// `connected`: who publishes what this node subscribes to, as far as it is connected.
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

    /// What is different from an earlier one, by name.
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

/// Watches a master's graph. While the master does not answer, nothing changes.
///
/// A master that was started anew knows only who registers with it again, and most ROS 1 nodes do
/// not, though their connections go on. So whoever this node is connected to as a subscriber is
/// there, whether or not the master lists it. What it is not connected to looks gone then: what was
/// bridged should be kept while its [`Publisher`](crate::Publisher) has a subscriber.
pub struct Graph {
    snapshots: watch::Receiver<Arc<Snapshot>>,
    seen: Arc<Snapshot>,
}

impl Graph {
    pub(crate) fn new(snapshots: watch::Receiver<Arc<Snapshot>>) -> Self {
        Self { snapshots, seen: Arc::default() }
    }

    /// Waits until the graph differs from what was returned last; at first, all of it is new. Many
    /// changes in a short time may be seen as one. `None` when the node has left.
    pub async fn changes(&mut self) -> Option<Vec<Change>> {
        let now = self.snapshots.wait_for(|now| **now != *self.seen).await.ok()?.clone();
        let changes = now.changes_since(&self.seen);
        self.seen = now;
        Some(changes)
    }

    /// As last returned by [`Self::changes`].
    pub fn snapshot(&self) -> &Snapshot {
        &self.seen
    }
}

#[cfg(test)]
#[path = "../tests/unit/graph.rs"]
mod tests;
