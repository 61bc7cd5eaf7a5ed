//! Chooses the node that publishes a topic: the proxy's main node if it can, otherwise one that is
//! made for it.
//!
//! A node of ROS 1 publishes a topic once, and latches one message of it. So counterparts that
//! latch nothing share one publisher, and each that latches has one of its own. The first of these
//! is at the main node: clients of actionlib take a server for connected only if the node that
//! latches `status` is the one that subscribes to `goal` and `cancel`.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Weak};

use bytes::Bytes;
use gdp_ros1::{MessageType, Node, NodeConfig, PublishOptions};
use parking_lot::{Mutex, MutexGuard};
use tokio::task::JoinSet;

use crate::graph::event::{GraphError, WriteError};

/// The publishers of one proxy at one master.
pub struct Publishers {
    config: NodeConfig,
    topics: Mutex<HashMap<String, PublishedTopic>>,
    /// How many nodes were made for one publisher.
    made: AtomicU32,
    /// Those of them that take leave of the master.
    leaving: Leaving,
}

/// Nodes that take leave.
type Leaving = Arc<Mutex<JoinSet<()>>>;

#[derive(Default)]
struct PublishedTopic {
    at_main: Weak<Publisher>,
    /// What counterparts that latch nothing share.
    unlatched: Weak<Publisher>,
}

/// Publishes one topic at one node, as long as somebody has it.
pub struct Publisher {
    kind: MessageType,
    latches: bool,
    /// Its counterpart has left, and only lets its last messages arrive.
    is_vacant: AtomicBool,
    publisher: gdp_ros1::Publisher,
    /// If it is not the main node.
    own_node: Option<(Node, Leaving)>,
}

impl Publishers {
    /// `config`: of the main node, after which the others are called.
    pub fn new(config: NodeConfig) -> Self {
        Self { config, topics: Mutex::default(), made: AtomicU32::new(0), leaving: Leaving::default() }
    }

    /// A publisher for one more counterpart; `main` is the proxy's node.
    pub async fn publish(
        &self,
        main: &Node,
        topic: &str,
        kind: MessageType,
        options: PublishOptions,
    ) -> Result<Arc<Publisher>, GraphError> {
        if let Some(publisher) = self.share_or_publish_at(main, topic, &kind, options)? {
            return Ok(publisher);
        }
        let number = self.made.fetch_add(1, Ordering::Relaxed);
        let name = format!("{}_at_{number}", self.config.name);
        let node = Node::start(NodeConfig { name, ..self.config.clone() }).await?;
        let publisher = node.publish(topic, kind.clone(), options)?;
        let own_node = Some((node, self.leaving.clone()));
        let publisher = Arc::new(Publisher::new(publisher, kind, options.latch, own_node));
        if !options.latch {
            self.topics().entry(topic.to_owned()).or_default().unlatched = Arc::downgrade(&publisher);
        }
        Ok(publisher)
    }

    /// `None` if it takes a node of its own.
    fn share_or_publish_at(
        &self,
        main: &Node,
        topic: &str,
        kind: &MessageType,
        options: PublishOptions,
    ) -> Result<Option<Arc<Publisher>>, GraphError> {
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
        let publisher = Arc::new(Publisher::new(publisher, kind.clone(), options.latch, None));
        known.at_main = Arc::downgrade(&publisher);
        if !options.latch {
            known.unlatched = Arc::downgrade(&publisher);
        }
        Ok(Some(publisher))
    }

    /// Waits for the nodes that take leave of the master.
    pub async fn leave(&self) {
        let mut leaving = std::mem::take(&mut *self.leaving.lock());
        while leaving.join_next().await.is_some() {}
    }

    fn topics(&self) -> MutexGuard<'_, HashMap<String, PublishedTopic>> {
        self.topics.lock()
    }
}

impl Publisher {
    fn new(
        publisher: gdp_ros1::Publisher,
        kind: MessageType,
        latches: bool,
        own_node: Option<(Node, Leaving)>,
    ) -> Self {
        Self { kind, latches, is_vacant: AtomicBool::new(false), publisher, own_node }
    }

    fn is_of(&self, kind: &MessageType) -> bool {
        (&self.kind.name, &self.kind.md5sum) == (&kind.name, &kind.md5sum)
    }

    /// Whether it is from now on that of another counterpart, because the one that it was for has
    /// left.
    fn take_over(&self) -> bool {
        let is_vacant = self.latches && self.is_vacant.swap(false, Ordering::Relaxed);
        if is_vacant {
            self.publisher.forget_latched();
        }
        is_vacant
    }

    /// Its counterpart has left: the next one may have its place before its last messages have
    /// arrived.
    pub fn vacate(&self) {
        self.is_vacant.store(true, Ordering::Relaxed);
    }

    /// Whether a subscriber is connected.
    pub fn is_matched(&self) -> bool {
        !self.publisher.subscribers().is_empty()
    }

    /// Hands a message to all subscribers.
    pub fn write(&self, bytes: Bytes) -> Result<(), WriteError> {
        self.publisher.publish(bytes).map_err(|error| WriteError::Failed(error.to_string()))
    }
}

impl Drop for Publisher {
    fn drop(&mut self) {
        let Some((node, leaving)) = self.own_node.take() else { return };
        let mut leaving = leaving.lock();
        while leaving.try_join_next().is_some() {}
        leaving.spawn(node.leave());
    }
}

#[cfg(test)]
#[path = "../../../tests/unit/graph/ros1/publishers.rs"]
mod tests;
