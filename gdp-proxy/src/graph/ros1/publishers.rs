//! Chooses the node that publishes a topic: the proxy's main node if it can, otherwise a further
//! node.
//!
//! A ROS 1 node publishes a topic once and latches one message of it. So all writers that do not
//! latch share one publisher, and each latching writer has one of its own. The second latching one
//! of every topic is at the same further node, and so on. So the topic with the most latching
//! writers determines the number of nodes, and not the number of topics.
//!
//! The first latching one is at the main node. The reason is actionlib: its clients require that
//! the node that latches `status` also subscribes to `goal` and `cancel`.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Weak};

use bytes::Bytes;
use gdp_ros1::{MessageType, Node, NodeConfig, NodeError, PublishOptions};
use parking_lot::{Mutex, MutexGuard};
use tokio::task::JoinSet;

use crate::graph::event::{GraphError, WriteError};

/// The publishers of one proxy at one master.
pub struct Publishers {
    config: NodeConfig,
    topics: Mutex<HashMap<String, PublishedTopic>>,
    further: tokio::sync::Mutex<Vec<Weak<FurtherNode>>>,
    /// Number of further nodes that were created.
    made: AtomicU32,
    /// Further nodes that are unregistering from the master.
    leaving: Leaving,
}

/// Nodes that are unregistering from the master.
type Leaving = Arc<Mutex<JoinSet<()>>>;

#[derive(Default)]
struct PublishedTopic {
    at_main: Weak<GraphPublisher>,
    /// The publisher that all writers without latching share.
    unlatched: Weak<GraphPublisher>,
}

/// A publisher of one topic at one node, shared by its writers.
pub struct GraphPublisher {
    kind: MessageType,
    latches: bool,
    /// True if its remote publisher has left, and it only delivers its last messages.
    is_vacant: AtomicBool,
    publisher: gdp_ros1::Publisher,
    /// The further node that it is at; `None` at the main node. It is dropped last.
    _further: Option<Arc<FurtherNode>>,
}

/// A node besides the main one. It leaves with its last publisher.
struct FurtherNode {
    node: Option<Node>,
    leaving: Leaving,
}

impl Publishers {
    /// `config` is that of the main node, from which the other nodes derive their names.
    pub fn new(config: NodeConfig) -> Self {
        let (topics, further) = (Mutex::default(), tokio::sync::Mutex::default());
        Self { config, topics, further, made: AtomicU32::new(0), leaving: Leaving::default() }
    }

    /// Returns a publisher for one more writer. `main` is the proxy's main node.
    pub async fn publish(
        &self,
        main: &Node,
        topic: &str,
        kind: MessageType,
        options: PublishOptions,
    ) -> Result<Arc<GraphPublisher>, GraphError> {
        if let Some(publisher) = self.share_or_publish_at(main, topic, &kind, options)? {
            return Ok(publisher);
        }
        let (publisher, node) = self.publish_further(topic, &kind, options).await?;
        let publisher = Arc::new(GraphPublisher::new(publisher, kind, options.latch, Some(node)));
        if !options.latch {
            self.topics().entry(topic.to_owned()).or_default().unlatched = Arc::downgrade(&publisher);
        }
        Ok(publisher)
    }

    /// Publishes at the first further node that does not publish the topic yet.
    async fn publish_further(
        &self,
        topic: &str,
        kind: &MessageType,
        options: PublishOptions,
    ) -> Result<(gdp_ros1::Publisher, Arc<FurtherNode>), GraphError> {
        let mut further = self.further.lock().await;
        further.retain(|node| node.strong_count() > 0);
        for at in further.iter().filter_map(Weak::upgrade) {
            let Some(node) = &at.node else { continue };
            match node.publish(topic, kind.clone(), options) {
                Err(NodeError::Published(_)) => {}
                published => return Ok((published?, at)),
            }
        }
        let number = self.made.fetch_add(1, Ordering::Relaxed);
        let name = format!("{}_at_{number}", self.config.name);
        let node = Node::start(NodeConfig { name, ..self.config.clone() }).await?;
        let publisher = node.publish(topic, kind.clone(), options)?;
        let at = Arc::new(FurtherNode { node: Some(node), leaving: self.leaving.clone() });
        further.push(Arc::downgrade(&at));
        Ok((publisher, at))
    }

    /// Returns `None` if the writer needs a further node.
    fn share_or_publish_at(
        &self,
        main: &Node,
        topic: &str,
        kind: &MessageType,
        options: PublishOptions,
    ) -> Result<Option<Arc<GraphPublisher>>, GraphError> {
        let mut topics = self.topics();
        topics.retain(|_, topic| topic.at_main.strong_count() + topic.unlatched.strong_count() > 0);
        let known = topics.entry(topic.to_owned()).or_default();
        if let Some(shared) = known.unlatched.upgrade().filter(|_| !options.latch) {
            if !shared.is_of(kind) {
                return Err(GraphError::OtherType { topic: topic.into(), published: shared.kind.name.clone() });
            }
            return Ok(Some(shared));
        }
        if let Some(at_main) = known.at_main.upgrade() {
            return Ok(Some(at_main).filter(|at_main| options.latch && at_main.is_of(kind) && at_main.take_over()));
        }
        let publisher = main.publish(topic, kind.clone(), options)?;
        let publisher = Arc::new(GraphPublisher::new(publisher, kind.clone(), options.latch, None));
        known.at_main = Arc::downgrade(&publisher);
        if !options.latch {
            known.unlatched = Arc::downgrade(&publisher);
        }
        Ok(Some(publisher))
    }

    /// Waits for the nodes that are unregistering from the master.
    pub async fn leave(&self) {
        let mut leaving = std::mem::take(&mut *self.leaving.lock());
        while leaving.join_next().await.is_some() {}
    }

    fn topics(&self) -> MutexGuard<'_, HashMap<String, PublishedTopic>> {
        self.topics.lock()
    }
}

impl GraphPublisher {
    fn new(
        publisher: gdp_ros1::Publisher,
        kind: MessageType,
        latches: bool,
        further: Option<Arc<FurtherNode>>,
    ) -> Self {
        Self { kind, latches, is_vacant: AtomicBool::new(false), publisher, _further: further }
    }

    fn is_of(&self, kind: &MessageType) -> bool {
        (&self.kind.name, &self.kind.md5sum) == (&kind.name, &kind.md5sum)
    }

    /// Takes the publisher over for another writer, if the one before has left. Returns whether it
    /// did.
    fn take_over(&self) -> bool {
        let is_vacant = self.latches && self.is_vacant.swap(false, Ordering::Relaxed);
        if is_vacant {
            self.publisher.forget_latched();
        }
        is_vacant
    }

    /// Records that the writer's remote publisher has left. The next writer may take over before
    /// the last messages are delivered.
    pub fn vacate(&self) {
        self.is_vacant.store(true, Ordering::Relaxed);
    }

    /// Whether a subscriber is connected.
    pub fn is_matched(&self) -> bool {
        !self.publisher.subscribers().is_empty()
    }

    /// Sends a message to all subscribers.
    pub fn write(&self, bytes: Bytes) -> Result<(), WriteError> {
        self.publisher.publish(bytes).map_err(|error| WriteError::Failed(error.to_string()))
    }
}

impl Drop for FurtherNode {
    fn drop(&mut self) {
        let Some(node) = self.node.take() else { return };
        let mut leaving = self.leaving.lock();
        while leaving.try_join_next().is_some() {}
        leaving.spawn(node.leave());
    }
}

#[cfg(test)]
#[path = "../../../tests/unit/graph/ros1/publishers.rs"]
mod tests;
