//! A ROS graph as the routes see it, of any kind: publishers of a topic, their messages,
//! and writers on behalf of remote publishers. A message is in the graph's own encoding, and this
//! module does not parse it.

mod actions;
mod event;
mod graph_observer;
mod ros1;
mod ros2;
mod services;
mod zenoh;

pub use crate::graph::event::{ArrivalSink, Arrived, Event, GraphError, Incompatibility, Key, NODE, WriteError};
pub use actions::{ActionCaller, ActionStand};
pub use services::{Asked, Asker, Caller, CallerError, Peer, Servers, Stand};

use std::collections::BTreeMap;
use std::sync::Arc;

use bytes::Bytes;

use crate::config::{GraphConfig, Graphs};
use crate::peer_proxies::PeerProxies;
use crate::ros2::{Domain, Qos, TopicName, TypeName};
use gdp_ros::roster::{Dialect, Kind, Offer};
use gdp_ros::types::Types;

pub use graph_observer::{Found, GraphObserver, Offered, TopicUse, names_in};
pub use ros2::ImmediateWriter;

/// One ROS graph, until it is [left](Self::leave).
pub enum Graph {
    Ros1(Box<ros1::Master>),
    Ros2(Box<Domain>),
    Zenoh(Box<zenoh::ZenohGraph>),
}

/// A reader of a topic, which ignores what this proxy itself writes.
pub enum Reader<'a> {
    Ros1(ros1::Ros1Reader),
    Ros2(Box<ros2::Ros2Reader<'a>>),
    Zenoh(Box<zenoh::ZenohReader<'a>>),
}

/// A writer on behalf of one remote publisher. Subscribers see it leave when it is dropped.
pub enum Writer {
    Ros1(ros1::Ros1Writer),
    Ros2(Box<ros2::Ros2Writer>),
    Zenoh(Box<zenoh::ZenohWriter>),
}

/// All graphs of the proxy, by their names in the configuration.
pub type All = BTreeMap<String, Arc<Graph>>;

/// Joins the graphs that are not in `joined` yet, as the ROS node `node`. After an error it leaves
/// the new ones.
pub async fn join(joined: &mut All, graphs: &Graphs, node: &str) -> Result<(), GraphError> {
    let mut new = All::new();
    for (name, graph) in graphs.iter().filter(|(name, _)| !joined.contains_key(*name)) {
        match Graph::join(graph, node).await {
            Ok(graph) => _ = new.insert(name.to_owned(), graph.into()),
            Err(error) => {
                leave(new).await;
                return Err(error);
            }
        }
    }
    joined.append(&mut new);
    Ok(())
}

/// Leaves all graphs.
pub async fn leave(graphs: All) {
    for graph in graphs.into_values() {
        if let Some(graph) = Arc::into_inner(graph) {
            graph.leave().await;
        }
    }
}

/// Checks that this program can join the graphs. Returns the first that it cannot join, with the
/// reason.
pub fn check(graphs: &Graphs) -> Result<(), (String, String)> {
    let mut zenoh = graphs.iter().filter_map(|(name, graph)| match graph {
        GraphConfig::Zenoh(config) => Some((name, config)),
        _ => None,
    });
    zenoh.try_for_each(|(name, config)| zenoh::check(config).map_err(|error| (name.to_owned(), error.to_string())))
}

impl Graph {
    async fn join(config: &GraphConfig, node: &str) -> Result<Self, GraphError> {
        match config {
            GraphConfig::Ros1(config) => Ok(Self::Ros1(ros1::Master::join(config, node).await?.into())),
            GraphConfig::Ros2(config) => Ok(Self::Ros2(Domain::join_as_proxy(config.domain_id.get(), node)?.into())),
            GraphConfig::Zenoh(config) => Ok(Self::Zenoh(zenoh::ZenohGraph::join(config, node)?.into())),
        }
    }

    /// Describes the graph for people, such as `domain 0`.
    pub fn describe(&self) -> String {
        match self {
            Self::Ros1(_) => "the graph of the ROS master".into(),
            Self::Ros2(domain) => format!("domain {}", domain.domain_id()),
            Self::Zenoh(_) => "the graph of the Zenoh router".into(),
        }
    }

    pub fn dialect(&self) -> Dialect {
        match self {
            Self::Ros1(_) => Dialect::Ros1,
            Self::Ros2(_) | Self::Zenoh(_) => Dialect::Ros2,
        }
    }

    /// Follows changes of this machine's network interfaces. A ROS 1 node listens on all of them,
    /// and Zenoh connects again by itself.
    pub fn interfaces_changed(&self) {
        if let Self::Ros2(domain) = self {
            domain.interfaces_changed();
        }
    }

    /// Returns the other proxies of the graph and what they carry.
    pub fn peer_proxies(&self) -> &Arc<PeerProxies> {
        match self {
            Self::Ros1(master) => master.peer_proxies(),
            Self::Ros2(domain) => domain.peer_proxies(),
            Self::Zenoh(graph) => graph.peer_proxies(),
        }
    }

    /// Returns the policy in which a local subscriber requests more than `offers`, if there is one.
    /// Such a subscriber receives nothing from a publisher with `offers`.
    pub fn misfit(&self, topic: &TopicName, offers: &Offer) -> Option<&'static str> {
        match self {
            // rmw_zenoh does not compare QoS.
            Self::Ros1(_) | Self::Zenoh(_) => None,
            Self::Ros2(domain) => ros2::misfit(domain, topic, offers),
        }
    }

    /// Returns a type as this graph writes it.
    pub fn kind(&self, kind: &TypeName) -> Kind {
        let name = match self.dialect() {
            Dialect::Ros1 => kind.to_ros1(),
            Dialect::Ros2 => kind.to_string(),
        };
        Kind { dialect: self.dialect(), name, hash: vec![] }
    }

    /// Reads a topic. Without `kind` it takes the type of the first publisher. Without `qos` it
    /// takes a QoS that is compatible with all publishers.
    pub fn reader(
        &self,
        topic: &TopicName,
        kind: Option<&TypeName>,
        qos: Option<Qos>,
    ) -> Result<Reader<'_>, GraphError> {
        match self {
            Self::Ros1(master) => Ok(Reader::Ros1(ros1::Ros1Reader::new(master, topic)?)),
            Self::Ros2(domain) => Ok(Reader::Ros2(ros2::Ros2Reader::new(domain, topic, kind, qos).into())),
            Self::Zenoh(graph) => Ok(Reader::Zenoh(graph.reader(topic, kind, qos).into())),
        }
    }

    /// Creates a writer. `definition` is that of the type: ROS 1 announces it to subscribers, and
    /// rmw_zenoh needs its hash.
    pub async fn writer(
        &self,
        types: &Types,
        topic: &TopicName,
        kind: &Kind,
        definition: Option<&str>,
        offers: Offer,
    ) -> Result<Writer, GraphError> {
        match self {
            Self::Ros1(master) => {
                let md5sum = types.md5sum(kind, definition)?;
                Ok(Writer::Ros1(ros1::Ros1Writer::new(master, topic, kind, definition, md5sum, offers).await?))
            }
            Self::Ros2(domain) => Ok(Writer::Ros2(ros2::Ros2Writer::new(domain, topic, kind, offers)?.into())),
            Self::Zenoh(graph) => {
                let hash = types.rihs01(kind, definition).map_err(|_| GraphError::NoHash(kind.name.clone()))?;
                Ok(Writer::Zenoh(graph.writer(topic, kind, &hash, offers)?.into()))
            }
        }
    }

    async fn leave(self) {
        match self {
            Self::Ros1(master) => master.leave().await,
            Self::Ros2(domain) => domain.leave().await,
            Self::Zenoh(graph) => graph.leave().await,
        }
    }
}

impl Reader<'_> {
    /// Waits for the next event. Safe to cancel.
    pub async fn next(&mut self) -> Result<Event, GraphError> {
        match self {
            Self::Ros1(reader) => reader.next().await.ok_or(GraphError::Left),
            Self::Ros2(reader) => Ok(reader.next().await?),
            Self::Zenoh(reader) => reader.next().await,
        }
    }

    /// Sets a function that takes messages of known publishers without the task that calls
    /// [`Self::next`]. It is asked only while that call waits and no earlier event is pending, so
    /// messages stay in their order. Only graphs of ROS 2 ask it.
    pub fn set_sink(&mut self, sink: Option<&ArrivalSink>) {
        if let Self::Ros2(reader) = self {
            reader.set_sink(sink);
        }
    }

    /// Reads the transient-local history once more.
    pub fn again(&mut self) -> Result<(), GraphError> {
        match self {
            // All ROS 1 publishers offer the same QoS, so this is never needed.
            Self::Ros1(_) => Ok(()),
            Self::Ros2(reader) => Ok(reader.again()?),
            Self::Zenoh(reader) => reader.again(),
        }
    }

    /// Returns the definition of the topic's type, if its publishers announce it.
    pub fn definition(&self) -> Option<&str> {
        match self {
            Self::Ros1(reader) => reader.definition(),
            Self::Ros2(_) | Self::Zenoh(_) => None,
        }
    }
}

impl Writer {
    /// Records that its publisher has left: another one may reuse it before it is dropped.
    pub fn vacate(&self) {
        if let Self::Ros1(writer) = self {
            writer.vacate();
        }
    }

    /// Shows the writer as one of the node with this full name. In ROS 1 it stays one of the proxy,
    /// because each node has an API of its own.
    pub fn assign(&mut self, node: &str) {
        match self {
            Self::Ros1(_) => {}
            Self::Ros2(writer) => writer.assign(node),
            Self::Zenoh(writer) => writer.assign(node),
        }
    }

    /// Changes the history depth in messages, 0 for as much as possible. In ROS 1 a latching
    /// publisher always keeps one.
    pub fn set_depth(&mut self, depth: u32) {
        if let Self::Ros2(writer) = self {
            writer.set_depth(depth);
        }
    }

    /// Whether a subscriber has matched the writer since the last call, or is connected.
    pub fn is_matched(&self) -> bool {
        match self {
            Self::Ros1(writer) => writer.is_matched(),
            Self::Ros2(writer) => writer.is_matched(),
            Self::Zenoh(writer) => writer.is_matched(),
        }
    }

    /// Returns a writer for other threads, which writes at once or not at all. Only graphs of ROS 2
    /// have one.
    pub fn immediate_writer(&self) -> Option<ImmediateWriter> {
        match self {
            Self::Ros2(writer) => Some(writer.immediate_writer()),
            Self::Ros1(_) | Self::Zenoh(_) => None,
        }
    }

    /// Writes one message with its source timestamp `timestamp_ns` in Unix nanoseconds.
    pub async fn write(&mut self, bytes: Bytes, timestamp_ns: u64) -> Result<(), WriteError> {
        match self {
            Self::Ros1(writer) => writer.write(bytes),
            Self::Ros2(writer) => writer.write(bytes, timestamp_ns).await,
            Self::Zenoh(writer) => writer.write(bytes, timestamp_ns).await,
        }
    }
}
