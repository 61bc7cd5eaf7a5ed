//! The ROS 2 half of the proxy: a participant in a DDS domain, with readers and writers of topics
//! of any type.
//!
//! Readers and writers of types that are unknown at compile time are created on a RustDDS
//! participant. [`nodes`] records to which ROS node each belongs, and [`announcer`] tells ROS
//! tools. This module does not use the fabric; `route` connects the two.

mod action;
mod announcer;
mod discovery;
mod domain_id;
mod gaps;
mod graph;
mod names;
mod nodes;
mod presence;
mod qos;
mod range;
mod raw;
mod raw_reader;
mod sample;
mod service;

pub use crate::ros2::domain_id::MAX_DOMAIN_ID;
pub use action::Action;
pub use gdp_ros::names::NameError;
pub use graph::{ActionInfo, DisplayedQos, Endpoint, Graph, ServiceInfo, ServicePeer, TopicInfo, TypeHash};
pub use names::{Part, TopicName, TypeName};
pub use qos::{Depth, Durability, Qos, Reliability};
pub use range::{Range, RangeError};
pub use raw::{ImmediateWriter, RawWriter, WriteError};
pub use raw_reader::{Arrived, RawReader, SampleSink, Unreadable, WriterChange};
pub use sample::{ENCAPSULATION, RawSample, Representation};

pub use service::{
    BadRequest, CallError, ClientLife, DdsClient, Headless, Mapping, ReceivedRequest, RequestId, Server,
};

use std::net::Ipv4Addr;
use std::sync::Arc;

use ros2_client::NodeName;
use rustdds::dds::CreateError;
use rustdds::{DomainParticipant, DomainParticipantBuilder, QosPolicies, RTPSEntity, TopicKind};
use tokio::sync::watch;
use tokio::task::JoinHandle;

use discovery::Discovery;
use gdp_ros::roster::{Kind, Offer};
use graph::PROXY_TOPIC;
use nodes::Nodes;

use crate::peer_proxies::{self, PeerProxies};
use presence::Presence;

/// Messages about nodes, of all participants together, that wait to be read. DDS keeps as many
/// after they were read.
const WAITING_NODES: u32 = 256;

/// The proxy's participant in a DDS domain, until it [leaves](Domain::leave).
pub struct Domain {
    participant: DomainParticipant,
    publisher: rustdds::Publisher,
    subscriber: rustdds::Subscriber,
    discovery: Arc<Discovery>,
    /// Announces the proxy and remote nodes to ROS tools (`ros2 node list`).
    nodes: Arc<Nodes>,
    /// The tasks that follow discovery and announce the nodes.
    tasks: Vec<JoinHandle<()>>,
    /// The claims of the other proxies.
    peer_proxies: Arc<PeerProxies>,
    /// The task that announces this proxy to them.
    presence: Option<JoinHandle<()>>,
}

/// Errors of DDS and of the environment.
#[derive(Debug, thiserror::Error)]
pub enum RosError {
    #[error(
        "cannot join DDS domain {domain}: {source}; is a network interface up (in a namespace: `ip link set lo up`), \
         and is \
         the domain the one in ROS_DOMAIN_ID?"
    )]
    Join { domain: u16, source: CreateError },
    #[error("{node:?} cannot be the name of a ROS node: {reason}")]
    Node { node: String, reason: String },
    #[error(transparent)]
    Range(#[from] RangeError),
    #[error(transparent)]
    Name(#[from] NameError),
    #[error("cannot make a DDS {what} for {topic}: {source}")]
    Endpoint { what: &'static str, topic: TopicName, source: CreateError },
}

impl Domain {
    /// Joins a domain, at most [`MAX_DOMAIN_ID`], as the ROS node `node` in the root namespace. The
    /// environment sets the range of discovery. Needs a tokio runtime.
    pub fn join(domain: u16, node: &str) -> Result<Self, RosError> {
        Self::join_within(Range::from_variables(|variable| std::env::var(variable).ok())?, domain, node)
    }

    pub fn join_within(range: Range, domain: u16, node: &str) -> Result<Self, RosError> {
        let refused = |source| RosError::Join { domain, source };
        let peers = range::static_peers(range, |variable| std::env::var(variable).ok());
        let builder = DomainParticipantBuilder::new(domain).with_initial_peers(peers);
        let builder = match range {
            // The participant announces no other address, and sends multicast on no other
            // interface.
            Range::Localhost => builder.with_only_networks([Ipv4Addr::LOCALHOST]),
            Range::Subnet => builder,
        };
        let participant = builder.build().map_err(refused)?;
        let none = QosPolicies::qos_none();
        let publisher = participant.create_publisher(&none).map_err(refused)?;
        let subscriber = participant.create_subscriber(&none).map_err(refused)?;
        let discovery = Arc::new(Discovery::default());
        let name = NodeName::new("/", node)
            .map_err(|error| RosError::Node { node: node.to_owned(), reason: error.to_string() })?;
        let nodes = Arc::new(Nodes::new(participant.guid(), name));
        let watch = tokio::spawn(discovery.clone().watch(participant.clone(), nodes.clone()));
        let (peer_proxies, tasks) = (Arc::default(), vec![watch]);
        let mut joined =
            Self { participant, publisher, subscriber, discovery, nodes, tasks, peer_proxies, presence: None };
        joined.announce()?;
        Ok(joined)
    }

    /// Starts the task that announces the nodes of this participant and reads those of the others.
    fn announce(&mut self) -> Result<(), RosError> {
        let (topic, kind) = (TopicName::parse("/ros_discovery_info")?, TypeName::parse(nodes::TYPE)?);
        let latched = Offer { transient_local: true, depth: 1, ..Qos::default().into() };
        let writer = self.raw_writer(&topic, nodes::TOPIC, &kind, &[], &latched)?;
        let all = Offer { depth: WAITING_NODES, ..latched };
        let reader = self.raw_reader(&topic, nodes::TOPIC, &kind, &[], &all)?;
        self.tasks.push(tokio::spawn(announcer::run(self.nodes.clone(), writer, reader)));
        Ok(())
    }

    /// Joins as [`Self::join`], and announces to other proxies that this is one: they ignore its
    /// endpoints.
    pub fn join_as_proxy(domain: u16, node: &str) -> Result<Self, RosError> {
        let mut joined = Self::join(domain, node)?;
        let (topic, kind) = (TopicName::parse("/gdp_proxy")?, TypeName::parse("gdp_proxy/msg/Presence")?);
        let writer = joined.raw_writer(&topic, PROXY_TOPIC, &kind, &[], &Qos::default().into())?;
        let reader = joined.raw_reader(&topic, PROXY_TOPIC, &kind, &[], &Qos::default().into())?;
        joined.presence =
            Some(tokio::spawn(peer_proxies::beat(joined.peer_proxies.clone(), Presence { writer, reader })));
        Ok(joined)
    }

    /// Joins the domain on network interfaces that came up after the start.
    pub fn interfaces_changed(&self) {
        // It fails only while the participant leaves.
        _ = self.participant.interfaces_changed();
    }

    pub fn domain_id(&self) -> u16 {
        self.participant.domain_id()
    }

    /// Returns the other proxies in the domain and what they carry.
    pub fn peer_proxies(&self) -> &Arc<PeerProxies> {
        &self.peer_proxies
    }

    /// Returns what others in the domain publish, subscribe to, serve and call, with every change.
    pub fn graph(&self) -> watch::Receiver<Arc<Graph>> {
        self.discovery.graph()
    }

    pub fn reader(&self, topic: &TopicName, kind: &TypeName, offers: &Offer) -> Result<RawReader, RosError> {
        self.raw_reader(topic, &topic.to_dds(), kind, &[], offers)
    }

    /// Creates a reader that announces the hash of its type.
    pub fn reader_of(&self, topic: &TopicName, kind: &Kind, offers: &Offer) -> Result<RawReader, RosError> {
        self.raw_reader(topic, &topic.to_dds(), &TypeName::parse(&kind.name)?, &kind.hash, offers)
    }

    pub fn writer(&self, topic: &TopicName, kind: &TypeName, offers: &Offer) -> Result<RawWriter, RosError> {
        self.raw_writer(topic, &topic.to_dds(), kind, &[], offers)
    }

    /// Creates a writer that announces the hash of its type.
    pub fn writer_of(&self, topic: &TopicName, kind: &Kind, offers: &Offer) -> Result<RawWriter, RosError> {
        self.raw_writer(topic, &topic.to_dds(), &TypeName::parse(&kind.name)?, &kind.hash, offers)
    }

    /// Creates a reader of the DDS topic of `name`. `hash` is that of the type, or empty.
    fn raw_reader(
        &self,
        name: &TopicName,
        dds: &str,
        kind: &TypeName,
        hash: &[u8],
        offers: &Offer,
    ) -> Result<RawReader, RosError> {
        let refused = |source| RosError::Endpoint { what: "reader", topic: name.clone(), source };
        let policies = qos::reader(offers).with_user_data(graph::user_data(hash));
        let (topic, kind) = self.topic(dds, kind, &policies).map_err(refused)?;
        RawReader::new(&self.subscriber, &topic, kind, policies, &self.nodes).map_err(refused)
    }

    fn raw_writer(
        &self,
        name: &TopicName,
        dds: &str,
        kind: &TypeName,
        hash: &[u8],
        offers: &Offer,
    ) -> Result<RawWriter, RosError> {
        let refused = |source| RosError::Endpoint { what: "writer", topic: name.clone(), source };
        let policies = qos::writer(offers).with_user_data(graph::user_data(hash));
        let (topic, kind) = self.topic(dds, kind, &policies).map_err(refused)?;
        RawWriter::new(&self.publisher, &topic, kind, policies, &self.nodes).map_err(refused)
    }

    /// Creates a DDS topic, and registers its type until the endpoint drops it.
    fn topic(&self, dds: &str, kind: &TypeName, qos: &QosPolicies) -> Result<(rustdds::Topic, Arc<str>), CreateError> {
        let topic = self.participant.create_topic(dds.to_owned(), kind.to_dds(), qos, TopicKind::NoKey)?;
        Ok((topic, self.discovery.expect(dds, kind)))
    }

    /// Announces the departure to the other participants, so that they do not wait for a lease to
    /// expire. Readers and writers of the domain do not work afterwards.
    pub async fn leave(self) {
        // The tasks own the participant as well. RustDDS leaves when the last owner drops it, and
        // then joins its threads.
        for task in self.presence.into_iter().chain(self.tasks) {
            task.abort();
            let _ = task.await;
        }
        let rest = (self.publisher, self.subscriber, self.participant);
        let _ = tokio::task::spawn_blocking(move || drop(rest)).await;
    }
}
