//! The ROS 2 half of the proxy: a participant in a DDS domain, and readers and writers of topics of
//! any type in it.
//!
//! The node, which is how ROS tools see the proxy, is ros2-client's; readers and writers of types
//! unknown at compile time are made on the RustDDS participant beneath it. Nothing here knows of
//! the fabric; `route` joins the two.

mod action;
mod discovery;
mod domain_id;
mod graph;
mod names;
mod presence;
mod qos;
mod range;
mod raw;
mod service;

pub use crate::ros2::domain_id::MAX_DOMAIN_ID;
pub use action::Action;
pub use gdp_ros::names::NameError;
pub use graph::{ActionInfo, DisplayedQos, Endpoint, Graph, ServiceInfo, ServicePeer, TopicInfo, TypeHash};
pub use names::{Part, TopicName, TypeName};
pub use qos::{Depth, Durability, Qos, Reliability};
pub use range::{Range, RangeError};
pub use raw::{Arrived, ENCAPSULATION, RawReader, RawSample, RawWriter, Representation, Unreadable, WriteError};

pub use service::{BadRequest, CallError, Client, ClientLife, Headless, Mapping, ReceivedRequest, RequestId, Server};

use std::net::Ipv4Addr;
use std::sync::Arc;

use ros2_client::{Context, Node, NodeName, NodeOptions};
use rustdds::dds::CreateError;
use rustdds::{DomainParticipant, DomainParticipantBuilder, QosPolicies, TopicKind};
use tokio::sync::watch;
use tokio::task::JoinHandle;

use discovery::Discovery;
use gdp_ros::roster::Offer;
use graph::PROXY_TOPIC;

use crate::peer_proxies::{self, PeerProxies};
use presence::Presence;

/// The proxy's presence in a DDS domain, until it [leaves](Domain::leave).
pub struct Domain {
    participant: DomainParticipant,
    publisher: rustdds::Publisher,
    subscriber: rustdds::Subscriber,
    discovery: Arc<Discovery>,
    /// Announces the proxy to ROS tools (`ros2 node list`) as long as it lives.
    node: Node,
    watch: JoinHandle<()>,
    /// What the other proxies carry, and what tells them that this is one.
    peer_proxies: Arc<PeerProxies>,
    presence: Option<JoinHandle<()>>,
}

/// What DDS refused to make.
#[derive(Debug, thiserror::Error)]
pub enum RosError {
    #[error(
        "cannot join DDS domain {domain}: {source}; is a network interface up (in a namespace: `ip link set lo up`), \
         and is \
         the domain the one in ROS_DOMAIN_ID?"
    )]
    Join { domain: u16, source: CreateError },
    #[error("cannot announce the ROS node /{node}: {reason}")]
    Node { node: String, reason: String },
    #[error(transparent)]
    Range(#[from] RangeError),
    #[error(transparent)]
    Name(#[from] NameError),
    #[error("cannot make a DDS {what} for {topic}: {source}")]
    Endpoint { what: &'static str, topic: TopicName, source: CreateError },
}

impl Domain {
    /// Joins a domain, at most [`MAX_DOMAIN_ID`], as the ROS node `node` in the root namespace, as
    /// far as the environment says. Needs a tokio runtime.
    pub fn join(domain: u16, node: &str) -> Result<Self, RosError> {
        Self::join_within(Range::from_variables(|variable| std::env::var(variable).ok())?, domain, node)
    }

    pub fn join_within(range: Range, domain: u16, node: &str) -> Result<Self, RosError> {
        let refused = |source| RosError::Join { domain, source };
        let builder = DomainParticipantBuilder::new(domain);
        let builder = match range {
            // It tells others of no other address, and asks by no other interface.
            Range::Localhost => builder.with_only_networks([Ipv4Addr::LOCALHOST]),
            Range::Subnet => builder,
        };
        let participant = builder.build().map_err(refused)?;
        let none = QosPolicies::qos_none();
        let publisher = participant.create_publisher(&none).map_err(refused)?;
        let subscriber = participant.create_subscriber(&none).map_err(refused)?;
        let discovery = Arc::new(Discovery::default());
        let node = announce(&participant, node)?;
        let watch = tokio::spawn(discovery.clone().watch(participant.clone()));
        let peer_proxies = Arc::default();
        Ok(Self { participant, publisher, subscriber, discovery, node, watch, peer_proxies, presence: None })
    }

    /// The same, and tells other proxies that this is one: they take nothing from it.
    pub fn join_as_proxy(domain: u16, node: &str) -> Result<Self, RosError> {
        let mut joined = Self::join(domain, node)?;
        let (topic, kind) = (TopicName::parse("/gdp_proxy")?, TypeName::parse("gdp_proxy/msg/Presence")?);
        let writer = joined.raw_writer(&topic, PROXY_TOPIC, &kind, &Qos::default().into())?;
        let reader = joined.raw_reader(&topic, PROXY_TOPIC, &kind, &Qos::default().into())?;
        joined.presence =
            Some(tokio::spawn(peer_proxies::beat(joined.peer_proxies.clone(), Presence { writer, reader })));
        Ok(joined)
    }

    /// What other proxies in the domain carry.
    pub fn peer_proxies(&self) -> &Arc<PeerProxies> {
        &self.peer_proxies
    }

    /// What the others in the domain publish, subscribe to, serve and call, and every change of it.
    pub fn graph(&self) -> watch::Receiver<Arc<Graph>> {
        self.discovery.graph()
    }

    pub fn reader(&self, topic: &TopicName, kind: &TypeName, offers: &Offer) -> Result<RawReader, RosError> {
        self.raw_reader(topic, &topic.to_dds(), kind, offers)
    }

    pub fn writer(&self, topic: &TopicName, kind: &TypeName, offers: &Offer) -> Result<RawWriter, RosError> {
        self.raw_writer(topic, &topic.to_dds(), kind, offers)
    }

    /// A reader of a DDS topic that belongs to `name`.
    fn raw_reader(&self, name: &TopicName, dds: &str, kind: &TypeName, offers: &Offer) -> Result<RawReader, RosError> {
        let refused = |source| RosError::Endpoint { what: "reader", topic: name.clone(), source };
        let policies = qos::reader(offers);
        let (topic, kind) = self.topic(dds, kind, &policies).map_err(refused)?;
        RawReader::new(&self.subscriber, &topic, kind, policies).map_err(refused)
    }

    fn raw_writer(&self, name: &TopicName, dds: &str, kind: &TypeName, offers: &Offer) -> Result<RawWriter, RosError> {
        let refused = |source| RosError::Endpoint { what: "writer", topic: name.clone(), source };
        let policies = qos::writer(offers);
        let (topic, kind) = self.topic(dds, kind, &policies).map_err(refused)?;
        RawWriter::new(&self.publisher, &topic, kind, policies).map_err(refused)
    }

    /// With its type, for its endpoint to hold.
    fn topic(&self, dds: &str, kind: &TypeName, qos: &QosPolicies) -> Result<(rustdds::Topic, Arc<str>), CreateError> {
        let topic = self.participant.create_topic(dds.to_owned(), kind.to_dds(), qos, TopicKind::NoKey)?;
        Ok((topic, self.discovery.expect(dds, kind)))
    }

    /// Says goodbye to the other participants, so that they do not wait for a lease to end. Readers
    /// and writers of the domain are of no use afterwards.
    pub async fn leave(self) {
        // The task holds the participant as well; RustDDS leaves when the last owner does, and
        // joins its threads then.
        for task in self.presence.into_iter().chain([self.watch]) {
            task.abort();
            let _ = task.await;
        }
        let rest = (self.node, self.publisher, self.subscriber, self.participant);
        let _ = tokio::task::spawn_blocking(move || drop(rest)).await;
    }
}

/// Tells ROS tools of the proxy. A node of ros2-client also has a spinner, which must not run here:
/// it would take the participant's events away from [`Discovery`], and offer the node's parameters
/// to everybody in the domain.
fn announce(participant: &DomainParticipant, node: &str) -> Result<Node, RosError> {
    let refused = |reason: String| RosError::Node { node: node.to_owned(), reason };
    let name = NodeName::new("/", node).map_err(|error| refused(error.to_string()))?;
    let context = Context::from_domain_participant(participant.clone()).map_err(|error| refused(error.to_string()))?;
    context.new_node(name, NodeOptions::new().enable_rosout(false)).map_err(|error| refused(error.to_string()))
}
