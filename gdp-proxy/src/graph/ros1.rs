//! A topic at a ROS 1 master.

mod action_client;
mod action_server;
pub mod actions;
mod publishers;

pub use action_client::ActionClient;
pub use action_server::ActionServer;

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use bytes::Bytes;
use futures::FutureExt;
use gdp_ros1::{
    Message, MessageType, Node, NodeConfig, NodeError, PublishOptions, PublisherInfo, QueueLimits, SourceState,
    SourceStates, SubscribeOptions, Subscription,
};
use tokio::sync::watch;
use tokio::task::JoinHandle;

use self::publishers::{GraphPublisher, Publishers};
use crate::config::Ros1Config;
use crate::graph::event::{Arrived, Event, GraphError, Key, NODE, WriteError};
use crate::peer_proxies::{self, PeerProxies, Voice};
use crate::ros2::TopicName;
use gdp_ros::roster::{Dialect, Kind, Offer};

/// The offer of a ROS 1 publisher: it waits for no subscriber, and its subscribers queue messages.
const OFFER: Offer = Offer::DEFAULT;

/// The proxy's nodes at one master.
pub struct Master {
    node: Node,
    publishers: Publishers,
    peer_proxies: Arc<PeerProxies>,
    presence: JoinHandle<()>,
}

/// Topic of the proxies' announcements at a master, of type `std_msgs/String`.
const PRESENCE: &str = "/gdp_proxy/carries";
const STRING_MD5: &str = "992ce8a1687cec8c8bd883ec73ca41d1";

impl Master {
    /// Joins as the ROS node `name`, without a leading slash. The master may start later.
    pub async fn join(config: &Ros1Config, name: &str) -> Result<Self, NodeError> {
        let variable = |variable: &str| match variable {
            "ROS_MASTER_URI" => Some(config.master.clone()),
            "ROS_IP" | "ROS_HOSTNAME" if config.host.is_some() => config.host.clone(),
            other => std::env::var(other).ok(),
        };
        let config = NodeConfig::on_this_machine(&format!("/{name}"), variable);
        let node = Node::start(config.clone()).await?;
        let kind = MessageType {
            name: "std_msgs/String".into(),
            md5sum: STRING_MD5.into(),
            definition: "string data\n".into(),
        };
        let publisher = node.publish(PRESENCE, kind.clone(), PublishOptions::default())?;
        let options = SubscribeOptions { kind: Some((kind.name, kind.md5sum)), ..SubscribeOptions::default() };
        let voice = Presence { publisher, subscription: node.subscribe(PRESENCE, options)? };
        let peer_proxies: Arc<PeerProxies> = Arc::default();
        let presence = tokio::spawn(peer_proxies::beat(peer_proxies.clone(), voice));
        Ok(Self { node, publishers: Publishers::new(config), peer_proxies, presence })
    }

    /// Returns the other proxies at the master and what they carry.
    pub fn peer_proxies(&self) -> &Arc<PeerProxies> {
        &self.peer_proxies
    }

    pub fn graph(&self) -> gdp_ros1::Graph {
        self.node.graph()
    }

    pub fn node(&self) -> &Node {
        &self.node
    }

    pub async fn leave(self) {
        self.presence.abort();
        tokio::join!(self.node.leave(), self.publishers.leave());
    }
}

struct Presence {
    publisher: gdp_ros1::Publisher,
    subscription: Subscription,
}

impl Voice for Presence {
    async fn tell(&mut self, text: String) {
        let bytes = [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat();
        if let Err(error) = self.publisher.publish(bytes.into()) {
            tracing::warn!("other proxies at the master do not hear of this one: {error}");
        }
    }

    async fn hear(&mut self) -> Option<Vec<u8>> {
        Some(self.subscription.next().await?.data.get(4..).unwrap_or_default().to_vec())
    }
}

/// A reader of a topic.
pub struct Ros1Reader {
    subscription: Subscription,
    sources: watch::Receiver<SourceStates>,
    /// The publishers by their URIs.
    known: BTreeMap<String, (Key, Arc<PublisherInfo>)>,
    next_key: Key,
    definition: Option<String>,
    events: VecDeque<Event>,
}

impl Ros1Reader {
    pub fn new(master: &Master, topic: &TopicName) -> Result<Self, NodeError> {
        let subscription = master.node.subscribe(topic.as_str(), SubscribeOptions::default())?;
        let mut sources = subscription.sources();
        sources.mark_changed();
        let (known, events) = (BTreeMap::new(), VecDeque::new());
        Ok(Self { subscription, sources, known, next_key: 0, definition: None, events })
    }

    pub fn definition(&self) -> Option<&str> {
        self.definition.as_deref()
    }

    /// Waits for the next event. Returns `None` once the node has left. Safe to cancel.
    pub async fn next(&mut self) -> Option<Event> {
        loop {
            if let Some(event) = self.events.pop_front() {
                return Some(event);
            }
            tokio::select! {
                biased;
                Ok(()) = self.sources.changed() => self.look(),
                message = self.subscription.next() => {
                    self.take(message?);
                }
            }
        }
    }

    fn take(&mut self, message: Message) {
        if is_proxy(&message.publisher.caller_id) {
            return;
        }
        // The message may arrive before its connection is announced.
        self.joined(&message.publisher);
        let from = self.known.get(&message.publisher.uri).map(|(key, _)| *key);
        self.events.push_back(Event::Message(Arrived { from, bytes: message.data, written_ns: None, lost: 0 }));
    }

    fn look(&mut self) {
        // The queued messages come from the publishers that were connected.
        while let Some(Some(message)) = self.subscription.next().now_or_never() {
            self.take(message);
        }
        let sources = self.sources.borrow_and_update().clone();
        let connected = |uri: &String| matches!(sources.get(uri), Some(SourceState::Connected(_)));
        let gone: Vec<String> = self.known.keys().filter(|uri| !connected(uri)).cloned().collect();
        for uri in gone {
            let key = self.known.remove(&uri).map(|(key, _)| key);
            self.events.extend(key.map(Event::Left));
        }
        for source in sources.values() {
            match source {
                SourceState::Connected(publisher) if !is_proxy(&publisher.caller_id) => self.joined(publisher),
                _ => {}
            }
        }
    }

    fn joined(&mut self, publisher: &Arc<PublisherInfo>) {
        let key = match self.known.get(&publisher.uri) {
            Some((_, before)) if before == publisher => return,
            Some((key, _)) => *key,
            None => {
                self.next_key += 1;
                self.next_key
            }
        };
        self.known.insert(publisher.uri.clone(), (key, publisher.clone()));
        if self.definition.is_none() && !publisher.definition.is_empty() {
            self.definition = Some(publisher.definition.clone());
        }
        let hash = hex::decode(&publisher.md5sum).unwrap_or_default();
        let kind = Kind { dialect: Dialect::Ros1, name: publisher.kind.clone(), hash };
        let offers = match publisher.latching {
            true => Offer { transient_local: true, depth: 1, ..OFFER },
            false => OFFER,
        };
        let node = publisher.caller_id.as_str().into();
        self.events.push_back(Event::Joined { key, kind, node, offers });
    }
}

/// Whether the node is this proxy or another one. Their messages come from the fabric, where other
/// graphs can read them.
pub fn is_proxy(caller_id: &str) -> bool {
    caller_id.strip_prefix('/').is_some_and(|name| name.starts_with(NODE))
}

/// A writer on behalf of a remote publisher.
pub struct Ros1Writer(Arc<GraphPublisher>);

impl Ros1Writer {
    pub async fn new(
        master: &Master,
        topic: &TopicName,
        kind: &Kind,
        definition: Option<&str>,
        md5sum: String,
        offers: Offer,
    ) -> Result<Self, GraphError> {
        let (name, definition) = (kind.name.clone(), definition.unwrap_or_default().to_owned());
        let kind = MessageType { name, md5sum, definition };
        let messages = if offers.depth == 0 { QueueLimits::default().messages } else { offers.depth as usize };
        let queue = QueueLimits { messages: messages.max(10), ..QueueLimits::default() };
        let options = PublishOptions { latch: offers.transient_local, queue };
        Ok(Self(master.publishers.publish(&master.node, topic.as_str(), kind, options).await?))
    }

    pub fn vacate(&self) {
        self.0.vacate();
    }

    pub fn is_matched(&self) -> bool {
        self.0.is_matched()
    }

    pub fn write(&self, bytes: Bytes) -> Result<(), WriteError> {
        self.0.write(bytes)
    }
}
